# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Intervals of a robot that compiled code runs: their begin, end, and going on without Python."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import accumulate
import math
from typing import Any, NamedTuple, TypeVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.cartesian.cartesian_commands import (
    CartesianCommand, CartesianPose, CartesianTwist, PoseAction)
from manip_sim.control.commands import (
    BaseTwist, Command, GripperAction, JointSetpoint, JointTrajectory, Status)
from manip_sim.control.gripper_controller import GripperController
from manip_sim.control.joint_controller import JointController
from manip_sim.control.law.records import (
    blank_motion, DUE, Gripper, MOTION, MOVES, no_gripper, no_targets, records, RobotJoints,
    Targets)
from manip_sim.control.modes import EFFORT, MODES, POSITION, VELOCITY
from manip_sim.derived import Derived
from manip_sim.physics.clock import Clock
from manip_sim.physics.physics import Physics

C = TypeVar('C', bound=Command)
#: Commands that can take effect while compiled code goes on, and modes of those of joints.
_STREAMED = (JointSetpoint, BaseTwist, CartesianPose, CartesianTwist, PoseAction)
_STREAMED_MODES = (EFFORT.name, POSITION.name, VELOCITY.name)
#: Control periods for which the path of trajectories is computed at once. One of ten steps takes
#: 324 us with 8 of them, 279 with 16 and 262 with 32, most of which is physics.
_AHEAD = 16
#: No joint that a trajectory leads.
_NOT_LED = np.empty(0, np.int64), np.empty((0, 0, 3))
#: No base that follows a twist.
_NOT_DRIVEN = np.empty(0, np.int64), np.empty(0, np.int64), records(blank_motion(0), MOTION)
#: The number of a world that is the only one of its table.
_ALONE = np.zeros(1, np.int64)


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
    :ivar flags: of joints, see the law, shape (4,)
    """

    row: Any
    moved_s: FloatArray
    owners: IntArray
    acts: IntArray
    until_s: FloatArray
    goals: FloatArray
    renewed_s: FloatArray
    flags: NDArray[np.bool_]

    @classmethod
    def of(cls, count: int) -> RunRoom:
        """Return room for a robot with a number of joints."""
        from manip_sim.control.law.compiling import Row  # It imports numba.
        from manip_sim.control.law.period import ROBOT
        return cls(Row(ROBOT), np.zeros(1), np.full(count, -1), np.zeros(1, np.int64), np.zeros(3),
                   np.zeros(count), np.full(count, -1.0), np.zeros(4, np.bool_))

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

    It gets joints, targets of end effectors and grippers as arrays of numbers, and may go on by
    itself with periods like the one before. What it has changed is taken over when the run ends,
    or when it is interrupted.

    :param physics: of the world
    :param joints: controller of the joints
    :param grippers: controllers of the grippers, by part
    :param clock: of the simulation
    """

    def __init__(self, physics: Physics, joints: JointController,
                 grippers: Mapping[str, GripperController], clock: Clock) -> None:
        self._physics, self._joints, self._grippers = physics, joints, grippers
        self._clock, self._derived = clock, Derived()

    @property
    def _room(self) -> RunRoom:
        room: RunRoom | None = self._derived.of.get('room')
        if room is None:
            room = self._derived.of['room'] = RunRoom.of(len(self._joints.names))
        return room

    @property
    def address(self) -> int:
        """Address of the row of the robot."""
        return int(self._room.row.address)

    @property
    def standing(self) -> RobotRun | None:
        """The intervals that compiled code goes on with by itself, if the robot acts in them."""
        run: RobotRun | None = self._derived.of.get('standing')
        return run

    @standing.setter
    def standing(self, run: RobotRun | None) -> None:
        self._derived.of['standing'] = run

    # ------------------------------------------------------------------ begin and end

    def begin(self, intervals: IntArray) -> RobotRun:
        """
        Begin intervals that the compiled law runs, and trajectories that are due in the first one.

        :param intervals: physics steps of each, shape (k,)
        :returns: as many of them as are known
        """
        joints, targets, count = self._begin_joints(intervals)
        if count < len(intervals):
            intervals = intervals[:count]
        grippers, moving, now_s = [], [], self._clock.control_s
        for controller in self._grippers.values():
            moves = controller.moving
            gripper = (controller.begin_run(self._physics.data, now_s) if moves
                       else controller.kept)
            grippers.append(gripper or no_gripper())
            if gripper is not None:
                moving.append((controller, gripper))
            until = controller.until_call(now_s) if moves else None
            if until is not None:
                intervals = intervals[:_count_within(intervals.tolist(), until)]
        first, second, *_ = *grippers, no_gripper(), no_gripper()
        seats = self._joints.seats.rows(
            self._joints.setpoints.joints, self._joints.effort, self._joints.payloads)
        return RobotRun(joints, targets, self._derived.made_of(_pair, first, second), moving,
                        intervals, self._room, seats)

    def _begin_joints(self, intervals: IntArray) -> tuple[RobotJoints, Targets, int]:
        """Return joints and targets for the law, and for how many intervals they are known."""
        controller, clock, now_s = self._joints, self._clock, self._clock.control_s
        durations_s = self._durations_s(intervals)
        controller.start_trajectories(now_s, float(durations_s[0]))
        trajectories, arms = [], []
        base: tuple[Any, ...] = _NOT_DRIVEN
        for command in controller.commands.running:
            if type(command) is JointSetpoint:
                continue
            if isinstance(command, JointTrajectory):
                trajectories.append(command)
            elif isinstance(command, CartesianCommand):
                arms.append(command)
            elif isinstance(command, BaseTwist):
                base = command.joints, command.columns, controller.base.refresh()
        targets, count = controller.cartesian.begin_run(
            arms, now_s, durations_s, lambda: clock.begins_s(intervals))
        indices, path = _NOT_LED
        if trajectories or controller.commands.waiting:
            indices, path = controller.trajectories.path(
                trajectories, clock.ends_s(intervals[:count], controller.servos.step_s))
            count = len(path)
        servos, setpoints, flags = controller.servos, controller.setpoints, self._room.flags
        flags[:] = controller.flags
        return self._derived.made_of(
            RobotJoints, setpoints.joints, servos.records, servos.places, controller.effort,
            setpoints.counts, controller.cartesian.postures, flags, indices, path, *base,
            controller.payloads.loads, servos.integrals), targets, count

    def _durations_s(self, intervals: IntArray) -> FloatArray:
        """Return how long intervals last, the same array as before for the same ones."""
        return self._derived.made_of(self._find_durations, intervals)

    def _find_durations(self, intervals: IntArray) -> FloatArray:
        return np.asarray(intervals * self._joints.servos.step_s, dtype=float)

    def begin_python_steps(self, steps: int) -> None:
        """
        Let laws of users exert their efforts in steps that Python runs, in an interval that began.

        :param steps: of the physics in it
        """
        controller = self._joints
        if controller.seats.of:
            controller.seats.begin(self._clock.control_s, steps, controller.setpoints.joints,
                                   controller.effort, controller.payloads)

    def end(self, run: RobotRun, places_at_begin: Callable[[], mujoco.MjData]) -> None:
        """
        Take over the changes of compiled code, and end trajectories that have come to an end.

        :param run: the intervals, of :meth:`begin`, after their steps
        :param places_at_begin: returns data with the kinematics at the beginning of the period
        """
        controller, moved_s = self._joints, run.room.moved_s.item()
        controller.flags = run.room.flags.tolist()
        if moved_s >= 0.0:
            controller.setpoints.now_s = moved_s
        if run.targets is not no_targets():
            controller.cartesian.end_run(
                controller.cartesian_commands, run.targets, places_at_begin)
        if len(run.joints.path):
            controller.end_trajectories(self._physics.data, self._clock.control_s)
        for gripper, arrays in run.moving:
            gripper.end_run(arrays)

    # ------------------------------------------------------------------ without Python

    def stand(self, run: RobotRun) -> bool:
        """
        Let compiled code go on with a control period, if Python has nothing to look at.

        It may if it knows all that setpoints and end effectors follow.

        :param run: the last intervals
        :returns: whether it may
        """
        for gripper, arrays in run.moving:
            gripper.stand(arrays)
        controller, commands, room = self._joints, self._joints.commands, run.room
        if commands.waiting or controller.resting:
            return False
        room.owners[:] = -1
        for number, command in enumerate(commands.running):
            if isinstance(command, BaseTwist):
                ends = not command.handle.is_active
            else:
                ends = isinstance(command, JointSetpoint) and all(
                    [MODES[mode].ends for mode in dict.fromkeys(command.modes)])
            if ends:
                room.owners[command.indices] = number
        known_s = controller.cartesian.stand(controller.cartesian_commands, run.targets)
        room.acts[0] = bool(commands.running or controller.command_timeouts.pending
                            or controller.seats.of or controller.acts)
        room.until_s[:] = controller.command_timeouts.first_s, known_s, math.inf
        if known_s == -math.inf:
            return False
        joints = self._look_ahead(run)
        if joints is not run.joints:
            room.write(joints, run.targets, run.grippers)
        return True

    def _look_ahead(self, run: RobotRun) -> RobotJoints:
        """
        Return the joints with the path of their trajectories in the next periods, if one runs.

        Periods have to begin before the last of ``until_s`` to be known: a trajectory ends in the
        next one, or it is farther ahead.
        """
        controller, clock, joints = self._joints, self._clock, run.joints
        trajectories = controller.commands.trajectories
        if not trajectories:
            led, path = _NOT_LED  # The last one may just have ended.
            return joints._replace(led=led, path=path) if len(joints.path) else joints
        indices, path = controller.trajectories.path(trajectories, clock.ends_s(
            np.tile(run.intervals, _AHEAD), controller.servos.step_s))
        periods = (len(path) - 1) // len(run.intervals)
        steps = clock.control_steps + periods * int(run.intervals.sum())
        run.room.until_s[2] = (steps - 0.5) * clock.step_ns * 1e-9
        return joints._replace(led=indices, path=path)

    def go_on(self, command: Command, period_s: float) -> bool:
        """
        Let a command replace one of its kind while compiled code goes on by itself.

        :param period_s: length of a control period [s]
        :returns: False, and nothing has changed, where it has to be applied instead
        """
        run, now_s = self.standing, self._clock.control_s
        if run is None or type(command) not in _STREAMED:
            return False
        older = self._alike(command)
        if older is None or not self._may_replace(older, command, run):
            return False
        controller, room = self._joints, run.room
        controller.commands.replace(older, command)
        command.handle.status = Status.RUNNING
        if isinstance(command, PoseAction):
            from manip_sim.control.law.period import renew_actions  # It imports numba.
            renew_actions(self._physics.standing[None], np.array([self.address]), _ALONE,
                          command.indices, command.action[None])
            return True
        if isinstance(command, JointSetpoint):
            exerts = command.modes[0] == EFFORT.name
            controller.apply_setpoint(command, period_s)
            room.flags[MOVES] = not exerts or controller.setpoints.moving
            room.flags[DUE] |= exerts
            room.goals[command.indices] = command.values
        elif isinstance(command, BaseTwist):
            controller.base.begin(command, self._physics.data, now_s, period_s, True)
        elif isinstance(command, CartesianCommand):
            arms, cartesian = controller.cartesian_commands, controller.cartesian
            cartesian.catch_up(arms, run.targets)
            cartesian.begin(command, self._physics.data, now_s, True)
            cartesian.begin_run(arms, now_s, self._durations_s(run.intervals),
                                lambda: self._clock.begins_s(run.intervals))
            room.until_s[1] = cartesian.stand(arms, run.targets)
        room.renewed_s[command.indices] = now_s
        return True

    def _alike(self, command: C) -> C | None:
        """Return another command of the same kind that runs for the same joints, or None."""
        for older in self._joints.commands.running:
            if (type(older) is type(command) and older.indices is command.indices
                    and older.handle.is_active and older is not command):
                return older
        return None

    def _may_replace(self, older: C, command: C, run: RobotRun) -> bool:
        """Return whether a command can take effect in place of one that differs in numbers."""
        if isinstance(command, JointSetpoint):
            modes = command.modes
            # For efforts, gains may have to change.
            return (isinstance(older, JointSetpoint) and older.modes is modes
                    and len(set(modes)) == 1 and modes[0] in _STREAMED_MODES
                    and (modes[0] != EFFORT.name or bool(
                        self._joints.servos.gives_effort(command.indices).all())))
        return isinstance(command, PoseAction) or self._clock.control_s < run.room.until_s.min()

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

    def catch_up(self, run: RobotRun | None, begin_s: float | None) -> None:
        """
        Take over the changes of compiled code that has gone on by itself.

        :param run: the intervals that it has gone on with, or None if the robot rests
        :param begin_s: when its last period began [s], or None if it has run none
        """
        controller, setpoints = self._joints, self._joints.setpoints
        if begin_s is not None:
            setpoints.now_s = begin_s
        if run is None:
            return
        room, now_s = run.room, self._clock.control_s
        controller.flags = room.flags.tolist()
        if begin_s is not None and room.moved_s[0] >= 0.0:
            setpoints.now_s = room.moved_s.item()
        arms = controller.cartesian_commands
        controller.cartesian.catch_up(arms, run.targets)
        for command in controller.commands.running:
            came_s = room.renewed_s.item(command.indices.item(0))
            if came_s >= 0.0:
                if isinstance(command, PoseAction):
                    command.action[:] = run.targets.actions[arms.index(command)]
                elif isinstance(command, JointSetpoint):
                    command.values[:] = room.goals[command.indices]
                room.renewed_s[command.indices] = -1.0
                controller.command_timeouts.renew(command.parts, came_s)
                if came_s == now_s:
                    setpoints.now_s = now_s
        for gripper, arrays in run.moving:
            gripper.end_run(arrays)


def _pair(first: Gripper, second: Gripper) -> tuple[Gripper, Gripper]:
    return first, second


def _count_within(intervals: Sequence[int], steps: int) -> int:
    """Return how many of some intervals begin before so many steps have been made."""
    return sum(begin < steps for begin in accumulate(intervals[:-1], initial=0))
