# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Setpoints of joints at each instant; how actuators follow them is not decided here."""

from __future__ import annotations

import numpy as np

from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.simulation.catching_up import caught_up, Terms, terms_of
from manip_sim.simulation.message_clock import MessageClock
from manip_sim.simulation.profiles import (
    change_before_the_end, evenly_braked, Plan, plan_ramps, ramp, velocity_before_the_end,
    way_of_ramp, within)
from manip_sim.simulation.streams import RampEstimator, StreamEstimator, WaitingGoal, WaitingGoals

#: Multiple of a stream's own acceleration that its setpoint may use.
_STREAM_ACCELERATION = 1.5
#: Share of the acceleration limit with which joints come to rest that no command moves any more:
#: servos add up to 15 % while they take over.
_BRAKING = 0.87
#: A setpoint that is slower and nearer to its goal than this has arrived [rad or m, and per s].
ARRIVED = 1e-10
#: Where the range ends is looked for this far ahead, beside the way of braking [s].
AHEAD_S = 0.1


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
    :ivar plan: that they follow, where nothing moves but streams on schedule, or None
    :ivar row: which of its intervals was the last one
    """

    #: Only counted, or computed from the rest.
    not_in_digest = ('limited', '_terms', '_inside_now', '_ends_s', '_begin_s', 'plan', 'row')

    def __init__(self, position_range: FloatArray, velocity_limit: FloatArray,
                 acceleration_limit: FloatArray) -> None:
        count = len(velocity_limit)
        self._low, self._high = position_range.T.copy()
        self._velocity_limit, self._acceleration_limit = velocity_limit, acceleration_limit
        self.limited = np.zeros(count, dtype=np.int64)
        self._estimator, self._ramp_estimator = StreamEstimator(count), RampEstimator(count)
        # When the intervals of a control period end, since it began.
        self._ends_s: FloatArray = np.zeros((0, 1))
        # Positions between which no end of the range is near at any velocity.
        self._inside = self._away_from_ends(velocity_limit)
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

    def at_rest(self, indices: IntArray) -> bool:
        """Return whether all of the given setpoints rest at their goals."""
        if not self.moving:
            return True
        if np.count_nonzero(self._reference[indices]) or self._waiting.brings(indices):
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
        if not clock.continues(self.now_s):
            # What the reference of a setpoint does that is no stream becomes a way to its goal.
            self._stages[:, at] += self._reference[at]
            self._reference[at] = 0.0
        limit = self._acceleration_limit[at]
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
            bound = np.maximum(limit, _STREAM_ACCELERATION * estimator.acceleration[at])
            self._bound[at] = np.maximum(bound, self._bound[at])
        change = np.abs(velocity - self._reference[at])
        self._goal[at], self._reference_goal[at] = goal, velocity
        ramp_s = min(max(left_s, 0.5 * interval_s), 1.5 * interval_s) + clock.slack_s
        self._ramp[at] = np.minimum(np.maximum(change / ramp_s, 1e-9), bound)
        self._until_s[at] = clock.until_s

    def come_back(self, indices: IntArray, goal: FloatArray) -> None:
        """
        Let moving setpoints brake, and then come to a position.

        :param goal: [rad or m], shape of ``indices``
        """
        self.set_velocity(indices, np.zeros(len(indices)))
        self._goal[indices] = goal
        self._seeks[indices] = self._brakes[indices] = True
        self._terms = None

    def begin_period(self, ends_s: FloatArray) -> None:
        """
        Begin a control period.

        :param ends_s: when its intervals end, since it begins now [s], shape (k, 1)
        """
        self._ends_s, self._begin_s, self.plan = ends_s, self.now_s, None

    def advance(self, duration_s: float) -> None:
        """
        Advance all setpoints.

        :param duration_s: length of the interval [s]
        """
        if self._waiting:
            self._take_goals()
        if self._next_end_s <= self.now_s + 1e-9:
            self._end_streams()
        if self.plan is not None and self.row + 1 < len(self.plan.durations_s):
            self._follow(self.plan, self.row + 1, duration_s)
            return
        self.plan = None
        begin, reference, position = self.velocity, self._reference, self.position
        # What is missing is computed before anything moves.
        missing = self._missing() if self._catches else None
        near = duration_s >= AHEAD_S or self._is_near_ends(self.position, missing is not None)
        if missing is None and not near:
            self.plan = self._look_ahead()
            if self.plan is not None:
                self._follow(self.plan, 0, duration_s)
                return
        velocity, travel = ramp(reference, self._reference_goal, self._ramp, duration_s)
        if missing is not None or near:
            before = self._stages[2]
            if missing is not None:
                self._catch_up(missing, duration_s)
            velocity, travel = self._limit(velocity, travel, before, near, duration_s)
        else:
            self._reference = velocity.copy()
        position = position + travel
        self.position = within(position, self._low, self._high) if near else position
        self.velocity, self.acceleration = velocity, (velocity - begin) / duration_s
        self.now_s += duration_s
        if not (self._catches or np.count_nonzero(velocity)
                or np.count_nonzero(self._reference_goal)):
            self._arrive()

    def _away_from_ends(self, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return positions between which nothing that is not faster has to brake."""
        way = velocity**2 / self._acceleration_limit + AHEAD_S * velocity
        return self._low + way, self._high - way

    def _look_ahead(self) -> Plan | None:
        """Return a plan for the rest of the period, if only references move in it."""
        since_s = self.now_s - self._begin_s
        first = int(np.count_nonzero(self._ends_s <= since_s + 1e-9))
        ends_s = self._ends_s[first:] - since_s if first else self._ends_s
        if len(ends_s) < 2 or not np.count_nonzero(self._reference_goal):
            return None
        if self._next_end_s <= self.now_s + float(ends_s[-2, 0]) + 1e-9:
            return None
        plan = plan_ramps(
            self.position, self._reference, self._reference_goal, self._ramp, ends_s)
        return None if self._is_near_ends(plan.positions[:-1], False) else plan

    def _follow(self, plan: Plan, row: int, duration_s: float) -> None:
        self.position, self.velocity, self.acceleration = (
            plan.positions[row], plan.velocities[row], plan.accelerations[row])
        self._reference, self.row = self.velocity.copy(), row
        self.now_s += duration_s

    def end_plan(self) -> None:
        """Follow the plan through all intervals that are left in it."""
        assert self.plan is not None
        self._follow(self.plan, len(self.plan.durations_s) - 1, 0.0)

    def _is_near_ends(self, position: FloatArray, catches: bool) -> bool:
        low, high = self._inside
        if not np.count_nonzero((position < low) | (position > high)):
            return False
        if catches:
            return True
        if self._inside_now is None:
            self._inside_now = self._away_from_ends(
                np.maximum(np.abs(self._reference), np.abs(self._reference_goal)))
        low, high = self._inside_now
        return bool(np.count_nonzero((position < low) | (position > high)))

    def _limit(self, reference: FloatArray, travel: FloatArray, before: FloatArray, near: bool,
               duration_s: float) -> tuple[FloatArray, FloatArray]:
        """
        Return the velocity after an interval, with all that is caught up, and the way in it.

        :param reference: velocity of the references after it, and ``travel`` their way in it
        :param before: what was caught up before it, as velocity
        :param near: whether some are near the end of their range
        """
        begin, caught_up = self.velocity, self._stages[2]
        plain = reference + caught_up
        # A velocity that was commanded has been limited before.
        top = self._get_terms().top
        velocity = within(plain, -top, top)
        change = self._bound * duration_s
        if near:
            ranges = self.position - self._low, self._high - self.position
            velocity = velocity_before_the_end(velocity, begin, *ranges, self._bound, duration_s)
            change = change_before_the_end(begin, *ranges, self._bound, duration_s)
        velocity = within(velocity, begin - change, begin + change)
        held = velocity != plain
        if np.count_nonzero(held):
            # What the limits take away is not caught up at once.
            self._catches = True
            reference = np.where(held & ~self._seeks, velocity, reference)
            self._stages[2] = caught_up = np.where(
                held & self._seeks, velocity - reference, caught_up)
        self._reference = reference.copy()
        even = held | (before != 0.0) | (caught_up != 0.0)
        return velocity, np.where(even, (begin + velocity) / 2.0 * duration_s, travel)

    def _arrive(self) -> None:
        if self._resting().all():
            self.moving = False
            self._bound = self._acceleration_limit.copy()
            self.position[self._seeks] = self._goal[self._seeks]
            for part in (self._stages, self.velocity, self.acceleration):
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
        held = np.abs(self.position - measured) > lead
        if np.count_nonzero(held):
            self.position = within(self.position, measured - lead, measured + lead)
            self._catches, self.plan = True, None
            self._stages[:, held] = 0.0
            for part in (self._reference, self.velocity, self.acceleration):
                part[held] = 0.0

    def _resting(self) -> BoolArray:
        pace = np.maximum.reduce(np.abs([
            *self._stages, self._reference, self._reference_goal]))
        away = np.where(self._seeks, np.abs(self._goal - self.position), 0.0)
        return np.maximum(pace, away) < ARRIVED

    def _end_streams(self) -> None:
        ended = self._until_s <= self.now_s + 1e-9
        self._reference_goal[ended] = 0.0
        self._ramp[ended] = self._acceleration_limit[ended]
        self._until_s[ended] = np.inf
        self._next_end_s = float(self._until_s.min(initial=np.inf))
        self._inside_now = self._terms = self.plan = None

    def _get_terms(self) -> Terms:
        if self._terms is None:
            self._terms = terms_of(self._estimator, self._until_s < np.inf, self._seeks,
                                   self._reference_goal, self._velocity_limit)
        return self._terms

    def _missing(self) -> FloatArray | None:
        """
        Return how far setpoints will be behind where they follow, or rest, of themselves.

        :returns: None if nothing is to be caught up
        """
        estimator, goal, reference = self._estimator, self._reference_goal, self._reference
        age_s = np.where(self._until_s < np.inf,
                         self.now_s - estimator.sent_s - 1.5 * estimator.interval_s, 0.0)
        missing = (self._goal + goal * age_s - self.position
                   - way_of_ramp(reference, goal, self._ramp))
        caught_up = np.count_nonzero(self._stages)
        if caught_up:
            missing -= self._get_terms().smoothing_s * (self._stages[1] + self._stages[2])
        seeks, brakes = self._seeks, np.count_nonzero(self._brakes)
        if brakes:
            self._brakes &= reference != 0.0
            seeks = seeks & ~self._brakes
        missing = np.where(seeks, missing, 0.0)
        if not (caught_up or brakes or np.count_nonzero(np.abs(missing) >= ARRIVED)):
            self._catches = False
            return None
        return missing

    def _catch_up(self, missing: FloatArray, duration_s: float) -> None:
        stages = caught_up(self._stages, missing, self._acceleration_limit, self._get_terms(),
                           duration_s)
        self._catches = bool(max(np.abs(missing).max(initial=0.0), np.abs(stages).max(initial=0.0))
                             >= ARRIVED or np.count_nonzero(self._brakes))
        self._stages = stages if self._catches else np.zeros_like(stages)
