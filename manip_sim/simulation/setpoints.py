# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Setpoints of joints at each instant; how actuators follow them is not decided here."""

from __future__ import annotations

import numpy as np

from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.simulation.streams import RampEstimator, StreamEstimator

#: Time constant of each of the two low-pass stages that smooth what is caught up [s].
_SMOOTHING_S = 0.02
#: That of moving streams, in message intervals, and in measures of their jitter, at least.
_SMOOTHING_INTERVALS, _SMOOTHING_JITTERS = 1.0, 20.0
#: Multiple of a stream's own acceleration that its setpoint may use.
_STREAM_ACCELERATION = 1.5
#: A setpoint that is slower and nearer to its goal than this has arrived [rad or m, and per s].
_ARRIVED = 1e-10


class SetpointGenerator:
    """
    A generator of setpoints that are continuous in position and velocity and keep to limits.

    A setpoint has a *reference*, a velocity that ramps to that of the goals within one message
    interval: on schedule it takes the setpoint along a stream one and a half intervals late. What
    is then still missing of the way is *caught up*: by a time-optimal profile with limited
    velocity and acceleration, and after it two low-pass stages, which average and so never
    overshoot. The way to a single goal is caught up as a whole. Last, the sum is limited: it never
    exceeds the velocity limit, nor accelerates or brakes harder than the acceleration limit or
    twice as hard as the stream itself. All is in closed form for time steps of any length.

    Its coordinates are joints, or any others with such limits.

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

    #: Only counted.
    not_in_digest = ('limited',)

    def __init__(self, position_range: FloatArray, velocity_limit: FloatArray,
                 acceleration_limit: FloatArray) -> None:
        count = len(velocity_limit)
        self._low, self._high = position_range.T.copy()
        self._velocity_limit = velocity_limit
        #: Nearer than this to an end of the range, velocities may have to be limited.
        self._ends = velocity_limit**2 / acceleration_limit + 0.1 * velocity_limit
        self._acceleration_limit = acceleration_limit
        self.limited = np.zeros(count, dtype=np.int64)
        self._estimator, self._ramp_estimator = StreamEstimator(count), RampEstimator(count)
        self._begin()

    def _begin(self) -> None:
        count = len(self._low)

        def zeros() -> FloatArray:
            return np.zeros(count)

        self.position, self.velocity, self.acceleration = zeros(), zeros(), zeros()
        self.moving = False
        # Whether there is something to catch up.
        self._catches = False
        self._seeks, self._brakes = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
        # Goals that have come at the present instant, how many, when they were sent.
        self._waits, self._waiting_goal = np.zeros(count, dtype=bool), zeros()
        self._waiting, self._stamp_s, self._period_s = zeros(), zeros(), 0.0
        # What is caught up: velocity before and after each low-pass stage.
        self._raw, self._stage1, self._stage2 = zeros(), zeros(), zeros()
        # The reference: its velocity, what it ramps to and how fast, and until when.
        self._reference, self._reference_goal = zeros(), zeros()
        self._ramp, self._bound = self._acceleration_limit.copy(), self._acceleration_limit.copy()
        self._until_s = np.full(count, np.inf)
        self._goal = zeros()
        self.now_s = 0.0

    def reset(self, position: FloatArray) -> None:
        """
        Hold all setpoints at a position, and forget what came; settings and counts stay.

        :param position: [rad or m], shape (n,)
        """
        self._begin()
        self._estimator, self._ramp_estimator = (
            self._estimator.begun_anew(), self._ramp_estimator.begun_anew())
        self.place(np.arange(len(position)), position, np.zeros(len(position)))
        self.moving = False

    def set_stream(self, indices: IntArray, longest_s: float | None = None,
                   hold_s: float | None = None) -> None:
        """
        Change what counts as a stream, and what happens when one stops.

        :param longest_s: longest interval between messages of a stream [s]; None: no change
        :param hold_s: how long setpoints go on at the velocity of a stream after a message was
            due [s]; 0: two message intervals; None: no change
        """
        if longest_s is not None:
            for clock in (self._estimator.clock, self._ramp_estimator.clock):
                clock.longest_s[indices] = longest_s
        if hold_s is not None:
            self._estimator.hold_s[indices] = hold_s

    @property
    def lost(self) -> IntArray:
        """How many messages of streams seem to have been lost, shape (n,)."""
        return np.asarray(self._estimator.clock.lost + self._ramp_estimator.clock.lost)

    def at_rest(self, indices: IntArray) -> bool:
        """Tell whether all of the given setpoints rest at their goals."""
        if not self.moving:
            return True
        if self._waits[indices].any() or self._reference[indices].any():
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

    def go_at(self, indices: IntArray, velocity: FloatArray, period_s: float,
              messages: int = 1, stamp_s: float = 0.0) -> None:
        """
        Let setpoints come to a velocity; velocities that come regularly are followed as a stream.

        :param velocity: [rad/s or m/s], shape of ``indices``
        :param period_s: length of a control period [s]
        :param messages: how many messages came since the last call, of which this is the last
        :param stamp_s: when it was sent, by any clock [s]; 0: unknown
        """
        limit = self._acceleration_limit[indices]
        ramp, own = self._ramp_estimator.take(
            indices, velocity, self.velocity[indices], self.now_s, period_s, limit, messages,
            stamp_s)
        self._come_to(indices, velocity)
        bound = np.maximum(limit, _STREAM_ACCELERATION * own)
        self._bound[indices] = np.maximum(bound, self._bound[indices])
        self._ramp[indices] = np.clip(ramp, 1e-9, bound)

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
        change = np.abs(velocity - self._reference[indices])
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
        self._bound[indices] = np.maximum(self._bound[indices], self._ramp[indices])
        self.acceleration[indices] = -np.sign(velocity) * self._ramp[indices]

    def _come_to(self, indices: IntArray, velocity: FloatArray) -> None:
        self._reference[indices] = self.velocity[indices]
        for stage in (self._raw, self._stage1, self._stage2):
            stage[indices] = 0.0
        self._seeks[indices] = self._brakes[indices] = self._waits[indices] = False
        self._reference_goal[indices] = velocity
        self._ramp[indices] = self._acceleration_limit[indices]
        self._until_s[indices] = np.inf
        self._estimator.forget(indices)
        self.moving = self._catches = True

    def go_to(self, indices: IntArray, goal: FloatArray, period_s: float, messages: int = 1,
              stamp_s: float = 0.0) -> None:
        """
        Let setpoints come to a position; goals that come regularly are followed as a stream.

        Of several goals at one instant the newest counts.

        :param goal: [rad or m], shape of ``indices``
        :param period_s: length of a control period [s]
        :param messages: how many messages came since the last call, of which this is the last
        :param stamp_s: when it was sent, by any clock [s]; 0: unknown
        """
        repeated = self._waits[indices] & (self._waiting_goal[indices] == goal)
        self._waiting[indices] = np.where(self._waits[indices], self._waiting[indices], 0.0) + (
            0.0 if repeated.all() else messages)
        self._waits[indices], self._waiting_goal[indices] = True, goal
        self._stamp_s[indices], self._period_s = stamp_s, period_s
        self.moving = self._catches = True

    def _take_goals(self) -> None:
        """Take in the goals that came at this instant."""
        estimator, indices = self._estimator, np.flatnonzero(self._waits)
        self._waits[indices], self._brakes[indices], self._seeks[indices] = False, False, True
        # What the reference of a setpoint does that is no stream becomes a way to its goal.
        first = indices[~estimator.streams(indices, self.now_s)]
        for stage in (self._raw, self._stage1, self._stage2):
            stage[first] += self._reference[first]
        self._reference[first] = 0.0
        goal, limit = self._waiting_goal[indices], self._acceleration_limit[indices]
        estimator.take(indices, goal, self.now_s, self._period_s, limit, self._waiting[indices],
                       self._stamp_s[indices])
        top, wanted = self._velocity_limit[indices], estimator.velocity[indices]
        velocity = _within(wanted, -top, top)
        self.limited[indices] += velocity != wanted
        # A message that is early or late has more or less of its interval left.
        clock, interval_s = estimator.clock, estimator.interval_s[indices]
        left_s = clock.sent_s[indices] + interval_s - self.now_s
        bound = np.maximum(limit, _STREAM_ACCELERATION * estimator.acceleration[indices])
        self._bound[indices] = np.maximum(bound, self._bound[indices])
        change = np.abs(velocity - self._reference[indices])
        self._goal[indices], self._reference_goal[indices] = goal, velocity
        self._ramp[indices] = np.clip(
            change / (_within(left_s, 0.5 * interval_s, 1.5 * interval_s)
                      + clock.slack_s[indices]), 1e-9, bound)
        self._until_s[indices] = estimator.until_s[indices]

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
        if self._waits.any():
            self._take_goals()
        self._end_streams()
        begin, low_pass = self.velocity, self._stage2
        # What is missing is computed before anything moves.
        missing = self._missing() if self._catches else None
        velocity, travel = self._advance_reference(duration_s)
        room = np.minimum(self._high - self.position, self.position - self._low)
        if missing is not None or (room < self._ends).any():
            if missing is not None:
                self._catch_up(missing, duration_s)
            velocity, travel = self._limit(velocity, travel, low_pass, duration_s)
        else:
            self._reference = velocity.copy()
        self.position = _within(self.position + travel, self._low, self._high)
        self.velocity, self.acceleration = velocity, (velocity - begin) / duration_s
        self.now_s += duration_s
        if not (self._catches or velocity.any() or self._reference_goal.any()):
            self._arrive()

    def _limit(self, reference: FloatArray, travel: FloatArray, low_pass: FloatArray,
               duration_s: float) -> tuple[FloatArray, FloatArray]:
        """
        Return the velocity after an interval, with all that is caught up, and the way in it.

        :param reference: velocity of the references after it, and ``travel`` their way in it
        :param low_pass: what was caught up before it, as velocity
        """
        begin, plain = self.velocity, reference + self._stage2
        # A velocity that was commanded has been limited before.
        top = np.where(self._seeks, self._velocity_limit, np.inf)
        velocity = self._before_the_range_ends(_within(plain, -top, top), duration_s)
        change = self._bound * duration_s
        velocity = _within(velocity, begin - change, begin + change)
        # What the limits take away is not caught up at once.
        held = velocity != plain
        self._catches |= bool(held.any())
        self._reference = np.where(held & ~self._seeks, velocity, reference)
        self._stage2 = np.where(held & self._seeks, velocity - reference, self._stage2)
        even = held | (low_pass != 0.0) | (self._stage2 != 0.0)
        return velocity, np.where(even, (begin + velocity) / 2.0 * duration_s, travel)

    def _arrive(self) -> None:
        if self._resting().all():
            self.moving = False
            self._bound = self._acceleration_limit.copy()
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
            for part in (self._raw, self._stage1, self._stage2, self._reference, self.velocity,
                         self.acceleration):
                part[held] = 0.0

    def _resting(self) -> BoolArray:
        pace = np.maximum.reduce([
            np.abs(self._raw), np.abs(self._stage1), np.abs(self._stage2),
            np.abs(self._reference), np.abs(self._reference_goal)])
        away = np.where(self._seeks, np.abs(self._goal - self.position), 0.0)
        return np.maximum(pace, away) < _ARRIVED

    def _end_streams(self) -> None:
        ended = self._until_s <= self.now_s + 1e-9
        if ended.any():
            self._reference_goal[ended] = 0.0
            self._ramp[ended] = self._acceleration_limit[ended]
            self._until_s[ended] = np.inf

    def _smoothing_s(self) -> FloatArray:
        """Return the time constants with which ways are caught up, shape (n,)."""
        estimator = self._estimator
        stream_s = np.maximum(_SMOOTHING_INTERVALS * estimator.interval_s,
                              _SMOOTHING_JITTERS * estimator.clock.jitter_s)
        return np.where(np.isfinite(self._until_s) & (self._reference_goal != 0.0),
                        np.maximum(stream_s, _SMOOTHING_S), _SMOOTHING_S)

    def _missing(self) -> FloatArray:
        """Return how far setpoints will be behind where they follow, or rest, of themselves."""
        self._brakes &= self._reference != 0.0
        estimator, goal = self._estimator, self._reference_goal
        age_s = np.where(np.isfinite(self._until_s),
                         self.now_s - estimator.clock.sent_s - 1.5 * estimator.interval_s, 0.0)
        change = goal - self._reference
        ramp = -change * np.abs(change) / (2.0 * self._ramp)
        low_pass = self._smoothing_s() * (self._stage1 + self._stage2)
        return np.where(self._seeks & ~self._brakes,
                        self._goal + goal * age_s - self.position - ramp - low_pass, 0.0)

    def _catch_up(self, missing: FloatArray, duration_s: float) -> None:
        limit, top = self._acceleration_limit, self._velocity_limit
        raw = braking_velocity(missing, limit, duration_s)
        change = limit * duration_s
        raw = _within(raw, self._raw - change, self._raw + change)
        raw = _within(raw, -top - self._reference_goal, top - self._reference_goal)
        # Two first-order stages, each of which averages what goes into it over the interval.
        share = duration_s / (self._smoothing_s() + duration_s / 2.0)
        stage1 = self._stage1 + share * (raw - self._stage1)
        stage2 = self._stage2 + share * ((self._stage1 + stage1) / 2.0 - self._stage2)
        pace = np.maximum(np.maximum(np.abs(missing), np.abs(raw)),
                          np.maximum(np.abs(stage1), np.abs(stage2)))
        self._catches = bool(pace.max(initial=0.0) >= _ARRIVED or self._brakes.any())
        if not self._catches:
            raw, stage1, stage2 = np.zeros_like(raw), np.zeros_like(raw), np.zeros_like(raw)
        self._raw, self._stage1, self._stage2 = raw, stage1, stage2

    def _advance_reference(self, duration_s: float) -> tuple[FloatArray, FloatArray]:
        """Return the velocity of the references after an interval, and their way in it."""
        begin = self._reference
        change = self._reference_goal - begin
        ramp_s = np.minimum(np.abs(change) / self._ramp, duration_s)
        end = begin + np.copysign(self._ramp * ramp_s, change)
        return end, np.asarray(end * duration_s - (end - begin) / 2.0 * ramp_s)

    def _before_the_range_ends(self, velocity: FloatArray, duration_s: float) -> FloatArray:
        """Return velocities, at the end of an interval, that allow braking within the range."""
        change = self._bound * duration_s / 2.0
        highest, lowest = (
            np.sqrt(np.maximum(change**2 + 2.0 * self._bound * np.maximum(
                distance - towards * duration_s / 2.0, 0.0), 0.0)) - change
            for distance, towards in (
                (np.minimum(self._high - self.position, 1e6), self.velocity),
                (np.minimum(self.position - self._low, 1e6), -self.velocity)))
        return _within(velocity, -lowest, highest)


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
