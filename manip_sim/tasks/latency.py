# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Latency of an episode's commands and states, in simulated time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math
from typing import Union

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.quoting import shown

#: Longest latency [s]; a longer one is a mistake in the unit.
LONGEST_S = 10.0
#: Share of a timestep by which a duration may miss a whole number of them.
_ROUNDING = 1e-6
_KEYS = ('command', 'state')


@dataclass(frozen=True)
class Latency:
    """
    How much later a command takes effect, and how old an observed state is.

    :ivar command_s: from an observation's arrival at the policy to the effect of its action [s]
    :ivar state_s: from the instant of a state to its arrival at the policy [s]
    """

    command_s: float = 0.0
    state_s: float = 0.0

    @classmethod
    def of(cls, given: LatencyLike) -> Latency:
        """
        Return a latency from what a user gives.

        :param given: a latency, that of commands [s], or a mapping with ``command`` and
            ``state`` [s]
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
                raise ModelError(f'latency of a {key} must be from 0 to {LONGEST_S:g} s, got '
                                 f'{shown(value)}')
        return cls(float(values.get('command', 0.0)), float(values.get('state', 0.0)))


NO_LATENCY = Latency()
LatencyLike = Union[Latency, float, Mapping[str, float]]


def whole_steps(duration_s: float, timestep_s: float, what: str) -> int:
    """
    Return the number of physics steps in a duration.

    :param duration_s: [s]
    :param timestep_s: of the physics [s]
    :param what: what the duration is, for the message
    :raises ModelError: if it is no whole number of timesteps
    """
    steps = duration_s / timestep_s
    if not math.isfinite(steps) or abs(steps - round(steps)) > _ROUNDING:
        raise ModelError(f'{what} must be a whole number of timesteps of {timestep_s:g} s, got '
                         f'{duration_s:g} s')
    return round(steps)
