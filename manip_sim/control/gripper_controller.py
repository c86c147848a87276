# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Control a gripper: approach the goals of actions and joint commands as fast as allowed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import contextlib
import math
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.commands import (
    Command, CommandHandle, GripperAction, GripperGrasp, GripperSetpoint, GripperSuction, Ledger,
    Status)
from manip_sim.control.gripper_actuators import ForceLimit, GripperActuators, GripperJoints
from manip_sim.control.law.records import (
    AWAITED, FINGERS_MOVE, Grip, Gripper, GRIPPER_RATE_HZ, no_rule, RENEWED, Rule, RULED, TAKES,
    TURNED)
from manip_sim.derived import Derived
from manip_sim.errors import ModelError
from manip_sim.models.grippers import ActionRule, GripperModel
from manip_sim.physics.parts import Part
from manip_sim.physics.physics import Physics

#: Methods whose meaning a rule stands for.
_OF_ACTIONS = {'format_action', 'start_at'}
#: Two setpoints that differ by less than this fraction of the range are the same.
_SAME = 1e-9


class SuctionCups:
    """
    The suction cups of a gripper; their vacuum is the activation of their actuators.

    The vacuum is lost as soon as a part of the lip touches nothing. Dex-Net 3.0 (Mahler et al.
    2018) too models a cup by eight points of its lip, all of which have to touch: a pump of some
    litres a minute cannot keep a vacuum against a gap.

    :param physics: of the world
    :param actuators: names of all actuators of the gripper
    :param cups: names of those that pull what a cup touches, each of a body whose shapes are a lip
    :ivar indices: of the cups among the actuators, shape (n,)
    """

    def __init__(self, physics: Physics, actuators: Sequence[str], cups: Sequence[str]) -> None:
        self._physics, self.names = physics, tuple(cups)
        self.indices: IntArray = np.array([actuators.index(cup) for cup in cups], dtype=np.int64)
        physics.on_change(self._find)

    def _find(self) -> None:
        model = self._physics.model
        ids = [int(model.actuator(name).id) for name in self.names]
        self._actuators: IntArray = np.array(ids, dtype=np.int64)
        self._activations: IntArray = model.actuator_actadr[ids].astype(np.int64)
        collides = (model.geom_contype | model.geom_conaffinity) != 0
        self._lips = [np.flatnonzero((model.geom_bodyid == body) & collides)
                      for body in model.actuator_trnid[ids, 0]]

    def draw(self, controls: FloatArray) -> bool:
        """
        Return whether a cup is to hold something.

        :param controls: of all actuators of the gripper
        """
        return bool((controls[self.indices] > 0.0).any())

    def held(self, data: mujoco.MjData) -> list[int]:
        """Return the id of the body that the whole lip of each cup touches, -1 where it leaks."""
        pairs = data.contact.geom
        return [self._held(pairs, lip) for lip in self._lips]

    def _held(self, pairs: IntArray, lip: IntArray) -> int:
        on_lip = np.isin(pairs, lip)
        touching = on_lip.any(axis=1) & (pairs >= 0).all(axis=1)
        points, others = pairs[touching][on_lip[touching]], pairs[touching][~on_lip[touching]]
        bodies = self._physics.model.geom_bodyid[others]
        return next((int(body) for body in np.unique(bodies)
                     if len(np.unique(points[bodies == body])) == len(lip)), -1)

    def vacuum(self, data: mujoco.MjData) -> FloatArray:
        """Return the vacuum in the cups, in the unit of their controls, shape (n,), a copy."""
        return np.array(data.act[self._activations])

    @property
    def full(self) -> FloatArray:
        """The full vacuum, in the unit of the controls, shape (n,), a copy."""
        return np.array(self._physics.model.actuator_ctrlrange[self._actuators, 1])

    def forces(self, data: mujoco.MjData) -> FloatArray:
        """Return the forces with which the cups pull [N], shape (n,), a copy."""
        return np.array(data.actuator_force[self._actuators])

    def controls(self, fraction: float, most_force: float) -> FloatArray:
        """
        Return the controls for a fraction of the full vacuum, shape (n,).

        :param fraction: in [0, 1]; 0 lets air in
        :param most_force: of each cup [N]; 0 for no other limit
        """
        model, control = self._physics.model, fraction * self.full
        if most_force:
            control = np.minimum(control, most_force / model.actuator_gainprm[self._actuators, 0])
        return np.where(control > 0.0, control, model.actuator_ctrlrange[self._actuators, 0])

    def lead(self, controls: FloatArray, lowest: FloatArray, data: mujoco.MjData) -> None:
        """
        Let air into the cups that leak: their vacuum is gone, and does not build up.

        :param controls: of all actuators of the gripper, changed in place
        :param lowest: of these controls
        """
        leaks = np.array(self.held(data)) < 0
        data.act[self._activations[leaks]] = 0.0
        controls[self.indices[leaks]] = lowest[self.indices[leaks]]


