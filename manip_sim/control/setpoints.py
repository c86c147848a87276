# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Setpoints of joints at each instant; how actuators follow them is not decided here."""

from __future__ import annotations

import numpy as np

from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.control.catching_up import caught_up, lateness, missing_way, Terms, terms_of
from manip_sim.control.motion_profiles import Plan, plan_ramps, ramp, within
from manip_sim.control.setpoint_goals import SetpointGoals
from manip_sim.control.setpoint_laws import (
    AHEAD_S, ARRIVED, away_from_ends, divided, limited, outside, resting, without_ended)


class SetpointGenerator(SetpointGoals):
    """
    A generator of setpoints that are continuous in position and velocity and keep to limits.

    A setpoint has a *reference*, a velocity that ramps to that of the goals within one message
    interval: on schedule it takes the setpoint along a stream one and a half intervals late. What
    is then still missing of the way is *caught up*: by a time-optimal profile with limited
    velocity and acceleration, and after it two low-pass stages, which average and so never
    overshoot. The way to a single goal is caught up as a whole. Last, the sum is limited: it never
    exceeds the velocity limit, nor accelerates or brakes harder than the acceleration limit or
    twice as hard as the stream itself. All is in closed form for time steps of any length.

    Its coordinates are joints, or any others with such limits. Parameters and variables are
    those of :class:`SetpointGoals`.
    """

    #: Only counted, or computed from the rest.
    not_in_digest = ('limited', '_terms', '_inside_now', '_ends_s', '_begin_s', 'plan', 'row')

    def __init__(self, position_range: FloatArray, velocity_limit: FloatArray,
                 acceleration_limit: FloatArray) -> None:
        super().__init__(position_range, velocity_limit, acceleration_limit)
        # Positions between which no end of the range is near at any velocity.
        self._inside = away_from_ends(self._low, self._high, velocity_limit, acceleration_limit)

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
        if not np.count_nonzero(outside(position, *self._inside)):
            return False
        if catches:
            return True
        if self._inside_now is None:
            self._inside_now = away_from_ends(
                self._low, self._high,
                np.maximum(np.abs(self._reference), np.abs(self._reference_goal)),
                self._acceleration_limit)
        return bool(np.count_nonzero(outside(position, *self._inside_now)))

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
        ranges = (self.position - self._low, self._high - self.position) if near else None
        velocity = limited(
            plain, begin, self._get_terms().top, self._bound, duration_s, ranges)
        held = velocity != plain
        if np.count_nonzero(held):
            # What the limits take away is not caught up at once.
            self._catches = True
            reference, caught_up = divided(velocity, held, reference, caught_up, self._seeks)
            self._stages[2] = caught_up
        self._reference = reference
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
        return resting(self._stages, self._reference, self._reference_goal,
                       self._goal - self.position, self._seeks)

    def _end_streams(self) -> None:
        self._until_s, self._reference_goal, self._ramp, self._bound = without_ended(
            self._until_s, self.now_s, self._reference_goal, self._ramp, self._bound,
            self._acceleration_limit)
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
        reference = self._reference
        missing = missing_way(
            self._goal, lateness(self._estimator, self._until_s < np.inf, self.now_s),
            self.position, reference, self._reference_goal, self._ramp)
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
