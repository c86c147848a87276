# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""One robot in many worlds: its commands and states as arrays with a leading axis of worlds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, MutableMapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.clamping import clamp, command_numbers
from manip_sim.control.cartesian.cartesian_commands import PoseAction
from manip_sim.control.commands import Command, CommandHandle, JointSetpoint
from manip_sim.control.modes import POSITION, VELOCITY
from manip_sim.control.seats import LawParameters
from manip_sim.control.setpoints import wait_in_worlds
from manip_sim.control.user_laws import Law, law_of
from manip_sim.errors import CommandError, ModelError
from manip_sim.physics.end_effectors import EndEffector
from manip_sim.physics.physics import EPOCH, STEPS
from manip_sim.physics.poses_and_twists import Pose, Twist
from manip_sim.simulation import SimulatedRobot, Wrench
from manip_sim.simulation.compiled_period import renew, renew_actions
from manip_sim.validation import positive_number
from manip_sim.worlds.rows import chosen, rows

#: So many streams of a robot are known at most.
_MOST_STREAMS = 8


@dataclass(frozen=True)
class RobotStates:
    """
    A snapshot of a robot in all worlds, as ``State`` is of one.

    :ivar time_ns: simulation time of each world [ns], shape (count,)
    :ivar position: of all scalar joints, in the order of ``joint_names`` [rad or m], shape
        (count, n)
    :ivar velocity: [rad/s or m/s], shape (count, n)
    :ivar effort: of the actuators at the joint in the last physics step [N m or N], shape
        (count, n)
    :ivar end_effectors: by arm, of the arms with a gripper; their arrays have a leading axis of
        worlds
    """

    time_ns: IntArray
    position: FloatArray
    velocity: FloatArray
    effort: FloatArray
    end_effectors: dict[str, EndEffector]


class RobotInWorlds:
    """
    A robot in all worlds.

    Every command takes an array with one row for each world, and ``where``: which worlds it is
    for, shape (count,), None for all. Rows of other worlds are ignored. If one row is invalid, a
    ``CommandError`` names its world, and no world gets a command.

    :param robots: the robot in each world
    :param table: ``Physics.standing`` of each world, shape (count, 5)
    :param timestep_s: length of a physics step [s]
    :ivar command: takes commands for joints, grippers and bases
    :ivar command_cartesian: takes commands for the end effectors of arms
    :ivar joint_names: all scalar joints, in the order of the states
    """

    def __init__(self, robots: Sequence[SimulatedRobot], table: IntArray, timestep_s: float
                 ) -> None:
        self._robots = robots
        self.command = Commands(robots, table, timestep_s)
        self.command_cartesian = CartesianCommands(robots, table, timestep_s)
        self.joint_names = robots[0].joint_names

    def __getitem__(self, world: int) -> SimulatedRobot:
        return self._robots[world]

    def __len__(self) -> int:
        return len(self._robots)

    def set_control_mode(self, part: str, mode: str, where: ArrayLike | None = None) -> None:
        """
        Change the control mode of a part, as :meth:`SimulatedRobot.set_control_mode` does.

        :param part: such as ``arm``
        :param mode: such as ``effort``
        :param where: in which worlds, shape (count,); None for all
        :raises CommandError: if the part is a gripper, or ``where`` has another shape or type
        :raises UnknownNameError: if the part or mode is unknown
        """
        for robot, included in zip(self._robots, chosen(where, len(self))):
            if included:
                robot.set_control_mode(part, mode)

    def set_law(self, part: str, law: Law | Callable[..., object], /, *,
                compiled: bool | None = None, where: ArrayLike | None = None,
                **parameters: ArrayLike) -> None:
        """
        Let a law of your own move a part, as :meth:`SimulatedRobot.set_law` does.

        :param part: such as ``arm``
        :param law: made by ``manip_sim.laws.law``; any other function with its arguments runs as
            plain Python
        :param compiled: False lets it run as plain Python; None: as it was made
        :param where: in which worlds, shape (count,); None for all
        :param parameters: of the law, by name, a number or one for each world, shape (count,)
        :raises CommandError: if the part is a gripper, or an array has another shape or type
        :raises ModelError: as of :meth:`SimulatedRobot.set_law`; no world has changed then
        :raises UnknownNameError: if the part or parameter is unknown
        """
        checked = law_of(law)
        worlds = np.flatnonzero(chosen(where, len(self))).tolist()
        by_world = {name: self._each(name, values) for name, values in parameters.items()}
        sets = [{name: values[world] for name, values in by_world.items()} for world in worlds]
        for values in sets:
            checked.values(values)
        for world, values in zip(worlds, sets):
            self._robots[world].set_law(part, checked, compiled=compiled, **values)

    def law_parameters(self, part: str) -> LawParametersInWorlds:
        """
        Return the parameters of the law that moves a part in all worlds, by name.

        :param part: such as ``arm``
        :raises ModelError: if no law moves it in some world, or not the same one in all
        :raises UnknownNameError: if the part is unknown
        """
        parameters = [robot.law_parameters(part) for robot in self._robots]
        names = {robot.joints.modes_of(robot.joints.indices_of(part)) for robot in self._robots}
        if len(names) > 1:
            raise ModelError(f'{part} is not moved by the same law in all worlds')
        return LawParametersInWorlds(parameters, self._each)

    def _each(self, name: str, values: ArrayLike) -> list[float]:
        """Return a number for each world."""
        numbers = command_numbers(values, name)
        if numbers.ndim == 0:
            return [float(numbers)] * len(self)
        if numbers.ndim > 1:
            raise CommandError(f'{name} must be a number or one for each world, got the shape '
                               f'{numbers.shape}')
        return [float(number) for number in rows(numbers, len(self), name)]

    def state(self) -> RobotStates:
        """Return a snapshot of the present instant, copies."""
        states = [robot.state() for robot in self._robots]
        arms = states[0].end_effectors
        return RobotStates(
            np.array([state.time_ns for state in states], dtype=np.int64),
            np.stack([state.position for state in states]),
            np.stack([state.velocity for state in states]),
            np.stack([state.effort for state in states]),
            {arm: _together([state.end_effectors[arm] for state in states]) for arm in arms})

    def measured(self, part: str | None = None) -> FloatArray:
        """
        Return the positions, then the velocities, then the efforts of the joints of a part.

        :param part: its name; None for all joints
        :returns: each in the order of the joints' names, in SI units, shape (count, 3 n), a copy
        """
        return np.stack([robot.measured(part) for robot in self._robots])


