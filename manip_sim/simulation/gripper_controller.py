# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What moves a gripper: goals of actions and joint commands, approached as fast as allowed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.errors import CommandError
from manip_sim.simulation.commands import (
    clamp, Command, field_of_mode, finite_numbers, Goal, GripperAction, joint_indices)
from manip_sim.simulation.formatting import Formatter
from manip_sim.simulation.gripper_actuators import GripperActuators
from manip_sim.simulation.parts import Part
from manip_sim.typing import FloatArray

#: Rate at which the reference calls a gripper's ``format_action`` [Hz].
GRIPPER_RATE_HZ = 20.0
#: A finger has come to the end of its range if it is nearer than this part of the range.
_AT_END = 0.015
#: A finger has stopped if it would take longer than this for its range [s].
_STOPPED_S = 20.0
#: How long a finger that was stopped takes to press with its full force [s].
_PRESS_S = 0.05
#: What two setpoints may differ by and yet be the same, as part of the range.
_SAME = 1e-9


class GripperController:
    """
    Drives a gripper: calls its ``format_action`` at the reference's 20 Hz of simulation time.

    An action lasts until the next one, so one message closes fully, and how often it is repeated
    does not matter. Actions and joint commands set goals; the setpoints approach them no faster
    than the fingers may move. Where an action asks for an end of the range and something has
    stopped the finger before it, the setpoint runs on until the actuator has its full force.

    :param model: the compiled ``mujoco.MjModel``, whose position servos have a setpoint activation
    :param part: the gripper
    :param timestep_s: of the physics [s]
    :ivar joint_names: the joints that a joint command may name
    :raises ModelError: if an actuator or ``format_action`` cannot be used
    """

    mode = 'position'

    def __init__(self, model: Any, part: Part, timestep_s: float) -> None:
        if part.gripper is None:
            raise ValueError(f'{part.name} is not a gripper')
        self.part = part
        self._model = model
        self._timestep_s = timestep_s
        self._actuators = GripperActuators(model, part)
        self._formatter = Formatter(part.gripper, len(part.actuators))
        self._joints = self._servo_joints()
        self.joint_names: tuple[str, ...] = tuple(model.joint(j).name for j in self._joints)
        self._tolerance = _SAME * np.ptp(self._actuators.ranges, axis=1)
        self._forget()

    def _forget(self) -> None:
        count = len(self.part.actuators)
        self._action: FloatArray | None = None
        self._next_call_s = 0.0
        # Whether the state of ``format_action`` belongs to the goal.
        self._in_step = False
        self._goal = np.zeros(count)
        # Which servos are asked for an end of their range, and were stopped before it.
        self._to_end = np.zeros((count, 2), dtype=bool)
        self._pressing = np.zeros(count, dtype=bool)
        self._pace = np.full(count, np.inf)
        self._turned = False
        self._moving = False

    def _servo_joints(self) -> list[int]:
        servos = self._actuators.is_servo
        return list(dict.fromkeys(joint for terms, servo in zip(self._actuators.terms, servos)
                                  if servo for joint, _ in terms))

    @property
    def faults(self) -> int:
        """How many calls of the gripper's ``format_action`` failed and changed nothing."""
        return self._formatter.faults

    @property
    def moving(self) -> bool:
        """Whether :meth:`tick` has to be called; if not, the setpoints stay where they are."""
        return self._moving

    def limits(self) -> FloatArray:
        """Return the range of an action, shape (dof, 2)."""
        return np.tile([-1.0, 1.0], (self._formatter.dof, 1))

    def action(self, action: ArrayLike) -> GripperAction:
        """
        Validate an action for the gripper's ``format_action``.

        :raises CommandError: if the length is wrong or a number is not finite
        """
        part, count = self.part.name, self._formatter.dof
        numbers = finite_numbers(action, count, f'{part}: an action')
        return GripperAction(part, *clamp(numbers, self.limits()))

    def joint_command(self, names: Sequence[str], position: ArrayLike, velocity: ArrayLike,
                      effort: ArrayLike) -> Goal:
        """
        Validate positions for joints that position servos drive.

        :returns: with these joints and those that are coupled to them, as indices into
            :attr:`joint_names`
        :raises CommandError: if a joint is not there, or the numbers do not fit
        """
        part = self.part.name
        self._refuse_without_setpoint(names)
        indices = joint_indices(names, self.joint_names, part)
        values = field_of_mode(part, self.mode, len(names), position, velocity, effort)
        joints = [self._model.joint(name) for name in names]
        ranges = np.array([j.range if j.limited[0] else (-np.inf, np.inf) for j in joints])
        values, clamped = clamp(values, ranges)
        named = {self._joints[i]: float(value) for i, value in zip(indices, values)}
        following = self._actuators.couplings.follow(named)
        positions = {joint: value for joint, value in following.items() if joint in self._joints}
        return Goal(part, self.mode, np.array([self._joints.index(j) for j in positions]),
                    np.array(list(positions.values())), clamped)

    def _refuse_without_setpoint(self, names: Sequence[str]) -> None:
        for index, terms in enumerate(self._actuators.terms):
            driven = {self._model.joint(joint).name for joint, _ in terms}
            for name in names:
                if name in driven and name not in self.joint_names:
                    raise CommandError(f"{self.part.name}: joint '{name}' takes no position, "
                                       f'{self._actuators.why_no_setpoint(index)}: use actions')

    def reset(self, data: Any) -> None:
        """Drop all commands and hold the fingers where they are."""
        self._forget()
        mujoco.mj_fwdPosition(self._model, data)
        self._goal = np.clip(self._actuators.place(data), *self._actuators.ranges.T)
        self._actuators.hold(data, self._goal)
        self._in_step = self._formatter.start_at(self._normalised(self._goal))

    def apply(self, command: Command, data: Any, step: int, time_s: float) -> None:
        """Take a command over; it takes effect with the next :meth:`tick`."""
        if isinstance(command, GripperAction):
            if not self._in_step:
                # A joint command may still be under way.
                self._goal = np.clip(self._actuators.setpoints(data), *self._actuators.ranges.T)
                self._in_step = self._formatter.start_at(self._normalised(self._goal))
            self._action = command.action
        elif isinstance(command, Goal):
            self._action, self._in_step = None, False
            positions = {self._joints[i]: float(v)
                         for i, v in zip(command.indices, command.values)}
            goal = self._actuators.rest(self._actuators.lengths_at(data, positions))
            self._set_goal(np.where(np.isnan(goal), self._goal, goal), to_end=False)
            self._pace[:] = np.inf
        else:
            return
        self._moving = True

    def _set_goal(self, goal: FloatArray, to_end: bool) -> None:
        low, high = self._actuators.ranges.T
        self._goal = np.clip(goal, low, high)
        ends = np.stack([self._goal - low, high - self._goal], axis=1) <= self._tolerance[:, None]
        self._to_end = ends & to_end & (self._actuators.overtravel > 0.0)
        self._pressing &= self._to_end.any(axis=1)
        self._turned = True

    def tick(self, data: Any, duration_s: float) -> None:
        """
        Write the controls of the physics steps that follow.

        :param duration_s: of these steps [s]
        """
        self._call_if_due(data)
        actuators = self._actuators
        place, start = actuators.place(data), actuators.setpoints(data)
        target = self._target(data, place, start)
        if self._turned:
            # What presses the other way lets go at once; else a finger would first have to wait
            # until the setpoint has come back to it.
            against = actuators.is_servo & ((target - place) * (start - place) < 0.0)
            start, self._turned = np.where(against, place, start), False
        setpoints = start + self._stride(target - start, duration_s)
        present = actuators.setpoints(data)
        there = np.abs(setpoints - present) <= self._tolerance
        actuators.approach(data, np.where(there & actuators.is_servo, present, setpoints),
                           duration_s)
        waits = self._to_end.any(axis=1) & ~self._pressing
        self._moving = self._action is not None or not there.all() or bool(waits.any())

    def _target(self, data: Any, place: FloatArray, setpoints: FloatArray) -> FloatArray:
        """Return the goals, beyond the end of the range where the full force is asked for."""
        span = np.ptp(self._actuators.ranges, axis=1)
        self._to_end[np.abs(place - self._goal) < _AT_END * span] = False
        arrived = np.abs(setpoints - self._goal) <= self._tolerance
        stopped = np.abs(self._actuators.speed_of_place(data)) < span / _STOPPED_S
        self._pressing |= arrived & stopped
        self._pressing &= self._to_end.any(axis=1)
        below, above = (self._actuators.overtravel * self._to_end * self._pressing[:, None]).T
        target: FloatArray = self._goal - below + above
        return target

    def _stride(self, distance: FloatArray, duration_s: float) -> FloatArray:
        """Return how far setpoints move."""
        speeds = np.minimum(self._actuators.speeds, self._pace)
        press = self._actuators.overtravel.max(axis=1, initial=0.0) / _PRESS_S
        reach = np.where(self._pressing, press, speeds) * duration_s
        stride: FloatArray = np.clip(distance, -reach, reach)
        return stride

    def _call_if_due(self, data: Any) -> None:
        """Call the gripper's ``format_action`` if its time has come."""
        now, period_s = data.time, 1.0 / GRIPPER_RATE_HZ
        if self._action is None or now < self._next_call_s - self._timestep_s / 2.0:
            return
        late = now - self._next_call_s
        self._next_call_s = period_s + (self._next_call_s if late < period_s else now)
        goal = self._formatted_goal()
        if goal is None:
            return
        if self._turns_back(goal, data):
            place = np.clip(self._actuators.place(data), *self._actuators.ranges.T)
            self._formatter.start_at(self._normalised(np.where(
                self._actuators.is_servo, place, self._goal)))
            again = self._formatted_goal()
            goal = goal if again is None else again
        if (np.abs(goal - self._goal) <= self._tolerance).all():
            self._action = None
        self._set_goal(goal, to_end=True)
        # The next call comes in a while: until then the setpoints move evenly, not in jumps.
        self._pace = (np.full(len(goal), np.inf) if self._action is None else
                      np.abs(goal - self._actuators.setpoints(data)) / period_s)

    def _formatted_goal(self) -> FloatArray | None:
        assert self._action is not None
        command = self._formatter.format(self._action)
        low, high = self._actuators.ranges.T
        return None if command is None else low + (command + 1.0) / 2.0 * (high - low)

    def _turns_back(self, goal: FloatArray, data: Any) -> bool:
        """Tell whether a goal goes back to a finger, but not yet past it."""
        place = self._actuators.place(data)
        ahead, still_ahead = self._goal - place, goal - place
        back = (ahead * still_ahead > 0.0) & (np.abs(still_ahead) < np.abs(ahead))
        return bool((back & self._actuators.is_servo).any())

    def _normalised(self, setpoints: FloatArray) -> FloatArray:
        low, high = self._actuators.ranges.T
        commands: FloatArray = (setpoints - low) / (high - low) * 2.0 - 1.0
        return commands
