# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""How an end effector follows regular poses: one and a half intervals late, without stops."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from manip_sim.algebra import length, product
from manip_sim.arrays import FloatArray
from manip_sim.control.joint_accelerations import SPEED_UP_S
from manip_sim.control.stream_estimation import StreamEstimator
from manip_sim.quaternion import matrix_of_vector, rotation_vector

_ALL = np.arange(6)
#: Less than this is no acceleration [m/s^2, rad/s^2].
_STEADY = 1e-3


@dataclass(frozen=True)
class _Pose:
    """What :meth:`PoseStream.take` is given."""

    position: FloatArray
    rotation: FloatArray
    period_s: float
    twist: FloatArray
    limits: FloatArray
    messages: int
    sent_s: float


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

    def __init__(self) -> None:
        self._estimator = StreamEstimator(6)
        ((self._clock, _),) = self._estimator.clocks.of(_ALL, 0.0)
        #: Sums of the translations and of the rotation vectors from pose to pose.
        self._sum = np.zeros(6)
        self._position, self._rotation = np.zeros(3), np.eye(3)
        #: Velocity that the reference comes to, how fast, and until when.
        self._velocity, self._slope = np.zeros(6), np.zeros(6)
        self._ramp_end_s = -np.inf
        #: Accelerations of the poses, linear and angular, as of the last message.
        self._own = (0.0, 0.0)
        self._waiting: _Pose | None = None
        self.moving, self.smooth = False, 0.0

    def set(self, longest_s: float, hold_s: float) -> None:
        """
        Change what counts as a stream.

        :param longest_s: longest interval between messages [s]
        :param hold_s: how long the reference goes on after a message was due [s]; 0: two intervals
        """
        self._estimator.clocks.set(_ALL, longest_s, hold_s)

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
        waiting = self._waiting
        if waiting is not None:
            copied = ((waiting.position == position).all()
                      and (waiting.rotation == rotation).all())
            messages = waiting.messages + (0 if copied else messages)
        self._waiting = _Pose(position, rotation, period_s, twist, limits, messages, sent_s)

    def update(self, now_s: float) -> None:
        """
        Follow the pose that came at this instant, or let the reference rest if none comes.

        :param now_s: simulation time [s]
        """
        if self._waiting is not None:
            self._follow(self._waiting, now_s)
            self._waiting = None
        elif now_s > self._clock.until_s + 1e-9:
            self.moving = False

    def _follow(self, pose: _Pose, now_s: float) -> None:
        estimator, limits = self._estimator, np.repeat(pose.limits, 3)
        clock = self._clock
        clock.notice_pause(now_s, pose.sent_s, pose.messages)
        streams = clock.continues(now_s)
        if streams:
            self._sum = self._sum + np.concatenate([
                pose.position - self._position,
                rotation_vector(product(pose.rotation, self._rotation.T))])
        before = self.twist(now_s) if self.moving and streams else pose.twist
        self._position, self._rotation = pose.position, pose.rotation
        estimator.take(clock, self._sum, now_s, pose.period_s, limits / SPEED_UP_S, pose.messages,
                       pose.sent_s)
        velocity, interval_s = estimator.velocity.copy(), max(clock.interval_s, pose.period_s)
        limited = 1.0
        for half, limit in zip((velocity[:3], velocity[3:]), pose.limits):
            part = min(1.0, limit / max(length(half), 1e-12))
            half *= part
            limited = min(limited, part)
        left_s = min(max(clock.sent_s + interval_s - now_s, 0.5 * interval_s),
                     1.5 * interval_s) + clock.slack_s
        self._velocity, self._slope = velocity, (velocity - before) / left_s
        self._ramp_end_s, self.moving = now_s + left_s, streams
        self.smooth = min(self._own_share(), 1.0) if limited == 1.0 else 0.0

    def _own_share(self) -> float:
        """Return how much of the acceleration of the reference is that of the poses."""
        before, own = self._own, self._estimator.acceleration
        self._own = length(own[:3]), length(own[3:])
        usual = self._estimator.usual_acceleration
        # One message alone may be a beginning, late or a jump.
        return min((min(sizes) / size for *sizes, size in zip(
            before, self._own, (length(usual[:3]), length(usual[3:])),
            (length(self._slope[:3]), length(self._slope[3:]))) if size > _STEADY), default=1.0)

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
        estimator, left_s = self._estimator, max(self._ramp_end_s - now_s, 0.0)
        age_s = now_s - estimator.sent_s - 1.5 * estimator.interval_s
        way = self._velocity * age_s + self._slope * left_s**2 / 2.0
        return self._position + way[:3], product(matrix_of_vector(way[3:]), self._rotation)
