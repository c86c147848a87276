# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The node's parameters: one table with type, default, limits and description."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult)
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from manip_sim.errors import describe_choices, ParameterError
from manip_sim.models.arenas import arena_names
from manip_sim.models.bases import base_names
from manip_sim.models.grippers import gripper_names
from manip_sim.models.robots import robot_names
from manip_sim.models.robots.subsystems import SUBSYSTEMS
from manip_sim.quoting import quoted
from manip_sim.ros.scope import Scope
from manip_sim.simulation.commands import MODES
from manip_sim.simulation.parts import Part

#: Parameters that every rclpy node knows.
_OF_RCLPY = ('use_sim_time', 'start_type_description_service')
STEPPING = ('realtime', 'free', 'lockstep')
#: Groups of parameters whose values for a part are those of the parts that it consists of.
_COUPLED = ('control_mode', 'command_timeout')


@dataclass(frozen=True)
class ParameterSpec:
    """
    One parameter.

    :ivar default: also tells the type
    :ivar live: whether it may change while the node runs
    :ivar minimum: and ``maximum``: inclusive limits of a number
    :ivar choices: the values that a string may have
    :ivar length: of an array of finite numbers, where it is fixed
    """

    name: str
    default: Any
    description: str
    unit: str = ''
    live: bool = False
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    length: int | None = None

    def within(self, scope: Scope) -> ParameterSpec:
        """Return the same parameter for one of several robots."""
        return replace(self, name=scope.parameter(self.name))

    def descriptor(self) -> ParameterDescriptor:
        """Return what ``ros2 param describe`` prints."""
        descriptor = ParameterDescriptor(
            description=self.description + (f' [{self.unit}]' if self.unit else ''),
            read_only=not self.live)
        if self.choices:
            descriptor.additional_constraints = f'One of: {", ".join(self.choices)}.'
        if self.minimum is not None and self.maximum is not None:
            if isinstance(self.default, float):
                descriptor.floating_point_range = [FloatingPointRange(
                    from_value=self.minimum, to_value=self.maximum, step=0.0)]
            else:
                descriptor.integer_range = [IntegerRange(
                    from_value=int(self.minimum), to_value=int(self.maximum), step=1)]
        return descriptor

    def problem_with(self, value: Any) -> str | None:
        """Return what is wrong with a value that has the right type, or None."""
        if self.choices:
            for item in value if isinstance(value, (list, tuple)) else [value]:
                if item not in self.choices:
                    return (f"parameter '{self.name}': unknown value {quoted(item)}: "
                            f'{describe_choices(item, self.choices)}')
        if self.length is not None and not (
                len(value) == self.length and all(map(math.isfinite, value))):
            return (f"parameter '{self.name}' must be {self.length} finite numbers, "
                    f'got {list(value)}')
        if (self.minimum is not None and self.maximum is not None
                and not self.minimum <= value <= self.maximum):
            return (f"parameter '{self.name}' must be from {self.minimum:g} to "
                    f'{self.maximum:g}{self.unit and " " + self.unit}, got {value:g}')
        return None


def node_parameters() -> list[ParameterSpec]:
    """Return the parameters of every node, before its robots are known."""
    return [
        ParameterSpec('robots', [''], 'Names of several robots in one world, such as left and '
                      'right: each has its topics in a namespace and its parameters, such as '
                      'left.robot, below its name. Empty: one robot.'),
        ParameterSpec('arena', 'empty', 'What is around the robot.',
                      choices=tuple(arena_names())),
        ParameterSpec('cube', True, 'In the arena table: put a free cube of 0.05 m and 0.1 kg on '
                      'the table.'),
        ParameterSpec('timestep', 0.002, 'Physics step.', 's', minimum=1e-4, maximum=0.01),
        ParameterSpec('publish_rate', 100.0, 'Control periods, and messages on each state topic, '
                      'per second of simulation time; a period is a whole number of timesteps.',
                      'Hz', minimum=1.0, maximum=10000.0),
        ParameterSpec('stepping', 'realtime', 'What drives the physics: the clock, nothing (as '
                      'fast as possible), or the commands of lockstep_parts.', choices=STEPPING),
        ParameterSpec('start_paused', False, 'Wait for ~/pause or ~/step after the start.'),
        ParameterSpec('real_time_factor', 1.0, 'Simulation time per wall time, for the stepping '
                      'realtime.', live=True, minimum=0.1, maximum=10.0),
        ParameterSpec('gravity_compensation', True, 'Let the actuators carry the weight of all '
                      'links and grippers; it counts as effort and against the torque limits.'),
        ParameterSpec('publish_clock', True, 'Publish /clock; switch it off in all nodes of a '
                      'domain but one.'),
    ]


