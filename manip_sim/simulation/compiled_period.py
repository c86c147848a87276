# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
The control periods of a world that compiled code runs: their row of arguments, and its call.

The intervals of its robots are begun, ended, and gone on with by themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from itertools import accumulate
from typing import Any, NamedTuple

import mujoco
import numpy as np

from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.control.cartesian.cartesian_commands import (
    CartesianPose, CartesianTwist, PoseAction)
from manip_sim.control.commands import BaseTwist, Command, GripperAction
from manip_sim.control.gripper_controller import GripperController
from manip_sim.control.joint_controller import JointController
from manip_sim.control.joint_runs import JointRuns
from manip_sim.control.law.records import Gripper, no_gripper, RobotJoints, Targets
from manip_sim.derived import Derived
from manip_sim.physics.clock import Clock
from manip_sim.physics.physics import BECAME, EPOCH, PHYSICS, Physics, ROW, Scratch
from manip_sim.physics.physics_steps import DivergenceWatch, PhysicsSteps
from manip_sim.physics.state_dependent_terms import FloatingBases

#: Of how many lengths of runs the room for notes is kept.
_REMEMBERED = 64
#: Compiled code runs so many steps at once, as there is room for notes of each.
MOST_STEPS = 1000
#: The number of a world that is the only one of its table.
_ALONE = np.zeros(1, np.int64)
#: No world of no table goes on by itself.
_NONE = np.zeros((0, 5), np.int64), np.zeros(0, np.int64)


class RunRoom(NamedTuple):
    """
    Room for what a robot does in intervals that the compiled law runs.

    :ivar row: the row of the robot
    :ivar moved_s: simulation time when setpoints stopped to move, or -1 [s], shape (1,)
    :ivar owners: of joints, see the law, shape (n,)
    :ivar acts: see the law, shape (1,)
    :ivar until_s: see the law [s], shape (3,)
    :ivar goals: of joints, see the law, shape (n,)
    :ivar renewed_s: of joints, see the law [s], shape (n,)
    """

    row: Any
    moved_s: FloatArray
    owners: IntArray
    acts: IntArray
    until_s: FloatArray
    goals: FloatArray
    renewed_s: FloatArray

    def write(self, joints: RobotJoints, targets: Targets, grippers: tuple[Gripper, Gripper]
              ) -> None:
        """Write the row."""
        self.row.write((joints, targets, grippers, self.moved_s, self.owners, self.acts,
                        self.until_s, self.goals, self.renewed_s))


class RobotRun(NamedTuple):
    """
    Part of a robot in intervals that the compiled law runs.

    :ivar joints: its joints
    :ivar targets: of its end effectors
    :ivar grippers: those that move or may begin to, and others without fingers
    :ivar moving: the former with their controllers
    :ivar intervals: physics steps of each interval, shape (k,)
    :ivar room: for the law
    :ivar seats: addresses of the rows of laws of users, shape (s,)
    """

    joints: RobotJoints
    targets: Targets
    grippers: tuple[Gripper, Gripper]
    moving: list[tuple[GripperController, Gripper]]
    intervals: IntArray
    room: RunRoom
    seats: IntArray


