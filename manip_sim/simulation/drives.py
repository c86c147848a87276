# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What moves a part: it takes commands and writes controls once per control period."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Union

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.models.robots import RobotModel
from manip_sim.simulation.commands import (
    clamp, Command, field_of_mode, finite_numbers, Goal, GripperAction, joint_indices,
    TrajectoryPoints)
from manip_sim.simulation.control import MODES, Servos
from manip_sim.simulation.parts import Part
from manip_sim.simulation.trajectory import check_times, Trajectory
from manip_sim.typing import FloatArray, IntArray

#: Rate at which the reference calls a gripper's ``format_action`` [Hz].
GRIPPER_RATE_HZ = 20.0
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
        self._trajectory: tuple[TrajectoryPoints, Trajectory, int] | None = None
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
        return self._twist_indices() is not None

    def _twist_indices(self) -> IntArray | None:
        """Return which actuators move along x and y and turn about z, or None."""
        words = [set((joint or '').split('_')) for joint in self.part.driven_joints]
        found = [[i for i, w in enumerate(words) if key in w] for key in _TWIST_JOINTS]
        if any(len(indices) != 1 for indices in found):
            return None
        return np.array([indices[0] for indices in found])

    def twist(self, forward: float, side: float, yaw: float) -> Goal:
        """
        Validate a velocity in the base's own frame.

        :param forward: along x [m/s]
        :param side: along y [m/s]
        :param yaw: about z [rad/s]
        :raises CommandError: if a number is not finite, or the base is not in velocity mode
        """
        indices = self._twist_indices()
        if indices is None or self.mode != 'velocity':
            raise CommandError(f'{self.part.name} takes a twist in velocity mode only, '
                               f'it is in {self.mode} mode')
        values = finite_numbers([forward, side, yaw], 3, f'{self.part.name}: a twist')
        ranges = self._servos.ranges['velocity'][indices]
        return Goal(self.part.name, self.mode, indices, *clamp(values, ranges))

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
        self._trajectory = None
        self._fresh_until = None
        self._servos.write(data, self._followed)

    def apply(self, command: Command, data: Any, step: int, time_s: float) -> None:
        """Take a command over; one that was meant for another mode is dropped."""
        if isinstance(command, TrajectoryPoints):
            if self.mode != 'position':
                return
            velocity = data.qvel[self._dofs]
            self._trajectory = (command, command.from_state(self._followed, velocity), step)
        elif isinstance(command, Goal) and command.mode == self.mode:
            self._trajectory = None
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
        self._followed = self._servos.approach(data, self._followed, self._goal,
                                               steps * timestep_s)
        self._servos.write(data, self._followed)

    def _check_timeout(self, time_s: float) -> None:
        if (self.command_timeout_s <= 0.0 or self._fresh_until is None
                or self._trajectory is not None or time_s < self._fresh_until):
            return
        self._fresh_until = None
        self.timeouts += 1
        self._goal = (self._followed if self.mode == 'position'
                      else np.zeros_like(self._goal)).copy()


class GripperDrive:
    """
    Drives a gripper: calls its ``format_action`` at the reference's 20 Hz of simulation time.

    An action lasts until the next one, so one message closes fully, and how often it is repeated
    does not matter.

    :param model: the compiled ``mujoco.MjModel``
    :param part: the gripper
    :param timestep_s: of the physics [s]
    """

    mode = 'position'

    def __init__(self, model: Any, part: Part, timestep_s: float) -> None:
        if part.gripper is None:
            raise ValueError(f'{part.name} is not a gripper')
        self.part = part
        self._gripper = part.gripper
        self._model = model
        self._ids = part.actuator_ids
        self._ranges = model.actuator_ctrlrange[self._ids].copy()
        self._steps_per_call = max(1, round(1.0 / (GRIPPER_RATE_HZ * timestep_s)))
        self._next_call = 0
        self._action: FloatArray | None = None

    def limits(self) -> FloatArray:
        """Return the range of an action, shape (dof, 2)."""
        return np.tile([-1.0, 1.0], (self._gripper.dof, 1))

    def action(self, action: ArrayLike) -> GripperAction:
        """
        Validate an action for the gripper's ``format_action``.

        :raises CommandError: if the length is wrong or a number is not finite
        """
        part, count = self.part.name, self._gripper.dof
        numbers = finite_numbers(action, count, f'{part}: an action')
        return GripperAction(part, *clamp(numbers, self.limits()))

    def joint_command(self, names: Sequence[str], position: ArrayLike, velocity: ArrayLike,
                      effort: ArrayLike) -> Goal:
        """
        Validate positions for joints that an actuator drives.

        :raises CommandError: if a joint is not there, or the numbers do not fit
        """
        part = self.part.name
        indices = joint_indices(names, self.part.driven_joints, part)
        values = field_of_mode(part, self.mode, len(names), position, velocity, effort)
        joints = [self._model.joint(name) for name in names]
        ranges = np.array([j.range if j.limited[0] else (-np.inf, np.inf) for j in joints])
        return Goal(part, self.mode, indices, *clamp(values, ranges))

    def reset(self, data: Any) -> None:
        """Drop all commands and hold the fingers where they are."""
        self._action = None
        self._next_call = 0
        mujoco.mj_fwdPosition(self._model, data)
        data.ctrl[self._ids] = self._ctrl_for(data.actuator_length[self._ids])
        self._go_on_from(data)

    def apply(self, command: Command, data: Any, step: int, time_s: float) -> None:
        """Take a command over."""
        if isinstance(command, GripperAction):
            if self._action is None:
                self._go_on_from(data)
            self._action = command.action
            self.call_if_due(data, step)
        elif isinstance(command, Goal):
            self._action = None
            goal = data.ctrl[self._ids].copy()
            wanted = self._ctrl_for(self._lengths(command))
            goal[command.indices] = wanted[command.indices]
            data.ctrl[self._ids] = np.clip(goal, *self._ranges.T)

    def _lengths(self, command: Goal) -> FloatArray:
        lengths = np.zeros(len(self._ids))
        lengths[command.indices] = command.values
        return lengths * self._model.actuator_gear[self._ids, 0]

    def steps_to_call(self, step: int) -> int | None:
        """Return after how many physics steps :meth:`call_if_due` has to be called, or None."""
        return None if self._action is None else max(1, self._next_call - step)

    def call_if_due(self, data: Any, step: int) -> None:
        """Call the gripper's ``format_action`` if its time has come."""
        if self._action is None or step < self._next_call:
            return
        command = np.clip(self._gripper.format_action(self._action), -1.0, 1.0)
        low, high = self._ranges.T
        ctrl = low + (command + 1.0) / 2.0 * (high - low)
        if np.array_equal(ctrl, data.ctrl[self._ids]):
            self._action = None
        data.ctrl[self._ids] = ctrl
        self._next_call = step + self._steps_per_call

    def _ctrl_for(self, length: FloatArray) -> FloatArray:
        """Return the control at which a position servo comes to rest at an actuator length."""
        gain = self._model.actuator_gainprm[self._ids, 0]
        bias = self._model.actuator_biasprm[self._ids]
        ctrl = -(bias[:, 0] + bias[:, 1] * length) / np.where(gain == 0.0, 1.0, gain)
        return np.clip(ctrl, *self._ranges.T)

    def _go_on_from(self, data: Any) -> None:
        low, high = self._ranges.T
        span = np.where(high > low, high - low, 1.0)
        self._gripper.start_at((data.ctrl[self._ids] - low) / span * 2.0 - 1.0)


Drive = Union[SubsystemDrive, GripperDrive]


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
