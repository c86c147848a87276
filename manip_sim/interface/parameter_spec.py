# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""One parameter of the node: its type, its limits, and what is wrong with a value."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math
from typing import Any

from manip_sim.errors import describe_choices, ModelError
from manip_sim.interface.scope import Scope
from manip_sim.models.composing import read_gripper
from manip_sim.models.sources import find_source, is_path
from manip_sim.quoting import quoted

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
        ``manip_sim.models.sources`` knows
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

        Integers become doubles, and an empty array becomes one with an empty string.
        """
        if isinstance(self.default, float) and type(value) is int:
            return _as_double(value)
        if self.length:
            whole = isinstance(value, Sequence) and not isinstance(value, str) and value and all(
                type(item) is int for item in value)
            return [_as_double(item) for item in value] if whole else value
        if isinstance(self.default, list) and not value:
            return ['']
        return value

    def type_problem(self, found: str, value: Any) -> str | None:
        """
        Return what is wrong with the type of a value, or None.

        :param found: the type, as ROS calls it
        """
        if found == self.type:
            return None
        hint = (f': quote it, as in {str(value)!r}'
                if self.type == 'string' and not self.choices else
                f': write a list, "[{value}]"' if f'{found}_array' == self.type else '')
        return f"parameter '{self.name}' must be of type {self.type}, got {value!r}{hint}"

    def problem_with(self, value: Any) -> str | None:
        """Return what is wrong with a value that has the right type, or None."""
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
        """Return what is wrong with a number, or None."""
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
