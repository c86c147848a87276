# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Commands for a robot in many worlds, as arrays with a leading axis of worlds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
import contextlib
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.control.command_parser import CartesianParser
from manip_sim.control.commands import Command, CommandHandle, JointSetpoint
from manip_sim.control.modes import POSITION, VELOCITY
from manip_sim.errors import CommandError, ModelError, UnknownNameError
from manip_sim.physics.physics import EPOCH, STEPS
from manip_sim.quoting import format_value
from manip_sim.simulation import SimulatedRobot
from manip_sim.validation import clamp, command_numbers

#: So many streams of a robot are known at most.
_MOST_STREAMS = 8
_NO_WORLDS = np.zeros(0, np.int64)
#: A robot in a world, and commands for it.
_Parsed = tuple[SimulatedRobot, tuple[Command, ...]]


class GoingOn:
    """
    The worlds that go on with a command, to which compiled code gives other numbers.

    :param table: ``Physics.standing`` of each world, shape (count, 5)
    :param timestep_s: length of a physics step [s]
    :ivar robots: address of the row of the robot in each world, or 0, shape (count,)
    """

    def __init__(self, table: IntArray, timestep_s: float) -> None:
        self._timestep_s = timestep_s
        self._steps, self._present_epochs = table[:, STEPS], table[:, EPOCH]
        self.robots, self._epochs = np.zeros((2, len(table)), np.int64)

    def find(self, mask: BoolArray, period_s: float | None, address: Callable[[int], int]
             ) -> IntArray:
        """
        Return the numbers of the worlds that go on with the command.

        :param mask: which may, shape (count,)
        :param period_s: length of a control period that they have to have [s]; None for any
        :param address: returns that of the row of the robot in a world if the command runs, or 0
        """
        stands = mask & (self._steps > 0)
        if period_s is not None:
            stands &= self._steps * self._timestep_s == period_s
        changed = stands & (self._epochs != self._present_epochs)
        if changed.any():
            for world in changed.nonzero()[0].tolist():
                self._epochs[world] = self._present_epochs[world]
                self.robots[world] = address(world)
        return (stands & (self.robots > 0)).nonzero()[0]


class RowByRow:
    """
    Validates the commands of all worlds first, and then applies them.

    :param robots: the robot in each world
    :param table: ``Physics.standing`` of each world, shape (count, 5)
    :param timestep_s: length of a physics step [s]
    """

    def __init__(self, robots: Sequence[SimulatedRobot], table: IntArray, timestep_s: float
                 ) -> None:
        self._robots, self._table, self._timestep_s = robots, table, timestep_s
        #: By part: the last action of each world, which nobody else has, and which go on.
        self._actions: dict[str, tuple[dict[int, Any], GoingOn]] = {}

    def _apply(self, parse: Callable[[SimulatedRobot, int], Iterable[Command]],
               where: ArrayLike | None, period_s: float | None) -> None:
        _send(self._parsed(parse, world_mask(where, len(self._robots))), period_s)

    def _parsed(self, parse: Callable[[SimulatedRobot, int], Iterable[Command]], mask: BoolArray
                ) -> list[_Parsed]:
        made = []
        for world in np.flatnonzero(mask).tolist():
            robot = self._robots[world]
            with naming(world):
                made.append((robot, tuple(parse(robot, world))))
        return made

    def _rows(self, values: ArrayLike, noun: str) -> FloatArray:
        return as_batch(values, len(self._robots), noun)

    def _act(self, part: str, numbers: FloatArray, mask: BoolArray, period_s: float | None,
             parse: Callable[[SimulatedRobot, FloatArray], Command],
             address: Callable[[SimulatedRobot, Any], int],
             renew: Callable[[GoingOn, IntArray, IntArray], None]) -> None:
        """
        Command an action in some worlds; those that go on with one get other numbers.

        :param numbers: of the actions, shape (count, n)
        :param mask: of the worlds, shape (count,)
        :param parse: returns the command of a world, with ``action``
        :param address: as of :meth:`GoingOn.find`, of a robot and its last action
        :param renew: gives the numbers to worlds that go on with actions for some indices
        """
        inside = mask & (np.abs(numbers) <= 1.0).all(axis=1)
        running, going_on = self._actions.setdefault(
            part, ({}, GoingOn(self._table, self._timestep_s)))
        worlds = going_on.find(inside, period_s, lambda world: (
            address(self._robots[world], running[world]) if world in running else 0))
        rest = mask.copy()
        rest[worlds] = False
        # Where nothing has to be clamped or rejected, actions differ in nothing but numbers.
        command: Any = None

        def parsed(robot: SimulatedRobot, world: int) -> list[Command]:
            nonlocal command
            if not inside[world]:
                return [parse(robot, numbers[world])]
            command = command or parse(robot, numbers[world])
            running[world] = replace(command, action=numbers[world], handle=CommandHandle())
            return [running[world]]
        made = self._parsed(parsed, rest)
        if len(worlds):
            renew(going_on, worlds, running[worlds.item(0)].indices)
        _send(made, period_s)


