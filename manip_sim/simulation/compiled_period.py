# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The control periods of a world that compiled code runs: their row of arguments, and its call."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.control.robot_runs import RobotRun, RunRoom
from manip_sim.derived import Derived
from manip_sim.physics.clock import Clock
from manip_sim.physics.physics import BECAME, EPOCH, PHYSICS, Scratch
from manip_sim.physics.physics_steps import DivergenceWatch, PhysicsSteps
from manip_sim.physics.state_dependent_terms import FloatingBases

#: Of how many lengths of runs the room for notes is kept.
_REMEMBERED = 64
#: Compiled code runs so many steps at once, as there is room for notes of each.
MOST_STEPS = 1000
#: The number of a world that is the only one of its table.
ALONE = np.zeros(1, np.int64)
#: No world of no table goes on by itself.
_NONE = np.zeros((0, 5), np.int64), np.zeros(0, np.int64)


class _Room(NamedTuple):
    """The row of the periods of a world, and parts of it that stay as long as its model."""

    row: Any
    place: tuple[Any, Any]
    time: Any
    orders: IntArray
    weight: Any
    watch: Any
    outcome: IntArray
    standing: Any


class CompiledPeriod:
    """
    A control period, or intervals of one, that compiled code runs in one world.

    :param steps: of the physics
    :param floating_bases: the weight of free robots
    :param clock: of the simulation
    :param timestep_s: length of a step [s]
    """

    def __init__(self, steps: PhysicsSteps, floating_bases: FloatingBases, clock: Clock,
                 timestep_s: float) -> None:
        self._steps, self._floating_bases = steps, floating_bases
        self._clock, self._timestep_s = clock, timestep_s
        self._derived = Derived()
        steps.physics.on_change(self._derived.clear)

    @property
    def may_step(self) -> bool:
        """True if compiled code may run steps."""
        from manip_sim.control.law.stepping import may_step  # It imports numba.
        return may_step(self._steps.physics.data)

    def _notes(self, steps: int) -> Any:
        """Return room for the notes of steps."""
        from manip_sim.control.law.stepping import notes_of  # It imports numba.
        kept = self._steps.notes.of
        notes = kept.get(steps)
        if notes is None:
            if len(kept) == _REMEMBERED:
                kept.clear()
            notes = kept[steps] = notes_of(
                self._steps.physics.data, self._steps.tool_bodies, steps)
        return notes

    def prepare(self, runs: Sequence[RobotRun], intervals: IntArray, left: int,
                begins: bool = False, ends: bool = False, stepping: bool = True) -> None:
        """
        Write the row of intervals.

        :param runs: of the robots that act
        :param intervals: steps of each, shape (k,)
        :param left: most steps of which there have to be notes
        :param begins: whether they begin a period, of which the state is remembered
        :param ends: whether they end it, and all of the last instant is computed
        :param stepping: whether the steps are run, or else the controls of the first one written
        """
        room, steps = self._room(), self._steps
        self._derived.of['room'] = room
        room.orders[:] = begins, ends, (
            steps.begin_by_law() if begins else stepping and steps.take_resumes()), 0, stepping
        notes = self._derived.of['notes'] = self._notes(left)
        steps.efforts.refresh_rules()
        for run in runs:
            run.room.write(run.joints, run.targets, run.grippers)
        robots = self._derived.made_of(_addresses, *[run.room for run in runs])
        seats = self._derived.made_of(_joined, *[run.seats for run in runs])
        room.row.write((room.place, room.time, room.orders, intervals, steps.physics.arrays,
                        room.weight, robots, seats, notes, room.watch, room.outcome,
                        room.standing))

    def stand(self, steps: int, act: bool) -> None:
        """
        Let the next periods go on like the one that the rows were written for, without Python.

        :param steps: of a period
        :param act: whether robots do
        """
        room, physics = self._derived.of['room'], self._steps.physics
        standing, notes = room.standing, self._derived.of['notes']
        if not len(standing.options):
            return
        changes = act or len(self._floating_bases.dofs) > 0
        room.orders[:] = 1, 1, 0, self._steps.resumes_after_laws(changes), 1
        standing.contacts[:] = notes.contacts[0], all([
            tool.is_quiet for tool in self._steps.tools])
        standing.kept[:] = standing.options
        physics.standing[:BECAME] = steps, room.row.address, 0
        physics.standing[EPOCH] += 1

    def _room(self) -> _Room:
        """Return the arrays that last as long as the model."""
        steps = self._steps
        return self._derived.made_of(
            self._make_room, steps.divergence, steps.efforts.room, steps.efforts.stale,
            steps.efforts.kept, steps.efforts.rules)

    def _make_room(self, watched: DivergenceWatch, last: FloatArray | None, stale: BoolArray,
                   efforts: FloatArray, rules: BoolArray) -> _Room:
        """
        Make it for a model, and for efforts that a restored state has replaced.

        :param watched: keeps the good state, of each model another
        :param last: room for what efforts of the last step depend on, or None
        :param stale: says that it was noted
        :param efforts: room for the efforts
        :param rules: of their computation
        """
        from manip_sim.control.law.compiling import Row  # It imports numba.
        from manip_sim.control.law.period import PERIOD, Standing, Time, Weight
        from manip_sim.control.law.stepping import LastStep, options_of, Watch, words_of
        steps, clock, physics = self._steps, self._clock, self._steps.physics
        model, data, addresses = physics.model, physics.data, physics.addresses
        halves = np.array([(part.start, part.stop) for part in steps.first_half], np.int64)
        watch = Watch(
            watched.good, steps.computed_from, halves.reshape(-1, 2), PHYSICS,
            data.qpos, data.qacc,
            words_of(watched.warnings.ctypes.data, 2 * len(watched.warned) - 1), watched.warned,
            LastStep.of(model, data, np.zeros(0) if last is None else last, stale, efforts,
                        rules))
        options = options_of(model)
        return _Room(
            Row(PERIOD), (addresses.model, addresses.data),
            Time(clock.counts, clock.step_ns, self._timestep_s), np.zeros(5, np.int64),
            Weight(self._floating_bases.dofs, data.qfrc_applied), watch,
            np.zeros(2, np.int64), Standing(
                np.zeros(2, np.int64), data.xfrc_applied, options, options.copy()))

    @property
    def row(self) -> int:
        """Address of the prepared row."""
        return int(self._derived.of['room'].row.address)

    def run(self) -> None:
        """Run the prepared row."""
        run_prepared([self.row], self._steps.physics.scratch)

    @property
    def orders(self) -> IntArray:
        """Orders of the last run, by ``BEGINS``, ``ENDS`` and ``RESUMES`` of the law."""
        orders: IntArray = self._derived.of['room'].orders
        return orders

    def outcome(self) -> tuple[int, bool, Any]:
        """Return how many steps were made, whether the end is good, and the notes of the steps."""
        steps, doubtful = self._derived.of['room'].outcome.tolist()
        return steps, not doubtful, self._derived.of['notes']


