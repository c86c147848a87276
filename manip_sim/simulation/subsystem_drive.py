# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What moves a subsystem: it takes commands and writes controls once per control period."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.models.robots import RobotModel
from manip_sim.simulation.commands import (
    BaseTwist, clamp, Command, field_of_mode, finite_numbers, Goal, joint_indices,
    TrajectoryPoints)
from manip_sim.simulation.control import MODES, Servos
from manip_sim.simulation.parts import Part
from manip_sim.simulation.trajectory import check_times, Trajectory
from manip_sim.typing import FloatArray, IntArray

#: Words in the names of the joints of a mobile base that moves along x, y and turns about z.
_TWIST_JOINTS = ('forward', 'side', 'yaw')


class SubsystemDrive:
    """
    Drives an arm, base, torso, head or legs.

    :param model: the compiled ``mujoco.MjModel``
    :param part: what is driven
    :param robot: whose ``format_action`` maps abstract actions
    """

    def __init__(self, model: Any, part: Part, robot: RobotModel) -> None:
        self.part = part
        self._robot = robot
        self._servos = Servos(model, part)
        self._dofs = np.array([model.joint(j).dofadr[0] for j in part.driven_joints])
        self._qpos = np.array([model.joint(j).qposadr[0] for j in part.driven_joints])
        self._twist_joints = _twist_joints(part)
        self._trajectory: tuple[TrajectoryPoints, Trajectory, int] | None = None
        self._twist: FloatArray | None = None
        self._fresh_until: float | None = None
        self.command_timeout_s = 0.0
        self.timeouts = 0
        self._servos.set_mode('position')

    @property
    def mode(self) -> str:
        """One of ``position``, ``velocity`` and ``effort``."""
        return self._servos.mode

    def limits(self) -> FloatArray:
        """Return the range of each actuator's goal in the present mode, shape (n, 2), a copy."""
        return self._servos.ranges[self.mode].copy()

    def action(self, action: ArrayLike) -> Goal:
        """
        Validate an abstract action, in [-1, 1] for each actuator.

        :raises CommandError: if the length is wrong or a number is not finite
        """
        count = len(self.part.actuators)
        numbers = finite_numbers(action, count, f'{self.part.name}: an action')
        _, clamped = clamp(numbers, np.tile([-1.0, 1.0], (count, 1)))
        mode = self.mode
        values = self._robot.format_action(self.part.name, numbers, self._servos.ranges[mode])
        return Goal(self.part.name, mode, np.arange(count), values, clamped)

    def joint_command(self, names: Sequence[str], position: ArrayLike, velocity: ArrayLike,
                      effort: ArrayLike) -> Goal:
        """
        Validate goals for some joints, in the field that the control mode uses.

        :raises CommandError: if a joint is not there, or the numbers do not fit
        """
        part, mode = self.part.name, self.mode
        indices = joint_indices(names, self.part.driven_joints, part)
        values = field_of_mode(part, mode, len(names), position, velocity, effort)
        values, clamped = clamp(values, self._clamp_ranges(mode)[indices])
        return Goal(part, mode, indices, values, clamped)

    def trajectory(self, names: Sequence[str], times_s: Sequence[float], positions: ArrayLike,
                   velocities: ArrayLike | None, accelerations: ArrayLike | None
                   ) -> TrajectoryPoints:
        """
        Validate a motion for some joints.

        :raises CommandError: if a joint is not there, the times do not increase, or the numbers
            do not fit; or if the part is not in position mode
        """
        part = self.part.name
        if self.mode != 'position':
            raise CommandError(f'{part} follows trajectories in position mode only, '
                               f'it is in {self.mode} mode')
        indices = joint_indices(names, self.part.driven_joints, part)
        times = finite_numbers(times_s, len(times_s), f'{part}: time_from_start')
        check_times(times)
        shape = (len(times), len(names))
        goal, clamped = clamp(_points(part, 'positions', positions, shape),
                              self._clamp_ranges('position')[indices])
        rates = None if velocities is None else _points(part, 'velocities', velocities, shape)
        bends = None if accelerations is None else _points(part, 'accelerations', accelerations,
                                                           shape)
        return TrajectoryPoints(part, indices, times, goal, rates, bends, clamped)

    @property
    def takes_twist(self) -> bool:
        """Whether the part is a base that moves along x and y and turns about z."""
        return self._twist_joints is not None

    def twist(self, forward: float, side: float, yaw: float) -> BaseTwist:
        """
        Validate a velocity in the base's own frame.

        :param forward: along x [m/s]
        :param side: along y [m/s]
        :param yaw: about z [rad/s]
        :raises CommandError: if a number is not finite, or the base is not in velocity mode
        """
        indices = self._twist_joints
        if indices is None or self.mode != 'velocity':
            raise CommandError(f'{self.part.name} takes a twist in velocity mode only, '
                               f'it is in {self.mode} mode')
        values = finite_numbers([forward, side, yaw], 3, f'{self.part.name}: a twist')
        ranges = self._servos.ranges['velocity'][indices]
        return BaseTwist(self.part.name, *clamp(values, ranges))

    def _turn_twist(self, data: Any) -> None:
        """Give the joints the velocities of the twist; the slides do not turn with the base."""
        if self._twist is None or self._twist_joints is None:
            return
        forward, side, turn = self._twist
        yaw = data.qpos[self._qpos[self._twist_joints[2]]]
        self._goal[self._twist_joints] = (np.cos(yaw) * forward - np.sin(yaw) * side,
                                          np.sin(yaw) * forward + np.cos(yaw) * side, turn)

    def _clamp_ranges(self, mode: str) -> FloatArray:
        ranges = self._servos.ranges[mode].copy()
        if mode == 'position':
            ranges[~self._servos.limited] = (-np.inf, np.inf)
        return ranges

    def set_mode(self, mode: str, data: Any) -> None:
        """
        Go on in another control mode, from where the part is.

        :raises UnknownNameError: if there is no such mode
        """
        if mode not in MODES:
            raise UnknownNameError('control mode', mode, MODES)
        self._servos.set_mode(mode)
        self.reset(data)

    def reset(self, data: Any) -> None:
        """Drop all commands and rest where the part is."""
        self._goal = self._servos.rest_goal(data)
        self._followed = self._goal.copy()
        self._trajectory = self._twist = None
        self._fresh_until = None
        self._servos.write(data, self._followed)

    def apply(self, command: Command, data: Any, step: int, time_s: float) -> None:
        """Take a command over; one that was meant for another mode is dropped."""
        if isinstance(command, TrajectoryPoints):
            if self.mode != 'position':
                return
            velocity = data.qvel[self._dofs]
            self._trajectory = (command, command.from_state(self._followed, velocity), step)
        elif isinstance(command, BaseTwist):
            if self.mode != 'velocity':
                return
            self._twist = command.twist
        elif isinstance(command, Goal) and command.mode == self.mode:
            self._trajectory = self._twist = None
            self._goal[command.indices] = command.values
        self._fresh_until = time_s + self.command_timeout_s

    def update(self, data: Any, step: int, timestep_s: float, steps: int) -> None:
        """
        Write the controls of the next control period.

        :param step: number of physics steps up to now
        :param steps: number of physics steps of the period
        """
        self._check_timeout(step * timestep_s)
        if self._trajectory is not None:
            points, trajectory, start = self._trajectory
            time_s = (step + steps - start) * timestep_s
            self._goal[points.indices] = trajectory.position(time_s)
            if time_s >= trajectory.end_s:
                self._trajectory = None
        self._turn_twist(data)
        self._followed = self._servos.approach(data, self._followed, self._goal,
                                               steps * timestep_s)
        self._servos.write(data, self._followed)

    def _check_timeout(self, time_s: float) -> None:
        if (self.command_timeout_s <= 0.0 or self._fresh_until is None
                or self._trajectory is not None or time_s < self._fresh_until):
            return
        self._fresh_until = self._twist = None
        self.timeouts += 1
        self._goal = (self._followed if self.mode == 'position'
                      else np.zeros_like(self._goal)).copy()


def _twist_joints(part: Part) -> IntArray | None:
    """Return which actuators of a base move along x and y and turn about z, or None."""
    words = [set((joint or '').split('_')) for joint in part.driven_joints]
    found = [[i for i, w in enumerate(words) if key in w] for key in _TWIST_JOINTS]
    if part.name != 'base' or any(len(indices) != 1 for indices in found):
        return None
    return np.array([indices[0] for indices in found])


def _points(part: str, field: str, values: ArrayLike, shape: tuple[int, int]) -> FloatArray:
    try:
        numbers = np.asarray(values, dtype=float)
    except ValueError:
        numbers = np.empty(0)
    if numbers.shape != shape:
        raise CommandError(f'{part}: {field} must have {shape[1]} numbers at each of {shape[0]} '
                           'points')
    if not np.isfinite(numbers).all():
        raise CommandError(f'{part}: {field} must be finite')
    return numbers