class _Stream(NamedTuple):
    """
    A command that goes on with other numbers.

    :ivar one: the command of a world
    :ivar modes: of all joints of the robot
    :ivar low: lowest numbers, finite, shape (n,)
    :ivar high: highest numbers, finite, shape (n,)
    :ivar velocities: whether they are velocities, not positions
    :ivar going_on: the worlds that go on with it
    """

    one: JointSetpoint
    modes: tuple[str, ...]
    low: FloatArray
    high: FloatArray
    velocities: bool
    going_on: GoingOn


class Commands(RowByRow):
    """
    Commands for joints, grippers and bases, with the method names of ``robot.parse``.

    Each takes ``where``, a mask of the worlds that it is for, and ``period_s``, the length of a
    control period [s], None for that of the last one.

    :param robots: the robot in each world
    :param table: ``Physics.standing`` of each world, shape (count, 5)
    :param timestep_s: length of a physics step [s]
    """

    def __init__(self, robots: Sequence[SimulatedRobot], table: IntArray, timestep_s: float
                 ) -> None:
        super().__init__(robots, table, timestep_s)
        #: By world: the last command that can go on with other numbers; nobody else has it.
        self._streams: dict[int, JointSetpoint] = {}
        #: Streams to which compiled code gives other numbers, by names, field and part.
        self._going_on: dict[tuple[str | None, ...], _Stream] = {}

    def action(self, part: str, action: ArrayLike, *, where: ArrayLike | None = None,
               period_s: float | None = None) -> None:
        """
        Command an abstract action in each world.

        :param part: such as ``arm`` or ``right/gripper``
        :param action: in [-1, 1] for each actuator of the part, or each dof of the gripper, shape
            (count, n)
        :raises CommandError: if a shape is wrong or a number is not finite
        :raises UnknownNameError: if the part is unknown
        """
        numbers = self._rows(action, f'{part}: actions')
        grippers = self._robots[0].grippers
        if not (isinstance(part, str) and part in grippers
                and numbers.shape[1:] == (grippers[part].dof,)):
            self._apply(lambda robot, world: [robot.parse.action(part, numbers[world])], where,
                        period_s)
            return
        from manip_sim.control.law.period import renew_grips  # It imports numba.
        number = [*grippers].index(part)

        def renew(going_on: GoingOn, worlds: IntArray, _: IntArray) -> None:
            renew_grips(going_on.robots, worlds, number, numbers)
        self._act(part, numbers, world_mask(where, len(self._robots)), period_s,
                  lambda robot, action: robot.parse.action(part, action),
                  lambda robot, command: robot.renews_grip(part, command), renew)

    def joint_command(self, names: Sequence[str], position: ArrayLike | None = None,
                      velocity: ArrayLike | None = None, effort: ArrayLike | None = None, *,
                      part: str | None = None, where: ArrayLike | None = None,
                      period_s: float | None = None) -> None:
        """
        Command goals of some joints in each world; NaN means no command for a joint.

        :param names: of the joints
        :param position: goals of the joints in position mode [rad or m], shape (count, n)
        :param velocity: goals of the joints in velocity mode [rad/s or m/s], shape (count, n)
        :param effort: goals of the joints in effort mode [N m or N], shape (count, n)
        :param part: whose joints may be named; None for all
        :raises CommandError: if a joint is unknown or named twice, or the numbers do not match
        """
        columns = self._columns(part or 'joint_command', position=position, velocity=velocity,
                                effort=effort)
        rest = world_mask(where, len(self._robots)).copy()
        alike, worlds, stream, goal = np.zeros_like(rest), _NO_WORLDS, None, None
        if len(columns) == 1:
            (field, values), = columns.items()
            stream = self._stream(names, field, part)
            if stream is not None and values.shape[1:] == stream.low.shape:
                inside = ((values >= stream.low) & (values <= stream.high)).all(axis=1)
                worlds = stream.going_on.find(
                    rest & inside, period_s, partial(self._address, stream))
                rest[worlds] = False
            goal, alike = self._alike(names, field, values, part, rest)
        made = self._parsed(lambda robot, world: robot.parse.joint_command(
            names, part=part, **{field: values[world] for field, values in columns.items()}),
            rest & ~alike)
        if stream is not None:
            self._renew(stream, worlds, values, period_s)
        if goal is not None:
            made += self._begin(goal, values, alike)
        _send(made, period_s)

    def joint_impedance(self, names: Sequence[str], position: ArrayLike | None = None,
                        velocity: ArrayLike | None = None, effort: ArrayLike | None = None,
                        stiffness: ArrayLike | None = None, damping: ArrayLike | None = None, *,
                        part: str | None = None, where: ArrayLike | None = None,
                        period_s: float | None = None) -> None:
        """
        Command joints in impedance mode in each world; NaN leaves a number as it was.

        :param names: of the joints
        :param position: goals [rad or m], shape (count, n)
        :param velocity: with respect to which servos damp [rad/s or m/s], shape (count, n)
        :param effort: to be added [N m or N], shape (count, n)
        :param stiffness: [N m/rad or N/m], shape (count,) for all joints, or (count, n)
        :param damping: [N m s/rad or N s/m], shape (count,) for all joints, or (count, n)
        :param part: whose joints may be named; None for all
        :raises CommandError: as ``robot.parse.joint_impedance``
        """
        columns = self._columns(part or 'joint_impedance', position=position, velocity=velocity,
                                effort=effort, stiffness=stiffness, damping=damping)
        self._apply(lambda robot, world: robot.parse.joint_impedance(
            names, part=part, **{field: values[world] for field, values in columns.items()}),
            where, period_s)

    def _columns(self, label: str, **given: ArrayLike | None) -> dict[str, FloatArray]:
        """Return the arrays that are given, by field."""
        return {field: self._rows(values, f'{label}: {field}')
                for field, values in given.items() if values is not None}

    def _stream(self, names: Sequence[str], field: str, part: str | None) -> _Stream | None:
        """Return the stream of such goals that is known, or None."""
        try:
            return self._going_on.get((*names, field, part))
        except TypeError:  # The error is raised world by world, with a clear message.
            return None

    def _address(self, stream: _Stream, world: int) -> int:
        """Return the address of the row of a robot whose stream may have other numbers, or 0."""
        robot, last, goal = self._robots[world], self._streams.get(world), stream.one
        if last is None or last.indices is not goal.indices or last.modes is not goal.modes or (
                robot.joints.modes != stream.modes):
            return 0
        return robot.streams(last)

    def _renew(self, stream: _Stream, worlds: IntArray, values: FloatArray,
               period_s: float | None) -> None:
        """Let commands that run in worlds that go on have other numbers."""
        if period_s is not None:
            shares = [(worlds, float(period_s))]
        else:
            steps = self._table[:, STEPS][worlds]
            shares = [(worlds[steps == period], period * self._timestep_s)
                      for period in dict.fromkeys(steps.tolist())]
        from manip_sim.control.law.period import renew  # It imports numba.
        for share, length_s in shares:
            renew(self._table, stream.going_on.robots, share, stream.one.indices, values,
                  length_s, stream.velocities)

    def _alike(self, names: Sequence[str], field: str, values: FloatArray, part: str | None,
               mask: BoolArray) -> tuple[JointSetpoint | None, BoolArray]:
        """Return the command of a world, and which differ from it in nothing but numbers."""
        none = None, np.zeros(len(self._robots), dtype=bool)
        fine = mask & np.isfinite(values.reshape(len(values), -1)).all(axis=1)
        if not fine.any():
            return none
        robots, first = self._robots, int(np.flatnonzero(fine)[0])
        joints = robots[first].joints
        try:
            parsed = robots[first].parse.joint_command(names, part=part, **{field: values[first]})
        except CommandError:  # One by one, the message names the world.
            return none
        if len(parsed) != 1 or not isinstance(parsed[0], JointSetpoint) or (
                len(parsed[0].indices) != values.shape[1]):
            return none
        goal, modes = parsed[0], joints.modes
        clamps = joints.clamps(goal.indices)
        inside = fine & (clamp(values, clamps)[0] == values).all(axis=1)
        velocities = {*goal.modes} == {VELOCITY.name}
        if velocities or {*goal.modes} == {POSITION.name}:
            if len(self._going_on) == _MOST_STREAMS:
                self._going_on.clear()
            low, high = np.nan_to_num(clamps).T.copy()
            self._going_on[(*names, field, part)] = _Stream(
                goal, modes, low, high, velocities, GoingOn(self._table, self._timestep_s))
        for world in np.flatnonzero(inside).tolist():
            inside[world] = robots[world].joints.modes == modes
        return goal, inside

    def _begin(self, goal: JointSetpoint, values: FloatArray, worlds: BoolArray
               ) -> list[_Parsed]:
        """Return such a command for some worlds, which these can go on with."""
        made: list[_Parsed] = []
        for world in np.flatnonzero(worlds).tolist():
            begun = self._streams[world] = JointSetpoint(
                robot=goal.robot, parts=goal.parts, indices=goal.indices, modes=goal.modes,
                values=values[world].copy())
            made.append((self._robots[world], (begun,)))
        return made

    def trajectory(self, part: str, names: Sequence[str], times_s: Sequence[float],
                   positions: ArrayLike, velocities: ArrayLike | None = None, *,
                   where: ArrayLike | None = None, period_s: float | None = None) -> None:
        """
        Command a trajectory of some joints of a part in each world, which begins now.

        :param times_s: of the points, from the start, the same in all worlds [s]
        :param positions: [rad or m], shape (count, n_points, n)
        :param velocities: [rad/s or m/s], of that shape, or None
        :raises CommandError: as ``robot.parse.trajectory``
        """
        goals = self._rows(positions, f'{part}: positions')
        speeds = None if velocities is None else self._rows(velocities, f'{part}: velocities')
        self._apply(lambda robot, world: [robot.parse.trajectory(
            part, names, times_s, goals[world], None if speeds is None else speeds[world])],
            where, period_s)

    def twist(self, twist: ArrayLike, *, where: ArrayLike | None = None,
              period_s: float | None = None) -> None:
        """
        Command a velocity of the mobile base, in its own frame, in each world.

        :param twist: along x and y [m/s] and about z [rad/s], shape (count, 3)
        :raises CommandError: if a shape is wrong, a number is not finite, or no base has a mode
            that takes it
        """
        numbers = self._rows(twist, 'base: twists')
        if numbers.shape[1:] != (3,):
            raise CommandError(f'base: twists must have the shape ({len(numbers)}, 3), got '
                               f'{numbers.shape}')
        self._apply(lambda robot, world: [robot.parse.twist(*numbers[world])], where, period_s)