class LawParametersInWorlds(MutableMapping[str, FloatArray]):
    """
    The parameters of the law that moves a part in many worlds, by name, shape (count,) each.

    :param worlds: the parameters in each world
    :param each: returns a number for each world, of a number or an array
    """

    def __init__(self, worlds: Sequence[LawParameters],
                 each: Callable[[str, ArrayLike], list[float]]) -> None:
        self._worlds, self._each = worlds, each

    def __getitem__(self, name: str) -> FloatArray:
        return np.array([world[name] for world in self._worlds])

    def __setitem__(self, name: str, values: ArrayLike) -> None:
        """
        Change a parameter, from the next step on.

        :param values: a number or one for each world, shape (count,)
        :raises CommandError: if they have another shape
        :raises ModelError: if a value is not a finite number; no world has changed then
        :raises UnknownNameError: if the parameter is unknown
        """
        checked = [world.checked(name, value)
                   for world, value in zip(self._worlds, self._each(name, values))]
        for world, value in zip(self._worlds, checked):
            world[name] = value

    def __delitem__(self, name: str) -> None:
        del self._worlds[0][name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._worlds[0])

    def __len__(self) -> int:
        return len(self._worlds[0])


def _together(states: Sequence[EndEffector]) -> EndEffector:
    """Return the states of an end effector with a leading axis."""
    return EndEffector(
        Pose(np.stack([state.pose.position for state in states]),
             np.stack([state.pose.quat_xyzw for state in states])),
        Twist(np.stack([state.twist.linear for state in states]),
              np.stack([state.twist.angular for state in states])),
        _wrenches([state.wrench for state in states]),
        _wrenches([state.external_wrench for state in states]))


def _wrenches(wrenches: Sequence[Wrench]) -> Wrench:
    return Wrench(np.stack([wrench.force for wrench in wrenches]),
                  np.stack([wrench.torque for wrench in wrenches]))


