# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Turn goals of named joints, such as a ``sensor_msgs/JointState`` has, into commands."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.control.commands import (
    Command, GripperSetpoint, JointImpedance, JointSetpoint, NoCommand)
from manip_sim.control.gripper_actuators import GripperJoints
from manip_sim.control.joint_controller import JointController
from manip_sim.control.modes import FIELDS, IMPEDANCE, MODES, POSITION
from manip_sim.errors import CommandError, describe_choices
from manip_sim.models.robots import RobotModel
from manip_sim.quoting import format_value, pluralize, quoted
from manip_sim.validation import clamp, clamped_example, command_numbers

#: Number of lists of names whose meaning is cached; a client has a few.
_REMEMBERED = 64


@dataclass(frozen=True)
class _Group:
    """
    The named joints that one controller moves.

    :ivar places: indices of the joints among the names, shape (n,)
    :ivar names: of the joints
    :ivar clamps: ranges of their goals, shape (n, 2)
    :ivar indices: for the command
    :ivar modes: names of their control modes; None for joints of a gripper
    """

    parts: frozenset[str]
    places: IntArray
    names: tuple[str, ...]
    clamps: FloatArray
    indices: IntArray
    modes: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        # Many commands share these arrays.
        for shared in (self.places, self.clamps, self.indices):
            shared.setflags(write=False)


@dataclass(frozen=True)
class _Addressed:
    """
    Properties shared by commands for the same joints while the control modes stay.

    :ivar modes: names of the control mode of each joint
    :ivar all_use: the field that all joints use, or None
    :ivar uses: by field, whether each joint uses it
    :ivar takers: by field, the places of the joints that need a number there
    :ivar groups: the joints outside grippers, then the joints of each gripper
    """

    names: tuple[str, ...]
    modes: tuple[str, ...]
    all_use: str | None
    uses: dict[str, BoolArray]
    takers: dict[str, list[int]]
    groups: tuple[_Group, ...]

    @property
    def parts(self) -> frozenset[str]:
        """The parts of all joints."""
        return frozenset().union(*(group.parts for group in self.groups))


