# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Setpoints of the same joints in several worlds, advanced together; a row is a world."""

from __future__ import annotations

from collections.abc import Sequence
import copy
from typing import Any

import numpy as np

from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.control.catching_up import caught_up, lateness, missing_way, Terms, terms_of
from manip_sim.control.motion_profiles import Plan, plan_ramps, ramp, within
from manip_sim.control.setpoint_laws import (
    AHEAD_S, ARRIVED, away_from_ends, divided, limited, outside, resting, without_ended)
from manip_sim.control.setpoints import SetpointGenerator
from manip_sim.worlds.shared_goals import SharedGoals

#: What a generator is made of that changes in time, of shape (n,).
_NUMBERS = ('position', 'velocity', 'acceleration', '_reference', '_reference_goal', '_goal',
            '_ramp', '_bound', '_until_s')
_STATE = (*_NUMBERS, '_seeks', '_brakes')
#: What estimators of streams are made of: what is always needed, and what new goals change too.
_OF_STREAMS = ('interval_s', 'jitter_s', 'sent_s')
_OF_GOALS = ('goal', 'velocity', 'acceleration', '_last', '_change')
_OF_STEPS = ('_steps', '_curves', '_fit')


class SetpointRows:
    """
    The setpoints of several generators of the same joints, in arrays of shape (rows, n).

    Each row does, to the last bit, what its generator would do. Its own decisions, such as that
    it has arrived, are those of the row, not of all rows. Goals of a generator must be taken
    before, and none may come while the rows exist.

    :param generators: whose states are taken, until :meth:`release`
    :ivar moves: whether each row moves or is about to, shape (rows,)
    :ivar plans: for the rest of the period, by the rows that began to follow one in the last
        interval, and have to be released
    """

    def __init__(self, generators: Sequence[SetpointGenerator]) -> None:
        self._generators = generators
        first, rows = generators[0], len(generators)
        (self.position, self.velocity, self.acceleration, self._reference, self._reference_goal,
         self._goal, self._ramp, self._bound, self._until_s, self._seeks, self._brakes) = (
            _stacked([getattr(of, name) for of in generators]) for name in _STATE)
        stages = np.concatenate([of._stages for of in generators], axis=1)
        self._stages = np.reshape(stages, (len(stages), rows, -1))
        self._estimator = copy.copy(first._estimator)
        self._stack_estimators(_OF_STREAMS)
        self._low, self._high = first._low, first._high
        self._velocity_limit = first._velocity_limit
        self._acceleration_limit = first._acceleration_limit
        self._inside = first._inside
        #: Between which positions no end of a range is near, as of when a row was asked.
        known = [of._inside_now for of in generators]
        self._knows_ends: BoolArray = np.array([inside is not None for inside in known])
        self._ends = np.stack([inside or (self._low, self._high) for inside in known], axis=1)
        self._terms: Terms | None = None
        self._now_s = np.array([of.now_s for of in generators])[:, None]
        self._next_ends_s = np.array([of._next_end_s for of in generators])
        self._goals_taken = False
        self._catching: BoolArray = np.array([of._catches for of in generators])
        self.moves: BoolArray = np.array([of.moving for of in generators])
        self._ends_s = first._ends_s
        self._begins_s = np.array([of._begin_s for of in generators])[:, None]
        self._interval = -1
        self.plans: dict[int, Plan] = {}

    def _stack_estimators(self, names: Sequence[str]) -> None:
        for name in names:
            setattr(self._estimator, name,
                    _stacked([getattr(of._estimator, name) for of in self._generators]))

    def take(self, shared: SharedGoals) -> None:
        """
        Let some rows come to goals, or follow a stream of them.

        :param shared: by :func:`take_goals`
        """
        if not self._goals_taken:
            self._goals_taken = True
            self.limited = _stacked([of.limited for of in self._generators])
            self._stack_estimators((*_OF_GOALS, 'lost'))
            for name in _OF_STEPS:
                setattr(self._estimator, name, np.concatenate(
                    [getattr(of._estimator, name) for of in self._generators], axis=1))
        rows, count = shared.rows, self.position.shape[1]
        shared.clock.where = slice(None)
        if len(rows) < len(self._generators):
            shared.clock.where = (np.array(rows)[:, None] * count + np.arange(count)).ravel()
        # Nothing in it depends on which row a joint is in.
        flat = self._flat()
        flat.now_s = float(self._now_s[rows[0], 0])
        flat._take(shared.clock, shared.message, shared.goals.ravel())
        shared.set_clocks()
        self._next_ends_s[rows] = self._until_s[rows].min(axis=1, initial=np.inf)
        self._catching[rows] = self.moves[rows] = True
        self._terms = None
        self._knows_ends[rows] = False

    def _flat(self) -> SetpointGenerator:
        """Return a generator of the joints of all rows, whose arrays are views of those here."""
        flat, rows = copy.copy(self._generators[0]), len(self._generators)
        flat._estimator = copy.copy(self._estimator)
        for name in (*_STATE, 'limited'):
            setattr(flat, name, getattr(self, name).reshape(-1))
        for name in (*_OF_STREAMS, *_OF_GOALS, 'lost'):
            setattr(flat._estimator, name, getattr(self._estimator, name).reshape(-1))
        flat._stages = self._stages.reshape(len(self._stages), -1)
        for name in ('_low', '_high', '_velocity_limit', '_acceleration_limit'):
            setattr(flat, name, np.tile(getattr(self, name), rows))
        return flat

    def set_time(self, now_s: FloatArray) -> None:
        """
        Set the simulation time.

        :param now_s: [s], shape (rows,)
        """
        self._now_s = now_s[:, None]

    def release(self, rows: Sequence[int]) -> None:
        """Give the states of rows back to their generators."""
        states = np.stack([*(getattr(self, name) for name in _NUMBERS), *self._stages], axis=1)
        brakes, catches, moves = self._brakes[rows], self._catching.tolist(), self.moves.tolist()
        times, ends = self._now_s[:, 0].tolist(), self._next_ends_s.tolist()
        for row, braking in zip(rows, brakes):
            of, state = self._generators[row], states[row].copy()
            # Views of an array of its own, so that they are made quickly.
            (of.position, of.velocity, of.acceleration, of._reference, of._reference_goal,
             of._goal, of._ramp, of._bound, of._until_s) = state[:len(_NUMBERS)]
            of._stages, of._brakes = state[len(_NUMBERS):], braking.copy()
            of._catches, of.moving = catches[row], moves[row]
            of.now_s, of._next_end_s, of._terms = times[row], ends[row], None
            of.plan, of.row = self.plans.get(row), 0
            of._inside_now = (*self._ends[:, row].copy(),) if self._knows_ends[row] else None
        if self._goals_taken:
            self._release_goals(rows)

    def _release_goals(self, rows: Sequence[int]) -> None:
        estimator, count = self._estimator, len(self._generators)
        states = np.stack([
            *(getattr(estimator, name) for name in (*_OF_STREAMS, *_OF_GOALS)),
            *(part.reshape(count, -1) for name in _OF_STEPS for part in getattr(estimator, name))
        ], axis=1)
        for row, seeks, clipped, lost in zip(
                rows, self._seeks[rows], self.limited[rows], estimator.lost[rows]):
            of, state = self._generators[row], states[row].copy()
            own = of._estimator
            (own.interval_s, own.jitter_s, own.sent_s, own.goal, own.velocity, own.acceleration,
             own._last, own._change) = state[:8]
            own._steps, own._curves, own._fit = state[8:10], state[10:12], state[12:]
            of._seeks, of.limited, own.lost = seeks.copy(), clipped.copy(), lost.copy()

    def advance(self, duration_s: float) -> None:
        """
        Advance all setpoints.

        :param duration_s: length of the interval [s]
        """
        self._interval += 1
        self.plans = {}
        begin = self.velocity
        missing, catches, near = self._look(duration_s)
        self._look_ahead(~(catches | near))
        velocity, travel = ramp(self._reference, self._reference_goal, self._ramp, duration_s)
        acts = catches | near
        if np.count_nonzero(acts):
            before = self._stages[2]
            self._catch_up(missing, catches, duration_s)
            velocity, travel = self._limit(velocity, travel, before, near, acts, duration_s)
        else:
            self._reference = velocity
        self.position = self.position + travel
        if np.count_nonzero(near):
            self.position = np.where(
                near[:, None], within(self.position, self._low, self._high), self.position)
        self.velocity, self.acceleration = velocity, (velocity - begin) / duration_s
        if self.plans:
            rows, plans = list(self.plans), self.plans.values()
            self.position[rows] = [plan.positions[0] for plan in plans]
            self.velocity[rows] = self._reference[rows] = [plan.velocities[0] for plan in plans]
            self.acceleration[rows] = [plan.accelerations[0] for plan in plans]
        self._now_s = self._now_s + duration_s
        done = ~(self._catching | velocity.any(axis=1) | self._reference_goal.any(axis=1))
        if np.count_nonzero(done):
            self._arrive(done)

    def _look(self, duration_s: float) -> tuple[FloatArray, BoolArray, BoolArray]:
        """Return what is missing, and which rows catch up or are near the end of a range."""
        due = self._next_ends_s <= self._now_s[:, 0] + 1e-9
        if np.count_nonzero(due):
            self._end_streams(due)
        missing, catches = self._missing()
        return missing, catches, self._rows_near_ends(catches, duration_s)

    @property
    def all_go_on(self) -> bool:
        """Whether the reference of each row moves, so that none of them has arrived."""
        return bool(self._reference.any(axis=1).all())

    def plan_period(self, now_s: float, ends_s: FloatArray) -> Plan | None:
        """
        Begin a control period of all rows, and return the plan that all of them follow in it.

        :param now_s: simulation time [s]
        :param ends_s: when its intervals end, since it begins [s], shape (k, 1)
        :returns: of shape (k, rows, n); None if some do not, and then nothing has moved
        """
        rows = len(self._generators)
        self._interval, self._ends_s = 0, ends_s
        self._now_s = self._begins_s = np.full((rows, 1), now_s)
        _, catches, near = self._look(float(ends_s[0, 0]))
        if np.count_nonzero(catches | near):
            return None
        found = self._plan_of(~catches)
        return found[0] if found is not None and np.count_nonzero(found[2]) == rows else None

    def follow_plan(self, plan: Plan) -> None:
        """Follow a plan of :meth:`plan_period` to its end."""
        self.position, self.velocity, self.acceleration = (
            plan.positions[-1], plan.velocities[-1], plan.accelerations[-1])
        self._reference = self.velocity.copy()
        self._now_s = self._now_s + float(self._ends_s[0, 0])

    def _look_ahead(self, plain: BoolArray) -> None:
        """Plan the rest of the period for rows in which only references move."""
        found = self._plan_of(plain)
        if found is None:
            return
        plan, rows, fits = found
        durations_s = np.broadcast_to(plan.durations_s, (*plan.positions.shape[:2], 1))
        for number in np.flatnonzero(fits).tolist():
            self.plans[int(rows[number])] = Plan(
                durations_s[:, number], *(part[:, number] for part in plan[1:]))

    def _plan_of(self, plain: BoolArray) -> tuple[Plan, IntArray, BoolArray] | None:
        """
        Return a plan for the rest of the period, or None if there is none.

        :param plain: rows in which only references move
        :returns: what rows would do, these rows, and which of them can do it
        """
        at, rows = self._interval, np.flatnonzero(plain & self._reference_goal.any(axis=1))
        ends_s = self._ends_s[at:, None]
        if len(ends_s) < 2 or not rows.size:
            return None
        if at:
            ends_s = ends_s - (self._now_s - self._begins_s)[rows]
        plan = plan_ramps(self.position[rows], self._reference[rows], self._reference_goal[rows],
                          self._ramp[rows], ends_s)
        fits = self._next_ends_s[rows] > self._now_s[rows, 0] + ends_s[-2, :, 0] + 1e-9
        away = outside(plan.positions[:-1], *self._inside).any(axis=(0, 2))
        asked = np.flatnonzero(away & fits)
        if asked.size:
            fits[asked] = ~outside(
                plan.positions[:-1, asked], *self._inside_of(rows[asked])).any(axis=(0, 2))
        return plan, rows, fits

    def _end_streams(self, due: BoolArray) -> None:
        self._until_s, self._reference_goal, self._ramp, self._bound = without_ended(
            self._until_s, self._now_s, self._reference_goal, self._ramp, self._bound,
            self._acceleration_limit)
        self._next_ends_s = self._until_s.min(axis=1, initial=np.inf)
        self._terms = None
        self._knows_ends[due] = False

    def _get_terms(self) -> Terms:
        if self._terms is None:
            self._terms = terms_of(self._estimator, self._until_s < np.inf, self._seeks,
                                   self._reference_goal, self._velocity_limit)
        return self._terms

    def _missing(self) -> tuple[FloatArray, BoolArray]:
        """Return what is missing of the ways, and which rows have something to catch up."""
        missing = missing_way(
            self._goal, lateness(self._estimator, self._until_s < np.inf, self._now_s),
            self.position, self._reference, self._reference_goal, self._ramp)
        has_stages = self._stages.any(axis=(0, 2))
        missing -= self._get_terms().smoothing_s * (self._stages[1] + self._stages[2])
        seeks, brakes = self._seeks, self._brakes.any(axis=1)
        if np.count_nonzero(brakes):
            self._brakes &= self._reference != 0.0
            seeks = seeks & ~self._brakes
        missing = np.where(seeks, missing, 0.0)
        far = (np.abs(missing) >= ARRIVED).any(axis=1)
        catches = self._catching & (has_stages | brakes | far)
        self._catching = catches
        return missing, catches

    def _rows_near_ends(self, catches: BoolArray, duration_s: float) -> BoolArray:
        """Return which rows are near the end of a range."""
        if duration_s >= AHEAD_S:
            return np.ones(len(catches), dtype=bool)
        near = np.asarray(outside(self.position, *self._inside).any(axis=1))
        asked = np.flatnonzero(near & ~catches)
        if asked.size:
            near[asked] = outside(self.position[asked], *self._inside_of(asked)).any(axis=1)
        return near

    def _inside_of(self, rows: IntArray) -> FloatArray:
        """Return positions between which no end of a range is near, shape (2, rows, n)."""
        new = rows[~self._knows_ends[rows]]
        if new.size:
            self._ends[:, new] = away_from_ends(
                self._low, self._high,
                np.maximum(np.abs(self._reference[new]), np.abs(self._reference_goal[new])),
                self._acceleration_limit)
            self._knows_ends[new] = True
        return self._ends[:, rows]

    def _catch_up(self, missing: FloatArray, catches: BoolArray, duration_s: float) -> None:
        stages = caught_up(self._stages, missing, self._acceleration_limit, self._get_terms(),
                           duration_s)
        largest = np.maximum(np.abs(missing).max(axis=1, initial=0.0),
                             np.abs(stages).max(axis=(0, 2), initial=0.0))
        goes_on = catches & ((largest >= ARRIVED) | self._brakes.any(axis=1))
        if not goes_on.all():
            stages = np.where(goes_on[:, None], stages, 0.0)
        self._catching, self._stages = goes_on, stages

    def _limit(self, reference: FloatArray, travel: FloatArray, before: FloatArray,
               near: BoolArray, acts: BoolArray, duration_s: float
               ) -> tuple[FloatArray, FloatArray]:
        """
        Return velocities after an interval and the ways in it, as for a single generator.

        :param near: which rows are near the end of a range, shape (rows,)
        :param acts: whose velocities are more than those of references, shape (rows,)
        """
        begin, caught_up = self.velocity, self._stages[2]
        plain, top, bound = reference + caught_up, self._get_terms().top, self._bound
        velocity = limited(plain, begin, top, bound, duration_s, None)
        rows = np.flatnonzero(near)
        if rows.size:
            ranges = self.position[rows] - self._low, self._high - self.position[rows]
            velocity[rows] = limited(
                plain[rows], begin[rows], top[rows], bound[rows], duration_s, ranges)
        held = (velocity != plain) & acts[:, None]
        velocity = np.where(acts[:, None], velocity, reference)
        if np.count_nonzero(held):
            self._catching = self._catching | held.any(axis=1)
            reference, caught_up = divided(velocity, held, reference, caught_up, self._seeks)
            self._stages[2] = caught_up
        self._reference = reference
        even = held | (before != 0.0) | (caught_up != 0.0)
        return velocity, np.where(even, (begin + velocity) / 2.0 * duration_s, travel)

    def _arrive(self, done: BoolArray) -> None:
        arrived = resting(self._stages, self._reference, self._reference_goal,
                          self._goal - self.position, self._seeks)
        rests: BoolArray = np.logical_and(done, arrived.all(axis=1))
        self._catching = self._catching | (done & ~rests)
        self.moves = self.moves & ~rests
        self._bound = np.where(rests[:, None], self._acceleration_limit, self._bound)
        self.position = np.where(rests[:, None] & self._seeks, self._goal, self.position)
        self._stages = np.where(rests[:, None], 0.0, self._stages)
        self.velocity = np.where(rests[:, None], 0.0, self.velocity)
        self.acceleration = np.where(rests[:, None], 0.0, self.acceleration)

    def hold_back(self, measured: FloatArray, lead: FloatArray) -> None:
        """
        Keep setpoints from running ahead of joints that cannot keep up.

        :param measured: where the joints are [rad or m], shape (rows, n)
        :param lead: how far a setpoint may be from there [rad or m], shape (rows, n)
        """
        held = np.abs(self.position - measured) > lead
        if not np.count_nonzero(held):
            return
        rows = np.asarray(held.any(axis=1))
        for row in np.flatnonzero(rows).tolist():
            self.plans.pop(row, None)
        self.position = np.where(rows[:, None], within(
            self.position, measured - lead, measured + lead), self.position)
        self._catching = self._catching | rows
        self._stages[:, held] = 0.0
        for part in (self._reference, self.velocity, self.acceleration):
            part[held] = 0.0


def _stacked(values: list[Any]) -> Any:
    return np.concatenate(values).reshape(len(values), -1)
