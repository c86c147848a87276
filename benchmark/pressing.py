# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A controller that presses on a table through topics in lock-step, as anyone would write it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from contact import Admittance
from geometry_msgs.msg import Point, PoseStamped, Quaternion, TwistStamped, WrenchStamped
import numpy as np
from std_msgs.msg import Float64MultiArray

#: Parameters of the node; the rate and the gripper come with them.
PARAMETERS = {'stepping': 'lockstep', 'arena': 'table', 'cube': False}
#: Where the gripper begins: fingers down, above the table of 0.8 m.
_START = PoseStamped()
_START.pose.position = Point(x=-0.1, y=0.0, z=0.83)
_START.pose.orientation = Quaternion(x=1.0, y=0.0, z=0.0, w=0.0)
_NEAR_M = 1e-3
#: Longest time that a gripper needs to close [s].
_CLOSED_S = 1.6


def _nanoseconds(message: Any) -> int:
    return int(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)


class PressingClient:
    """
    Closes a gripper, brings it down, presses with a force, then slides to the left.

    It answers each instant once, after both topics that it needs of that instant have come. The
    z-axis of ``ft_frame`` has to point out of the gripper.

    :param node: of rclpy
    :param force_n: to press with [N]
    :param rate_hz: of the control periods [Hz]
    :param slide: how fast [m/s]
    :param seconds: how long it presses at each place
    :ivar forces: what it read from the touch on [N]
    """

    def __init__(self, node: Any, force_n: float, rate_hz: float, slide: float = 0.03,
                 seconds: float = 3.0) -> None:
        self._law = Admittance(force_n, 1.0 / rate_hz)
        self._force_n, self._slide = force_n, slide
        self._count = round(seconds * rate_hz)
        self.forces: list[float] = []
        self._below = False
        self._answered = 0
        self._pose, self._wrench = PoseStamped(), WrenchStamped()
        self._go = node.create_publisher(PoseStamped, 'right/target_pose', 10)
        self._close = node.create_publisher(Float64MultiArray, 'right/gripper/command', 10)
        self._move = node.create_publisher(TwistStamped, 'right/target_twist', 10)
        node.create_subscription(PoseStamped, 'right/eef_pose', self._take_pose, 10)
        node.create_subscription(WrenchStamped, 'right/external_wrench', self._take_wrench, 10)

    @property
    def done(self) -> bool:
        """True once it has pressed and slid."""
        return len(self.forces) >= 2 * self._count

    def _take_pose(self, message: PoseStamped) -> None:
        self._pose = message
        self._answer()

    def _take_wrench(self, message: WrenchStamped) -> None:
        self._wrench = message
        self._answer()

    def _answer(self) -> None:
        stamp = _nanoseconds(self._pose)
        if self.done or stamp <= self._answered or stamp != _nanoseconds(self._wrench) or not all(
                topic.get_subscription_count() for topic in (self._go, self._move, self._close)):
            return
        self._answered = stamp
        if stamp < _CLOSED_S * 1e9:
            self._close.publish(Float64MultiArray(data=[1.0]))
        here, there = self._pose.pose, _START.pose
        self._below = self._below or stamp > _CLOSED_S * 1e9 and all(
            abs(getattr(here.position, axis) - getattr(there.position, axis)) < _NEAR_M
            for axis in 'xyz') and abs(here.orientation.x) > 0.99999
        command = self._twist() if self._below else PoseStamped(pose=there)
        command.header.stamp = self._pose.header.stamp
        (self._move if self._below else self._go).publish(command)

    def _twist(self) -> TwistStamped:
        """Return how fast the gripper shall move, in ``world``."""
        message = TwistStamped()
        pushed_up = -self._wrench.wrench.force.z
        message.twist.linear.z = float(self._law.velocity(pushed_up))
        if self._law.touched:
            self.forces.append(pushed_up)
        if len(self.forces) > self._count:
            message.twist.linear.y = self._slide
        return message

    def errors(self, settle: float = 0.5) -> tuple[float, float]:
        """
        Return the greatest errors of what it read, still and sliding [N].

        :param settle: share of the time at each place that does not count
        """
        late = round(settle * self._count)
        errors = np.abs(np.array(self.forces) - self._force_n)
        return errors[late:self._count].max(), errors[self._count + late:2 * self._count].max()


def press(node: Any, spin_until: Callable[[Callable[[], bool]], object], force_n: float,
          rate_hz: float, seconds: float = 3.0) -> tuple[float, float]:
    """
    Press and slide, and return the greatest errors [N].

    :param node: of the client
    :param spin_until: lets the node work until a condition holds
    """
    client = PressingClient(node, force_n, rate_hz, seconds=seconds)
    spin_until(lambda: client.done)
    return client.errors()