def composition_parameters(scope: Scope) -> list[ParameterSpec]:
    """Return the parameters that say which robot there is."""
    specs = [
        ParameterSpec('robot', 'Panda', 'Robot of the catalogue.',
                      choices=tuple(robot_names())),
        ParameterSpec('gripper', 'default',
                      "Gripper on every arm; 'default' is the robot's own, 'none' leaves it off.",
                      choices=('default', 'none', *gripper_names())),
        ParameterSpec('base', 'default',
                      "What the robot stands on; 'default' is the robot's own, 'none' is the "
                      'floor.', choices=('default', 'none', *base_names())),
        ParameterSpec('prefix', f'{scope.name}_' if scope.name else '',
                      'Beginning of all names of the robot, its base and its '
                      'grippers: joints, frames, the model. Empty: names as in robot0_joint1.'),
        ParameterSpec('lockstep_parts', ['arm'], 'Parts that must each have had a command before '
                      'lockstep advances by a control period, such as arm or right/gripper.')]
    if not scope.name:
        specs.append(ParameterSpec('idn', 0, 'Number of the robot in names, as in robot0_joint1, '
                                   'where prefix is empty.', minimum=0, maximum=999))
    return [spec.within(scope) for spec in specs]


def place_parameters(scope: Scope, position: Sequence[float]) -> list[ParameterSpec]:
    """
    Return the parameters that say where a robot stands.

    :param position: where it stands unless the user says where [m], three numbers
    """
    return [spec.within(scope) for spec in (
        ParameterSpec('position', [float(value) for value in position], 'Where the floor below '
                      "the robot's root is in the frame world: x, y, z.", 'm', length=3),
        ParameterSpec('orientation', [0.0, 0.0, 0.0], 'How the robot is turned in the frame '
                      'world: roll, pitch, yaw.', 'rad', length=3))]


def robot_parameters(scope: Scope, parts: Sequence[str]) -> list[ParameterSpec]:
    """
    Return the parameters that depend on the parts of a robot.

    :param parts: the parts with driven joints: subsystems and arms
    """
    specs = []
    for part in parts:
        moves = part == 'base'
        specs += [
            ParameterSpec(f'control_mode.{part}', 'velocity' if moves else 'position',
                          f'What commands of the {part} mean; a change holds it where it is.',
                          live=True, choices=MODES),
            ParameterSpec(f'command_timeout.{part}', 0.5 if moves else 0.0,
                          f'Without a fresh command of the {part} for so long (simulation time), '
                          'position holds, velocity goes to zero, effort to gravity compensation; '
                          '0 is never.', 's', live=True, minimum=0.0, maximum=3600.0)]
    return [spec.within(scope) for spec in specs]