class CartesianCommands(RowByRow):
    """
    Commands for the end effectors of arms, with the method names of ``robot.parse_cartesian``.

    Each takes ``where`` and ``period_s``, as those for joints do.

    :param robots: the robot in each world
    :param table: ``Physics.standing`` of each world, shape (count, 5)
    :param timestep_s: length of a physics step [s]
    """

    def pose(self, arm: str, position: ArrayLike, quat_xyzw: ArrayLike, frame: str = '', *,
             where: ArrayLike | None = None, period_s: float | None = None) -> None:
        """
        Command a pose of ``grip_site`` of an arm in each world.

        :param position: in the frame [m], shape (count, 3)
        :param quat_xyzw: in the frame, of length 1, shape (count, 4)
        :param frame: a link of the robot or a frame on one; empty for ``world``
        :raises CommandError: if the frame is unknown, or the numbers are not poses
        :raises UnknownNameError: if the arm is unknown or has no gripper
        """
        self._each(CartesianParser.pose, arm, {'positions': position, 'quaternions': quat_xyzw},
                   where, period_s, frame=frame)

    def twist(self, arm: str, linear: ArrayLike, angular: ArrayLike, frame: str = '', *,
              where: ArrayLike | None = None, period_s: float | None = None) -> None:
        """
        Command a velocity of ``grip_site`` of an arm in each world.

        :param linear: [m/s], shape (count, 3)
        :param angular: [rad/s], shape (count, 3)
        :param frame: whose axes the velocity is in; empty for ``world``
        :raises CommandError: if the frame is unknown, or a number is not finite or too great
        :raises UnknownNameError: if the arm is unknown or has no gripper
        """
        self._each(CartesianParser.twist, arm, {
            'linear velocities': linear, 'angular velocities': angular}, where, period_s,
            frame=frame)

    def until_contact(self, arm: str, linear: ArrayLike, angular: ArrayLike, *, force: float,
                      distance: float, duration_s: float, frame: str = '',
                      where: ArrayLike | None = None, period_s: float | None = None) -> None:
        """
        Command a velocity of ``grip_site`` of an arm until contact in each world.

        :param linear: [m/s], shape (count, 3)
        :param angular: [rad/s], shape (count, 3)
        :param force: size of the external force on the tool that ends it [N]
        :param distance: from where ``grip_site`` is now, which ends it [m]
        :param duration_s: simulation time that ends it [s]
        :param frame: whose axes the velocity is in; empty for ``world``
        :raises CommandError: as ``robot.parse_cartesian.until_contact``
        :raises UnknownNameError: if the arm is unknown or has no gripper
        """
        self._each(CartesianParser.until_contact, arm, {
            'linear velocities': linear, 'angular velocities': angular}, where, period_s,
            force=force, distance=distance, duration_s=duration_s, frame=frame)

    def wrench(self, arm: str, force: ArrayLike, torque: ArrayLike, frame: str = '', *,
               where: ArrayLike | None = None, period_s: float | None = None) -> None:
        """
        Command a wrench that the impedance of an arm exerts in each world.

        :param force: that ``grip_site`` pushes with [N], shape (count, 3)
        :param torque: about ``grip_site`` [N m], shape (count, 3)
        :param frame: whose axes the wrench is in; empty for ``world``
        :raises CommandError: if the frame is unknown, a number is not finite, or the arm is not
            an impedance
        :raises UnknownNameError: if the arm is unknown or has no gripper
        """
        self._each(CartesianParser.wrench, arm, {'forces': force, 'torques': torque}, where,
                   period_s, frame=frame)

    def force_mode(self, arm: str, selection: ArrayLike, wrench: ArrayLike, limits: ArrayLike, *,
                   where: ArrayLike | None = None, period_s: float | None = None) -> None:
        """
        Command that the impedance of an arm exerts a wrench along chosen axes in each world.

        :param selection: 1 for the axes that are chosen, else 0, shape (count, 6)
        :param wrench: force and torque there [N, N m], shape (count, 6)
        :param limits: velocities there [m/s, rad/s], shape (count, 6)
        :raises CommandError: as ``robot.parse_cartesian.force_mode``
        :raises UnknownNameError: if the arm is unknown or has no gripper
        """
        self._each(CartesianParser.force_mode, arm, {
            'selections': selection, 'wrenches': wrench, 'limits': limits}, where, period_s)

    def action(self, arm: str, action: ArrayLike, *, where: ArrayLike | None = None,
               period_s: float | None = None) -> None:
        """
        Command an action of robosuite's OSC_POSE in each world.

        :param action: six numbers in [-1, 1]: along x, y, z and about x, y, z, shape (count, 6)
        :raises CommandError: if a shape is wrong or a number is not finite
        :raises UnknownNameError: if the arm is unknown or has no gripper
        """
        numbers = self._rows(action, f'{arm}: pose actions')
        mask = world_mask(where, len(self._robots))
        if not isinstance(arm, str) or numbers.shape[1:] != (6,):
            self._apply(lambda robot, world: [robot.parse_cartesian.action(arm, numbers[world])],
                        mask, period_s)
            return
        from manip_sim.control.law.period import renew_actions  # It imports numba.

        def renew(going_on: GoingOn, worlds: IntArray, indices: IntArray) -> None:
            renew_actions(self._table, going_on.robots, worlds, indices, numbers)
        self._act(arm, numbers, mask, period_s, lambda robot, action: (
            robot.parse_cartesian.action(arm, action)), SimulatedRobot.streams, renew)

    def _each(self, parse: Callable[..., Command], arm: str, rows: Mapping[str, ArrayLike],
              where: ArrayLike | None, period_s: float | None, **common: Any) -> None:
        """Command an arm in each world by its row of each array, and what all have in common."""
        columns = [self._rows(values, f'{arm}: {noun}') for noun, values in rows.items()]
        self._apply(lambda robot, world: [parse(
            robot.parse_cartesian, arm, *[column[world] for column in columns], **common)],
            where, period_s)


