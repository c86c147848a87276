# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What moves a gripper: it calls ``format_action`` in simulation time and writes controls."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from manip_sim.simulation.commands import Command, GripperAction, GripperSetpoint, Status
from manip_sim.simulation.parts import Part
from manip_sim.typing import FloatArray

#: Rate at which the reference calls a gripper's ``format_action`` [Hz].
GRIPPER_RATE_HZ = 20.0


class GripperController:
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
        self._goal: FloatArray | None = None
        self._ctrl_speed = self._speed_limit()

    def _speed_limit(self) -> FloatArray:
        """Return how fast each control may change for a joint command, infinite where unknown."""
        limits = np.full(len(self._ids), np.inf)
        for index, joint in enumerate(self.part.driven_joints):
            if joint is None:
                continue
            declared = self._model.joint(joint).user
            if len(declared) and declared[0] > 0.0:
                limits[index] = declared[0]
        gain = self._model.actuator_gainprm[self._ids, 0]
        per_length = np.abs(self._model.actuator_biasprm[self._ids, 1]
                            / np.where(gain == 0.0, 1.0, gain))
        scale = per_length * np.abs(self._model.actuator_gear[self._ids, 0])
        return limits * np.where(scale > 0.0, scale, 1.0)

    @property
    def dof(self):
        return self._gripper.dof

    @property
    def indices(self):
        return np.arange(len(self._ids))

    @property
    def commanded_joints(self):
        return [j for j in self.part.driven_joints if j]

    def followers(self, joint):
        return []

    def joint_ranges(self, joints):
        found = [self._model.joint(name) for name in joints]
        return np.array([j.range if j.limited[0] else (-np.inf, np.inf) for j in found])

    def actuators_of(self, joints):
        return np.array([self.part.driven_joints.index(j) for j in joints])

    @property
    def moving(self):
        return self._action is not None or self._goal is not None

    def reset(self, data: Any) -> None:
        """Drop all commands and hold the fingers where they are."""
        self._action = self._goal = None
        self._next_call = 0
        mujoco.mj_fwdPosition(self._model, data)
        data.ctrl[self._ids] = self._ctrl_for(data.actuator_length[self._ids])
        self._go_on_from(data)

    def apply(self, command: Command, data: Any, step: int) -> None:
        """Take a command over."""
        command.handle.status = Status.RUNNING
        if isinstance(command, GripperAction):
            if self._action is None:
                self._go_on_from(data)
            self._action, self._goal = command.action, None
            self.call_if_due(data, step)
        elif isinstance(command, GripperSetpoint):
            self._action = None
            goal = data.ctrl[self._ids].copy() if self._goal is None else self._goal
            wanted = self._ctrl_for(self._lengths(command))
            goal[command.indices] = wanted[command.indices]
            self._goal = np.clip(goal, *self._ranges.T)

    def update(self, data: Any, period_s: float) -> None:
        """
        Approach the goal of a joint command, no faster than the joints may move.

        :param period_s: length of the control period that begins [s]
        """
        if self._goal is None:
            return
        reach = self._ctrl_speed * period_s
        here = data.ctrl[self._ids]
        data.ctrl[self._ids] = here + np.clip(self._goal - here, -reach, reach)
        if np.array_equal(data.ctrl[self._ids], self._goal):
            self._goal = None

    def _lengths(self, command: GripperSetpoint) -> FloatArray:
        lengths = np.zeros(len(self._ids))
        lengths[command.indices] = command.values
        lengths *= self._model.actuator_gear[self._ids, 0]
        return lengths

    def tick(self, data, step, h):
        self.call_if_due(data, step)
        self.update(data, h)

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
        return np.asarray(np.clip(ctrl, *self._ranges.T))

    def _go_on_from(self, data: Any) -> None:
        low, high = self._ranges.T
        span = np.where(high > low, high - low, 1.0)
        self._gripper.start_at((data.ctrl[self._ids] - low) / span * 2.0 - 1.0)
