# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Parameters of the node: types, limits, checks, files, and values given without a node."""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
import math
from pathlib import Path
import re
from typing import Any, Protocol

from manip_sim.control.reflexes import ReflexLimits
from manip_sim.errors import describe_choices, ModelError, ParameterError
from manip_sim.interface.topics import Scope
from manip_sim.models.registry import find_source, is_path
from manip_sim.models.robots.robot_model import SUBSYSTEMS
from manip_sim.models.user_files import read_yaml, StrictLoader
from manip_sim.models.world import read_gripper
from manip_sim.physics.parts import Part
from manip_sim.quoting import quoted, quoted_names

#: The node's name with its namespace, unless it is started in another one.
NODE = '/manip_sim'
_PARAMETERS = 'ros__parameters'


class _Loader(StrictLoader):
    """Resolves the types of plain scalars as rcl_yaml_param_parser does."""

    yaml_implicit_resolvers: dict[str, Any] = {}


_Loader.add_implicit_resolver('tag:yaml.org,2002:bool', re.compile(
    r'(?:y|Y|yes|Yes|YES|n|N|no|No|NO|true|True|TRUE|false|False|FALSE|on|On|ON|off|Off|OFF)\Z'),
    list('yYnNtTfFoO'))
_Loader.add_implicit_resolver('tag:yaml.org,2002:int', re.compile(
    r'[-+]?(?:0x[0-9a-fA-F]+|[0-9]+)\Z'), list('-+0123456789'))
_Loader.add_implicit_resolver('tag:yaml.org,2002:float', re.compile(
    r'[-+]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?|\.?inf|\.?nan)\Z',
    re.IGNORECASE), list('-+.0123456789iInN'))
_Loader.add_constructor('tag:yaml.org,2002:bool', lambda loader, node: (
    loader.construct_scalar(node)[0] in 'yYtT' or node.value.lower() == 'on'))
_Loader.add_constructor('tag:yaml.org,2002:float', lambda loader, node: float(
    loader.construct_scalar(node).lower().replace('.inf', 'inf').replace('.nan', 'nan')))


def read_parameters(file: Path) -> dict[str, Any]:
    """
    Return the parameters that a file has for the node, by name with dots.

    Where several sections are for it, later ones override earlier ones.

    :raises ModelError: if the file cannot be read, or is not plain YAML
    :raises ParameterError: if nothing in it is for the node, or a section is not a mapping
    """
    sections = list(sections_of(read_yaml(file, _Loader)))
    if not any(matches(node, NODE) for node, _ in sections):
        has = f'is for {quoted_names([node for node, _ in sections])}' if sections else (
            f"has no key '{_PARAMETERS}' below the name of a node")
        raise ParameterError(f'{file} has no parameters for {NODE}, it {has}')
    values: dict[str, Any] = {}
    for node, parameters in sections:
        if matches(node, NODE):
            if not isinstance(parameters, dict):
                raise ParameterError(f'{file}: {quoted(node)}: {_PARAMETERS} must hold names and '
                                     'values')
            values.update(_flat(parameters))
    return values


