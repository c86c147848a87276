# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Validate input from outside and turn it into commands; nothing is changed here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.commands import (
    BaseTwist, Command, GripperAction, JointSetpoint, JointTrajectory, TrajectoryStop)
from manip_sim.control.gripper_controller import GripperController
from manip_sim.control.joint_command_parser import as_names, check_names, JointCommandParser
from manip_sim.control.joint_controller import JointController
from manip_sim.control.modes import MODES, names_of_modes
from manip_sim.control.trajectory import check_times, Trajectory
from manip_sim.errors import CommandError
from manip_sim.models.robots import RobotModel
from manip_sim.models.robots.robot_model import SUBSYSTEMS
from manip_sim.quoting import pluralize
from manip_sim.validation import (
    action_example, clamp, clamped_example, command_numbers, finite_command_numbers)

#: A trajectory with more points is rejected: checking it would take too long.
MAX_POINTS = 10_000
#: A start farther ahead is rejected as the stamp of another clock [s].
_MAX_AHEAD_S = 3600.0


class CommandParser(JointCommandParser):
    """
    A parser of commands for the parts of a robot.

    :param robot: for which the commands are; its ``format_action`` maps abstract actions
    :param joints: controller of the joints of arms, base, torso, head and legs; only read
    :param grippers: controllers of the grippers, by part; only read
    """

    def __init__(self, robot: RobotModel, joints: JointController,
                 grippers: Mapping[str, GripperController]) -> None:
        super().__init__(
            robot, joints, {part: gripper.joints for part, gripper in grippers.items()})
        self._grippers = grippers

    def action(self, part: str, action: ArrayLike) -> Command:
        """
        Return the command for an abstract action.

        :param part: such as ``arm`` or ``right/gripper``
        :param action: in [-1, 1] for each actuator of the part, or each dof of the gripper
        :raises CommandError: if the length is wrong or a number is not finite
        :raises UnknownNameError: if the part is unknown
        """
        if part in self._grippers:
            gripper = self._grippers[part]
            numbers = finite_command_numbers(action, gripper.dof, f'{part}: an action')
            inside, clamped = clamp(numbers, np.array([-1.0, 1.0]))
            return GripperAction(
                robot=self._robot, parts=frozenset([part]), indices=gripper.indices,
                action=inside, clamped=clamped, clamped_example=action_example(numbers, inside))
        indices, modes = self._joints.indices_of(part), self._joints.modes
        numbers = finite_command_numbers(action, len(indices), f'{part}: an action')
        inside, clamped = clamp(numbers, np.array([-1.0, 1.0]))
        return JointSetpoint(
            robot=self._robot, parts=self._joints.parts_of(indices), indices=indices,
            clamped=clamped, clamped_example=action_example(numbers, inside),
            modes=tuple(modes[i] for i in indices),
            values=self._formatted(part, indices, inside, modes))

    def _formatted(self, part: str, indices: IntArray, action: FloatArray, modes: Sequence[str]
                   ) -> FloatArray:
        # format_action knows subsystems, of which one arm of two is only a part.
        subsystem = part if part in SUBSYSTEMS else 'arm'
        whole = self._joints.indices_of(subsystem)
        places = np.flatnonzero(np.isin(whole, indices))
        padded = np.zeros(len(whole))
        padded[places] = action
        ranges = self._joints.ranges(whole, modes)
        return self._robot.format_action(subsystem, padded, ranges)[places]

    def trajectory(self, part: str, names: Sequence[str], times_s: Sequence[float],
                   positions: ArrayLike, velocities: ArrayLike | None = None,
                   accelerations: ArrayLike | None = None, start_ns: int = 0,
                   now_ns: int = 0) -> Command:
        """
        Return the command for a trajectory of some joints of a part.

        The spline is made and checked here, from the present setpoints. Points in the past are
        dropped; a motion that exceeds velocity limits is slowed down as a whole. Without points
        the present trajectories of the joints end.

        :param times_s: of the points, from the start [s]
        :param positions: [rad or m], shape (n_points, n)
        :param velocities: [rad/s or m/s], of that shape, or None
        :param accelerations: [rad/s^2 or m/s^2], of that shape, or None
        :param start_ns: simulation time of the start [ns]; 0 for now
        :param now_ns: present simulation time [ns]
        :raises CommandError: if a joint is unknown, the times do not increase, all points are in
            the past or the numbers do not match; or if the mode of a joint
            follows no trajectories
        """
        joints = self._joints
        indices, names = joints.indices_of(part), as_names(names, part)
        times = command_numbers(times_s, f'{part}: time_from_start')
        if names or times.size:
            check_names(names, [joints.names[i] for i in indices], part)
            indices = joints.find(names)
        if not times.size:
            return TrajectoryStop(
                robot=self._robot, parts=joints.parts_of(indices), indices=indices)
        modes = joints.modes
        for name, i in zip(names, indices):
            if not MODES[modes[i]].follows_trajectories:
                able = names_of_modes(lambda mode: mode.follows_trajectories)
                raise CommandError(f'{part} follows trajectories in {able} mode only, '
                                   f"joint '{name}' is in {modes[i]} mode")
        if times.size > MAX_POINTS:
            raise CommandError(f'{part}: a trajectory may have at most {MAX_POINTS} points, got '
                               f'{times.size}')
        times = finite_command_numbers(times, times.size, f'{part}: time_from_start')
        check_times(times)
        shape = (len(times), len(names))
        asked = _points(part, 'positions', positions, shape)
        goal, clamped = clamp(asked, joints.clamps(indices, modes))
        goal_velocities = (
            None if velocities is None else _points(part, 'velocities', velocities, shape))
        goal_accelerations = (
            None if accelerations is None
            else _points(part, 'accelerations', accelerations, shape))
        if goal_accelerations is not None and goal_velocities is None:
            raise CommandError(f'{part}: accelerations need velocities')
        delay_s = (start_ns - now_ns) * 1e-9 if start_ns else 0.0
        _check_start(part, times, delay_s)
        elapsed_s = max(0.0, -delay_s)
        trajectory, slowed = joints.fitted(
            Trajectory(times, goal, goal_velocities, goal_accelerations), indices, elapsed_s)
        if slowed > 1.0 and elapsed_s > 0.0:
            start_ns = 0
        return JointTrajectory(
            robot=self._robot, parts=joints.parts_of(indices), indices=indices,
            trajectory=trajectory, columns=np.arange(len(names)), start_ns=start_ns,
            slowed=slowed, clamped=clamped, clamped_example=clamped_example(names, asked, goal))

    def twist(self, forward: float, side: float, yaw: float) -> Command:
        """
        Return the command for a velocity of the mobile base in its own frame.

        :param forward: along x [m/s]
        :param side: along y [m/s]
        :param yaw: about z [rad/s]
        :raises CommandError: if a number is not finite, or no base has a mode that takes it
        """
        indices = self._joints.twist_indices
        if indices is None:
            raise CommandError('base: this robot has no base that takes a twist')
        values = finite_command_numbers([forward, side, yaw], 3, 'base: a twist')
        modes = self._joints.modes
        if not MODES[modes[indices[0]]].takes_twists:
            able = names_of_modes(lambda mode: mode.takes_twists)
            raise CommandError(f'base takes a twist in {able} mode only, it is in '
                               f'{modes[indices[0]]} mode')
        inside, clamped = clamp(values, self._joints.twist_clamps(indices, modes))
        return BaseTwist(
            robot=self._robot, parts=self._joints.parts_of(indices), indices=indices,
            twist=inside, joints=indices, columns=np.arange(3), clamped=clamped,
            clamped_example=clamped_example(('linear.x', 'linear.y', 'angular.z'), values, inside))


def _points(part: str, field: str, values: ArrayLike, shape: tuple[int, int]) -> FloatArray:
    try:
        numbers = command_numbers(values, f'{part}: {field}')
    except CommandError:  # No numbers, or points of different lengths.
        numbers = np.empty(0)
    if numbers.shape != shape:
        raise CommandError(f'{part}: {field} must have {pluralize(shape[1], "number")} at each of '
                           f'{pluralize(shape[0], "point")}')
    if not np.isfinite(numbers).all():
        raise CommandError(f'{part}: {field} must be finite')
    return numbers


def _check_start(part: str, times: FloatArray, delay_s: float) -> None:
    if delay_s > _MAX_AHEAD_S:
        raise CommandError(f'{part}: the trajectory would start in {delay_s:.0f} s of simulation '
                           'time, by its stamp: set use_sim_time in the node that sends it, or '
                           'leave the stamp zero')
    if delay_s < 0.0 and times[-1] + delay_s < 0.0:
        raise CommandError(f'{part}: the trajectory ended {-(times[-1] + delay_s):.3f} s ago, by '
                           'its stamp')
