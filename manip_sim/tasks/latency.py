# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Latency of an episode's commands and states, in simulated time, as users give it.

The ``sensing`` of the robots delays both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
import math
from typing import Union

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.quoting import format_value
from manip_sim.sensing.robot_sensing import ROUNDING

#: Longest latency [s]; a longer one is a mistake in the unit.
LONGEST_S = 10.0
_KEYS = ('command', 'state', 'command_jitter', 'state_jitter')


@dataclass(frozen=True)
class Latency:
    """
    Delay of commands, and age of observed states.

    :ivar command_s: from an observation's arrival at the policy to the effect of its action [s]
    :ivar state_s: from the instant of a state to its arrival at the policy [s]
    :ivar command_jitter_s: standard deviation of the former, drawn from the seed [s]
    :ivar state_jitter_s: that of the latter [s]
    """

    command_s: float = 0.0
    state_s: float = 0.0
    command_jitter_s: float = 0.0
    state_jitter_s: float = 0.0

    @classmethod
    def of(cls, given: LatencyLike) -> Latency:
        """
        Return a latency from what a user gives.

        :param given: a latency, that of commands [s], or a mapping with ``command``,
            ``state``, ``command_jitter`` and ``state_jitter`` [s]
        :raises UnknownNameError: if a key of the mapping is another one
        :raises ModelError: if a number is not finite, negative or above 10 s
        """
        if isinstance(given, Latency):
            return given
        values = given if isinstance(given, Mapping) else {'command': given}
        for key, value in values.items():
            if key not in _KEYS:
                raise UnknownNameError('key of latency', key, _KEYS)
            if (isinstance(value, bool) or not isinstance(value, (int, float))
                    or not 0.0 <= value <= LONGEST_S):  # NaN is not either.
                kind = key.replace('_', ', ')
                raise ModelError(f'latency of a {kind} must be from 0 to {LONGEST_S:g} s, got '
                                 f'{format_value(value)}')
        return cls(*(float(values.get(key, 0.0)) for key in _KEYS))

    def as_mapping(self) -> dict[str, float]:
        """Return what :meth:`of` takes."""
        return {key: getattr(self, f'{key}_s') for key in _KEYS}

    def rounded_up(self, timestep_s: float) -> Latency:
        """
        Return the latency with means of whole timesteps, of which the shortest is one.

        :param timestep_s: of the physics [s]
        """
        command_s, state_s = (timestep_s * math.ceil(mean_s / timestep_s - ROUNDING)
                              for mean_s in (self.command_s, self.state_s))
        return replace(self, command_s=command_s, state_s=state_s)

    @property
    def quantities(self) -> dict[str, float]:
        """Values above 0, by the names of ``manip_sim.sensing.sensor_noise.QUANTITIES``."""
        return {f'latency.{key}': value for key, value in self.as_mapping().items() if value}

    def check(self, timestep_s: float) -> None:
        """
        Reject means that are not a whole number of timesteps.

        :param timestep_s: of the physics [s]
        :raises ModelError: naming the nearest ones
        """
        for mean_s, kind in ((self.command_s, 'command'), (self.state_s, 'state')):
            number_of_parts(mean_s, timestep_s, f'latency of a {kind}', 'timesteps')


NO_LATENCY = Latency()
LatencyLike = Union[Latency, float, Mapping[str, float]]


def number_of_parts(duration_s: float, part_s: float, noun: str, parts: str) -> int:
    """
    Return the number of parts in a duration.

    :raises ModelError: if it is not a whole number of parts
    """
    count = duration_s / part_s
    if not math.isfinite(count) or abs(count - round(count)) > ROUNDING:
        near = ' or '.join(f'{n * part_s:.9g}' for n in (
            math.floor(count), math.floor(count) + 1)) if math.isfinite(count) else ''
        raise ModelError(f'{noun} must be a whole number of {parts} of {part_s:.9g} s, got '
                         f'{duration_s:g} s' + (f'; the nearest are {near} s' if near else ''))
    return round(count)