class JointCommandParser:
    """
    A parser of goals for named joints.

    :param robot: for which the commands are
    :param joints: controller of the joints of arms, base, torso, head and legs; only read
    :param grippers: the joints of the grippers, by part; only read
    """

    def __init__(self, robot: RobotModel, joints: JointController,
                 grippers: Mapping[str, GripperJoints]) -> None:
        self._robot = robot
        self._joints = joints
        self._fingers = grippers
        self._gripper_of = {joint: gripper for gripper in grippers.values()
                            for joint in gripper.names}
        self._addressed = lru_cache(_REMEMBERED)(self._address)

    def joint_command(self, names: Sequence[str], position: ArrayLike = (),
                      velocity: ArrayLike = (), effort: ArrayLike = (), part: str | None = None
                      ) -> list[Command]:
        """
        Return the commands for goals of some joints; one invalid goal rejects them all.

        Each joint uses the field of its control mode; NaN means no command for the joint. A field
        may also have numbers only for the joints whose mode uses it, in the order of their names;
        finger joints at the end, or coupled to one named before them, need none. Parts that are
        named without any number get a ``NoCommand``.

        :param names: of the joints
        :param position: goals of the joints in position mode [rad or m]
        :param velocity: goals of the joints in velocity mode [rad/s or m/s]
        :param effort: goals of the joints in effort mode [N m or N]
        :param part: whose joints may be named; None for all
        :raises CommandError: if a joint is unknown or named twice, or the numbers do not match
        """
        label = part or 'joint_command'
        names = as_names(names, label)
        columns: dict[str, FloatArray] = {}
        for field, column in zip(FIELDS, (position, velocity, effort)):
            if not (isinstance(column, (tuple, array)) and not column):
                columns[field] = command_numbers(column, f'{label}: {field}')
        if not len(names) and all(np.isnan(numbers).all() for numbers in columns.values()):
            return []
        modes = self._joints.modes  # They may change while this thread reads the command.
        addressed = self._addressed(part, names, modes)
        if len(columns) == 1:  # As most commands are: a number for each joint, all in one field.
            (field, numbers), = columns.items()
            if numbers.shape == (len(names),) and addressed.all_use == field and (
                    np.isfinite(numbers).all()):
                return _commands(self._robot, addressed, numbers)
        values = np.full(len(names), np.nan)
        for field, numbers in columns.items():
            if not numbers.size:
                continue
            placed = self._placed(label, field, numbers, addressed)
            uses = addressed.uses[field]
            surplus = ~(uses | np.isnan(placed))
            if np.count_nonzero(surplus):
                place = np.flatnonzero(surplus)[0]
                raise CommandError(
                    f"{label}: joint '{names[place]}' is in {addressed.modes[place]} mode, which "
                    f'does not use the field {field}: leave it empty, or NaN for this joint')
            values[uses] = placed[uses]
        missing = np.isnan(values)
        if not np.count_nonzero(missing):
            return _commands(self._robot, addressed, values)
        commands, silent = [], addressed.parts
        if not missing.all():
            named = tuple(name for name, gone in zip(names, missing) if not gone)
            commands = _commands(
                self._robot, self._addressed(part, named, modes), values[~missing])
            silent = silent.difference(*(command.parts for command in commands))
        if silent:
            commands.append(NoCommand(
                robot=self._robot, parts=silent, indices=np.empty(0, dtype=np.int64)))
        return commands

    def joint_impedance(self, names: Sequence[str], position: ArrayLike = (),
                        velocity: ArrayLike | None = None, effort: ArrayLike | None = None,
                        stiffness: ArrayLike | None = None, damping: ArrayLike | None = None,
                        part: str | None = None) -> list[Command]:
        """
        Return the command for joints in impedance mode.

        A servo exerts ``stiffness * (position - measured) + damping * (velocity - measured) +
        effort`` and what the motion of its setpoint needs, which goes to the position within the
        limits of the joint. None, nothing or NaN leaves a number as it was: at first the model's
        gains, no effort, and the velocity of the setpoint.

        :param names: of the joints, n of them
        :param position: goals [rad or m], shape (n,)
        :param velocity: with respect to which the servos damp [rad/s or m/s], shape (n,)
        :param effort: to be added, until another one or another mode [N m or N], shape (n,)
        :param stiffness: [N m/rad or N/m], a number or shape (n,)
        :param damping: [N m s/rad or N s/m], a number or shape (n,)
        :param part: whose joints may be named; None for all
        :raises CommandError: if a joint is unknown, named twice or in another mode, or the numbers
            do not match, are infinite, or are not positive gains
        """
        label = part or 'joint_impedance'
        names, joints = as_names(names, label), self._joints
        check_names(names, [joints.names[i] for i in (
            range(len(joints.names)) if part is None else joints.indices_of(part))], label)
        modes, indices = joints.modes, joints.find(names)
        for name, index in zip(names, indices.tolist()):
            if modes[index] != IMPEDANCE.name:
                raise CommandError(f"{label}: joint '{name}' is in {modes[index]} mode, not in "
                                   f'{IMPEDANCE.name} mode')
        columns = {field: _column(label, field, values, len(names)) for field, values in (
            ('position', position), ('velocity', velocity), ('effort', effort),
            ('stiffness', stiffness), ('damping', damping))}
        for field in ('stiffness', 'damping'):
            low = columns[field] <= 0.0
            if low.any():
                place = int(np.argmax(low))
                raise CommandError(
                    f"{label}: {field} of joint '{names[place]}' must be greater than 0, got "
                    f'{columns[field][place]:g}')
        inside, clamped, example = dict(columns), 0, ''
        for field, ranges in (('position', joints.clamps(indices, modes)),
                              ('velocity', joints.ranges_of('velocity', indices)),
                              ('effort', joints.ranges_of('effort', indices))):
            inside[field] = np.clip(columns[field], ranges[:, 0], ranges[:, 1])  # NaN stays.
            before, after = np.nan_to_num(columns[field]), np.nan_to_num(inside[field])
            if (before != after).any():
                clamped += int(np.count_nonzero(before != after))
                example = example or f'{field} of {clamped_example(names, before, after)}'
        return [JointImpedance(
            robot=self._robot, parts=joints.parts_of(indices), indices=indices, clamped=clamped,
            clamped_example=example, modes=(IMPEDANCE.name,) * len(names),
            values=inside.pop('position'), pulls=np.array([*inside.values()]))]

    def _placed(self, what: str, field: str, given: FloatArray, addressed: _Addressed
                ) -> FloatArray:
        """Return the numbers of a field by joint, NaN where there is none."""
        count = len(addressed.names)
        if np.count_nonzero(np.isinf(given)):
            infinite = np.flatnonzero(np.isinf(given))[0]
            raise CommandError(f'{what}: {field} must be finite, got {given.flat[infinite]} at '
                               f'index {infinite}')
        if given.shape == (count,):
            return given
        placed = np.full(count, np.nan)
        if np.isnan(given).all():
            return placed
        takers = addressed.takers[field]
        observed = [i for i in takers[given.size:] if addressed.names[i] not in self._gripper_of]
        if given.ndim != 1 or given.size > len(takers) or observed:
            raise CommandError(f'{what}: {field} must have {pluralize(count, "number")}, '
                               f'got {given.size}: one for each joint')
        placed[takers[:given.size]] = given
        return placed

    def _address(self, part: str | None, names: tuple[str, ...], modes: tuple[str, ...]
                 ) -> _Addressed:
        """Return the meaning of the names while all joints are in these modes."""
        for gripper in self._fingers.values():
            gripper.check_take_positions(names)
        check_names(names, self._available(part), part or 'joint_command')
        mode_of = dict(zip(self._joints.names, modes))
        meant = tuple(
            POSITION.name if name in self._gripper_of else mode_of[name] for name in names)
        used = [MODES[mode].field for mode in meant]
        return _Addressed(
            names, meant, used[0] if len(set(used)) == 1 else None,
            {field: np.array([use == field for use in used]) for field in FIELDS},
            {field: self._takers(field, names, used) for field in FIELDS},
            (*self._own(names, meant, modes), *self._of_grippers(names)))

    def _available(self, part: str | None) -> list[str]:
        if part is None:
            return [*self._joints.names, *self._gripper_of]
        if part in self._fingers:
            return list(self._fingers[part].names)
        return [self._joints.names[i] for i in self._joints.indices_of(part)]

    def _takers(self, field: str, names: Sequence[str], used: Sequence[str]) -> list[int]:
        followed: set[str] = set()
        takers = []
        for index, (name, use) in enumerate(zip(names, used)):
            if use != field or name in followed:
                continue
            takers.append(index)
            if name in self._gripper_of:
                followed.update(self._gripper_of[name].followers(name))
        return takers

    def _own(self, names: Sequence[str], meant: Sequence[str], modes: Sequence[str]
             ) -> Iterable[_Group]:
        places = [i for i, name in enumerate(names) if name not in self._gripper_of]
        if places:
            joint_names = tuple(names[i] for i in places)
            indices = self._joints.find(joint_names)
            yield _Group(self._joints.parts_of(indices), np.array(places), joint_names,
                         self._joints.clamps(indices, modes), indices,
                         tuple(meant[i] for i in places))

    def _of_grippers(self, names: Sequence[str]) -> Iterable[_Group]:
        for part, gripper in self._fingers.items():
            places = [i for i, name in enumerate(names) if self._gripper_of.get(name) is gripper]
            if places:
                fingers = tuple(names[i] for i in places)
                yield _Group(frozenset([part]), np.array(places), fingers,
                             gripper.ranges(fingers), gripper.actuators_of(fingers))