def _flat(parameters: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for name, value in parameters.items():
        if isinstance(value, dict):
            yield from ((f'{name}.{below}', item) for below, item in _flat(value))
        else:
            yield name, value


def sections_of(content: Any) -> Iterator[tuple[str, Any]]:
    """Yield the node names and patterns of a parameters file, with the content below each."""
    def walk(content: Any, keys: tuple[str, ...]) -> Iterator[tuple[str, Any]]:
        if isinstance(content, dict):
            for key, below in content.items():
                if key == _PARAMETERS:
                    yield '/'.join(keys), below
                else:
                    yield from walk(below, (*keys, str(key).strip('/')))
    yield from walk(content, ())


def matches(pattern: str, node_name: str) -> bool:
    """Return whether a node name, or a pattern with ``*`` and ``**``, stands for a node."""
    tokens = [token for token in pattern.split('/') if token]
    expression = ''.join('(/[^/]+)*' if token == '**'
                         else '/' + re.escape(token).replace(r'\*', '[^/]*') for token in tokens)
    return re.fullmatch(expression, node_name) is not None


_TYPES = {bool: 'bool', int: 'integer', float: 'double', str: 'string'}


def type_name(value: Any) -> str:
    """Return the type of a value as ROS calls it, such as ``double`` or ``string_array``."""
    if not isinstance(value, (list, tuple)):
        return _TYPES.get(type(value), type(value).__name__)
    names = {type_name(item) for item in value}
    return f'{names.pop()}_array' if len(names) == 1 else 'array'


def _as_double(value: float) -> float:
    """Return a number as a double; a whole number from a file may be too great for one."""
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


@dataclass(frozen=True)
class ParameterSpec:
    """
    One parameter.

    :ivar default: also determines the type
    :ivar live: whether it may change while the node runs
    :ivar minimum: and ``maximum``: inclusive limits of a number
    :ivar choices: the values that a string may have
    :ivar length: of an array of finite numbers, where it is fixed
    :ivar kind: of the models that it may name, such as ``robots``: also files, and what
        ``manip_sim.models.registry`` knows
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
    kind: str = ''

    def within(self, scope: Scope) -> ParameterSpec:
        """Return the same parameter for one of several robots."""
        return replace(self, name=scope.parameter(self.name))

    @property
    def type(self) -> str:
        """The type as ROS calls it, such as ``double``."""
        return type_name(self.default)

    def as_declared(self, value: Any) -> Any:
        """
        Return a value converted to the declared type, where ROS parses it as another one.

        Integers become doubles. An empty array becomes the default, of strings one with an empty
        string.
        """
        if isinstance(self.default, float) and type(value) is int:
            return _as_double(value)
        if self.length:
            whole = isinstance(value, Sequence) and not isinstance(value, str) and value and all(
                type(item) is int for item in value)
            return [_as_double(item) for item in value] if whole else value
        if isinstance(self.default, list) and not value:
            return [''] if self.type == 'string_array' else [*self.default]
        return value

    def type_problem(self, ros_type: str, value: Any) -> str | None:
        """
        Return the problem with the type of a value, or None.

        :param ros_type: the type, as ROS calls it
        """
        if ros_type == self.type:
            return None
        hint = (f': quote it, as in {str(value)!r}'
                if self.type == 'string' and not self.choices else
                f': write a list, "[{value}]"' if f'{ros_type}_array' == self.type else '')
        return f"parameter '{self.name}' must be of type {self.type}, got {value!r}{hint}"

    def problem_with(self, value: Any) -> str | None:
        """Return the problem with a value of the right type, or None."""
        try:
            return self._unknown(value) or self._out_of_range(value)
        except ModelError as error:  # In the text that names grippers by arm.
            return str(error)

    def _unknown(self, value: Any) -> str | None:
        values = value if isinstance(value, (list, tuple)) else [value]
        if self.kind == 'grippers':
            by_arm = read_gripper(value, f"parameter '{self.name}'")
            values = [by_arm] if isinstance(by_arm, str) else list(by_arm.values())
        for item in values if self.choices else ():
            if item not in self.choices and not (self.kind and (
                    is_path(item) or find_source(item, self.kind) is not None)):
                return (f"parameter '{self.name}': unknown value {quoted(item)}: "
                        f'{describe_choices(item, self.choices)}')
        return None

    def _out_of_range(self, value: Any) -> str | None:
        if self.length is not None and not (
                len(value) == self.length and all(map(math.isfinite, value))):
            return (f"parameter '{self.name}' must be {self.length} finite numbers, "
                    f'got {list(value)}')
        if self.length is not None:
            return next(filter(None, map(self._outside, value)), None)
        return self._outside(value)

    def _outside(self, value: Any) -> str | None:
        """Return the problem with the range of a number, or None."""
        if isinstance(value, float) and self.minimum is None and not math.isfinite(value):
            return f"parameter '{self.name}' must be a finite number, got {value}"
        if (self.minimum is not None and self.maximum is not None
                and not self.minimum <= value <= self.maximum):
            whole = type(value) is int and abs(value) < 2**63
            low, high, got = (f'{x:.0f}' if whole else f'{_as_double(x):g}'
                              for x in (self.minimum, self.maximum, value))
            return (f"parameter '{self.name}' must be from {low} to "
                    f'{high}{self.unit and " " + self.unit}, got {got}')
        return None


#: Parameters that every rclpy node knows.
_OF_RCLPY = ('use_sim_time', 'start_type_description_service')
#: Name of the parameter that a robot has, after its namespace, if it came while the node ran.
SPAWNED = 'spawned'


#: Parameters of parts that set the same parameters of the parts that a part consists of.
COUPLED = ('control_mode.{}', 'command_timeout.{}', 'timeout_follows_mode.{}',
           'stream_interval.{}', 'stream_hold.{}', 'integral_gain.{}',
           *(f'reflex.{{}}.{field.name}' for field in fields(ReflexLimits)))


def coupled_names(scope: Scope, pattern: str, parts: Iterable[str], known: Container[str]
                  ) -> dict[str, str]:
    """
    Return the names of the parameters of one of :data:`COUPLED` that are known, by part.

    :param scope: of the robot
    :param pattern: with the part as ``{}``
    """
    return {part: name for part in parts
            if (name := scope.parameter(pattern.format(part))) in known}


class ParameterSource(Protocol):
    """A declarer of parameters that returns their values: a node or :class:`GivenParameters`."""

    def declare(self, specs: Sequence[ParameterSpec]) -> None:
        """Declare parameters; ParameterError if a given value cannot be used."""

    def couple(self, scope: Scope, parts: Mapping[str, Part]) -> None:
        """
        Let parameters of a part set the same ones of its parts, and under its other name.

        Those that are declared; a value given for one arm overrides one given for both.
        """

    def value(self, name: str) -> Any:
        """Return the value of a declared parameter."""


class GivenParameters:
    """
    Parameters from a file or a command line.

    :param given: values by name
    :ivar given: the same, a copy
    :ivar specs: of the declared parameters, by name
    """

    def __init__(self, given: Mapping[str, Any]) -> None:
        self.given = dict(given)
        self._values: dict[str, Any] = {}
        self.specs: dict[str, ParameterSpec] = {}

    def declare(self, specs: Sequence[ParameterSpec]) -> None:
        """
        Declare parameters and read their given values.

        :raises ParameterError: if a value cannot be used
        """
        for spec in specs:
            self.specs[spec.name] = spec
            self._values[spec.name] = spec.default
            if spec.name in self.given:
                value = spec.as_declared(self.given[spec.name])
                problem = spec.type_problem(type_name(value), value) or spec.problem_with(value)
                if problem:
                    raise ParameterError(problem)
                self._values[spec.name] = value

    def couple(self, scope: Scope, parts: Mapping[str, Part]) -> None:
        """Let parameters of a part set the same ones of its parts, and under its other name."""
        for pattern in COUPLED:
            names = coupled_names(scope, pattern, parts, self.specs)
            for part in sorted(names, key=lambda part: parts[part].atomic == (part,)):
                if names[part] in self.given:
                    value = self.specs[names[part]].as_declared(self.given[names[part]])
                    self._values.update({name: value for other, name in names.items()
                                         if {*parts[other].atomic} <= {*parts[part].atomic}})
            # Parts that consist of several have the values in which these agree.
            for part, name in names.items():
                shared = {self._values[names[member]] for member in parts[part].atomic
                          if member in names}
                if len(shared) == 1:
                    self._values[name] = shared.pop()

    def value(self, name: str) -> Any:
        """Return the value of a declared parameter."""
        return self._values[name]

    def check_names(self) -> None:
        """
        Reject given parameters that nobody declared; forget parameters of spawned robots.

        :raises ParameterError: naming the nearest parameters
        """
        forget_spawned(self.given, self.specs)
        check_names(self.given, self.specs)


def spawned_parameter(scope: Scope) -> ParameterSpec:
    """Return the parameter that marks a robot that was spawned while the node ran."""
    return ParameterSpec(SPAWNED, True, 'The robot was spawned: a node that starts with a dump of '
                         'the parameters leaves out those of this robot.').within(scope)


def forget_spawned(values: dict[str, Any], known: Iterable[str]) -> None:
    """
    Remove the parameters of spawned robots, which the dump of a node has.

    :param values: parameters by name; changed
    :param known: names of those that were declared; a robot that has some of them stays
    """
    spawned = {name.partition('.')[0] for name in values if name.partition('.')[2] == SPAWNED}
    spawned -= {name.partition('.')[0] for name in known}
    for name in [name for name in values if name.partition('.')[0] in spawned]:
        del values[name]


def check_names(names: Iterable[str], known: Iterable[str]) -> None:
    """
    Reject names of parameters that are not known, but for those that every node has.

    :raises ParameterError: naming the nearest parameters
    """
    known = list(known)
    for name in names:
        if name in known or name in _OF_RCLPY or name.startswith('qos_overrides.'):
            continue
        missing = [f'this robot has no {part}, ' for part in name.split('.')
                   if part in SUBSYSTEMS and not any(
                       other.endswith(f'control_mode.{part}') for other in known)]
        raise ParameterError(f"unknown parameter {quoted(name, 200)}: {''.join(missing)}"
                             f'{describe_choices(name, known)}')
