# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The control periods of a world that compiled code runs: their row of arguments, and its call."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
import threading
from typing import Any

import numpy as np

from manip_sim.arrays import IntArray
from manip_sim.derived import Derived
from manip_sim.physics.clock import Clock
from manip_sim.physics.physics import PHYSICS, Scratch
from manip_sim.physics.physics_steps import PhysicsSteps
from manip_sim.simulation.robot import RobotRun

#: Of how many lengths of runs the room for notes is kept.
_REMEMBERED = 64
#: Compiled code runs so many steps at most, as there is room for notes of each.
_MOST_STEPS = 1000


class _Kept(threading.local):
    """The row of the scratch of a thread."""

    scratch: Scratch | None = None
    row: Any


_kept = _Kept()


class CompiledPeriod:
    """
    A control period, or intervals of one, that compiled code runs in one world.

    :param steps: of the physics
    :param clock: of the simulation
    :param timestep_s: length of a step [s]
    """

    def __init__(self, steps: PhysicsSteps, clock: Clock, timestep_s: float) -> None:
        self._steps, self._clock, self._timestep_s = steps, clock, timestep_s
        self._derived = Derived()

    def may_run(self, steps: int) -> bool:
        """Return whether compiled code may run steps."""
        return steps <= _MOST_STEPS and _stepping().may_step(self._steps.data)

    def notes(self, steps: int) -> Any:
        """Return room for the notes of steps."""
        physics = self._steps
        notes = physics.notes.of.get(steps)
        if notes is None:
            if len(physics.notes.of) == _REMEMBERED:
                physics.notes.of.clear()
            notes = physics.notes.of[steps] = _stepping().notes_of(
                physics.data, physics.tool_bodies, steps)
        return notes

    def prepare(self, run: RobotRun, left: int, begins: bool, ends: bool) -> Any:
        """
        Write the row of intervals.

        :param run: of the only robot that acts
        :param left: most steps of which there have to be notes
        :param begins: whether they begin a period, of which the state is remembered
        :param ends: whether they end it, and all of the last instant is computed
        :returns: room for the notes of the steps
        """
        place, time, orders, watch, outcome = self._fixed()
        physics = self._steps
        resumes = physics.begin_by_law() if begins else physics.take_resumes()
        orders[:] = begins, ends, resumes
        notes = self.notes(left)
        self._row().write((
            place, time, orders, run.intervals, physics.arrays, run.joints, run.targets,
            run.grippers, notes, watch, outcome))
        return notes

    def _row(self) -> Any:
        row = self._derived.of.get('row')
        if row is None:
            from manip_sim.control.law.period import PERIOD  # It imports numba.
            from manip_sim.control.law.rows import Row
            row = self._derived.of['row'] = Row(PERIOD)
        return row

    def _fixed(self) -> Any:
        """Return what stays as long as there is the same model."""
        physics = self._steps
        fixed = self._derived.of.get('fixed')
        if fixed is None or fixed[0] is not physics.divergence:
            fixed = self._derived.of['fixed'] = physics.divergence, self._make_fixed()
        return fixed[1]

    def _make_fixed(self) -> Any:
        from manip_sim.control.law.period import Outcome, Time  # It imports numba.
        from manip_sim.control.law.stepping import LastStep, Watch
        physics, clock = self._steps, self._clock
        model, data, room = physics.model, physics.data, physics.room_for_efforts
        halves = np.array([(part.start, part.stop) for part in physics.first_half], np.int64)
        watch = Watch(
            physics.divergence.good, physics.computed_from, halves.reshape(-1, 2), PHYSICS,
            data.qpos, data.qacc,
            LastStep.of(model, data, np.zeros(0) if room is None else room))
        addresses = physics.addresses
        return ((addresses.model, addresses.data),
                Time(clock.counts, clock.step_ns, self._timestep_s), np.zeros(3, np.int64), watch,
                Outcome(np.zeros(2, np.int64), np.zeros(1)))

    @property
    def row(self) -> int:
        """Address of the row of what has been prepared."""
        return int(self._row().address)

    def run(self) -> None:
        """Run what has been prepared."""
        run_prepared([self.row], self._steps.scratch)

    @property
    def orders(self) -> IntArray:
        """What was wanted of the last run, by ``BEGINS``, ``ENDS`` and ``RESUMES`` of the law."""
        orders: IntArray = self._fixed()[2]
        return orders

    def outcome(self) -> tuple[int, bool, float]:
        """Return how many steps were made, whether the end is good, when setpoints stopped."""
        *_, outcome = self._fixed()
        steps, doubtful = outcome.steps.tolist()
        return steps, not doubtful, outcome.moved_s.item()


@cache
def _stepping() -> Any:
    from manip_sim.control.law import stepping  # It imports numba.
    return stepping


@cache
def _law() -> Any:
    from manip_sim.control.law.period import run_rows  # It imports numba.
    return run_rows


def _row_of(scratch: Scratch) -> Any:
    from manip_sim.control.law.period import SCRATCH, ScratchArrays  # It imports numba.
    from manip_sim.control.law.rows import Row
    row = Row(SCRATCH)
    row.write(ScratchArrays(scratch.address, scratch.kinematics))
    return row


def run_prepared(rows: Sequence[int], scratch: Scratch) -> None:
    """
    Run the prepared periods of worlds whose models are of the same sizes, without Python.

    :param rows: addresses of their rows
    :param scratch: of this thread and of these worlds
    """
    if _kept.scratch is not scratch:
        _kept.scratch, _kept.row = scratch, _row_of(scratch)
    _law()(np.array(rows), _kept.row.address)
