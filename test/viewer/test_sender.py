# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What the viewer sends before the node has been discovered."""

import time

import pytest

rclpy = pytest.importorskip('rclpy', reason='the sender needs ROS 2')
pytest.importorskip('viser', reason='the viewer needs the extra viewer')

from sensor_msgs.msg import JointState  # noqa: E402

from manip_sim.viewer.ros.commands import CommandSender  # noqa: E402


@pytest.mark.parametrize('forgotten', [False, True])
def test_the_last_goal_waits_for_the_node_unless_it_is_gone(node, forgotten):
    sender, taken = CommandSender(node, 'sim', {}, pytest.fail), []
    sender.prepare({'/arm/joint_command': JointState})
    for goal in (0.1, 0.2):
        sender.move_joints('/', 'arm', 'position', {'joint1': goal})
    if forgotten:
        sender.forget_waiting()
    executor = rclpy.executors.SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    node.create_subscription(JointState, '/arm/joint_command', taken.append, 10)
    end = time.monotonic() + (1.0 if forgotten else 30.0)
    while not taken and time.monotonic() < end:
        sender.send_waiting()
        executor.spin_once(timeout_sec=0.02)
    executor.shutdown()
    assert [list(message.position) for message in taken] == ([] if forgotten else [[0.2]])