class Formatter:
    """
    The ``format_action`` of a gripper, which may be a user's code, with its results checked.

    :param gripper: its method is called once with zeros, and its state restored
    :param count: how many commands the method has to return
    :ivar faults: how many later calls raised or returned something else
    :ivar last_fault: what the last of these did
    :raises ModelError: if the call with zeros raises or does not return ``count`` finite numbers
    """

    #: Only counted and told.
    remembered = ('faults', 'last_fault')
    undigested = remembered

    def __init__(self, gripper: GripperModel, count: int) -> None:
        self._gripper = gripper
        self._count = count
        self.dof = gripper.dof
        self.faults = 0
        self.last_fault = ''
        self._closing: FloatArray | None = None
        with self._state_kept():
            fault = self._fault(np.zeros(self.dof))[1]
        if fault is not None:
            raise ModelError(f'format_action of {type(gripper).__name__} must return {count} '
                             f'finite numbers, one for each actuator, but with an action of '
                             f'{self.dof} zeros {fault}')

    @contextlib.contextmanager
    def _state_kept(self) -> Iterator[None]:
        gripper = self._gripper
        state = gripper.state_copy()
        try:
            yield
        finally:
            vars(gripper).clear()
            vars(gripper).update(state)

    @property
    def closing(self) -> FloatArray:
        """
        Signs of how commands change with actions of ones, zero where they do not, shape (count,).

        On first use, ``format_action`` is called with ones and minus ones, and its state restored.
        """
        if self._closing is None:
            commands = []
            with self._state_kept():
                for sign in (1.0, -1.0):
                    self.start_at(np.zeros(self._count))
                    commands.append(self._fault(np.full(self.dof, sign))[0])
            self._closing = np.sign(commands[0] - commands[1])
        return self._closing

    def format(self, action: FloatArray) -> FloatArray | None:
        """
        Return commands in [-1, 1], shape (count,), or None after a fault, which is counted.

        :param action: in [-1, 1], shape (dof,)
        """
        command, fault = self._fault(action)
        if fault is not None:
            self._take_note(f'format_action: {fault}')
            return None
        return np.minimum(np.maximum(command, -1.0), 1.0)  # np.clip takes thrice as long.

    def start_at(self, command: FloatArray) -> bool:
        """Let ``format_action`` continue from a command; return whether that worked."""
        try:
            self._gripper.start_at(command)
        except Exception as error:
            self._take_note(f'start_at: it raised {type(error).__name__}: {error}')
            return False
        return True

    def _take_note(self, fault: str) -> None:
        self.faults += 1
        self.last_fault = fault

    def _fault(self, action: FloatArray) -> tuple[FloatArray, str | None]:
        """Return the commands of an action, and their fault or None."""
        nothing: Any = np.zeros(self._count)
        try:
            command = np.asarray(self._gripper.format_action(action.copy()), dtype=float)
        except Exception as error:
            return nothing, f'it raised {type(error).__name__}: {error}'
        if command.shape != (self._count,):
            return nothing, f'it returned the shape {command.shape}'
        if not np.isfinite(command).all():
            return nothing, f'it returned {command.tolist()}'
        return command, None