class GoingOn:
    """
    The worlds that go on with a command, to which compiled code gives other numbers.

    :param table: ``Physics.standing`` of each world, shape (count, 5)
    :param timestep_s: length of a physics step [s]
    :ivar robots: address of the row of the robot in each world, or 0, shape (count,)
    """

    def __init__(self, table: IntArray, timestep_s: float) -> None:
        self._table, self._timestep_s = table, timestep_s
        self.robots, self._epochs = np.zeros((2, len(table)), np.int64)

    def find(self, mask: BoolArray, period_s: float | None, address: Callable[[int], int]
             ) -> IntArray:
        """
        Return the numbers of the worlds that go on with the command.

        :param mask: which may, shape (count,)
        :param period_s: length of a control period that they have to have [s]; None for any
        :param address: returns that of the row of the robot in a world if the command runs, or 0
        """
        steps, epochs = self._table[:, STEPS], self._table[:, EPOCH]
        stands = mask & (steps > 0)
        if period_s is not None:
            stands &= steps * self._timestep_s == period_s
        for world in np.flatnonzero(stands & (self._epochs != epochs)).tolist():
            self._epochs[world] = epochs[world]
            self.robots[world] = address(world)
        return np.flatnonzero(stands & (self.robots > 0))


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

    def _apply(self, parse: Callable[[SimulatedRobot, int], Iterable[Command]],
               where: ArrayLike | None, period_s: float | None) -> None:
        for robot, commands in self._parsed(parse, chosen(where, len(self._robots))):
            robot.apply(*commands, period_s=period_s)

    def _parsed(self, parse: Callable[[SimulatedRobot, int], Iterable[Command]], mask: BoolArray
                ) -> list[tuple[SimulatedRobot, tuple[Command, ...]]]:
        made = []
        for world in np.flatnonzero(mask).tolist():
            robot = self._robots[world]
            try:
                made.append((robot, tuple(parse(robot, world))))
            except CommandError as error:
                raise CommandError(f'world {world}: {error}') from error
        return made

    def _rows(self, values: ArrayLike, what: str) -> FloatArray:
        return rows(values, len(self._robots), what)


class _Stream(NamedTuple):
    """
    A command that goes on with other numbers.

    :ivar one: the command of a world
    :ivar modes: of all joints of the robot
    :ivar clamps: lowest and highest numbers, shape (n, 2)
    :ivar velocities: whether they are velocities, not positions
    :ivar going_on: the worlds that go on with it
    """

    one: JointSetpoint
    modes: tuple[str, ...]
    clamps: FloatArray
    velocities: bool
    going_on: GoingOn


