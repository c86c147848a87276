# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A lock-step controller of one arm, as a process: prints a hash of all states that it saw."""

import hashlib
import math
import sys

import rclpy
from sensor_msgs.msg import JointState


def main(arm, cycles):
    """Move all joints of an arm on sines and answer each state once."""
    rclpy.init()
    node = rclpy.create_node(f'{arm}_controller')
    publisher = node.create_publisher(JointState, f'{arm}/joint_command', 10)
    digest, stamps, start = hashlib.sha256(), [], []

    def answer(state):
        stamp_ns = state.header.stamp.sec * 10**9 + state.header.stamp.nanosec
        if stamps and stamp_ns <= stamps[-1]:
            return
        stamps.append(stamp_ns)
        start[:] = start or state.position
        for field in (state.position, state.velocity, state.effort):
            digest.update(field.tobytes())
        sway = 0.1 * math.sin(2.0 * math.pi * 0.5 * stamp_ns * 1e-9)
        command = JointState(name=state.name, position=[p + sway for p in start])
        command.header.stamp = state.header.stamp
        publisher.publish(command)

    # An answer that nobody takes is not repeated, and the node would wait for it.
    while not publisher.get_subscription_count():
        rclpy.spin_once(node, timeout_sec=0.1)
    node.create_subscription(JointState, f'{arm}/joint_states', answer, 10)
    while len(stamps) < cycles:
        rclpy.spin_once(node, timeout_sec=1.0)
    print(stamps[0], stamps[-1], digest.hexdigest(), flush=True)
    node.destroy_node()
    rclpy.shutdown()


if __name__ == '__main__':
    main(sys.argv[1], int(sys.argv[2]))
