# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Intervals of a robot that compiled code runs: begun, ended, and gone on with by itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.commands import GripperAction
from manip_sim.control.gripper_controller import GripperController
from manip_sim.control.joint_controller import JointController
from manip_sim.control.law.arm_records import Targets
from manip_sim.control.law.finger_records import Gripper, no_gripper
from manip_sim.control.law.joint_records import RobotJoints
from manip_sim.derived import Derived
from manip_sim.physics.clock import Clock
from manip_sim.physics.physics import Physics


class RunRoom(NamedTuple):
    """
    Room for what a robot does in intervals that the compiled law runs.

    :ivar row: the row of the robot
    :ivar moved_s: simulation time when setpoints stopped to move, or -1 [s], shape (1,)
    :ivar owners: of joints, see the law, shape (n,)
    :ivar acts: see the law, shape (1,)
    :ivar goals: of joints, see the law, shape (n,)
    :ivar renewed_s: of joints, see the law [s], shape (n,)
    """

    row: Any
    moved_s: FloatArray
    owners: IntArray
    acts: IntArray
    goals: FloatArray
    renewed_s: FloatArray

    def write(self, joints: RobotJoints, targets: Targets, grippers: tuple[Gripper, Gripper]
              ) -> None:
        """Write the row."""
        self.row.write((joints, targets, grippers, self.moved_s, self.owners, self.acts,
                        self.goals, self.renewed_s))


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
        self._physics, self._joints, self._grippers = physics, joints, grippers
        self._clock, self._derived = clock, Derived()

    def begin(self, intervals: IntArray) -> RobotRun:
        """
        Begin intervals that the compiled law runs.

        :param intervals: physics steps of each, shape (k,)
        """
        data = self._physics.data
        joints, targets, count = self._joints.begin_run(intervals, self._clock)
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
            from manip_sim.control.law.period import ROBOT  # It imports numba.
            from manip_sim.control.law.rows import Row
            count = len(self._joints.names)
            room = self._derived.of['room'] = RunRoom(
                Row(ROBOT), np.zeros(1), np.full(count, -1), np.zeros(1, np.int64),
                np.zeros(count), np.full(count, -1.0))
        return room

    @property
    def address(self) -> int:
        """Address of the row of the robot."""
        return int(self._room.row.address)

    def end(self, run: RobotRun) -> None:
        """
        Take over the changes of compiled code, after the steps of the intervals.

        :param run: the intervals, of :meth:`begin`
        """
        self._joints.end_run(run.joints, run.targets, run.room.moved_s.item(),
                             self._physics.data, self._clock.control_s)
        for controller, gripper in run.moving:
            controller.end_run(gripper)

    def stand(self, run: RobotRun) -> float | None:
        """
        Let compiled code go on with a control period, if Python has nothing to look at.

        :param run: the last intervals
        :returns: simulation time since the last reset at which a command times out [s], or None
        """
        for controller, gripper in run.moving:
            controller.stand(gripper)
        return self._joints.stand(run.joints, run.targets, run.room.owners, run.room.acts)

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

    def catch_up(self, run: RobotRun | None, begin_s: float | None) -> None:
        """
        Take over the changes of compiled code that has gone on by itself.

        :param run: the intervals that it has gone on with, or None if the robot rests
        :param begin_s: when its last period began [s], or None if it has run none
        """
        if begin_s is not None:
            self._joints.setpoints.now_s = begin_s
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
