# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Control a gripper: approach the goals of actions and joint commands as fast as allowed."""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.checked_gripper_actions import Formatter
from manip_sim.control.commands import (
    Command, CommandHandle, GripperAction, GripperGrasp, GripperSetpoint, GripperSuction, Status)
from manip_sim.control.gripper_actuators import GripperActuators
from manip_sim.control.gripper_force import ForceLimit
from manip_sim.control.gripper_joints import GripperJoints
from manip_sim.control.law.finger_records import Grip, Gripper, MOVES, TURNED
from manip_sim.control.ledger import Ledger
from manip_sim.control.suction import SuctionCups
from manip_sim.derived import Derived
from manip_sim.physics.parts import Part
from manip_sim.physics.physics import Physics

#: Rate at which robosuite calls a gripper's ``format_action`` [Hz].
GRIPPER_RATE_HZ = 20.0
#: Two setpoints that differ by less than this fraction of the range are the same.
_SAME = 1e-9


class GripperController:
    """
    A controller that calls a gripper's ``format_action`` at robosuite's 20 Hz of simulation time.

    An action lasts until the next one, so one message closes fully, and how often it is repeated
    does not matter. Actions and joint commands set goals; the setpoints approach them no faster
    than the fingers may move. If an action or a grasp leads to an end of the range and a finger is
    stopped before it, the setpoint goes on until the actuator exerts its full force. Two fingers
    with a drive each that press against each other stay equally open: the force of the one that
    is pushed in falls below the full force.

    :param physics: of the world, whose position servos have a setpoint activation
    :param part: the gripper
    :param timestep_s: of the physics [s]
    :ivar joints: those that take position commands
    :ivar cups: the suction cups
    :ivar commands: the command that has not ended, and who took the actuators last
    :raises ModelError: if an actuator or ``format_action`` cannot be used
    """

    def __init__(self, physics: Physics, part: Part, timestep_s: float) -> None:
        if part.gripper is None:
            raise ValueError(f'{part.name} is not a gripper')
        self.part, self._derived = part, Derived()
        self._physics = physics
        self._timestep_s = timestep_s
        self._actuators = GripperActuators(physics, part)
        self._force = ForceLimit(physics, self._actuators)
        self.cups = SuctionCups(physics, part.actuators, part.gripper.cups)
        self._formatter = Formatter(part.gripper, len(part.actuators))
        self.joints = GripperJoints(physics, part.name, self._actuators)
        self._tolerance = _SAME * np.ptp(self._actuators.ranges, axis=1)
        self.commands = Ledger(len(part.actuators))
        self._forget()

    def _forget(self) -> None:
        count = len(self.part.actuators)
        self._action: FloatArray | None = None
        self._next_call_s = 0.0
        # Whether the state of ``format_action`` matches the goal.
        self._in_step = False
        self._goal = np.zeros(count)
        # Which servos were sent to an end of their range, and stopped before it.
        self._to_end = np.zeros((count, 2), dtype=bool)
        self._pressing = np.zeros(count, dtype=bool)
        self._pace = np.full(count, np.inf)
        self._turned = False
        self._moving = False

    @property
    def faults(self) -> int:
        """How many calls of the gripper's ``format_action`` or ``start_at`` failed."""
        return self._formatter.faults

    @property
    def last_fault(self) -> str:
        """What the last of these calls did; empty if there was none."""
        return self._formatter.last_fault

    @property
    def moving(self) -> bool:
        """Whether :meth:`tick` has to be called; if not, the setpoints stay where they are."""
        return self._moving or self._centres or self.cups.draw(self._goal)

    @property
    def _centres(self) -> bool:
        """True if two fingers press against each other, and are kept equally open."""
        return self._actuators.is_pair and bool(self._pressing.all())

    @property
    def dof(self) -> int:
        """Length of an action."""
        return self._formatter.dof

    @property
    def indices(self) -> IntArray:
        """All indices of the gripper's actuators."""
        return np.arange(len(self.part.actuators))

    def reset(self, data: mujoco.MjData) -> None:
        """Abort all commands and hold the fingers where they are."""
        reason = 'the simulation was reset'
        self.commands.end(Status.ABORTED, reason)
        self.commands.release(self.indices, Status.ABORTED, reason)
        self._force.set(0.0)
        self._forget()
        mujoco.mj_fwdPosition(self._physics.model, data)
        self._goal = np.clip(self._actuators.place(data), *self._actuators.ranges.T)
        self._actuators.hold(data, self._goal)
        self._in_step = self._formatter.start_at(self._normalised(self._goal))

    def apply(self, command: Command, data: mujoco.MjData) -> None:
        """Apply a command; it takes effect with the next :meth:`tick`."""
        self.commands.end(Status.REPLACED)  # Also one of a gripper without actuators.
        self.commands.take(command, self.indices)
        self.commands.running.append(command)
        command.handle.status = Status.RUNNING
        self._force.set(command.max_effort if isinstance(command, GripperGrasp) else 0.0)
        if isinstance(command, GripperAction):
            if not self._in_step:
                # A joint command may still be under way.
                self._goal = np.clip(self._actuators.setpoints(data), *self._actuators.ranges.T)
                self._in_step = self._formatter.start_at(self._normalised(self._goal))
            self._action = command.action
        elif isinstance(command, GripperSetpoint):
            self._action, self._in_step = None, False
            positions = self.joints.with_followers(dict(zip(command.joints, command.values)))
            goal = self._actuators.rest(self._actuators.lengths_at(data, positions))
            grasp = command if isinstance(command, GripperGrasp) else None
            if grasp is not None:
                goal = self._together(goal)
            self._set_goal(np.where(np.isnan(goal), self._goal, goal), to_end=grasp is not None)
            self._pace[:] = self._pace_of(grasp, data)
        elif isinstance(command, GripperSuction):
            self._action, self._in_step = None, False
            goal = self._goal.copy()
            goal[self.cups.indices] = command.controls
            self._set_goal(goal, to_end=False)
            self._pace[:] = np.inf
        self._moving = True

    def _together(self, goal: FloatArray) -> FloatArray:
        """Close servos without a goal (NaN) by the same fraction as the first one that has one."""
        low, high = self._actuators.ranges.T
        closing = self._formatter.closing
        first = int(np.flatnonzero(~np.isnan(goal))[0])
        part = (goal[first] - low[first]) / (high[first] - low[first])
        # For a servo that closes in the other direction, the remaining fraction counts.
        part = np.where(closing == closing[first], part, 1.0 - part)
        follows = np.isnan(goal) & self._actuators.is_servo & (closing != 0.0)
        return np.where(follows & (closing[first] != 0.0), low + part * (high - low), goal)

    def _pace_of(self, grasp: GripperGrasp | None, data: mujoco.MjData) -> FloatArray:
        """Return how fast setpoints may move so that the joint keeps to a grasp's velocity."""
        if grasp is None or not grasp.max_velocity:
            return np.full(len(self._goal), np.inf)
        present = float(data.joint(grasp.joints[0]).qpos[0])
        duration_s = abs(float(grasp.values[0]) - present) / grasp.max_velocity
        return np.asarray(np.abs(self._goal - self._actuators.setpoints(data))
                          / max(duration_s, self._timestep_s))

    def withdraw(self, handle: CommandHandle, data: mujoco.MjData, reason: str) -> None:
        """
        Abort a command; if it was the last one, all fingers stop, unless one of them presses.

        :param handle: of the command
        :param reason: why, for the handle
        """
        withdrawn = self.commands.withdraw(handle, reason)
        if withdrawn.size and self._moving and not self._pressing.any():
            self._action, self._in_step = None, False
            self._set_goal(self._actuators.setpoints(data), to_end=False)

    def _set_goal(self, goal: FloatArray, to_end: bool) -> None:
        low, high = self._actuators.ranges.T
        self._goal[:] = np.clip(goal, low, high)
        ends = np.stack([self._goal - low, high - self._goal], axis=1) <= self._tolerance[:, None]
        ends &= to_end & (self._actuators.overtravel > 0.0)
        self._pressing &= (self._to_end & ends).any(axis=1)
        self._to_end[:] = ends
        self._turned = True

    def tick(self, data: mujoco.MjData, duration_s: float) -> None:
        """
        Write the controls of the physics steps that follow.

        :param duration_s: of these steps [s]
        """
        from manip_sim.control.law.gripping import move_fingers  # It imports numba.
        gripper = self.begin_run(data)
        move_fingers(self._physics.arrays, gripper, duration_s)
        self.end_run(gripper)

    def begin_run(self, data: mujoco.MjData) -> Gripper:
        """Call ``format_action`` if it is due, and return the gripper for the compiled law."""
        self._call_if_due(data)
        goal, stopped, flags = self._room
        goal[:], sucks = self._goal, self.cups.draw(self._goal)
        if sucks:
            self.cups.lead(goal, self._actuators.ranges[:, 0], data)
        flags[:] = (self._moving or sucks, self._turned, self._action is not None,
                    self._actuators.is_pair)
        return self._derived.made_of(
            _gripper, self._actuators.fingers(self._tolerance), goal, self._to_end,
            self._pressing, self._pace, stopped, flags)

    @property
    def _room(self) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
        """Room for the goals of an interval, and for what the compiled law says of the fingers."""
        room: tuple[FloatArray, FloatArray, NDArray[np.bool_]] | None = (
            self._derived.of.get('room'))
        if room is None:
            count = len(self.part.actuators)
            room = self._derived.of['room'] = (
                np.zeros(count), np.zeros(count), np.zeros(4, np.bool_))
        return room

    def end_run(self, gripper: Gripper) -> None:
        """Take over what the compiled law has changed; end commands once all fingers stand."""
        moved, self._moving, self._turned = (
            self._moving, bool(gripper.grip.flags[MOVES]), bool(gripper.grip.flags[TURNED]))
        if moved and not self._moving:
            for command in list(self.commands.running):
                self.commands.finish(command, self._goal - gripper.grip.stopped)

    def until_call(self, data: mujoco.MjData) -> int | None:
        """Return after how many physics steps ``format_action`` is due again, or None."""
        if self._action is None:
            return None
        left_s = self._next_call_s - self._timestep_s / 2.0 - data.time
        return max(1, math.ceil(float(left_s) / self._timestep_s - 1e-6))

    def _call_if_due(self, data: mujoco.MjData) -> None:
        """Call the gripper's ``format_action`` if it is due."""
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
        # Until the next call the setpoints move evenly, not in jumps.
        self._pace[:] = (np.inf if self._action is None else
                         np.abs(goal - self._actuators.setpoints(data)) / period_s)

    def _formatted_goal(self) -> FloatArray | None:
        assert self._action is not None
        command = self._formatter.format(self._action)
        low, high = self._actuators.ranges.T
        return None if command is None else low + (command + 1.0) / 2.0 * (high - low)

    def _turns_back(self, goal: FloatArray, data: mujoco.MjData) -> bool:
        """Return whether a goal moves back towards a finger, but not past it."""
        place = self._actuators.place(data)
        ahead, still_ahead = self._goal - place, goal - place
        back = (ahead * still_ahead > 0.0) & (np.abs(still_ahead) < np.abs(ahead))
        return bool((back & self._actuators.is_servo).any())

    def _normalised(self, setpoints: FloatArray) -> FloatArray:
        low, high = self._actuators.ranges.T
        commands: FloatArray = (setpoints - low) / (high - low) * 2.0 - 1.0
        return commands


def _gripper(fingers: Any, *grip: Any) -> Gripper:
    return Gripper(fingers, Grip(*grip))