class GripperController:
    """
    A controller that calls a gripper's ``format_action`` at robosuite's 20 Hz of simulation time.

    The law follows the rule of its actions instead, if the gripper has one.

    An action lasts until the next one, so one message closes fully, and how often it is repeated
    does not matter. Actions and joint commands set goals; the setpoints approach them no faster
    than the fingers may move. If an action or a grasp leads to an end of the range and a finger is
    stopped before it, the setpoint goes on until the actuator exerts its full force. Two fingers
    with a drive each that press against each other stay equally open: the force of the one that
    is pushed in falls below the full force.

    Times ``now_s`` are simulation time since the last reset [s].

    :param physics: of the world, whose position servos have a setpoint activation
    :param part: the gripper
    :param timestep_s: of the physics [s]
    :ivar joints: those that take position commands
    :ivar cups: the suction cups
    :ivar commands: the command that has not ended, and who took the actuators last
    :raises ModelError: if an actuator or ``format_action`` cannot be used
    """

    remembered = ('_action', '_call', '_in_step', '_goal', '_to_end', '_pressing', '_pace',
                  '_turned', '_moving')

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
        # When it is taken next, and half a step.
        self._call = np.array([0.0, self._timestep_s / 2.0])
        # True while the state of ``format_action`` matches the goal.
        self._in_step = False
        self._goal = np.zeros(count)
        # Servos that were sent to an end of their range, and stopped before it.
        self._to_end = np.zeros((count, 2), dtype=bool)
        self._pressing = np.zeros(count, dtype=bool)
        self._pace = np.full(count, np.inf)
        self._turned = False
        self._moving = False

    @property
    def faults(self) -> int:
        """Number of calls of the gripper's ``format_action`` or ``start_at`` that failed."""
        return self._formatter.faults

    @property
    def last_fault(self) -> str:
        """Description of the last of these calls; empty if there was none."""
        return self._formatter.last_fault

    @property
    def moving(self) -> bool:
        """True if the law has to move fingers; otherwise the setpoints stay where they are."""
        self._physics.interrupt()
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
        """Apply a command; it takes effect in the next interval."""
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
        """Abort a command; if it was the last one, fingers stop, unless one of them presses."""
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

    def begin_run(self, data: mujoco.MjData, now_s: float) -> Gripper:
        """Return the gripper for the law; without a rule, call ``format_action`` if due."""
        rule = self._rule
        if rule is no_rule():
            self._call_if_due(data, now_s)
        goal, stopped, flags, action = self._room
        sucks = self.cups.draw(self._goal)
        if sucks:
            goal[:] = self._goal
            self.cups.lead(goal, self._actuators.ranges[:, 0], data)
        else:
            goal = self._goal
        if self._action is not None:
            action[:] = self._action
        flags[:] = (self._moving or sucks, self._turned, self._action is not None,
                    self._actuators.is_pair, rule is not no_rule(), False, False)
        gripper = self._derived.made_of(
            _gripper, self._actuators.fingers(self._tolerance), goal, self._to_end,
            self._pressing, self._pace, stopped, flags, action, self._call, rule)
        self._derived.of['kept'] = self._physics.arrays, gripper
        return gripper

    @property
    def kept(self) -> Gripper | None:
        """The gripper for the law, as it was last, if its fingers may move again like that."""
        arrays, gripper = self._derived.of.get('kept', (None, None))
        if gripper is None or arrays is not self._physics.arrays:
            return None
        # Those of a restored state, and after a reset, are others.
        grip: Grip = gripper.grip
        same = grip.goal is self._goal and grip.rule is self._rule and grip.flags[RULED]
        return gripper if same else None

    @property
    def _rule(self) -> Rule:
        """The rule that the law follows, or that without commands where Python takes actions."""
        gripper, made = self.part.gripper, self._derived.of
        assert gripper is not None
        if self.cups.names or not _OF_ACTIONS.isdisjoint(vars(gripper)):
            return no_rule()
        if 'rule' not in made:
            rule = made['rule'] = gripper.action_rule
            made['commands'] = np.zeros(0 if rule is None else len(rule.numbers))
        rule, commands = made['rule'], made['commands']
        if rule is None or not len(commands):
            return no_rule()
        if len(rule.steps):
            if gripper.current_action.shape != rule.steps.shape:
                gripper.current_action = np.resize(gripper.current_action, rule.steps.shape)
            commands = gripper.current_action
        return self._derived.made_of(_with_commands, rule, commands)

    @property
    def _room(self) -> tuple[FloatArray, FloatArray, NDArray[np.bool_], FloatArray]:
        """Room for goals of an interval, what the law says of the fingers, and the action."""
        room: tuple[FloatArray, FloatArray, NDArray[np.bool_], FloatArray] | None = (
            self._derived.of.get('room'))
        if room is None:
            count = len(self.part.actuators)
            room = self._derived.of['room'] = (
                np.zeros(count), np.zeros(count), np.zeros(7, np.bool_), np.zeros(self.dof))
        return room

    def end_run(self, gripper: Gripper) -> None:
        """Take over what the compiled law has changed; end commands once all fingers stand."""
        grip, flags = gripper.grip, gripper.grip.flags
        if not (self._moving or flags[FINGERS_MOVE] or flags[RENEWED]):
            return
        if flags[RENEWED]:
            self._take_renewed(grip)
        moved, self._moving = self._moving, bool(flags[FINGERS_MOVE])
        self._turned = bool(flags[TURNED])
        if not flags[TAKES]:
            self._action = None
        if moved and not self._moving:
            for command in list(self.commands.running):
                self.commands.finish(command, self._goal - grip.stopped)

    @property
    def stands(self) -> bool:
        """True if compiled code can go on with it by itself."""
        return not self.cups.draw(self._goal) and (
            self._action is None or self._rule is not no_rule())

    def stand(self, gripper: Gripper) -> None:
        """Let compiled code go on by itself until a command ends that somebody else may know."""
        renewed = self._derived.of.get('renewed')
        gripper.grip.flags[AWAITED] = any(
            [command is not renewed for command in self.commands.running])

    def renews(self, command: GripperAction) -> bool:
        """
        Return whether compiled code may give an action other numbers while it goes on by itself.

        :param command: that was applied, nobody else has it
        """
        renews = self._rule is not no_rule() and self._in_step and (
            self.commands.current_owner(command) is None)
        if renews:
            self._derived.of['renewed'] = command
        return renews

    def _take_renewed(self, grip: Grip) -> None:
        """Take over an action that compiled code was given, as if it had come just now."""
        command: GripperAction = self._derived.of['renewed']
        grip.flags[RENEWED] = False
        command.action[:] = grip.action
        self._action, self._moving = command.action, True
        if not self.commands.running:
            self.commands.running.append(command)
            command.handle.status, command.handle.error = Status.RUNNING, None

    def until_call(self, now_s: float) -> int | None:
        """Return after how many physics steps ``format_action`` is due again, or None."""
        if self._action is None or self._rule is not no_rule():
            return None
        due_s, half_s = self._call
        return max(1, math.ceil(float(due_s - half_s - now_s) / self._timestep_s - 1e-6))

    def _call_if_due(self, data: mujoco.MjData, now: float) -> None:
        """Call the gripper's ``format_action`` if it is due."""
        period_s, (due_s, half_s) = 1.0 / GRIPPER_RATE_HZ, self._call.tolist()
        if self._action is None or now < due_s - half_s:
            return
        self._call[0] = period_s + (due_s if now - due_s < period_s else now)
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


def _with_commands(rule: ActionRule, commands: FloatArray) -> Rule:
    return Rule(rule.numbers, np.ascontiguousarray(rule.steps), rule.proportional, rule.sources,
                rule.still, commands)
