# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A stream of poses that an end effector follows one and a half intervals late, without stops."""

from __future__ import annotations

from typing import Any

import numpy as np

from manip_sim.algebra import length, product
from manip_sim.arrays import FloatArray
from manip_sim.control.law.joint_records import blank_state, FIELDS, records
from manip_sim.control.servos import SPEED_UP_S
from manip_sim.quaternion import matrix_of_vector, rotation_vector

_ALL = np.arange(6)
#: Largest acceleration that counts as zero [m/s^2, rad/s^2].
_STEADY = 1e-3


class PoseStream:
    """
    The poses of a stream of targets, all in the same frame.

    The velocity of the reference ramps to that of the poses within one message interval, so that
    it follows them with a delay of one and a half.

    :ivar moving: whether poses have come regularly, so that the reference moves
    :ivar smooth: share of the acceleration of the reference that is that of the poses themselves,
        0 after a jump, where messages are late, and where poses are faster than the end effector
        may be
    """

    #: Of arrays that compiled code reads.
    shapes = {'_state': ('d', 6, len(FIELDS)), '_position': ('d', 3), '_rotation': ('d', 3, 3),
              '_velocity': ('d', 6), '_slope': ('d', 6)}

    def __init__(self) -> None:
        #: The coordinates are sums of translations and of rotation vectors from pose to pose.
        self._state = blank_state(np.ones(6))
        self._position, self._rotation = np.zeros(3), np.eye(3)
        #: Velocity that the reference comes to, how fast, and until when.
        self._velocity, self._slope = np.zeros(6), np.zeros(6)
        self._ramp_end_s = -np.inf
        #: When the reference would be at the last pose.
        self._at_goal_s = 0.0
        #: Accelerations of the poses, linear and angular, as of the last message.
        self._own = (0.0, 0.0)
        #: A pose that came at this instant, the limits, and the end effector's twist.
        self._waiting: tuple[FloatArray, FloatArray, FloatArray, FloatArray] | None = None
        self.moving, self.smooth = False, 0.0

    def set(self, longest_s: float, hold_s: float) -> None:
        """
        Change what counts as a stream.

        :param longest_s: longest interval between messages [s]
        :param hold_s: how long the reference goes on after a message was due [s]; 0: two intervals
        """
        joints = self._joints
        joints['longest'], joints['hold'] = longest_s, hold_s

    @property
    def _joints(self) -> Any:
        return records(self._state)

    def take(self, position: FloatArray, rotation: FloatArray, period_s: float, twist: FloatArray,
             limits: FloatArray, messages: int = 1, sent_s: float = 0.0) -> None:
        """
        Take in the pose of a message; of several at one instant the newest counts.

        :param position: [m], shape (3,)
        :param rotation: rotation matrix, shape (3, 3)
        :param period_s: length of a control period [s]
        :param twist: of the end effector now, if the stream begins [m/s, rad/s], shape (6,)
        :param limits: of linear and angular velocity [m/s, rad/s], shape (2,)
        :param messages: how many messages came since the last call, of which this is the last
        :param sent_s: when it was sent, by any clock [s]; 0: unknown
        """
        from manip_sim.control.law.stream_timing import wait  # It imports numba.
        joints = self._joints
        joints['limit'] = np.repeat(limits, 3) / SPEED_UP_S
        goal = joints['goal'] + np.concatenate([
            position - self._position, rotation_vector(product(rotation, self._rotation.T))])
        wait(joints, _ALL, goal, float(period_s), float(messages), float(sent_s), False)
        self._waiting = position, rotation, limits, twist

    def update(self, now_s: float) -> None:
        """
        Follow the pose that came at this instant, or let the reference rest if none comes.

        :param now_s: simulation time [s]
        """
        if self._waiting is not None:
            self._follow(*self._waiting, now_s)
            self._waiting = None
        elif now_s > self._joints['until'][0] + 1e-9:
            self.moving = False

    def _follow(self, position: FloatArray, rotation: FloatArray, limits: FloatArray,
                present: FloatArray, now_s: float) -> None:
        from manip_sim.control.law.stream_goals import take_alone  # It imports numba.
        joints = self._joints
        taken = take_alone(joints, now_s)
        if not taken:
            return
        streams = taken > 1
        before = self.twist(now_s) if self.moving and streams else present
        self._position, self._rotation = position, rotation
        first, velocity = joints[0], np.array(joints['rate_goal'])
        interval_s, limited = max(first['interval'], first['waiting_period']), 1.0
        for half, limit in zip((velocity[:3], velocity[3:]), limits):
            part = min(1.0, limit / max(length(half), 1e-12))
            half *= part
            limited = min(limited, part)
        left_s = min(max(first['sent'] + interval_s - now_s, 0.5 * interval_s),
                     1.5 * interval_s) + first['slack']
        self._velocity, self._slope = velocity, (velocity - before) / left_s
        self._ramp_end_s, self.moving = now_s + left_s, streams
        self._at_goal_s = first['sent'] + 1.5 * interval_s
        self.smooth = min(self._own_share(), 1.0) if limited == 1.0 else 0.0

    def _own_share(self) -> float:
        """Return how much of the acceleration of the reference is that of the poses."""
        before, own = self._own, self._joints['own']
        self._own = length(own[:3]), length(own[3:])
        # One message alone may be a beginning, late or a jump.
        return min((min(sizes) / size for *sizes, size in zip(
            before, self._own, (length(self._slope[:3]), length(self._slope[3:])))
            if size > _STEADY), default=1.0)

    @property
    def until_s(self) -> float:
        """Simulation time when the stream ends, unless a pose comes [s]."""
        return float(self._joints['until'][0])

    @property
    def at_rest(self) -> bool:
        """True while nothing moves until the next pose."""
        return not self.moving and self._waiting is None

    def twist(self, now_s: float) -> FloatArray:
        """Return the velocity of the reference [m/s, rad/s], shape (6,)."""
        return self._velocity - self._slope * max(self._ramp_end_s - now_s, 0.0)

    def acceleration(self, now_s: float) -> FloatArray:
        """Return the acceleration of the reference [m/s^2, rad/s^2], shape (6,)."""
        return self._slope if now_s < self._ramp_end_s - 1e-9 else np.zeros(6)

    def pose(self, now_s: float) -> tuple[FloatArray, FloatArray]:
        """Return position [m] and rotation matrix of the reference."""
        if not self.moving:
            return self._position, self._rotation
        joints, left_s = self._joints, max(self._ramp_end_s - now_s, 0.0)
        way = (joints['level'] - joints['goal'] + self._velocity * (now_s - self._at_goal_s)
               + self._slope * left_s**2 / 2.0)
        return self._position + way[:3], product(matrix_of_vector(way[3:]), self._rotation)
