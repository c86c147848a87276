# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Latency of an episode's commands and states, and answer time of its policy, as users give them.

The ``sensing`` of the robots delays commands and states, in simulated time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
import math
from typing import Any, Union

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.quoting import format_value
from manip_sim.sensing.robot_sensing import ROUNDING
from manip_sim.validation import whole_number

#: Longest latency [s]; a longer one is a mistake in the unit.
LONGEST_S = 10.0
#: In place of seconds: as long as the policy takes, wall time.
MEASURED = 'measured'
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


@dataclass(frozen=True)
class AnswerTime:
    """
    The time that a policy thinks, simulated, and its use of chunks of actions.

    :ivar mean_s: from the observation to the effect of the first action [s]
    :ivar jitter_s: standard deviation of the single times, drawn from the seed [s]
    :ivar measured: whether each time is the wall time that the policy took, which no seed repeats
    :ivar chunk_hz: rate of the actions of a chunk [Hz]; None for the control rate
    :ivar ask_ahead: number of actions left of a chunk with which the policy is asked again; with
        0 it is asked when all were taken
    """

    mean_s: float = 0.0
    jitter_s: float = 0.0
    measured: bool = False
    chunk_hz: float | None = None
    ask_ahead: int = 0

    @classmethod
    def of(cls, given: AnswerTimeLike) -> AnswerTime:
        """
        Return an answer time from what a user gives.

        :param given: one, or seconds, or ``measured``, or a mapping with ``time`` (one of these),
            ``jitter`` [s], ``chunk_hz`` and ``ask_ahead``
        :raises UnknownNameError: if a key of the mapping is another one
        :raises ModelError: if a value cannot be used
        """
        if isinstance(given, AnswerTime):
            return given
        values = given if isinstance(given, Mapping) else {'time': given}
        known = ('time', 'jitter', 'chunk_hz', 'ask_ahead')
        for key in values:
            if key not in known:
                raise UnknownNameError('key of answer_time', key, known)
        time, rate = values.get('time', 0.0), values.get('chunk_hz')
        measured = isinstance(time, str) and time == MEASURED
        mean_s = 0.0 if measured else _seconds(time, f"answer_time must be '{MEASURED}' or")
        jitter_s = _seconds(values.get('jitter', 0.0), 'jitter of answer_time must be')
        if measured and jitter_s:
            raise ModelError('a measured answer_time has no jitter')
        if rate is not None and (isinstance(rate, bool) or not isinstance(rate, (int, float))
                                 or not 0.0 < rate < math.inf):
            raise ModelError(f'chunk_hz must be above 0 Hz, got {format_value(rate)}')
        return cls(mean_s, jitter_s, measured, None if rate is None else float(rate),
                   whole_number(values.get('ask_ahead', 0), 0, 'ask_ahead'))

    @property
    def is_none(self) -> bool:
        """True if each answer is one action that takes effect at once, unless it is a chunk."""
        return self == NO_ANSWER_TIME

    def as_dict(self) -> dict[str, Any]:
        """Return the fields by name."""
        return asdict(self)


NO_ANSWER_TIME = AnswerTime()
AnswerTimeLike = Union[AnswerTime, float, str, Mapping[str, Any]]


def _seconds(value: Any, noun: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not (
            0.0 <= value <= LONGEST_S):  # NaN is not either.
        raise ModelError(f'{noun} from 0 to {LONGEST_S:g} s, got {format_value(value)}')
    return float(value)
