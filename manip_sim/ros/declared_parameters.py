# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Declare the node's parameters, read what the user gave and validate changes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
import contextlib
from dataclasses import dataclass
import difflib
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult)
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import HistoryPolicy, ReliabilityPolicy

from manip_sim.control.modes import MODES
from manip_sim.control.surroundings import ARENA
from manip_sim.errors import describe_choices, ParameterError
from manip_sim.interface.parameter_spec import (
    check_names, COUPLED, coupled_names, forget_spawned, ParameterSpec)
from manip_sim.interface.part_parameters import default_timeout
from manip_sim.interface.topics import Scope
from manip_sim.physics.parts import Part
from manip_sim.quoting import quoted
from manip_sim.rclpy_internals import forget_parameters, parameter_overrides
from manip_sim.simulation import SimulatedRobot, Simulation

#: Groups of parameters that set one another, by the name of one of them.
_TIMED = dict.fromkeys(('control_mode', 'command_timeout', 'timeout_follows_mode'), 'control_mode')
_QOS = 'qos_overrides.'
_CHOICES = {
    'history': [policy.name.lower() for policy in HistoryPolicy if policy.name != 'UNKNOWN'],
    'reliability': [policy.name.lower() for policy in ReliabilityPolicy
                    if policy.name != 'UNKNOWN']}
#: A history of more messages costs more memory than a state is worth.
_MAX_DEPTH = 100_000


@dataclass(frozen=True)
class _PartParameter:
    """
    A parameter of a part.

    :ivar scope: of the robot
    :ivar group: the name without the part, such as ``reflex.velocity``
    :ivar part: name
    :ivar is_atomic: true if it acts; others only set the parameters of atomic parts
    :ivar atomic: names of the parameters of the parts that the part consists of, mostly its own;
        an arm without a gripper has none of forces
    :ivar same: names of the parameters of all parts without other joints, with its own
    """

    scope: Scope
    group: str
    part: str
    is_atomic: bool
    atomic: tuple[str, ...]
    same: tuple[str, ...]


