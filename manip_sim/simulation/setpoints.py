# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Setpoints of joints at each instant; how actuators follow them is not decided here."""

from __future__ import annotations

import math

import numpy as np

from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.simulation.streams import RampEstimator, StreamEstimator

#: Time constant of each of the two low-pass stages that smooth a step [s].
_SMOOTHING_S = 0.02
#: Message intervals in which the lag behind a stream that jitters is caught up.
_SOFT_INTERVALS = 5.0
#: Multiple of the acceleration limit that a stream may use: its sender plans the motion.
_STREAM_ACCELERATION = 4.0
#: A setpoint that is slower and nearer to its goal than this has arrived [rad or m, and per s].
_ARRIVED = 1e-10


class SetpointGenerator:
    """
    A generator of joint setpoints that are continuous in position and velocity.

    The velocity of a setpoint is the sum of two parts. The *stream* part follows goals that come
    regularly: it ramps to their velocity within one message interval, so that setpoints follow a
    stream with a delay of one and a half intervals. The *catch-up* part covers the rest: a
    time-optimal profile with limited velocity and acceleration, and after it two low-pass stages,
    which average and so never overshoot. All is in closed form for time steps of any length.

    :param position_range: lowest and highest setpoint [rad or m], shape (n, 2)
    :param velocity_limit: [rad/s or m/s], shape (n,)
    :param acceleration_limit: of steps, velocities and stops [rad/s^2 or m/s^2], shape (n,)
    :ivar position: setpoint at the end of the last interval [rad or m], shape (n,)
    :ivar velocity: its velocity there [rad/s or m/s], shape (n,)
    :ivar acceleration: its acceleration there [rad/s^2 or m/s^2], shape (n,)
    :ivar limited: how often a streamed goal required more than the velocity limit, shape (n,)
    :ivar now_s: simulation time, which the caller may set [s]
    :ivar moving: whether any setpoint moves or is about to
    """

    def __init__(self, position_range: FloatArray, velocity_limit: FloatArray,
                 acceleration_limit: FloatArray) -> None:
        count = len(velocity_limit)
        self._low, self._high = position_range.T.copy()
        self._velocity_limit = velocity_limit
        self._acceleration_limit = acceleration_limit

        def zeros() -> FloatArray:
            return np.zeros(count)

        self.position, self.velocity, self.acceleration = zeros(), zeros(), zeros()
        self.limited = np.zeros(count, dtype=np.int64)
        self.moving = False
        # Whether the catch-up part has something to do.
        self._catches = False
        self._seeks, self._brakes = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
        self._goal = zeros()
        # The catch-up part: velocity before and after each low-pass stage.
        self._raw, self._stage1, self._stage2 = zeros(), zeros(), zeros()
        # The stream part: its velocity, what it ramps to and how fast, and until when.
        self._stream, self._stream_goal = zeros(), zeros()
        self._ramp = acceleration_limit.copy()
        self._until_s = np.full(count, np.inf)
        self._estimator = StreamEstimator(count)
        self._ramp_estimator = RampEstimator(count)
        self.now_s = 0.0

    def at_rest(self, indices: IntArray) -> bool:
        """Tell whether all of the given setpoints rest at their goals."""
        if not self.moving:
            return True
        if self._stream[indices].any():
            return False
        return bool(self._resting()[indices].all())

    @property
    def settled(self) -> bool:
        """Whether :meth:`advance` has nothing to do."""
        return not (self.moving or self._catches)

    def wake(self) -> None:
        """Resume setpoints that were held back after they had come to rest."""
        self.moving = self.moving or self._catches

    def place(self, indices: IntArray, position: FloatArray, velocity: FloatArray) -> None:
        """
        Set position and velocity of setpoints, which come to rest from there.

        :param position: [rad or m], shape of ``indices``
        :param velocity: [rad/s or m/s], shape of ``indices``
        """
        self.position[indices] = np.clip(position, self._low[indices], self._high[indices])
        self.velocity[indices], self.acceleration[indices] = velocity, 0.0
        self.set_velocity(indices, np.zeros(len(indices)))

    def go_at(self, indices: IntArray, velocity: FloatArray, period_s: float) -> None:
        """
        Let setpoints come to a velocity; velocities that come regularly are followed as a stream.

        :param velocity: [rad/s or m/s], shape of ``indices``
        :param period_s: length of a control period [s]
        """
        ramp = self._ramp_estimator.take(
            indices, velocity, self.velocity[indices], self.now_s, period_s,
            self._acceleration_limit[indices])
        self._come_to(indices, velocity)
        self._ramp[indices] = ramp

    def set_velocity(self, indices: IntArray, velocity: FloatArray) -> None:
        """
        Let setpoints come to a velocity with the acceleration limit; zero holds them.

        :param velocity: [rad/s or m/s], shape of ``indices``
        """
        self._ramp_estimator.forget(indices)
        self._come_to(indices, velocity)

    def ramp_to(self, indices: IntArray, velocity: FloatArray, duration_s: float) -> None:
        """
        Let setpoints come to a velocity evenly within a time, or later at the acceleration limit.

        :param velocity: [rad/s or m/s], shape of ``indices``
        :param duration_s: the time [s]
        """
        self.set_velocity(indices, velocity)
        change = np.abs(velocity - self._stream[indices])
        self._ramp[indices] = np.clip(change / duration_s, 1e-9, self._ramp[indices])

    def brake(self, indices: IntArray) -> None:
        """
        Let setpoints come to rest at the acceleration limit.

        Where the range would end before, they slow down evenly up to there.
        """
        position, velocity = self.position[indices], self.velocity[indices]
        ahead = np.where(velocity > 0.0, self._high[indices] - position,
                         position - self._low[indices])
        self.set_velocity(indices, np.zeros(len(indices)))
        self._ramp[indices] = np.maximum(
            self._ramp[indices], velocity**2 / (2.0 * np.maximum(ahead, 1e-6)))
        self.acceleration[indices] = -np.sign(velocity) * self._ramp[indices]

    def _come_to(self, indices: IntArray, velocity: FloatArray) -> None:
        # Only one part moves: both together could exceed the acceleration limit.
        self._stream[indices] = self.velocity[indices]
        for stage in (self._raw, self._stage1, self._stage2):
            stage[indices] = 0.0
        self._seeks[indices] = self._brakes[indices] = False
        self._stream_goal[indices] = velocity
        self._ramp[indices] = self._acceleration_limit[indices]
        self._until_s[indices] = np.inf
        self._estimator.forget(indices)
        self.moving = self._catches = True

    def go_to(self, indices: IntArray, goal: FloatArray, period_s: float) -> None:
        """
        Let setpoints come to a position; goals that come regularly are followed as a stream.

        :param goal: [rad or m], shape of ``indices``
        :param period_s: length of a control period [s]
        """
        estimator = self._estimator
        first = indices[~estimator.streams(indices, self.now_s)]
        for stage in (self._raw, self._stage1, self._stage2):
            stage[first] += self._stream[first]
        self._stream[first], self._brakes[indices] = 0.0, False
        self._goal[indices], self._seeks[indices] = goal, True
        self.moving = self._catches = True
        indices = estimator.take(indices, goal, self.now_s, period_s,
                                 self._acceleration_limit[indices])
        top, interval_s = self._velocity_limit[indices], estimator.interval_s[indices]
        wanted = estimator.velocity[indices]
        velocity = _within(wanted, -top, top)
        self.limited[indices] += velocity != wanted
        self._stream_goal[indices] = velocity
        stream = self._stream[indices]
        highest = np.where(np.abs(velocity) > np.abs(stream),
                           _STREAM_ACCELERATION * self._acceleration_limit[indices], np.inf)
        self._ramp[indices] = np.clip(np.abs(velocity - stream) / interval_s, 1e-9, highest)
        self._until_s[indices] = self.now_s + interval_s

    def come_back(self, indices: IntArray, goal: FloatArray) -> None:
        """
        Let moving setpoints brake, and then come to a position.

        :param goal: [rad or m], shape of ``indices``
        """
        self.set_velocity(indices, np.zeros(len(indices)))
        self._goal[indices] = goal
        self._seeks[indices] = self._brakes[indices] = True

    def advance(self, duration_s: float) -> None:
        """
        Advance all setpoints.

        :param duration_s: length of the interval [s]
        """
        self._end_streams()
        # What is missing is computed before anything moves.
        missing = self._missing() if self._catches else None
        travel = self._advance_stream(duration_s)
        if missing is not None:
            travel += self._advance_catch_up(missing, duration_s)
        self.position = _within(self.position + travel, self._low, self._high)
        self.velocity = self._stream + self._stage2
        self.now_s += duration_s
        if not (self._catches or self._stream.any() or self._stream_goal.any()):
            self._arrive()

    def _arrive(self) -> None:
        if self._resting().all():
            self.moving = False
            self.position[self._seeks] = self._goal[self._seeks]
            for part in (self._raw, self._stage1, self._stage2, self.velocity, self.acceleration):
                part[:] = 0.0
        else:
            self._catches = True

    def follow(self, indices: IntArray, position: FloatArray, velocity: FloatArray,
               acceleration: FloatArray) -> None:
        """
        Set the present setpoints from another source, such as a trajectory.

        When it ends, they come to rest from there.

        :param position: [rad or m], shape of ``indices``; ``velocity`` and ``acceleration`` too
        """
        self.place(indices, position, velocity)
        self.acceleration[indices] = acceleration

    def hold_back(self, measured: FloatArray, lead: FloatArray) -> None:
        """
        Keep setpoints from running ahead of joints that cannot keep up.

        :param measured: where the joints are [rad or m], shape (n,)
        :param lead: how far a setpoint may be from there [rad or m], shape (n,)
        """
        near = _within(self.position, measured - lead, measured + lead)
        held = near != self.position
        if held.any():
            self.position, self._catches = near, True
            for part in (self._raw, self._stage1, self._stage2, self._stream, self.velocity,
                         self.acceleration):
                part[held] = 0.0

    def _resting(self) -> BoolArray:
        pace = np.maximum.reduce([
            np.abs(self._raw), np.abs(self._stage1), np.abs(self._stage2), np.abs(self._stream),
            np.abs(self._stream_goal)])
        away = np.where(self._seeks, np.abs(self._goal - self.position), 0.0)
        return np.maximum(pace, away) < _ARRIVED

    def _end_streams(self) -> None:
        ended = self._until_s <= self.now_s + 1e-9
        if ended.any():
            self._stream_goal[ended] = 0.0
            self._ramp[ended] = np.maximum(
                np.abs(self._stream[ended]) / self._estimator.interval_s[ended], 1e-9)
            self._until_s[ended] = np.inf

    def _still_to_come(self) -> FloatArray:
        """Return how far the setpoints go by themselves if no further command comes."""
        left_s = self._until_s - self.now_s
        streaming = np.isfinite(left_s)
        left_s = np.where(streaming, left_s, 0.0)
        change = self._stream_goal - self._stream
        ramp_s = np.abs(change) / self._ramp
        ramp_s = np.where(streaming, np.minimum(ramp_s, left_s), ramp_s)
        reached = self._stream + np.sign(change) * self._ramp * ramp_s
        stream = (self._stream + reached) / 2.0 * ramp_s + reached * (left_s - ramp_s) * streaming
        # After the message interval the stream ramps down to zero within another one.
        stream += np.where(streaming, reached * self._estimator.interval_s / 2.0, 0.0)
        return np.asarray(stream + _SMOOTHING_S * (self._stage1 + self._stage2))

    def _missing(self) -> FloatArray:
        self._brakes &= self._stream != 0.0
        return np.where(self._seeks & ~self._brakes,
                        self._goal - self.position - self._still_to_come(), 0.0)

    def _advance_catch_up(self, missing: FloatArray, duration_s: float) -> FloatArray:
        limit, top = self._acceleration_limit, self._velocity_limit
        if self._estimator.jitter.any():
            soft = self._soft(missing)
            raw = braking_velocity(missing - soft, limit, duration_s) + soft / np.maximum(
                _SOFT_INTERVALS * self._estimator.interval_s, duration_s)
        else:
            raw = braking_velocity(missing, limit, duration_s)
        change = limit * duration_s
        raw = _within(raw, self._raw - change, self._raw + change)
        self._raw = _within(raw, -top - self._stream_goal, top - self._stream_goal)
        # Two first-order stages whose input is constant during the interval.
        ratio = duration_s / _SMOOTHING_S
        decay = math.exp(-ratio)
        raw, stage1, stage2 = self._raw, self._stage1, self._stage2
        off1, off2 = (stage1 - raw) * decay, (stage2 - raw) * decay
        self._stage1, self._stage2 = raw + off1, raw + off2 + off1 * ratio
        self.acceleration += (self._stage1 - self._stage2) / _SMOOTHING_S
        pace = np.maximum(np.maximum(np.abs(missing), np.abs(raw)),
                          np.maximum(np.abs(self._stage1), np.abs(self._stage2)))
        self._catches = bool(pace.max(initial=0.0) >= _ARRIVED or self._brakes.any())
        if not self._catches:
            for part in (self._raw, self._stage1, self._stage2):
                part[:] = 0.0
        return np.asarray(raw * duration_s + _SMOOTHING_S * (
            stage1 + stage2 - self._stage1 - self._stage2))

    def _soft(self, missing: FloatArray) -> FloatArray:
        """Return how much of a lag may be caught up slowly because messages jitter."""
        band = np.where(np.isfinite(self._until_s), self._estimator.jitter * self._stream_goal
                        * self._estimator.interval_s, 0.0)
        return _within(missing, np.minimum(band, 0.0), np.maximum(band, 0.0))

    def _advance_stream(self, duration_s: float) -> FloatArray:
        begin, goal = self._stream, self._stream_goal
        free = ~self._seeks & (goal != 0.0)
        if free.any():
            goal = self._before_the_range_ends(goal, duration_s)
        change = goal - begin
        ramp_s = np.minimum(np.abs(change) / self._ramp, duration_s)
        end = begin + np.copysign(self._ramp * ramp_s, change)
        self._stream = end
        self.acceleration = (end - begin) / duration_s
        return np.asarray(end * duration_s - (end - begin) / 2.0 * ramp_s)

    def _before_the_range_ends(self, velocity: FloatArray, duration_s: float) -> FloatArray:
        """Return velocities, at the end of an interval, that allow braking within the range."""
        change = self._acceleration_limit * duration_s / 2.0
        highest, lowest = (
            np.sqrt(np.maximum(change**2 + 2.0 * self._acceleration_limit * np.maximum(
                distance - towards * duration_s / 2.0, 0.0), 0.0)) - change
            for distance, towards in ((np.minimum(self._high - self.position, 1e6), self._stream),
                                      (np.minimum(self.position - self._low, 1e6), -self._stream)))
        return np.where(self._seeks, velocity, np.clip(velocity, -lowest, highest))


def _within(values: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    # np.clip takes several times as long for arrays as short as these.
    return np.asarray(np.minimum(np.maximum(values, low), high))


def braking_velocity(distance: FloatArray, limit: FloatArray, interval_s: float) -> FloatArray:
    """
    Return the highest velocity in the next interval that still allows braking before the goal.

    The distance left after the interval is that of a constant deceleration, v^2 / (2 a), so the
    intervals that follow may be of any length.

    :param distance: to the goal, with sign [rad or m], shape (n,)
    :param limit: of the acceleration [rad/s^2 or m/s^2], shape (n,)
    :param interval_s: [s]
    """
    size, change = np.minimum(np.abs(distance), 1e6), limit * interval_s
    # The root of v^2 + 2 change v = 2 limit size, written so that it is exact for small sizes.
    return np.asarray(np.sign(distance) * 2.0 * limit * size / (
        change + np.sqrt(change**2 + 2.0 * limit * size)))
