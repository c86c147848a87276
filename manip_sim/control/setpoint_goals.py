# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What setpoints of joints are to come to: positions, velocities, and streams of them."""

from __future__ import annotations

import numpy as np

from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.control.catching_up import Terms
from manip_sim.control.message_clock import MessageClock
from manip_sim.control.motion_profiles import evenly_braked, Plan, within
from manip_sim.control.stream_estimation import (
    RampEstimator, StreamEstimator, WaitingGoal, WaitingGoals)

#: Multiple of a stream's own acceleration that its setpoint may use.
_STREAM_ACCELERATION = 1.5
#: Share of the acceleration limit with which joints come to rest that no command moves any more:
#: servos add up to 15 % while they take over.
_BRAKING = 0.87
#: A goal that is nearer to an end of its range is at it [rad or m].
_AT_END = 1e-9


class SetpointGoals:
    """
    Setpoints, what they are to come to, and how they may.

    :param position_range: lowest and highest setpoint [rad or m], shape (n, 2)
    :param velocity_limit: [rad/s or m/s], shape (n,)
    :param acceleration_limit: of steps, velocities and stops [rad/s^2 or m/s^2], shape (n,)
    :ivar position: setpoint at the end of the last interval [rad or m], shape (n,)
    :ivar velocity: its velocity there [rad/s or m/s], shape (n,)
    :ivar acceleration: its acceleration there [rad/s^2 or m/s^2], shape (n,)
    :ivar limited: how often a streamed goal required more than the velocity limit, shape (n,)
    :ivar now_s: simulation time, which the caller may set [s]
    :ivar moving: whether any setpoint moves or is about to
    :ivar plan: that they follow, where nothing moves but streams on schedule, or None
    :ivar row: which of its intervals was the last one
    """

    def __init__(self, position_range: FloatArray, velocity_limit: FloatArray,
                 acceleration_limit: FloatArray) -> None:
        count = len(velocity_limit)
        self._low, self._high = position_range.T.copy()
        self._velocity_limit, self._acceleration_limit = velocity_limit, acceleration_limit
        self.limited = np.zeros(count, dtype=np.int64)
        self._estimator, self._ramp_estimator = StreamEstimator(count), RampEstimator(count)
        # When the intervals of a control period end, since it began.
        self._ends_s: FloatArray = np.zeros((0, 1))
        self._begin()

    def _begin(self) -> None:
        count = len(self._low)
        self.position, self.velocity, self.acceleration = np.zeros((3, count))
        self.moving = False
        # Whether there is something to catch up.
        self._catches = False
        self._seeks, self._brakes = np.zeros((2, count), dtype=bool)
        self._waiting = WaitingGoals(count)
        # What is caught up: velocity before and after each low-pass stage.
        self._stages = np.zeros((3, count))
        # The reference: its velocity, what it ramps to and how fast, and until when.
        self._reference, self._reference_goal, self._goal = np.zeros((3, count))
        self._ramp, self._bound = self._acceleration_limit.copy(), self._acceleration_limit.copy()
        self._until_s, self._next_end_s = np.full(count, np.inf), np.inf
        # The terms, and the same positions for the references; None until they are needed.
        self._terms: Terms | None = None
        self._inside_now: tuple[FloatArray, FloatArray] | None = None
        self.now_s = self._begin_s = 0.0
        self.plan: Plan | None = None
        self.row = 0

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
        for estimator in (self._estimator, self._ramp_estimator):
            estimator.clocks.set(indices, longest_s, hold_s)

    def stream_settings(self, index: int) -> tuple[float, float]:
        """Return what :meth:`set_stream` has set for a setpoint [s]."""
        return self._estimator.clocks.settings(index)

    @property
    def lost(self) -> IntArray:
        """How many messages of streams seem to have been lost, shape (n,)."""
        return np.asarray(self._estimator.lost + self._ramp_estimator.lost)

    def place(self, indices: IntArray, position: FloatArray, velocity: FloatArray) -> None:
        """
        Set position and velocity of setpoints, which come to rest from there.

        Beyond an end of the range, they stop at it.

        :param position: [rad or m], shape of ``indices``
        :param velocity: [rad/s or m/s], shape of ``indices``
        """
        low, high = self._low[indices], self._high[indices]
        self.position[indices] = np.clip(position, low, high)
        self.velocity[indices] = np.clip(velocity, np.where(position < low, 0.0, -np.inf),
                                         np.where(position > high, 0.0, np.inf))
        self.acceleration[indices] = 0.0
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
        slope, own = np.empty((2, len(indices)))
        for clock, places in self._ramp_estimator.clocks.of(indices, self.now_s):
            clock.notice_pause(self.now_s, stamp_s, messages)
            if not clock.continues(self.now_s):
                self._bound[clock.where] = limit[places]
            slope[places], own[places] = self._ramp_estimator.take(
                clock, velocity[places], self.velocity[clock.where], self.now_s, period_s,
                limit[places], messages, stamp_s)
        self._come_to(indices, velocity)
        bound = np.maximum(limit, _STREAM_ACCELERATION * own)
        self._bound[indices] = np.maximum(bound, self._bound[indices])
        self._ramp[indices] = np.minimum(np.maximum(slope, 1e-9), bound)

    def set_velocity(self, indices: IntArray, velocity: FloatArray) -> None:
        """
        Let setpoints come to a velocity with the acceleration limit; zero holds them.

        :param velocity: [rad/s or m/s], shape of ``indices``
        """
        self._ramp_estimator.forget(indices)
        self._bound[indices] = self._acceleration_limit[indices]
        self._come_to(indices, velocity)

    def ramp_to(self, indices: IntArray, velocity: FloatArray, duration_s: float,
                limit: FloatArray | None = None) -> None:
        """
        Let setpoints come to a velocity evenly within a time, or later at the acceleration limit.

        :param velocity: [rad/s or m/s], shape of ``indices``
        :param duration_s: the time [s]
        :param limit: of the acceleration, if it is not that of the joints
            [rad/s^2 or m/s^2], shape of ``indices``
        """
        self.set_velocity(indices, velocity)
        change = np.abs(velocity - self._reference[indices])
        if limit is None:
            limit = self._ramp[indices]
        else:
            self._bound[indices] = np.maximum(limit, self._bound[indices])
        self._ramp[indices] = np.clip(change / duration_s, 1e-9, limit)

    def brake(self, indices: IntArray) -> None:
        """
        Let setpoints come to rest together, as soon as their acceleration limits allow.

        Where the range would end before, they slow down evenly up to there.
        """
        velocity = self.velocity[indices]
        self.set_velocity(indices, np.zeros(len(indices)))
        # They are at rest at the end of an interval, at the earliest of the first one.
        self._ramp[indices] = evenly_braked(
            velocity, self.position[indices], self._low[indices], self._high[indices],
            _BRAKING * self._acceleration_limit[indices],
            float(self._ends_s[0, 0]) if len(self._ends_s) else 0.0)
        self._bound[indices] = np.maximum(self._bound[indices], self._ramp[indices])
        self.acceleration[indices] = -np.sign(velocity) * self._ramp[indices]

    def _come_to(self, indices: IntArray, velocity: FloatArray) -> None:
        self._reference[indices] = self.velocity[indices]
        self._stages[:, indices] = 0.0
        self._seeks[indices] = self._brakes[indices] = False
        self._reference_goal[indices] = velocity
        self._ramp[indices] = self._acceleration_limit[indices]
        self._until_s[indices] = np.inf
        self._estimator.forget(indices)
        if self._waiting:
            self._waiting.withdraw(indices)
        self._start()

    def _start(self) -> None:
        """Move, by other goals than before."""
        self.moving = self._catches = True
        self._inside_now = self._terms = self.plan = None

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
        self._waiting.add(WaitingGoal(indices, goal, messages, stamp_s, period_s))
        self.moving = self._catches = True

    def _take_goals(self) -> None:
        """Take in the goals that came at this instant."""
        for waiting in self._waiting.take_all():
            for clock, places in self._estimator.clocks.of(waiting.indices, self.now_s):
                self._take(clock, waiting, waiting.goal[places])
        self._next_end_s = float(self._until_s.min(initial=np.inf))
        self._start()

    def _take(self, clock: MessageClock, waiting: WaitingGoal, goal: FloatArray) -> None:
        estimator, at = self._estimator, clock.where
        self._brakes[at], self._seeks[at] = False, True
        limit = self._acceleration_limit[at]
        clock.notice_pause(self.now_s, waiting.stamp_s, waiting.messages)
        if not clock.continues(self.now_s):
            # What the reference of a setpoint does that is no stream becomes a way to its goal.
            self._stages[:, at] += self._reference[at]
            self._reference[at] = 0.0
            self._bound[at] = limit
        estimator.take(clock, goal, self.now_s, waiting.period_s, limit, waiting.messages,
                       waiting.stamp_s)
        top, wanted = self._velocity_limit[at], estimator.velocity[at]
        velocity = within(wanted, -top, top)
        self.limited[at] += velocity != wanted
        # A message that is early or late has more or less of its interval left.
        interval_s = max(clock.interval_s, waiting.period_s)
        left_s = clock.sent_s + interval_s - self.now_s
        bound = limit
        if clock.on_time:
            own = np.where(self._cut_off(at), 0.0, estimator.acceleration[at])
            bound = np.maximum(limit, _STREAM_ACCELERATION * own)
            self._bound[at] = np.maximum(bound, self._bound[at])
        change = np.abs(velocity - self._reference[at])
        self._goal[at], self._reference_goal[at] = goal, velocity
        ramp_s = min(max(left_s, 0.5 * interval_s), 1.5 * interval_s) + clock.slack_s
        self._ramp[at] = np.minimum(np.maximum(change / ramp_s, 1e-9), bound)
        self._until_s[at] = clock.until_s

    def _cut_off(self, at: slice | IntArray) -> BoolArray:
        """Tell where the acceleration of a stream is that of goals clamped to the range."""
        goals = self._estimator.last_goals(at)
        low, high = self._low[at] + _AT_END, self._high[at] - _AT_END
        return np.asarray(((goals <= low) | (goals >= high)).any(axis=0))

    def come_back(self, indices: IntArray, goal: FloatArray) -> None:
        """
        Let moving setpoints brake, and then come to a position.

        :param goal: [rad or m], shape of ``indices``
        """
        self.set_velocity(indices, np.zeros(len(indices)))
        self._goal[indices] = goal
        self._seeks[indices] = self._brakes[indices] = True
        self._terms = None

    def follow(self, indices: IntArray, position: FloatArray, velocity: FloatArray,
               acceleration: FloatArray) -> None:
        """
        Set the present setpoints from another source, such as a trajectory.

        When it ends, they come to rest from there. Beyond the range, they rest at its end.

        :param position: [rad or m], shape of ``indices``; ``velocity`` and ``acceleration`` too
        """
        inside = (position >= self._low[indices]) & (position <= self._high[indices])
        self.place(indices, position, np.where(inside, velocity, 0.0))
        self.acceleration[indices] = np.where(inside, acceleration, 0.0)