def _addresses(*rooms: RunRoom) -> IntArray:
    """Return the addresses of the rows of robots."""
    return np.array([room.row.address for room in rooms], dtype=np.int64)


def _joined(*rows: IntArray) -> IntArray:
    """Return the addresses of the rows of all laws of users."""
    return np.concatenate([np.zeros(0, np.int64), *rows])


@cache
def _period() -> Any:
    from manip_sim.control.law import period  # It imports numba.
    return period


def go_on(rows: IntArray, table: IntArray, worlds: IntArray, steps: int, scratch: Scratch
          ) -> None:
    """
    Let worlds go on as in their last periods, where Python has nothing to do for them.

    :param rows: addresses of the rows of those that go on, shape (n,)
    :param table: ``Physics.standing`` of all worlds, shape (count, 5)
    :param worlds: which of them go on, shape (n,); :data:`ALONE` for one world
    :param steps: of the period
    :param scratch: of this thread and of these worlds
    """
    _period().run_rows(rows, table, worlds, steps, _row_in_thread(scratch))


def is_loaded() -> bool:
    """Return whether compiled code is there already, whose import takes a while."""
    return _period.cache_info().currsize > 0


def load() -> None:
    """Import compiled code."""
    _period()


def run_prepared(rows: Sequence[int], scratch: Scratch) -> None:
    """
    Run the prepared periods of worlds whose models are of the same sizes, without Python.

    :param rows: addresses of their rows
    :param scratch: of this thread and of these worlds
    """
    _period().run_rows(np.array(rows), *_NONE, 0, _row_in_thread(scratch))


def _row_in_thread(scratch: Scratch) -> int:
    """Return the address of the row of the scratch of this thread."""
    row = scratch.derived.of.get('row')
    if row is None:
        from manip_sim.control.law.compiling import Row  # It imports numba.
        row = scratch.derived.of['row'] = Row(_period().SCRATCH)
        row.write(_period().ScratchArrays(scratch.address, scratch.kinematics))
    return int(row.address)
