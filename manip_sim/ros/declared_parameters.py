# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Declare the node's parameters, read what the user gave and validate changes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult)
from rclpy.node import Node
from rclpy.parameter import Parameter

from manip_sim.control.modes import MODES
from manip_sim.control.reflexes import ReflexLimits
from manip_sim.errors import ParameterError
from manip_sim.interface.given_parameters import check_names, forget_spawned
from manip_sim.interface.parameter_spec import ParameterSpec
from manip_sim.interface.parameters import default_timeout
from manip_sim.interface.scope import Scope
from manip_sim.physics.parts import Part
from manip_sim.rclpy_internals import forget_parameters, parameter_overrides

#: Parameters of parts whose values are those of the parts that a part consists of.
_COUPLED = ('control_mode.{}', 'command_timeout.{}', 'stream_interval.{}', 'stream_hold.{}',
            *(f'reflex.{{}}.{field.name}' for field in fields(ReflexLimits)))
_MODE, _TIMEOUT = _COUPLED[:2]


class Parameters:
    """
    The parameters of a node: declares them and validates their changes.

    :param node: the node; its overrides may give an integer where a double is declared
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._specs: dict[str, ParameterSpec] = {}
        self._parts: dict[Scope, Mapping[str, Part]] = {}
        #: Scope, one of :data:`_COUPLED`, and part of the parameters of parts.
        self._of_part: dict[str, tuple[Scope, str, str]] = {}
        #: Timeouts that the user has set, and those that follow the modes in the present change.
        self._set_timeouts: set[str] = set()
        self._following: set[str] = set()
        #: True while parameters are changed to the settings that act already.
        self.showing = False
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
        """Remove all parameters of a robot that came while the node ran."""
        begin = scope.parameter('')
        self._parts.pop(scope, None)
        self._of_part = {name: found for name, found in self._of_part.items() if found[0] != scope}
        self._set_timeouts = {name for name in self._set_timeouts if not name.startswith(begin)}
        self._specs = {name: spec for name, spec in self._specs.items()
                       if not name.startswith(begin)}
        forget_parameters(self._node, (begin,))

    @property
    def names(self) -> list[str]:
        """The names of all parameters but those of QoS."""
        return [*self._specs]

    def check_names(self) -> None:
        """
        Reject parameters that the user gave and nobody declared; forget those of spawned robots.

        :raises ParameterError: naming the nearest ones
        """
        overrides = parameter_overrides(self._node)
        forget_spawned(overrides, self._specs)
        check_names(overrides, self._specs)

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

        At the start, a value given for one arm overrides one given for both, and a timeout that
        is the default of the control mode follows it.
        """
        self._parts[scope] = parts
        given = parameter_overrides(self._node)
        for pattern in _COUPLED:
            names = {scope.parameter(pattern.format(part)): part for part in parts}
            names = {name: part for name, part in names.items() if name in self._specs}
            self._of_part.update({name: (scope, pattern, part) for name, part in names.items()})
            for whole in (True, False):
                for name, part in names.items():
                    if name in given and whole == (parts[part].atomic != (part,)):
                        self._node.set_parameters([given[name]])
        for name in [*self._set_timeouts]:
            its, _, part = self._of_part[name]
            mode = self.value(its.parameter(_MODE.format(part)))
            if self.value(name) == default_timeout(part, mode):
                self._set_timeouts.discard(name)

    def of_atomic_part(self, name: str) -> tuple[Scope, str, str] | None:
        """
        Return the scope, the group and the part of a parameter that acts on an atomic part.

        Those of other parts, and None, have no effect but on the parameters of atomic parts.
        """
        scope, pattern, part = self._of_part.get(name, (None, '', ''))
        if scope is None or self._parts[scope][part].atomic != (part,):
            return None
        return scope, pattern.replace('.{}', ''), part

    def show(self, values: Mapping[str, Any], timeouts: Mapping[str, bool]) -> None:
        """
        Let parameters have the values that act already.

        :param values: by name; names that are not declared are left out
        :param timeouts: of atomic parts, by name, whether they were set
        """
        changed = [Parameter(name, value=value) for name, value in values.items()
                   if name in self._specs and self.value(name) != value]
        self.showing = True
        try:
            self._node.set_parameters(changed)
        finally:
            self.showing = False
        for name, is_set in timeouts.items():
            scope, pattern, part = self._of_part[name]
            names = {name, *(scope.parameter(pattern.format(other))
                             for other in _coupled_parts(self._parts[scope], part))}
            if is_set:
                self._set_timeouts |= names
            else:
                self._set_timeouts -= names

    def _with_coupled(self, parameters: list[Parameter]) -> list[Parameter]:
        """
        Add the parameters of the same joints.

        Of several in one change, that of fewer parts acts, and of equal parts the last one.
        """
        values = {parameter.name: parameter for parameter in parameters}
        coupled = [(parameter, *self._of_part[parameter.name]) for parameter in parameters
                   if parameter.name in self._of_part]
        for parameter, scope, pattern, part in sorted(
                coupled, key=lambda found: -len(self._parts[found[1]][found[3]].atomic)):
            for other in (part, *_coupled_parts(self._parts[scope], part)):
                name = scope.parameter(pattern.format(other))
                if name in self._specs:
                    values[name] = Parameter(name, parameter.type_, parameter.value)
        for scope, pattern in {found[1:3]: None for found in coupled}:
            self._join(scope, pattern, values)
        return [*values.values()]

    def _join(self, scope: Scope, pattern: str, values: dict[str, Parameter]) -> None:
        """Add the parameters of parts that consist of several, where these agree."""
        for name, (its, own, part) in self._of_part.items():
            atomic = self._parts[its][part].atomic
            if (its, own) != (scope, pattern) or len(atomic) < 2:
                continue
            names = [scope.parameter(pattern.format(other)) for other in atomic]
            parts = [values.get(n) or self._node.get_parameter(n) for n in names]
            if name not in values and any(n in values for n in names) and all(
                    one.value == parts[0].value for one in parts):
                values[name] = Parameter(name, parts[0].type_, parts[0].value)

    def _with_timeouts(self, parameters: list[Parameter]) -> list[Parameter]:
        """Add the timeouts of parts whose control mode is set, unless the user has set them."""
        known = {parameter.name for parameter in parameters} | self._set_timeouts
        self._following = set()
        for parameter in () if self.showing else list(parameters):
            scope, pattern, part = self._of_part.get(parameter.name, (None, '', ''))
            if scope is None or pattern != _MODE or parameter.value not in [*MODES]:
                continue
            name = scope.parameter(_TIMEOUT.format(part))
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
        if not self.showing:
            self._set_timeouts.update(
                parameter.name for parameter in parameters if parameter.name not in self._following
                and self._of_part.get(parameter.name, ('', '', ''))[1] == _TIMEOUT)
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
