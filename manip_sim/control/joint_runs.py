# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Runs of compiled code that control the joints of a robot: their begin, end, and going on."""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import Any, TypeVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.cartesian.cartesian_commands import CartesianCommand, PoseAction
from manip_sim.control.commands import BaseTwist, Command, JointSetpoint, JointTrajectory, Status
from manip_sim.control.joint_controller import JointController
from manip_sim.control.law.records import (
    blank_motion, DUE, MOTION, MOVES, no_targets, records, RobotJoints, Targets)
from manip_sim.control.modes import EFFORT, MODES, POSITION, VELOCITY
from manip_sim.derived import Derived
from manip_sim.physics.clock import Clock

C = TypeVar('C', bound=Command)
#: Modes whose commands can take effect while compiled code goes on.
_STREAMED = (EFFORT.name, POSITION.name, VELOCITY.name)
#: Control periods for which the path of trajectories is computed at once. One of ten steps takes
#: 324 us with 8 of them, 279 with 16 and 262 with 32, most of which is physics.
_AHEAD = 16
#: No joint that a trajectory leads.
_NOT_LED = np.empty(0, np.int64), np.empty((0, 0, 3))
#: No base that follows a twist.
_NOT_DRIVEN = np.empty(0, np.int64), np.empty(0, np.int64), records(blank_motion(0), MOTION)


