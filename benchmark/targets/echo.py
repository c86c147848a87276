# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The other end of a bare ping-pong: a new state of a Panda's arm for each command, no physics."""

from __future__ import annotations

import contextlib

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import JointState

#: The least by which stamps differ [ns].
_PERIOD_NS = 1_000_000


class Echo(Node):
    """Answers commands by states, and repeats the last state while none come."""

    def __init__(self) -> None:
        super().__init__('echo')
        self.state = JointState(name=[f'robot0_joint{n + 1}' for n in range(7)],
                                position=[0.1] * 7, velocity=[0.0] * 7, effort=[0.0] * 7)
        self.time_ns = 0
        self.publisher = self.create_publisher(JointState, 'arm/joint_states', 10)
        self.create_subscription(JointState, 'arm/joint_command', self.answer, 10)
        self.timer = self.create_timer(0.1, lambda: self.publisher.publish(self.state))

    def answer(self, command: JointState) -> None:
        """Publish the next state."""
        self.time_ns += _PERIOD_NS
        stamp = self.state.header.stamp
        stamp.sec, stamp.nanosec = divmod(self.time_ns, 10**9)
        self.publisher.publish(self.state)
        self.timer.reset()


def main() -> None:
    """Answer until the process is ended."""
    rclpy.init()
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(Echo())


if __name__ == '__main__':
    main()
