# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A stream of poses that an end effector follows one and a half intervals late, without stops."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from typing import Any

import numpy as np

from manip_sim.algebra import length, product, rotation_vector
from manip_sim.arrays import FloatArray
from manip_sim.control.law.records import FIELDS, MOTION_FIELDS, PLACES, records
from manip_sim.control.servos import SPEED_UP_S
from manip_sim.control.velocity_stream import Stream

_ALL = np.arange(6)
#: Largest acceleration that counts as zero [m/s^2, rad/s^2].
_STEADY = 1e-3


class PoseStream(Stream):
    """
    The poses of a stream of targets, all in the same frame.

    The velocity of the reference ramps to that of the poses within one message interval, so that
    it follows them with a delay of one and a half. The motion is the way from the last pose to it,
    translation [m] and rotation vector [rad].

    :ivar moving: whether poses have come regularly, so that the reference moves
    :ivar smooth: share of the acceleration of the reference that is that of the poses themselves,
        0 after a jump, where messages are late, and where poses are faster than the end effector
        may be
    """

    #: Of arrays that compiled code reads.
    shapes = {'_state': ('d', 6, len(FIELDS)), '_position': ('d', 3), '_rotation': ('d', 3, 3),
              '_motion': ('d', 6, len(MOTION_FIELDS))}

    def __init__(self) -> None:
        #: The coordinates are sums of translations and of rotation vectors from pose to pose.
        super().__init__(np.ones(6))
        self._position, self._rotation = np.zeros(3), np.eye(3)
        self.motion['own'] = np.inf
        #: Accelerations of the poses, linear and angular, as of the last message.
        self._own = (0.0, 0.0)
        self.moving, self.smooth = False, 0.0
        #: When the last pose came [s], and the stream before that.
        self._came_s = -np.inf
        self._before: PoseStream | None = None

    @property
    def _joints(self) -> Any:
        return records(self._state)

    def take(self, position: FloatArray, rotation: FloatArray, now_s: float, period_s: float,
             present: Callable[[], FloatArray], limits: FloatArray, messages: int = 1,
             sent_s: float = 0.0) -> None:
        """
        Follow the pose of a message; of several at one instant the newest counts.

        :param position: [m], shape (3,)
        :param rotation: rotation matrix, shape (3, 3)
        :param now_s: simulation time [s]
        :param period_s: length of a control period [s]
        :param present: returns the twist of the end effector now, which counts if the stream
            begins [m/s, rad/s], shape (6,)
        :param limits: of linear and angular velocity [m/s, rad/s], shape (2,)
        :param messages: how many messages came since the last call, of which this is the last
        :param sent_s: when it was sent, by any clock [s]; 0: unknown
        """
        from manip_sim.control.law.streams import wait  # It imports numba.
        if self._before is not None and self._came_s == now_s:
            vars(self).update(vars(self._before))
        joints = self._joints
        joints['limit'] = np.repeat(limits, 3) / SPEED_UP_S
        goal = joints['goal'] + np.concatenate([
            position - self._position, rotation_vector(product(rotation, self._rotation.T))])
        wait(joints, _ALL, goal, float(period_s), float(messages), float(sent_s), False)
        before = copy(self)
        before._state, before._motion, before._before = (
            self._state.copy(), self._motion.copy(), None)
        self._came_s, self._before = now_s, before
        self._follow(position, rotation, limits, present, now_s)

    def update(self, now_s: float) -> None:
        """
        Let the reference rest if no pose has come for too long.

        :param now_s: simulation time [s]
        """
        if now_s > self.until_s + 1e-9:
            self.moving = False

    def _follow(self, position: FloatArray, rotation: FloatArray, limits: FloatArray,
                present: Callable[[], FloatArray], now_s: float) -> None:
        from manip_sim.control.law.streams import take_alone  # It imports numba.
        from manip_sim.control.law.streams import velocities_at
        joints, motion = self._joints, self.motion
        taken = take_alone(joints, now_s)
        self._position, self._rotation = position, rotation
        if not taken:
            return
        streams = taken > 1
        before = velocities_at(motion, now_s) if self.moving and streams else present()
        first, velocity = joints[0], np.array(joints['rate_goal'])
        interval_s, limited = max(first['interval'], first['waiting_period']), 1.0
        for half, limit in zip((velocity[:3], velocity[3:]), limits):
            part = min(1.0, limit / max(length(half), 1e-12))
            half *= part
            limited = min(limited, part)
        left_s = min(max(first['sent'] + interval_s - now_s, 0.5 * interval_s),
                     1.5 * interval_s) + first['slack']
        motion['velocity'], motion['slope'] = velocity, (velocity - before) / left_s
        motion['reached'], self.moving = now_s + left_s, streams
        motion['position'] = joints['level'] - joints['goal']
        motion['due'] = first['sent'] + 1.5 * interval_s
        self.smooth = min(self._own_share(), 1.0) if limited == 1.0 else 0.0

    def _own_share(self) -> float:
        """Return how much of the acceleration of the reference is that of the poses."""
        before, own, slope = self._own, self._joints['own'], self.motion['slope']
        self._own = length(own[:3]), length(own[3:])
        # One message alone may be a beginning, late or a jump.
        return min((min(sizes) / size for *sizes, size in zip(
            before, self._own, (length(slope[:3]), length(slope[3:])))
            if size > _STEADY), default=1.0)

    @property
    def until_s(self) -> float:
        """Simulation time when the reference comes to rest, unless a pose comes [s]."""
        return self._state.item(0, PLACES['until']) if self.moving else np.inf