class Commands(RowByRow):
    """
    Commands for joints, grippers and bases, with the method names of ``robot.parse``.

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
        :param period_s: length of a control period [s]; None for that of the last one
        :raises CommandError: if a shape is wrong or a number is not finite
        :raises UnknownNameError: if the part is unknown
        """
        numbers = self._rows(action, f'{part}: actions')
        self._apply(lambda robot, world: [robot.parse.action(part, numbers[world])], where,
                    period_s)

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
        :param period_s: length of a control period [s]; None for that of the last one
        :raises CommandError: if a joint is unknown or named twice, or the numbers do not match
        """
        columns = {field: self._rows(values, f'{part or "joint_command"}: {field}')
                   for field, values in (('position', position), ('velocity', velocity),
                                         ('effort', effort)) if values is not None}
        mask = chosen(where, len(self._robots))
        alike, goal = np.zeros(len(self._robots), dtype=bool), None
        if len(columns) == 1:
            (field, values), = columns.items()
            mask = mask & ~self._go_on(names, field, values, part, mask, period_s)
            if not mask.any():
                return
            goal, alike = self._alike(names, field, values, part, mask)
        made = self._parsed(lambda robot, world: robot.parse.joint_command(
            names, part=part, **{field: values[world] for field, values in columns.items()}),
            mask & ~alike)
        if goal is not None:
            if period_s is not None:
                positive_number(period_s, 'period_s', CommandError)
            made += self._begin(goal, values, alike & ~self._renew(goal, values, alike, period_s))
        for robot, commands in made:
            robot.apply(*commands, period_s=period_s)

    def _go_on(self, names: Sequence[str], field: str, values: FloatArray, part: str | None,
               mask: BoolArray, period_s: float | None) -> BoolArray:
        """Let commands that run in worlds that go on have other numbers; return where they do."""
        try:
            stream = self._going_on.get((*names, field, part))
        except TypeError:  # The error is raised world by world, with a clear message.
            stream = None
        goes_on = np.zeros(len(mask), dtype=bool)
        if stream is None or values.ndim != 2 or values.shape[1] != len(stream.clamps) or (
                np.isinf(values).any()):
            return goes_on
        low, high = stream.clamps.T
        worlds = stream.going_on.find(
            mask & ((values >= low) & (values <= high)).all(axis=1), period_s,
            lambda world: self._address(world, stream))
        steps = self._table[worlds, STEPS]
        for period in dict.fromkeys(steps.tolist()):
            renew(self._table, stream.going_on.robots, worlds[steps == period],
                  stream.one.indices, values, period * self._timestep_s, stream.velocities)
        goes_on[worlds] = True
        return goes_on

    def _address(self, world: int, stream: _Stream) -> int:
        """Return the address of the row of a robot whose stream may have other numbers, or 0."""
        robot, last, goal = self._robots[world], self._streams.get(world), stream.one
        if last is None or last.indices is not goal.indices or last.modes is not goal.modes or (
                robot.joints.modes != stream.modes):
            return 0
        return robot.streams(last)

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
            self._going_on[(*names, field, part)] = _Stream(
                goal, modes, clamps, velocities, GoingOn(self._table, self._timestep_s))
        for world in np.flatnonzero(inside).tolist():
            inside[world] = robots[world].joints.modes == modes
        return goal, inside

    def _renew(self, goal: JointSetpoint, values: FloatArray, worlds: BoolArray,
               period_s: float | None) -> BoolArray:
        """Let worlds in which such a command runs go on with it; return which do."""
        renewed, setpoints, periods = np.zeros(len(worlds), dtype=bool), [], []
        modes = [mode for mode in (POSITION, VELOCITY) if {*goal.modes} == {mode.name}]
        if not modes:
            return renewed
        for world in np.flatnonzero(worlds).tolist():
            robot, last = self._robots[world], self._streams.get(world)
            if last is not None and last.indices is goal.indices and last.modes is goal.modes and (
                    robot.renew(last, values[world], period_s)):
                renewed[world] = True
                setpoints.append(robot.joints.setpoints)
                periods.append(robot.period_s)
        if setpoints:
            wait_in_worlds(setpoints, goal.indices, values[renewed], np.array(periods),
                           modes[0] is VELOCITY)
        return renewed

    def _begin(self, goal: JointSetpoint, values: FloatArray, worlds: BoolArray
               ) -> list[tuple[SimulatedRobot, tuple[Command, ...]]]:
        """Return such a command for some worlds, which these can go on with."""
        made: list[tuple[SimulatedRobot, tuple[Command, ...]]] = []
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
        :param period_s: length of a control period [s]; None for that of the last one
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
        :param period_s: length of a control period [s]; None for that of the last one
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

    :param robots: the robot in each world
    :param table: ``Physics.standing`` of each world, shape (count, 5)
    :param timestep_s: length of a physics step [s]
    """

    def __init__(self, robots: Sequence[SimulatedRobot], table: IntArray, timestep_s: float
                 ) -> None:
        super().__init__(robots, table, timestep_s)
        #: By arm: the last action of each world, which nobody else has, and the worlds that go on.
        self._actions: dict[str, tuple[dict[int, PoseAction], GoingOn]] = {}

    def pose(self, arm: str, position: ArrayLike, quat_xyzw: ArrayLike, frame: str = '', *,
             where: ArrayLike | None = None, period_s: float | None = None) -> None:
        """
        Command a pose of ``grip_site`` of an arm in each world.

        :param position: in the frame [m], shape (count, 3)
        :param quat_xyzw: in the frame, of length 1, shape (count, 4)
        :param frame: a link of the robot or a frame on one; empty for ``world``
        :param period_s: length of a control period [s]; None for that of the last one
        :raises CommandError: if the frame is unknown, or the numbers are not poses
        :raises UnknownNameError: if the arm is unknown or has no gripper
        """
        places = self._rows(position, f'{arm}: positions')
        turns = self._rows(quat_xyzw, f'{arm}: quaternions')
        self._apply(lambda robot, world: [robot.parse_cartesian.pose(
            arm, places[world], turns[world], frame)], where, period_s)

    def twist(self, arm: str, linear: ArrayLike, angular: ArrayLike, frame: str = '', *,
              where: ArrayLike | None = None, period_s: float | None = None) -> None:
        """
        Command a velocity of ``grip_site`` of an arm in each world.

        :param linear: [m/s], shape (count, 3)
        :param angular: [rad/s], shape (count, 3)
        :param frame: whose axes the velocity is in; empty for ``world``
        :param period_s: length of a control period [s]; None for that of the last one
        :raises CommandError: if the frame is unknown, or a number is not finite or too great
        :raises UnknownNameError: if the arm is unknown or has no gripper
        """
        speeds = self._rows(linear, f'{arm}: linear velocities')
        turns = self._rows(angular, f'{arm}: angular velocities')
        self._apply(lambda robot, world: [robot.parse_cartesian.twist(
            arm, speeds[world], turns[world], frame)], where, period_s)

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
        :param period_s: length of a control period [s]; None for that of the last one
        :raises CommandError: as ``robot.parse_cartesian.until_contact``
        :raises UnknownNameError: if the arm is unknown or has no gripper
        """
        speeds = self._rows(linear, f'{arm}: linear velocities')
        turns = self._rows(angular, f'{arm}: angular velocities')
        self._apply(lambda robot, world: [robot.parse_cartesian.until_contact(
            arm, speeds[world], turns[world], force=force, distance=distance,
            duration_s=duration_s, frame=frame)], where, period_s)

    def wrench(self, arm: str, force: ArrayLike, torque: ArrayLike, frame: str = '', *,
               where: ArrayLike | None = None, period_s: float | None = None) -> None:
        """
        Command a wrench that the impedance of an arm exerts in each world.

        :param force: that ``grip_site`` pushes with [N], shape (count, 3)
        :param torque: about ``grip_site`` [N m], shape (count, 3)
        :param frame: whose axes the wrench is in; empty for ``world``
        :param period_s: length of a control period [s]; None for that of the last one
        :raises CommandError: if the frame is unknown, a number is not finite, or the arm is not
            an impedance
        :raises UnknownNameError: if the arm is unknown or has no gripper
        """
        forces = self._rows(force, f'{arm}: forces')
        torques = self._rows(torque, f'{arm}: torques')
        self._apply(lambda robot, world: [robot.parse_cartesian.wrench(
            arm, forces[world], torques[world], frame)], where, period_s)

    def force_mode(self, arm: str, selection: ArrayLike, wrench: ArrayLike, limits: ArrayLike, *,
                   where: ArrayLike | None = None, period_s: float | None = None) -> None:
        """
        Command that the impedance of an arm exerts a wrench along chosen axes in each world.

        :param selection: 1 for the axes that are chosen, else 0, shape (count, 6)
        :param wrench: force and torque there [N, N m], shape (count, 6)
        :param limits: velocities there [m/s, rad/s], shape (count, 6)
        :param period_s: length of a control period [s]; None for that of the last one
        :raises CommandError: as ``robot.parse_cartesian.force_mode``
        :raises UnknownNameError: if the arm is unknown or has no gripper
        """
        axes, wrenches, speeds = (self._rows(value, f'{arm}: {name}') for value, name in (
            (selection, 'selections'), (wrench, 'wrenches'), (limits, 'limits')))
        self._apply(lambda robot, world: [robot.parse_cartesian.force_mode(
            arm, axes[world], wrenches[world], speeds[world])], where, period_s)

    def action(self, arm: str, action: ArrayLike, *, where: ArrayLike | None = None,
               period_s: float | None = None) -> None:
        """
        Command an action of robosuite's OSC_POSE in each world.

        :param action: six numbers in [-1, 1]: along x, y, z and about x, y, z, shape (count, 6)
        :param period_s: length of a control period [s]; None for that of the last one
        :raises CommandError: if a shape is wrong or a number is not finite
        :raises UnknownNameError: if the arm is unknown or has no gripper
        """
        numbers = self._rows(action, f'{arm}: pose actions')
        mask = chosen(where, len(self._robots))
        inside = mask & (np.abs(numbers.reshape(len(numbers), -1)) <= 1.0).all(axis=1)
        if not isinstance(arm, str) or numbers.shape[1:] != (6,) or not inside.any():
            self._apply(lambda robot, world: [robot.parse_cartesian.action(arm, numbers[world])],
                        mask, period_s)
            return
        if np.isfinite(numbers).all():
            others = np.ones(len(mask), dtype=bool)
            others[self._go_on(arm, numbers, inside, period_s)] = False
            mask, inside = mask & others, inside & others
            if not mask.any():
                return
        # Where nothing has to be clamped or rejected, actions differ in nothing but numbers.
        command = None
        if inside.any():
            first = int(np.flatnonzero(inside)[0])
            command = self._robots[first].parse_cartesian.action(arm, numbers[first])
            running, _ = self._actions.setdefault(
                arm, ({}, GoingOn(self._table, self._timestep_s)))

        def parsed(robot: SimulatedRobot, world: int) -> list[PoseAction]:
            if command is None or not inside[world]:
                return [robot.parse_cartesian.action(arm, numbers[world])]
            running[world] = replace(command, action=numbers[world], handle=CommandHandle())
            return [running[world]]
        self._apply(parsed, mask, period_s)

    def _go_on(self, arm: str, actions: FloatArray, mask: BoolArray, period_s: float | None
               ) -> IntArray:
        """Let actions that run in worlds that go on have other numbers; return where they do."""
        if arm not in self._actions:
            return np.zeros(0, np.int64)
        running, going_on = self._actions[arm]
        worlds = going_on.find(mask, period_s, lambda world: (
            self._robots[world].streams(running[world]) if world in running else 0))
        if len(worlds):
            renew_actions(self._table, going_on.robots, worlds, running[worlds.item(0)].indices,
                          actions)
        return worlds
