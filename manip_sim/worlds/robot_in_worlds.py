# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""One robot in many worlds: its commands and states as arrays with a leading axis of worlds."""

from __future__ import annotations

from collections.abc import Callable, Iterator, MutableMapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.modes import Law, law_of
from manip_sim.control.seats import LawParameters
from manip_sim.errors import CommandError, ModelError
from manip_sim.physics.parts import EndEffector
from manip_sim.physics.payload import Payload
from manip_sim.simulation import SimulatedRobot
from manip_sim.validation import command_numbers
from manip_sim.worlds.commands import as_batch, CartesianCommands, Commands, naming, world_mask


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
        for robot, included in zip(self._robots, world_mask(where, len(self))):
            if included:
                robot.set_control_mode(part, mode)

    def set_law(self, part: str, law: Law | Callable[..., object], /, *,
                compiled: bool | None = None, where: ArrayLike | None = None,
                **parameters: ArrayLike) -> None:
        """
        Let a law of your own move a part, as :meth:`SimulatedRobot.set_law` does.

        :param part: such as ``arm``
        :param law: made by ``manip_sim.laws.law``, or decorated by ``numba.njit``; any other
            function or callable object with its arguments runs as plain Python
        :param compiled: False lets it run as plain Python; None: as it was made
        :param where: in which worlds, shape (count,); None for all
        :param parameters: of the law, by name, a number or one for each world, shape (count,)
        :raises CommandError: if the part is a gripper, or an array has another shape or type
        :raises ModelError: as of :meth:`SimulatedRobot.set_law`; no world has changed then
        :raises UnknownNameError: if the part or parameter is unknown
        """
        checked = law_of(law)
        worlds = np.flatnonzero(world_mask(where, len(self))).tolist()
        by_world = {name: self._each(name, values) for name, values in parameters.items()}
        sets = [{name: values[world] for name, values in by_world.items()} for world in worlds]
        for world, values in zip(worlds, sets):
            with naming(world):
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

    def set_payload(self, arm: str, mass: ArrayLike, center_of_mass: ArrayLike = (0.0,) * 3,
                    inertia: ArrayLike = (0.0,) * 6, where: ArrayLike | None = None) -> None:
        """
        Declare what an arm holds, as :meth:`SimulatedRobot.set_payload` does.

        :param arm: such as ``right``
        :param mass: [kg], a number or one for each world, shape (count,); 0 for nothing
        :param center_of_mass: [m], shape (3,) or (count, 3)
        :param inertia: [kg m^2], shape (6,) or (count, 6)
        :param where: in which worlds, shape (count,); None for all
        :raises CommandError: as of :meth:`SimulatedRobot.set_payload`, or if an array has another
            shape; no world has changed then
        :raises UnknownNameError: if the arm is unknown or has no gripper
        """
        worlds = np.flatnonzero(world_mask(where, len(self))).tolist()
        masses = self._each('mass', mass)
        places, turns = (self._each_of(name, values, length) for name, values, length in (
            ('center_of_mass', center_of_mass, 3), ('inertia', inertia, 6)))
        payloads = []
        for world in worlds:
            with naming(world):
                payloads.append(Payload.checked(masses[world], places[world], turns[world]))
        for world, payload in zip(worlds, payloads):
            self._robots[world].joints.set_payload(arm, payload)

    def _each_of(self, name: str, values: ArrayLike, length: int) -> FloatArray:
        """Return some numbers for each world, shape (count, length)."""
        numbers = command_numbers(values, name)
        if numbers.shape == (length,):
            numbers = np.broadcast_to(numbers, (len(self), length))
        if numbers.shape != (len(self), length):
            raise CommandError(f'{name} must have the shape ({length},) or ({len(self)}, {length})'
                               f', got {numbers.shape}')
        return numbers

    def _each(self, name: str, values: ArrayLike) -> list[float]:
        """Return a number for each world."""
        numbers = command_numbers(values, name)
        if numbers.ndim == 0:
            return [float(numbers)] * len(self)
        if numbers.ndim > 1:
            raise CommandError(f'{name} must be a number or one for each world, got the shape '
                               f'{numbers.shape}')
        return [float(number) for number in as_batch(numbers, len(self), name)]

    def state(self) -> RobotStates:
        """Return a snapshot of the present instant, copies."""
        states = [robot.state() for robot in self._robots]
        arms = states[0].end_effectors
        return RobotStates(
            np.array([state.time_ns for state in states], dtype=np.int64),
            np.stack([state.position for state in states]),
            np.stack([state.velocity for state in states]),
            np.stack([state.effort for state in states]),
            {arm: _stacked([state.end_effectors[arm] for state in states]) for arm in arms})

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
        checked = []
        for world, value in enumerate(self._each(name, values)):
            with naming(world):
                checked.append(self._worlds[world].checked(name, value))
        for parameters, value in zip(self._worlds, checked):
            parameters[name] = value

    def __delitem__(self, name: str) -> None:
        del self._worlds[0][name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._worlds[0])

    def __len__(self) -> int:
        return len(self._worlds[0])


def _stacked(states: Sequence[Any]) -> Any:
    """Return arrays, or objects that have arrays, as one with a leading axis."""
    first = states[0]
    if isinstance(first, np.ndarray):
        return np.stack(states)
    return type(first)(*(_stacked([getattr(state, field.name) for state in states])
                         for field in fields(first)))
