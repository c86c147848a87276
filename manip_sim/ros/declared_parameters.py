# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Declare the node's parameters, read what the user gave and validate changes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult)
from rclpy.node import Node
from rclpy.parameter import Parameter

from manip_sim.control.modes import MODES
from manip_sim.errors import ParameterError
from manip_sim.interface.given_parameters import check_names
from manip_sim.interface.parameter_spec import ParameterSpec
from manip_sim.interface.parameters import default_timeout
from manip_sim.interface.scope import Scope
from manip_sim.physics.parts import Part
from manip_sim.rclpy_internals import forget_parameters, parameter_overrides

#: Groups of parameters whose values for a part are those of the parts that it consists of.
_COUPLED = ('control_mode', 'command_timeout', 'stream_interval', 'stream_hold')


class Parameters:
    """
    The parameters of a node: declares them and validates their changes.

    :param node: the node; its overrides may give an integer where a double is declared
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._specs: dict[str, ParameterSpec] = {}
        self._parts: dict[Scope, Mapping[str, Part]] = {}
        #: Timeouts that the user has set, and those that follow the modes in the present change.
        self._set_timeouts: set[str] = set()
        self._following: set[str] = set()
        node.add_pre_set_parameters_callback(lambda parameters: self._with_timeouts(
            self._with_coupled([self._as_declared(parameter) for parameter in parameters])))
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
                given = overrides[spec.name] = self._as_declared(overrides[spec.name])
                problem = _problem(spec, given)
                if problem:
                    raise ParameterError(problem)
            self._node.declare_parameter(spec.name, spec.default, _descriptor(spec))

    def undeclare(self, scope: Scope) -> None:
        """Remove all parameters of a robot, and those of the QoS of its topics."""
        begin = scope.parameter('')
        self._parts.pop(scope, None)
        self._set_timeouts = {name for name in self._set_timeouts if not name.startswith(begin)}
        self._specs = {name: spec for name, spec in self._specs.items()
                       if not name.startswith(begin)}
        topics = self._node.resolve_topic_name(scope.topic('joint_states')).removesuffix(
            'joint_states')
        forget_parameters(self._node, (begin, f'qos_overrides.{topics}'))

    @property
    def names(self) -> list[str]:
        """The names of all parameters but those of QoS."""
        return [*self._specs]

    def check_names(self) -> None:
        """
        Reject parameters that the user gave and nobody declared.

        :raises ParameterError: naming the nearest ones
        """
        check_names(parameter_overrides(self._node), self._specs)

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
        Let parameters of a part set those of the parts that it consists of, and of its other name.

        At the start, a value given for one arm overrides one given for both.
        """
        self._parts[scope] = parts
        given = parameter_overrides(self._node)
        for whole in (True, False):
            for part in parts:
                for group in _COUPLED:
                    name = scope.parameter(f'{group}.{part}')
                    if name in given and whole == (parts[part].atomic != (part,)):
                        self._node.set_parameters([given[name]])

    def of_part(self, name: str) -> tuple[Scope, str, str] | None:
        """Return the scope, the group and the part that a parameter belongs to, or None."""
        for scope, parts in self._parts.items():
            for group in _COUPLED:
                begin = scope.parameter(f'{group}.')
                if name.startswith(begin) and name[len(begin):] in parts:
                    return scope, group, name[len(begin):]
        return None

    def _with_coupled(self, parameters: list[Parameter]) -> list[Parameter]:
        """Add the parameters of coupled parts, unless the user sets them at the same time."""
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

    def _with_timeouts(self, parameters: list[Parameter]) -> list[Parameter]:
        """Add the timeouts of parts whose control mode is set, unless the user has set them."""
        known = {parameter.name for parameter in parameters} | self._set_timeouts
        self._following = set()
        for parameter in list(parameters):
            scope, group, part = self.of_part(parameter.name) or (None, '', '')
            if scope is None or group != 'control_mode' or parameter.value not in [*MODES]:
                continue
            name = scope.parameter(f'command_timeout.{part}')
            if name not in known:
                self._following.add(name)
                parameters.append(Parameter(
                    name, Parameter.Type.DOUBLE, default_timeout(part, parameter.value)))
        return parameters

    def is_set(self, name: str) -> bool:
        """Return whether the user has set a timeout, or it follows the control mode."""
        return name in self._set_timeouts

    @property
    def values(self) -> dict[str, Any]:
        """The present values of all that was declared, by name, as YAML or JSON has them."""
        found = {name: self.value(name) for name in self._specs}
        return {name: value if isinstance(value, (str, bool, int, float)) else list(value)
                for name, value in found.items()}

    def value(self, name: str) -> Any:
        return self._node.get_parameter(name).value

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
        self._set_timeouts.update(
            parameter.name for parameter in parameters if parameter.name not in self._following
            and (self.of_part(parameter.name) or ('', '', ''))[1] == 'command_timeout')
        return SetParametersResult(successful=True)


def _problem(spec: ParameterSpec, given: Parameter) -> str | None:
    return (spec.type_problem(given.type_.name.lower(), given.value)
            or spec.problem_with(given.value))


def _coupled_parts(parts: Mapping[str, Part], part: str) -> list[str]:
    """Return the parts that a part consists of, and its other name."""
    own = set(parts[part].atomic)
    return [name for name, other in parts.items() if name != part
            and other.gripper is None and set(other.atomic) <= own]


def _descriptor(spec: ParameterSpec) -> ParameterDescriptor:
    """Return what ``ros2 param describe`` prints."""
    descriptor = ParameterDescriptor(
        description=spec.description + (f' [{spec.unit}]' if spec.unit else ''),
        read_only=not spec.live)
    if spec.choices:
        descriptor.additional_constraints = f'One of: {", ".join(spec.choices)}.'
    if spec.minimum is not None and spec.maximum is not None:
        if isinstance(spec.default, float):
            descriptor.floating_point_range = [FloatingPointRange(
                from_value=spec.minimum, to_value=spec.maximum, step=0.0)]
        else:
            descriptor.integer_range = [IntegerRange(
                from_value=int(spec.minimum), to_value=int(spec.maximum), step=1)]
    return descriptor