class JointRuns:
    """
    The intervals in which compiled code controls the joints of a robot.

    It gets joints and targets of end effectors as arrays of numbers, and may go on by itself with
    periods like the one before. What it has changed is taken over when the run ends, or when it is
    interrupted.

    :param controller: of the joints
    """

    def __init__(self, controller: JointController) -> None:
        self._controller = controller
        self._derived = Derived()

    def begin(self, intervals: IntArray, clock: Clock) -> tuple[RobotJoints, Targets, int]:
        """
        Return joints and targets for the compiled law, and for how many intervals they are known.

        Trajectories that are due in the first interval begin.

        :param intervals: physics steps of each, shape (k,)
        :param clock: of the simulation
        """
        controller, now_s = self._controller, clock.control_s
        step_s, durations_s = controller.servos.step_s, self._derived.made_of(
            self._durations, intervals)
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
                trajectories, clock.ends_s(intervals[:count], step_s))
            count = len(path)
        servos, setpoints, flags = controller.servos, controller.setpoints, self._flags
        flags[:] = controller.flags
        return self._derived.made_of(
            RobotJoints, setpoints.joints, servos.records, servos.places, controller.effort,
            setpoints.counts, controller.cartesian.postures, flags, indices, path, *base,
            controller.payloads.loads, servos.integrals), targets, count

    def _durations(self, intervals: IntArray) -> FloatArray:
        return np.asarray(intervals * self._controller.servos.step_s, dtype=float)

    @property
    def _flags(self) -> NDArray[np.bool_]:
        """Room for the flags of the compiled law."""
        flags: NDArray[np.bool_] | None = self._derived.of.get('flags')
        if flags is None:
            flags = self._derived.of['flags'] = np.zeros(4, np.bool_)
        return flags

    def begin_python_steps(self, steps: int, now_s: float) -> None:
        """
        Let laws of users exert their efforts in steps that Python runs, in an interval that began.

        :param steps: of the physics in it
        :param now_s: simulation time since the last reset [s]
        """
        controller = self._controller
        if controller.seats.of:
            controller.seats.begin(now_s, steps, controller.setpoints.joints, controller.effort,
                                   controller.payloads)

    def seat_rows(self) -> IntArray:
        """Return the addresses of the rows of the laws of users, for compiled code."""
        controller = self._controller
        return controller.seats.rows(
            controller.setpoints.joints, controller.effort, controller.payloads)

    def end(self, joints: RobotJoints, targets: Targets, moved_s: float, data: mujoco.MjData,
            now_s: float, places_at_begin: Callable[[], mujoco.MjData]) -> None:
        """
        Take over the changes of the compiled law, and end trajectories that have come to an end.

        :param joints: as :meth:`begin` has returned them
        :param targets: with them
        :param moved_s: simulation time when setpoints stopped to move, or -1 [s]
        :param now_s: simulation time since the last reset, after the intervals [s]
        :param places_at_begin: returns data with the kinematics at the beginning of the period
        """
        controller = self._controller
        controller.flags = joints.flags.tolist()
        if moved_s >= 0.0:
            controller.setpoints.now_s = moved_s
        if targets is not no_targets():
            controller.cartesian.end_run(
                controller.cartesian_commands, targets, places_at_begin)
        if len(joints.path):
            controller.end_trajectories(data, now_s)

    def stand(self, joints: RobotJoints, targets: Targets, owners: IntArray, acts: IntArray,
              until_s: FloatArray) -> bool:
        """
        Let compiled code go on, if it knows all that setpoints and end effectors follow.

        :param joints: as :meth:`begin` has returned them
        :param targets: with them
        :param owners: for the law, shape (n,)
        :param acts: for the law, shape (1,)
        :param until_s: for the law, shape (3,)
        :returns: whether it may
        """
        controller, commands = self._controller, self._controller.commands
        if commands.waiting or controller.resting:
            return False
        owners[:] = -1
        for number, command in enumerate(commands.running):
            if isinstance(command, BaseTwist):
                ends = not command.handle.is_active
            else:
                ends = isinstance(command, JointSetpoint) and all(
                    [MODES[mode].ends for mode in dict.fromkeys(command.modes)])
            if ends:
                owners[command.indices] = number
        known_s = controller.cartesian.stand(controller.cartesian_commands, targets)
        acts[0] = bool(commands.running or controller.command_timeouts.pending
                       or controller.seats.of or controller.acts)
        until_s[:] = controller.command_timeouts.first_s, known_s, math.inf
        return known_s > -math.inf

    def look_ahead(self, joints: RobotJoints, intervals: IntArray, clock: Clock,
                   until_s: FloatArray) -> RobotJoints:
        """
        Return the joints with the path of their trajectories in the next periods, if one runs.

        :param joints: as :meth:`begin` has returned them
        :param intervals: physics steps of those of a period, shape (k,)
        :param clock: of the simulation
        :param until_s: as of :meth:`stand`; periods have to begin before the last to be known [s]:
            a trajectory ends in the next one, or it is farther ahead
        """
        controller = self._controller
        trajectories = controller.commands.trajectories
        if not trajectories:
            led, path = _NOT_LED  # The last one may just have ended.
            return joints._replace(led=led, path=path) if len(joints.path) else joints
        indices, path = controller.trajectories.path(trajectories, clock.ends_s(
            np.tile(intervals, _AHEAD), controller.servos.step_s))
        periods = (len(path) - 1) // len(intervals)
        steps = clock.control_steps + periods * int(intervals.sum())
        until_s[2] = (steps - 0.5) * clock.step_ns * 1e-9
        return joints._replace(led=indices, path=path)

    def go_on(self, command: Command, goals: FloatArray, renewed_s: FloatArray, now_s: float,
              period_s: float) -> bool:
        """
        Let a command replace one that differs in its numbers alone while compiled code goes on.

        :param goals: of joints, see :meth:`catch_up`, changed
        :param renewed_s: with them, changed
        :param now_s: simulation time since the last reset [s]
        :param period_s: length of a control period [s]
        :returns: False, and nothing has changed, where it has to be applied instead
        """
        controller = self._controller
        if type(command) is not JointSetpoint or len(set(command.modes)) != 1 or (
                command.modes[0] not in _STREAMED):
            return False
        older = self._alike(command)
        if older is None or older.modes is not command.modes:
            return False
        exerts = command.modes[0] == EFFORT.name
        if exerts and not controller.servos.gives_effort(command.indices).all():
            return False  # Gains have to change.
        controller.commands.replace(older, command)
        command.handle.status = Status.RUNNING
        controller.apply_setpoint(command, period_s)
        flags = self._flags
        flags[MOVES] = not exerts or controller.setpoints.moving
        flags[DUE] |= exerts
        goals[command.indices], renewed_s[command.indices] = command.values, now_s
        return True

    def go_on_acting(self, command: PoseAction) -> bool:
        """
        Let an action replace one that differs in its numbers alone while compiled code goes on.

        The caller gives compiled code the numbers.

        :returns: False, and nothing has changed, where it has to be applied instead
        """
        older = self._alike(command)
        if older is None:
            return False
        self._controller.commands.replace(older, command)
        command.handle.status = Status.RUNNING
        return True

    def go_on_moving(self, command: Command, targets: Targets, intervals: IntArray,
                     until_s: FloatArray, renewed_s: FloatArray, data: mujoco.MjData, clock: Clock,
                     period_s: float) -> bool:
        """
        Let a twist or pose replace one of its kind while compiled code goes on.

        :param targets: with which it goes on
        :param intervals: physics steps of those of a period, shape (k,)
        :param until_s: of the law, see :meth:`stand`, changed
        :param renewed_s: when commands were replaced, by joint [s], shape (n,), changed
        :param clock: of the simulation
        :param period_s: length of a control period [s]
        :returns: False, and nothing has changed, where it has to be applied instead
        """
        controller, older, now_s = self._controller, self._alike(command), clock.control_s
        if older is None or now_s >= until_s.min():
            return False
        controller.commands.replace(older, command)
        command.handle.status = Status.RUNNING
        if isinstance(command, BaseTwist):
            controller.base.begin(command, data, now_s, period_s, True)
        elif isinstance(command, CartesianCommand):
            arms, cartesian = controller.cartesian_commands, controller.cartesian
            cartesian.catch_up(arms, targets)
            cartesian.begin(command, data, now_s, True)
            cartesian.begin_run(arms, now_s, self._derived.made_of(self._durations, intervals),
                                lambda: clock.begins_s(intervals))
            until_s[1] = cartesian.stand(arms, targets)
        renewed_s[command.indices] = now_s
        return True

    def _alike(self, command: C) -> C | None:
        """Return another command of the same kind that runs for the same joints, or None."""
        for older in self._controller.commands.running:
            if (type(older) is type(command) and older.indices is command.indices
                    and older.handle.is_active and older is not command):
                return older
        return None

    def catch_up(self, targets: Targets, moved_s: float, goals: FloatArray,
                 renewed_s: FloatArray, now_s: float) -> None:
        """
        Take over what compiled code has done by itself.

        :param targets: of end effectors
        :param moved_s: simulation time when setpoints stopped to move, or -1 [s]
        :param goals: that have come meanwhile, by joint, shape (n,)
        :param renewed_s: when they came, or -1 [s], shape (n,)
        :param now_s: simulation time since the last reset [s]
        """
        controller, setpoints = self._controller, self._controller.setpoints
        controller.flags = self._flags.tolist()
        if moved_s >= 0.0:
            setpoints.now_s = moved_s
        arms = controller.cartesian_commands
        controller.cartesian.catch_up(arms, targets)
        for command in controller.commands.running:
            came_s = renewed_s.item(command.indices.item(0))
            if came_s >= 0.0:
                if isinstance(command, PoseAction):
                    command.action[:] = targets.actions[arms.index(command)]
                elif isinstance(command, JointSetpoint):
                    command.values[:] = goals[command.indices]
                renewed_s[command.indices] = -1.0
                controller.command_timeouts.renew(command.parts, came_s)
                if came_s == now_s:
                    setpoints.now_s = now_s