def _send(made: Iterable[_Parsed], period_s: float | None) -> None:
    for robot, commands in made:
        robot.apply(*commands, period_s=period_s)


def world_mask(where: ArrayLike | None, count: int) -> BoolArray:
    """
    Return a mask of worlds.

    :param where: a truth value for each world, or None for all worlds
    :returns: shape (count,)
    :raises CommandError: if it has another shape or type
    """
    if where is None:
        return np.ones(count, dtype=bool)
    try:
        mask = np.asarray(where)
    except ValueError as error:
        raise CommandError(f'where must be {count} truth values, one for each world, got '
                           f'{format_value(where)}') from error
    if mask.shape != (count,) or mask.dtype != np.bool_:
        raise CommandError(f'where must be {count} truth values, one for each world, got '
                           f'{mask.dtype} of shape {mask.shape}')
    return mask


def as_batch(values: ArrayLike, count: int, noun: str) -> FloatArray:
    """
    Return numbers with a leading axis of worlds.

    :param noun: noun for them, for the message
    :returns: shape (count, ...), a copy
    :raises CommandError: if they are not numbers, or not one row for each world
    """
    numbers = command_numbers(values, noun)
    if numbers.ndim == 0 or len(numbers) != count:
        raise CommandError(f'{noun} must have a leading axis of {count}, one row for each world, '
                           f'got the shape {numbers.shape}')
    return numbers


@contextlib.contextmanager
def naming(world: int) -> Iterator[None]:
    """Let an error about a value name the world that it is for."""
    try:
        yield
    except UnknownNameError:
        raise
    except (CommandError, ModelError) as error:
        raise type(error)(f'world {world}: {error}') from error
