# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
What a node may do in an enclave of SROS2, or a stranger without one, as JSON.

``control`` commands the first joint, resets, and tries what a controller may not do. ``look``
tells which nodes are seen by one of two participants as soon as it sees the other one.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

from rcl_interfaces.srv import SetParameters
import rclpy
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger

_PATIENCE_S = 300.0
GOAL = 0.2


def _allowed(create: Any, *arguments: Any) -> Any:
    """Return a publisher, subscription or client, or None if it is not permitted."""
    try:
        return create(*arguments)
    except Exception as error:  # Each middleware has its own.
        print(error, file=sys.stderr)
        return None


def _spin(executor: SingleThreadedExecutor, condition: Any) -> None:
    end_s = time.monotonic() + _PATIENCE_S
    while not condition():
        assert time.monotonic() < end_s, 'timed out'
        executor.spin_once(timeout_sec=0.05)


def control(node: Any, executor: SingleThreadedExecutor) -> dict[str, Any]:
    """Do what a controller may do, and try the rest."""
    positions: list[float] = []

    def is_there() -> bool:
        commands.publish(JointState(name=['robot0_joint1'], position=[GOAL]))
        return bool(positions) and abs(positions[-1] - GOAL) < 0.02
    node.create_subscription(JointState, 'joint_states', lambda message: positions.append(
        message.position[message.name.index('robot0_joint1')]), 10)
    commands = node.create_publisher(JointState, 'arm/joint_command', 10)
    _spin(executor, is_there)
    reset = node.create_client(Trigger, 'manip_sim/reset')
    _spin(executor, reset.service_is_ready)
    answer = reset.call_async(Trigger.Request())
    _spin(executor, answer.done)
    return {
        'joint': GOAL, 'reset': answer.result().success, 'beyond': [name for name, found in {
            'publish joint_states': _allowed(
                node.create_publisher, JointState, 'joint_states', 10),
            'publish chatter': _allowed(node.create_publisher, String, 'chatter', 10),
            'subscribe chatter': _allowed(
                node.create_subscription, String, 'chatter', lambda _: None, 10),
            'call set_parameters': _allowed(
                node.create_client, SetParameters, 'manip_sim/set_parameters')}.items()
            if found is not None]}


def look(node: Any, executor: SingleThreadedExecutor) -> dict[str, Any]:
    """Return the nodes that are seen when discovery has worked."""
    context = rclpy.Context()
    rclpy.init(context=context, args=sys.argv)
    # In an enclave, the policy knows this name alone.
    other = rclpy.create_node('controller', context=context)
    _spin(executor, lambda: len(node.get_node_names()) > 1)
    found = sorted(node.get_node_names())
    other.destroy_node()
    rclpy.shutdown(context=context)
    return {'nodes': found}


def main() -> None:
    """Print what was found."""
    rclpy.init(args=sys.argv)
    node = rclpy.create_node('controller')
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    print(json.dumps({'control': control, 'look': look}[sys.argv[1]](node, executor)))
    rclpy.shutdown()


if __name__ == '__main__':
    main()