class RobotRuns:
    """
    The intervals of a robot that compiled code runs.

    :param physics: of the world
    :param joints: controller of the joints
    :param grippers: controllers of the grippers, by part
    :param clock: of the simulation
    """

    def __init__(self, physics: Physics, joints: JointController,
                 grippers: Mapping[str, GripperController], clock: Clock) -> None:
        self._physics, self._controller, self._grippers = physics, joints, grippers
        self._joints, self._clock, self._derived = JointRuns(joints), clock, Derived()

    def begin(self, intervals: IntArray) -> RobotRun:
        """
        Begin intervals that the compiled law runs.

        :param intervals: physics steps of each, shape (k,)
        """
        data = self._physics.data
        joints, targets, count = self._joints.begin(intervals, self._clock)
        if count < len(intervals):
            intervals = intervals[:count]
        grippers, moving, now_s = [], [], self._clock.control_s
        for controller in self._grippers.values():
            moves = controller.moving
            gripper = controller.begin_run(data, now_s) if moves else controller.kept
            grippers.append(gripper or no_gripper())
            if gripper is not None:
                moving.append((controller, gripper))
            until = controller.until_call(now_s) if moves else None
            if until is not None:
                intervals = intervals[:_count_within(intervals.tolist(), until)]
        first, second, *_ = *grippers, no_gripper(), no_gripper()
        return RobotRun(joints, targets, self._derived.made_of(_pair, first, second), moving,
                        intervals, self._room, self._joints.seat_rows())

    @property
    def _room(self) -> RunRoom:
        room: RunRoom | None = self._derived.of.get('room')
        if room is None:
            from manip_sim.control.law.compiling import Row
            from manip_sim.control.law.period import ROBOT  # It imports numba.
            count = len(self._controller.names)
            room = self._derived.of['room'] = RunRoom(
                Row(ROBOT), np.zeros(1), np.full(count, -1), np.zeros(1, np.int64),
                np.zeros(3), np.zeros(count), np.full(count, -1.0))
        return room

    @property
    def address(self) -> int:
        """Address of the row of the robot."""
        return int(self._room.row.address)

    def end(self, run: RobotRun, places_at_begin: Callable[[], mujoco.MjData]) -> None:
        """
        Take over the changes of compiled code, after the steps of the intervals.

        :param run: the intervals, of :meth:`begin`
        :param places_at_begin: returns data with the kinematics at the beginning of the period
        """
        self._joints.end(run.joints, run.targets, run.room.moved_s.item(), self._physics.data,
                         self._clock.control_s, places_at_begin)
        for controller, gripper in run.moving:
            controller.end_run(gripper)

    def stand(self, run: RobotRun) -> bool:
        """
        Let compiled code go on with a control period, if Python has nothing to look at.

        :param run: the last intervals
        :returns: whether it may
        """
        for controller, gripper in run.moving:
            controller.stand(gripper)
        room = run.room
        if not self._joints.stand(run.joints, run.targets, room.owners, room.acts, room.until_s):
            return False
        joints = self._joints.look_ahead(run.joints, run.intervals, self._clock, room.until_s)
        if joints is not run.joints:
            room.write(joints, run.targets, run.grippers)
        return True

    @property
    def standing(self) -> RobotRun | None:
        """The intervals that compiled code goes on with by itself, if the robot acts in them."""
        run: RobotRun | None = self._derived.of.get('standing')
        return run

    @standing.setter
    def standing(self, run: RobotRun | None) -> None:
        self._derived.of['standing'] = run

    def renews(self, part: str, command: GripperAction) -> int:
        """
        Return where compiled code can give the action of a gripper other numbers.

        :param command: that was applied, nobody else has it
        :returns: address of the row of the robot; 0 if it has to be applied again
        """
        controller = self._grippers[part]
        goes_on = self.standing is not None and any(
            [other is controller for other, _ in self.standing.moving])
        return self.address if goes_on and controller.renews(command) else 0

    def go_on(self, command: Command, period_s: float) -> bool:
        """
        Let compiled code go on with a command like the one before, if it does go on.

        :param period_s: length of a control period [s]
        :returns: False, and nothing has changed, where it has to be applied instead
        """
        if self.standing is None:
            return False
        run, room = self.standing, self.standing.room
        if type(command) in (BaseTwist, CartesianPose, CartesianTwist):
            return self._joints.go_on_moving(
                command, run.targets, run.intervals, room.until_s, room.renewed_s,
                self._physics.data, self._clock, period_s)
        if type(command) is not PoseAction:
            return self._joints.go_on(
                command, room.goals, room.renewed_s, self._clock.control_s, period_s)
        goes_on = self._joints.go_on_acting(command)
        if goes_on:
            renew_actions(self._physics.standing[None], np.array([self.address]), _ALONE,
                          command.indices, command.action[None])
        return goes_on

    def begin_python_steps(self, steps: int) -> None:
        """
        Let laws of users exert their efforts in steps that Python runs, in an interval that began.

        :param steps: of the physics in it
        """
        self._joints.begin_python_steps(steps, self._clock.control_s)

    def catch_up(self, run: RobotRun | None, begin_s: float | None) -> None:
        """
        Take over the changes of compiled code that has gone on by itself.

        :param run: the intervals that it has gone on with, or None if the robot rests
        :param begin_s: when its last period began [s], or None if it has run none
        """
        if begin_s is not None:
            self._controller.setpoints.now_s = begin_s
        if run is not None:
            moved_s = -1.0 if begin_s is None else run.room.moved_s.item()
            self._joints.catch_up(
                run.targets, moved_s, run.room.goals, run.room.renewed_s, self._clock.control_s)
            for controller, gripper in run.moving:
                controller.end_run(gripper)