class Parameters:
    """
    Declares parameters on a node and validates their changes.

    :param node: the node; its overrides may give an integer where a double is meant
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._specs: dict[str, ParameterSpec] = {}
        self._parts: dict[Scope, Mapping[str, Part]] = {}
        node.add_pre_set_parameters_callback(
            lambda parameters: self._with_coupled(self._integers_to_doubles(parameters)))
        node.add_on_set_parameters_callback(self._validate)

    def declare(self, specs: Sequence[ParameterSpec]) -> None:
        """
        Declare parameters and read what the user gave for them.

        :raises ParameterError: if a value cannot be used
        """
        overrides = self._node._parameter_overrides
        for spec in specs:
            self._specs[spec.name] = spec
            if spec.name in overrides:
                given = overrides[spec.name] = self._as_declared(overrides[spec.name])
                problem = self._type_problem(spec, given) or spec.problem_with(given.value)
                if problem:
                    raise ParameterError(problem)
            try:
                self._node.declare_parameter(spec.name, spec.default, spec.descriptor())
            except (InvalidParameterTypeException, InvalidParameterValueException) as error:
                raise ParameterError(f"parameter '{spec.name}': {error}") from error

    def _type_problem(self, spec: ParameterSpec, given: Parameter) -> str | None:
        expected = Parameter.Type.from_parameter_value(spec.default)
        if given.type_ is expected:
            return None
        return (f"parameter '{spec.name}' must be of type {expected.name.lower()}, "
                f'got {given.value!r}')

    def check_names(self) -> None:
        """
        Refuse parameters that the user gave and nobody declared.

        :raises ParameterError: naming the nearest ones
        """
        for name in self._node._parameter_overrides:
            if not (name in self._specs or name in _OF_RCLPY or name.startswith('qos_overrides.')):
                missing = [f'this robot has no {part}, ' for part in name.split('.')
                           if part in SUBSYSTEMS and not any(
                               spec.endswith(f'control_mode.{part}') for spec in self._specs)]
                raise ParameterError(f"unknown parameter '{name}': {''.join(missing)}"
                                     f'{describe_choices(name, self._specs)}')

    def couple(self, scope: Scope, parts: Mapping[str, Part]) -> None:
        """
        Let parameters of a part set those of the parts that it consists of, and the reverse.

        Of what the user gave at the start, that of one arm overrides that of both.

        :param scope: the robot
        :param parts: its parts by name
        """
        self._parts[scope] = parts
        given = self._node._parameter_overrides
        for whole in (True, False):
            for part in parts:
                for group in _COUPLED:
                    name = scope.parameter(f'{group}.{part}')
                    if name in given and whole == (parts[part].atomic != (part,)):
                        self._node.set_parameters([given[name]])

    def of_part(self, name: str) -> tuple[Scope, str, str] | None:
        """Return the robot, the group and the part that a parameter is about, or None."""
        for scope, parts in self._parts.items():
            for group in _COUPLED:
                begin = scope.parameter(f'{group}.')
                if name.startswith(begin) and name[len(begin):] in parts:
                    return scope, group, name[len(begin):]
        return None

    def _with_coupled(self, parameters: list[Parameter]) -> list[Parameter]:
        """Add what follows for other parts, which the user does not set at the same time."""
        values = {p.name: p for p in parameters}
        result = list(parameters)
        for parameter in parameters:
            found = self.of_part(parameter.name)
            if found is None:
                continue
            scope, group, part = found
            for other in _coupled_parts(self._parts[scope], part):
                name = scope.parameter(f'{group}.{other}')
                if name not in values:
                    values[name] = Parameter(name, parameter.type_, parameter.value)
                    result.append(values[name])
        return result

    def value(self, name: str) -> Any:
        """Return the present value of a declared parameter."""
        return self._node.get_parameter(name).value

    def _as_declared(self, parameter: Parameter) -> Parameter:
        spec = self._specs.get(parameter.name)
        if (spec is not None and isinstance(spec.default, float)
                and parameter.type_ is Parameter.Type.INTEGER):
            return Parameter(parameter.name, Parameter.Type.DOUBLE, float(parameter.value))
        if (spec is not None and spec.length and parameter.type_ is Parameter.Type.INTEGER_ARRAY):
            return Parameter(parameter.name, Parameter.Type.DOUBLE_ARRAY,
                             [float(value) for value in parameter.value])
        if spec is not None and isinstance(spec.default, list) and not parameter.value:
            # ROS reads [] as no value, and rclpy an empty list as one of bytes.
            return Parameter(parameter.name, Parameter.Type.STRING_ARRAY, [''])
        return parameter

    def _integers_to_doubles(self, parameters: list[Parameter]) -> list[Parameter]:
        return [self._as_declared(parameter) for parameter in parameters]

    def _validate(self, parameters: list[Parameter]) -> SetParametersResult:
        for parameter in parameters:
            spec = self._specs.get(parameter.name)
            if spec is None or parameter.value is None:
                continue
            problem = self._type_problem(spec, parameter) or spec.problem_with(parameter.value)
            if problem:
                return SetParametersResult(successful=False, reason=problem)
        return SetParametersResult(successful=True)


def _coupled_parts(parts: Mapping[str, Part], part: str) -> list[str]:
    """Return the parts that a part consists of, and its other name."""
    own = set(parts[part].atomic)
    return [name for name, other in parts.items() if name != part
            and other.gripper is None and set(other.atomic) <= own]


def steps_per_period(publish_rate: float, timestep: float) -> int:
    """
    Return how many physics steps a control period has.

    :param publish_rate: [Hz]
    :param timestep: [s]
    :raises ParameterError: if it is not a whole number, naming the nearest rates for which it is
    """
    steps = 1.0 / (publish_rate * timestep)
    whole = max(1, round(steps))
    if abs(steps - whole) > 1e-6 * whole:
        lower, higher = int(steps) + 1, int(steps)
        rates = [1.0 / (n * timestep) for n in (lower, higher) if n > 0]
        raise ParameterError(
            f"parameter 'publish_rate': a period of {publish_rate:g} Hz is not a whole number of "
            f'timesteps of {timestep:g} s; the nearest rates that are: '
            + ', '.join(f'{rate:.10g}' for rate in rates))
    return whole