def _column(what: str, field: str, values: ArrayLike | None, count: int) -> FloatArray:
    """Return a number for each joint, NaN where there is none."""
    numbers = np.array([]) if values is None else command_numbers(values, f'{what}: {field}')
    if not numbers.size:
        return np.full(count, np.nan)
    if np.isinf(numbers).any():
        raise CommandError(f'{what}: {field} must be finite, got {numbers[np.isinf(numbers)][0]}')
    if numbers.ndim == 0 and field in ('stiffness', 'damping'):
        return np.full(count, float(numbers))
    if numbers.shape != (count,):
        raise CommandError(f'{what}: {field} must have {pluralize(count, "number")}, one for each '
                           f'joint, got the shape {numbers.shape}')
    return np.array(numbers, dtype=float)


def as_names(names: Sequence[str], what: str) -> tuple[str, ...]:
    """
    Return the names of joints as a tuple.

    :param what: noun for their receiver, for the message
    :raises CommandError: if they are not a sequence of texts
    """
    try:
        texts = tuple(names)
        ''.join(texts)  # It takes nothing but texts.
        if not isinstance(names, str):
            return texts
    except TypeError:
        pass
    raise CommandError(f'{what}: names of joints must be a sequence of texts, '
                       f'got {format_value(names)}')


def check_names(names: Sequence[str], available: Sequence[str], what: str) -> None:
    """
    Check the names of joints.

    :param available: the joints that can be commanded
    :param what: what takes them, for the message
    :raises CommandError: if there are none, one is unknown, or one comes twice
    """
    if not len(names):
        raise CommandError(f'{what}: no joint is named')
    known = set(available)
    for name in names:
        if name not in known:
            raise CommandError(f'{what} has no joint {quoted(name)} that can be commanded: '
                               f'{describe_choices(name, available)}')
    if len(set(names)) != len(names):
        twice = next(name for name in names if list(names).count(name) > 1)
        raise CommandError(f"{what}: joint '{twice}' is named twice")


def _commands(robot: RobotModel, addressed: _Addressed, values: FloatArray) -> list[Command]:
    """Return the commands for the goals of all joints that are addressed."""
    commands: list[Command] = []
    for group in addressed.groups:
        goals = values[group.places]
        inside, clamped = clamp(goals, group.clamps)
        common: dict[str, Any] = {
            'robot': robot, 'parts': group.parts, 'indices': group.indices, 'values': inside,
            'clamped': clamped,
            'clamped_example': clamped_example(group.names, goals, inside) if clamped else ''}
        commands.append(GripperSetpoint(joints=group.names, **common) if group.modes is None
                        else JointSetpoint(modes=group.modes, **common))
    return commands