def _pair(first: Gripper, second: Gripper) -> tuple[Gripper, Gripper]:
    return first, second


def _count_within(intervals: Sequence[int], steps: int) -> int:
    """Return how many of some intervals begin before so many steps have been made."""
    return sum(begin < steps for begin in accumulate(intervals[:-1], initial=0))


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
        return bool(_stepping().may_step(self._steps.physics.data))

    def notes(self, steps: int) -> Any:
        """Return room for the notes of steps."""
        kept = self._steps.notes.of
        notes = kept.get(steps)
        if notes is None:
            if len(kept) == _REMEMBERED:
                kept.clear()
            notes = kept[steps] = _stepping().notes_of(
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
        notes = self._derived.of['notes'] = self.notes(left)
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
        from manip_sim.control.law.compiling import Row
        from manip_sim.control.law.period import (  # It imports numba.
            PERIOD, Standing, Time, Weight)
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
def _stepping() -> Any:
    from manip_sim.control.law import stepping  # It imports numba.
    return stepping


@cache
def _period() -> Any:
    from manip_sim.control.law import period  # It imports numba.
    return period


def go_on(table: IntArray, worlds: IntArray, steps: int, scratch: Scratch) -> None:
    """
    Let worlds go on as in their last periods, where Python has nothing to do for them.

    :param table: ``Physics.standing`` of all worlds, shape (count, 5)
    :param worlds: which of them go on, shape (n,)
    :param steps: of the period
    :param scratch: of this thread and of these worlds
    """
    _period().run_rows(table[:, ROW][worlds], table, worlds, steps, _row_in_thread(scratch))


def go_on_alone(standing: IntArray, steps: int, scratch: Scratch) -> None:
    """
    Let a world go on as in its last period, if Python has nothing to do for it.

    :param standing: ``Physics.standing``, of periods of so many steps
    :param steps: of the period
    :param scratch: of this thread and of this world
    """
    _period().run_rows(
        standing[ROW:ROW + 1], standing[None], _ALONE, steps, _row_in_thread(scratch))


def renew(table: IntArray, robots: IntArray, worlds: IntArray, indices: IntArray,
          goals: FloatArray, period_s: float, velocities: bool) -> None:
    """
    Give commands that run other goals, as if equal ones had replaced them, in worlds that go on.

    :param table: ``Physics.standing`` of all worlds, shape (count, 5)
    :param robots: address of the row of the robot in each world, shape (count,)
    :param worlds: which of them do, shape (k,)
    :param indices: of the joints of the command, shape (n,)
    :param goals: positions [rad or m] or velocities [rad/s or m/s], shape (count, n)
    :param period_s: length of a control period [s]
    :param velocities: whether goals are velocities
    """
    _period().renew(table, robots, worlds, indices, goals, period_s, velocities)


def renew_actions(table: IntArray, robots: IntArray, worlds: IntArray, indices: IntArray,
                  actions: FloatArray) -> None:
    """
    Give actions of OSC_POSE that run other numbers, as if equal ones had replaced them.

    :param table: ``Physics.standing`` of all worlds, shape (count, 5)
    :param robots: address of the row of the robot in each world, shape (count,)
    :param worlds: which of them do, shape (k,)
    :param indices: of the joints of the arm, shape (n,)
    :param actions: in [-1, 1], shape (count, 6)
    """
    _period().renew_actions(table, robots, worlds, indices, actions)


def renew_grips(robots: IntArray, worlds: IntArray, number: int, actions: FloatArray) -> None:
    """
    Give actions of grippers other numbers, as if equal ones had replaced them, in some worlds.

    :param robots: address of the row of the robot in each world, shape (count,)
    :param worlds: which of them, all go on, shape (k,)
    :param number: of the gripper of the robot
    :param actions: in [-1, 1], shape (count, dof)
    """
    _period().renew_grips(robots, worlds, number, actions)


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