class Parameters:
    """
    The parameters of a node: declares them and validates their changes.

    :param node: the node; its overrides may give an integer where a double is declared
    :raises ParameterError: if the value of a QoS override cannot be used
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._check_qos_values()
        # rclpy declares it without a description.
        node.set_descriptor('use_sim_time', ParameterDescriptor(
            type=Parameter.Type.BOOL.value,
            description='Take the time of the node from /clock, which has no effect where the '
                        'node itself is its source.'))
        self._specs: dict[str, ParameterSpec] = {}
        #: By name.
        self._of_parts: dict[str, _PartParameter] = {}
        #: True while changes of parameters do not act.
        self.showing = False
        node.add_pre_set_parameters_callback(self._complete)
        node.add_on_set_parameters_callback(self._validate)

    def declare(self, specs: Sequence[ParameterSpec]) -> None:
        """
        Declare parameters and read what the user gave for them.

        :raises ParameterError: if a value cannot be used
        """
        overrides = parameter_overrides(self._node)
        for spec in specs:
            self._specs[spec.name] = spec
            if spec.name in overrides:
                parameter = overrides[spec.name] = self._as_declared(overrides[spec.name])
                problem = _problem(spec, parameter)
                if problem:
                    raise ParameterError(problem)
            self._node.declare_parameter(spec.name, spec.default, _descriptor(spec))

    def undeclare(self, scope: Scope) -> None:
        """Remove all parameters of a robot that came while the node ran."""
        begin = scope.parameter('')
        self._of_parts = {name: coupled for name, coupled in self._of_parts.items()
                          if coupled.scope != scope}
        self.forget(begin)

    def forget(self, begin: str) -> None:
        """Remove the parameters whose names begin in some way, such as ``law.arm.``."""
        self._specs = {name: spec for name, spec in self._specs.items()
                       if not name.startswith(begin)}
        forget_parameters(self._node, (begin,))

    @property
    def names(self) -> list[str]:
        """The names of all parameters but for QoS."""
        return [*self._specs]

    def check_names(self) -> None:
        """
        Reject given parameters that nobody declared; forget parameters of spawned robots.

        :raises ParameterError: naming the nearest ones
        """
        overrides = parameter_overrides(self._node)
        forget_spawned(overrides, self._specs)
        check_names(overrides, self._specs)

    def _qos_overrides(self) -> list[tuple[str, Any]]:
        overrides = parameter_overrides(self._node)
        return [(name, overrides[name]) for name in sorted(overrides) if name.startswith(_QOS)]

    def _check_qos_values(self) -> None:
        """Check the values of QoS overrides; rclpy would raise unclear errors, or accept them."""
        for name, parameter in self._qos_overrides():
            policy, value = name.rpartition('.')[2], parameter.value
            choices = _CHOICES.get(policy)
            if choices is not None and value not in choices:
                raise ParameterError(f"parameter '{name}': unknown value {quoted(value)}: "
                                     f'{describe_choices(value, choices)}')
            if policy == 'depth' and not (type(value) is int and 1 <= value <= _MAX_DEPTH):
                raise ParameterError(f"parameter '{name}' must be an integer from 1 to "
                                     f'{_MAX_DEPTH}, got {quoted(value)}')

    def check_qos_names(self) -> None:
        """
        Check that each QoS override belongs to a topic; to be called when all topics exist.

        Exact values below ``truth/`` may come later, beside the topics that exist.

        :raises ParameterError: naming the nearest override that has an effect
        """
        for name, _ in self._qos_overrides():
            if not self._node.has_parameter(name) and not self._node.has_parameter(
                    name.replace('/truth/', '/', 1)):
                known = self._node.list_parameters([_QOS[:-1]], 0).names
                near = difflib.get_close_matches(name, known, n=2, cutoff=0.0)
                raise ParameterError(f'unknown parameter {quoted(name, 200)}: did you mean '
                                     + ' or '.join(f"'{other}'" for other in near) + '?')

    def rejection(self, parameters: Sequence[Parameter]) -> str | None:
        """Return why parameters cannot be changed, whatever their values are, or None."""
        for parameter in parameters:
            spec = self._specs.get(parameter.name)
            if spec is not None and not spec.live:
                return f"parameter '{spec.name}' is read-only: set it at the start"
            try:
                check_names([parameter.name], self._specs)
            except ParameterError as error:
                return str(error)
        return None

    def couple(self, scope: Scope, parts: Mapping[str, Part]) -> None:
        """
        Let parameters of a part set the same ones of its parts, and under its other name.

        At the start, a value given for one arm overrides one given for both.
        """
        overrides = parameter_overrides(self._node)
        coupled = {}
        for pattern in COUPLED:
            names = coupled_names(scope, pattern, parts, self._specs)
            for part, name in names.items():
                atomic = parts[part].atomic
                coupled[name] = _PartParameter(
                    scope, pattern.replace('.{}', ''), part, atomic == (part,),
                    tuple(names[other] for other in atomic if other in names),
                    tuple(names[other] for other in names if {*parts[other].atomic} <= {*atomic}))
        self._of_parts.update(coupled)
        self._node.set_parameters([overrides[name] for name in sorted(
            coupled, key=lambda name: coupled[name].is_atomic) if name in overrides])

    def show(self, values: Mapping[str, Any]) -> None:
        """
        Let parameters have the values that act already.

        :param values: by name; names that are not declared are left out
        """
        changed = [Parameter(name, value=value) for name, value in values.items()
                   if name in self._specs and self.value(name) != value]
        with self.without_acting():
            self._node.set_parameters(changed)

    def changed_since(self, before: Mapping[str, Parameter]) -> list[Parameter]:
        """
        Return the former parameters of those that have changed, with all that they set.

        :param before: all parameters, by name
        """
        changed = {name for name in before.keys() & self._specs.keys()
                   if self.value(name) != before[name].value}
        groups = {(coupled.scope, _TIMED.get(coupled.group, coupled.group))
                  for name, coupled in self._of_parts.items() if name in changed}
        changed.update(name for name, coupled in self._of_parts.items() if name in before and (
            coupled.scope, _TIMED.get(coupled.group, coupled.group)) in groups)
        return [before[name] for name in before if name in changed]

    @contextlib.contextmanager
    def without_acting(self) -> Iterator[None]:
        """Let changes of parameters change nothing else, as what they say acts already."""
        before, self.showing = self.showing, True
        try:
            yield
        finally:
            self.showing = before

    def _complete(self, parameters: list[Parameter]) -> list[Parameter]:
        """
        Add the parameters of the same joints, and timeouts that follow the control mode.

        Of several in one change, that of fewer parts acts, and of equal parts the last one.
        """
        values = {change.name: self._as_declared(change) for change in parameters}
        known = self._of_parts
        for change in sorted([change for change in values.values() if change.name in known],
                             key=lambda change: -len(known[change.name].atomic)):
            for name in known[change.name].same:
                values[name] = Parameter(name, change.type_, change.value)
        if not self.showing:
            self._complete_timeouts(values)
        # Parts that consist of several have the values in which these agree.
        for name, coupled in known.items():
            if not coupled.is_atomic and {*coupled.atomic} & {*values} and (
                    name not in values or _problem(self._specs[name], values[name]) is None):
                ones = [values.get(atom) or self._node.get_parameter(atom)
                        for atom in coupled.atomic]
                if all(parameter.value == ones[0].value for parameter in ones):
                    values[name] = Parameter(name, ones[0].type_, ones[0].value)
        return [*values.values()]

    def _complete_timeouts(self, values: dict[str, Parameter]) -> None:
        """Add that timeouts which change do not follow the control mode, and those that do."""
        known = self._of_parts
        for timeout in [name for name, coupled in known.items()
                        if coupled.is_atomic and coupled.group == 'command_timeout']:
            scope, part = known[timeout].scope, known[timeout].part
            follows, mode = (scope.parameter(f'{group}.{part}')
                             for group in ('timeout_follows_mode', 'control_mode'))
            if timeout in values and follows not in values:
                values.update({name: Parameter(name, value=False)
                               for name in known[follows].same})
            present = {name: values.get(name) or self._node.get_parameter(name)
                       for name in (follows, mode)}
            if {*present} & {*values} and present[follows].value is True and (
                    present[mode].value in [*MODES]):
                values.update({name: Parameter(
                    name, value=default_timeout(part, present[mode].value))
                    for name in known[timeout].same})

    @property
    def values(self) -> dict[str, Any]:
        """The present values of all declared parameters, by name, as of :meth:`value`."""
        return {name: self.value(name) for name in self._specs}

    def value(self, name: str) -> Any:
        """Return the present value of a parameter, as YAML or JSON has it."""
        value = self._node.get_parameter(name).value
        return value if isinstance(value, (str, bool, int, float)) else list(value)

    def lockstep_parts(self, simulation: Simulation, robots: Mapping[Scope, SimulatedRobot]
                       ) -> tuple[dict[str, list[str]], bool]:
        """
        Return the parts whose commands lock-step waits for, by robot, and whether for the arena's.

        :raises ParameterError: if a robot has no such part, or lock-step would wait for nothing
        """
        needed, names = {}, [scope.parameter('lockstep_parts') for scope in robots]
        # In ROS parameters, a list with one empty string stands for an empty list of strings.
        given = [[part for part in self.value(name) if part] for name in names]
        for name, robot, parts in zip(names, robots.values(), given):
            known = [*robot.parts, *[ARENA] * bool(simulation.surroundings.actuators)]
            if parts == ['arm'] and 'arm' not in robot.parts:
                parts = list(robot.parts)
            for part in parts:
                if part not in known:
                    raise ParameterError(f"parameter '{name}': this robot has no part '{part}'; "
                                         f'it has {", ".join(robot.parts)}')
            needed[robot.name] = [part for part in parts if part != ARENA]
        lockstep = self.value('stepping') == 'lockstep'
        if lockstep and not any(given):
            raise ParameterError(f"parameter '{names[0]}': lockstep needs at least one part")
        return needed, lockstep and any(ARENA in parts for parts in given)

    def _as_declared(self, parameter: Parameter) -> Parameter:
        spec = self._specs.get(parameter.name)
        value = parameter.value if spec is None else spec.as_declared(parameter.value)
        if spec is None or value is parameter.value:
            return parameter
        return Parameter(parameter.name, Parameter.Type[spec.type.upper()], value)

    def _validate(self, parameters: list[Parameter]) -> SetParametersResult:
        for parameter in parameters:
            spec = self._specs.get(parameter.name)
            if spec is None or parameter.value is None:
                continue
            problem = _problem(spec, parameter)
            if problem:
                return SetParametersResult(successful=False, reason=problem)
        return SetParametersResult(successful=True)


def _problem(spec: ParameterSpec, parameter: Parameter) -> str | None:
    return (spec.type_problem(parameter.type_.name.lower(), parameter.value)
            or spec.problem_with(parameter.value))


def _descriptor(spec: ParameterSpec) -> ParameterDescriptor:
    """Return what ``ros2 param describe`` prints."""
    descriptor = ParameterDescriptor(
        description=spec.description + (f' [{spec.unit}]' if spec.unit else ''),
        read_only=not spec.live)
    if spec.choices:
        descriptor.additional_constraints = f'One of: {", ".join(spec.choices)}.'
    if spec.length is not None:
        descriptor.additional_constraints = f'{spec.length} finite numbers' + (
            '.' if spec.minimum is None else f' from {spec.minimum:g} to {spec.maximum:g}.')
    elif spec.minimum is not None and spec.maximum is not None:
        if isinstance(spec.default, float):
            descriptor.floating_point_range = [FloatingPointRange(
                from_value=spec.minimum, to_value=spec.maximum, step=0.0)]
        else:
            descriptor.integer_range = [IntegerRange(
                from_value=int(spec.minimum), to_value=int(spec.maximum), step=1)]
    return descriptor
