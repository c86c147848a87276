# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Setpoints of the same joints in several worlds, advanced together; a row is a world."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from manip_sim.arrays import BoolArray, FloatArray
from manip_sim.control.law.joint_records import records
from manip_sim.control.motion_profiles import Plan
from manip_sim.control.setpoints import hold_back, plan_of, SetpointGenerator


class SetpointRows:
    """
    The setpoints of several generators of the same joints, as records of shape (rows, n).

    :param generators: whose states are taken, until :meth:`release`
    :ivar moves: whether each row moves or is about to, shape (rows,)
    :ivar plans: for the rest of the period, by the rows that began to follow one in the last
        interval, and have to be released
    """

    def __init__(self, generators: Sequence[SetpointGenerator]) -> None:
        self._generators = generators
        self._state = np.stack([of._state for of in generators])
        self._states, self._ends_s = self._state[:, None], np.zeros(0)
        self._now_s = np.array([of.now_s for of in generators])
        self.moves: BoolArray = np.array([of.moving for of in generators])
        self.plans: dict[int, Plan] = {}

    @property
    def _joints(self) -> Any:
        return records(self._state)

    @property
    def position(self) -> FloatArray:
        """Setpoints [rad or m], shape (rows, n), a view; velocity and acceleration too."""
        return np.asarray(self._joints['position'])

    @property
    def velocity(self) -> FloatArray:
        """Their velocities [rad/s or m/s], shape (rows, n), a view."""
        return np.asarray(self._joints['velocity'])

    @property
    def acceleration(self) -> FloatArray:
        """Their accelerations [rad/s^2 or m/s^2], shape (rows, n), a view."""
        return np.asarray(self._joints['acceleration'])

    def set_time(self, now_s: FloatArray) -> None:
        """
        Set the simulation time.

        :param now_s: [s], shape (rows,)
        """
        self._now_s = now_s

    def release(self, rows: Sequence[int]) -> None:
        """Give the states of rows back to their generators."""
        for row in rows:
            of, plan = self._generators[row], self.plans.get(row)
            of.take_states(self._states[row].copy(), None)
            of.plan = plan
            of._state[:] = self._state[row]
            for name in ('limited', 'lost'):
                of._joints[name] = 0.0
            of.now_s = float(self._now_s[row])
            of.find_moving()

    def advance(self, duration_s: float) -> None:
        """
        Advance all setpoints.

        :param duration_s: length of the interval [s]
        """
        ends_s = self._generators[0].ends_left(float(self._now_s[0]), duration_s)
        counts = self._advance(ends_s)
        self.plans = {int(row): plan_of(records(self._states[row]), ends_s)
                      for row in np.flatnonzero(counts > 1)}
        self._state = self._states[:, 0].copy()
        self._now_s = self._now_s + duration_s
        self.moves = np.asarray(self._joints['moves'].any(axis=1))

    def _advance(self, ends_s: FloatArray) -> Any:
        from manip_sim.control.law.setpoint_motion import advance_rows  # It imports numba.
        rows, count, fields = self._state.shape
        self._states, self._ends_s = np.empty((rows, len(ends_s), count, fields)), ends_s
        return advance_rows(self._joints, records(self._states), self._now_s, ends_s)

    def plan_period(self, now_s: float, ends_s: FloatArray, goals: FloatArray | None,
                    period_s: float) -> Plan | None:
        """
        Begin a control period of all rows, and return the plan that all of them have in it.

        Nothing moves until :meth:`follow_plan`.

        :param now_s: simulation time [s]
        :param ends_s: when its intervals end, since it begins [s], shape (k, 1)
        :param goals: of a message for all joints [rad or m], shape (rows, n), or None
        :param period_s: length of a control period that they are meant for [s]
        :returns: of shape (k, rows, n); None if some have none
        """
        from manip_sim.control.law.stream_timing import wait  # It imports numba.
        before, self._now_s = self._state.copy(), np.full(len(self._state), now_s)
        if goals is not None:
            indices = np.arange(goals.shape[1])
            for joints, goal in zip(self._joints, goals):
                wait(joints, indices, goal, period_s, 1.0, 0.0, False)
        counts = self._advance(ends_s[:, 0])
        self._state = before
        if len(ends_s) < 2 or not (counts == len(ends_s)).all():
            return None
        states = np.ascontiguousarray(np.swapaxes(self._states, 0, 1))
        return plan_of(records(states), ends_s[:, 0])

    def follow_plan(self) -> None:
        """Follow the plan of :meth:`plan_period` to its end."""
        first = records(self._states[:, 0])
        for name in ('limited', 'lost'):
            for row in np.flatnonzero(first[name].any(axis=1)).tolist():
                of = self._generators[row]
                setattr(of, name, getattr(of, name) + first[name][row].astype(np.int64))
        self._state = self._states[:, -1].copy()
        self._joints['limited'] = self._joints['lost'] = 0.0
        self._states = self._state[:, None]
        self._now_s = self._now_s + float(self._ends_s[0])

    def hold_back(self, measured: FloatArray, lead: FloatArray) -> None:
        """
        Keep setpoints from running ahead of joints that cannot keep up.

        :param measured: where the joints are [rad or m], shape (rows, n)
        :param lead: how far a setpoint may be from there [rad or m], shape (rows, n)
        """
        held = hold_back(self._joints, measured, lead)
        for row in np.flatnonzero(held.any(axis=1)).tolist():
            self.plans.pop(row, None)
