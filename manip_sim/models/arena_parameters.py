# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Parameters of an arena: name, default, unit, limits and description."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
import math
import numbers
from typing import Any, Union

from manip_sim.errors import ModelError
from manip_sim.quoting import shown

Value = Union[bool, float]


@dataclass(frozen=True)
class ArenaParameter:
    """
    A number or a flag that an arena can be created with.

    :ivar name: such as ``table_length``
    :ivar default: of the type of the parameter, bool or float
    :ivar description: a phrase, without a full stop
    :ivar unit: such as ``m``, empty if there is none
    :ivar low: the least value of a number
    :ivar high: the greatest value of a number
    :ivar keyword: of the arena's constructor, if it is not the name
    """

    name: str
    default: Value
    description: str
    unit: str = ''
    low: float = -math.inf
    high: float = math.inf
    keyword: str = ''

    @property
    def argument(self) -> str:
        """The keyword of the arena's constructor."""
        return self.keyword or self.name

    @property
    def limits(self) -> str:
        """The values that can be given, such as ``0.3 to 5 m``."""
        if isinstance(self.default, bool):
            return 'true or false'
        return f'{self.low:g} to {self.high:g} {self.unit}'.rstrip()

    def check(self, value: Any, arena: str) -> None:
        """
        Reject a value of the wrong type or outside the limits.

        :raises ModelError: naming arena, parameter and limits
        """
        if isinstance(self.default, bool):
            fits = isinstance(value, bool)
        else:
            fits = (not isinstance(value, bool) and isinstance(value, numbers.Real)
                    and self.low <= float(value) <= self.high)
        if not fits:
            raise ModelError(f"parameter '{self.name}' of the arena {arena} must be "
                             f'{self.limits}, got {shown(value)}')


def check_arguments(parameters: Iterable[ArenaParameter], arena: str, **arguments: Any) -> None:
    """
    Check arguments of an arena's constructor.

    :raises ModelError: naming arena, parameter and limits
    """
    for parameter in parameters:
        if parameter.argument in arguments:
            parameter.check(arguments[parameter.argument], arena)
