# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Faults that are planned: what fails, of which part, from when until when; drawn by seed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
import math
from os import fspath, PathLike
from types import MappingProxyType
from typing import Any, cast, NamedTuple, Union

import numpy as np

from manip_sim.errors import describe_choices, ModelError
from manip_sim.models.user_files import parse_yaml, read_yaml
from manip_sim.quoting import format_value, quoted
from manip_sim.validation import listed

#: A YAML file, or what one holds.
FaultsLike = Union[str, PathLike[str], Iterable[Mapping[str, Any]], Mapping[str, Any],
                   'FaultPlan']

_KEYS = ('what', 'part', 'robot', 'from', 'until', 'value', 'chance')


@dataclass(frozen=True)
class FaultKind:
    """
    A kind of fault.

    :ivar meaning: in words
    :ivar value: meaning of its value; empty if it has none
    :ivar default: of the value; None if it must be given
    :ivar most: greatest value; the least is 0, of an offset the negative
    :ivar signed: whether the value may be negative
    """

    meaning: str
    value: str = ''
    default: float | None = 0.0
    most: float = 1.0
    signed: bool = False


FROZEN, LOST, LATE, OFFSET, NOISY = STATE_FAULTS = (
    'frozen_state', 'lost_state', 'late_state', 'offset_state', 'noisy_state')
LIMP, STUCK, LOST_COMMANDS = 'limp', 'stuck', 'lost_commands'
KINDS: Mapping[str, FaultKind] = MappingProxyType({
    FROZEN: FaultKind('joint states stay as they were'),
    LOST: FaultKind('joint states do not arrive, so that the ones before are repeated',
                    'share of the control periods', 1.0),
    LATE: FaultKind('joint states are older', 'age [s]', None, 10.0),
    OFFSET: FaultKind('positions are off', 'offset [rad or m]', None, 10.0, True),
    NOISY: FaultKind('positions have white noise', 'standard deviation [rad or m]', None, 10.0),
    LIMP: FaultKind('joints have no effort, not even against their weight'),
    LOST_COMMANDS: FaultKind('commands do not arrive', 'share of the commands', 1.0),
    STUCK: FaultKind('the fingers of a gripper do not move'),
})


class PlannedFault(NamedTuple):
    """
    A fault of a plan.

    :ivar what: one of :data:`KINDS`
    :ivar part: such as ``arm`` or ``right/gripper``
    :ivar robot: its name; empty for each robot that has such a part
    :ivar begin_s: from so long after the reset on, the least and the greatest [s]
    :ivar end_s: until then, infinite for all the time
    :ivar value: least and greatest
    :ivar chance: of being there in an episode
    """

    what: str
    part: str
    robot: str
    begin_s: tuple[float, float]
    end_s: tuple[float, float]
    value: tuple[float, float]
    chance: float

    def drawn(self, random: np.random.Generator) -> tuple[float, float, float] | None:
        """Return begin and end [s] and value of an episode, or None if it is not in it."""
        there, *shares = random.random(4).tolist()
        if there >= self.chance:
            return None
        begin, end, value = (low if low == high else low + (high - low) * share for (low, high),
                             share in zip((self.begin_s, self.end_s, self.value), shares))
        return begin, end, value


class FaultPlan:
    """
    Faults of each episode; numbers may be ranges, from which the seed of the episode draws.

    :param given: a YAML file with the key ``faults``, its content, or a list: mappings with
        ``what`` (one of :data:`KINDS`) and ``part``, and where needed ``robot``, ``from`` and
        ``until`` (since the reset [s], numbers or [low, high]), ``value`` and ``chance``
    :raises ModelError: naming the fault that cannot be used
    :ivar given: the mapping of the user, plain
    :ivar faults: those that are planned
    """

    def __init__(self, given: FaultsLike) -> None:
        if isinstance(given, FaultPlan):
            given = given.given
        source = 'faults'
        if isinstance(given, (str, PathLike)):
            source = fspath(given)
            given = _listed(read_yaml(given), source)
        elif isinstance(given, Mapping) and 'faults' in given:
            given = _listed(given, source)
        self.given: list[Any] = [
            dict(fault) if isinstance(fault, Mapping) else fault
            for fault in listed(cast('Iterable[Any]', given), source, 'a list of faults')]
        self.faults: Sequence[PlannedFault] = [
            planned(fault, f'{source}: number {number}')
            for number, fault in enumerate(self.given, 1)]


def _listed(values: Mapping[str, Any], source: str) -> Any:
    if set(values) != {'faults'}:
        raise ModelError(f"{source}: expected the key 'faults' and nothing else, got "
                         f'{", ".join(map(quoted, values)) or "nothing"}')
    return values['faults']


def fault_from_text(text: str) -> dict[str, Any]:
    """
    Return a fault that is written as YAML or JSON on a line, checked.

    :raises ModelError: if it cannot be used
    """
    values = parse_yaml(text, 'the fault')
    planned(values, 'the fault')
    return dict(values)


def planned(fault: Any, source: str) -> PlannedFault:
    """
    Return a fault, checked.

    :raises ModelError: if it cannot be used
    """
    if not isinstance(fault, Mapping):
        raise ModelError(f"{source}: expected keys such as 'what' and 'part', "
                         f'got {format_value(fault)}')
    for key in fault:
        _known('key', key, _KEYS, source)
    for key in ('what', 'part'):
        if not isinstance(fault.get(key), str):
            raise ModelError(f"{source}: '{key}' must be a name, "
                             f'got {format_value(fault.get(key))}')
    _known('fault', fault['what'], KINDS, source)
    kind, robot = KINDS[fault['what']], fault.get('robot', '')
    if not isinstance(robot, str):
        raise ModelError(f"{source}: 'robot' must be a name, got {format_value(robot)}")
    begin = _range(fault.get('from', 0.0), 0.0, math.inf, f"{source}: 'from'")
    end = (math.inf, math.inf)
    if fault.get('until') is not None:
        end = _range(fault['until'], 0.0, math.inf, f"{source}: 'until'")
    if end[0] <= begin[1]:
        raise ModelError(f"{source}: 'until' must be after 'from', got {end[0]:g} and "
                         f'{begin[1]:g} s')
    if not kind.value and 'value' in fault:
        raise ModelError(f'{source}: {fault["what"]} has no value')
    value, chance = fault.get('value', kind.default), fault.get('chance', 1.0)
    if isinstance(chance, (list, tuple)):
        raise ModelError(f"{source}: 'chance' must be one number, got {format_value(chance)}")
    if value is None:
        raise ModelError(f"{source}: {fault['what']} needs a 'value': {kind.value}")
    low = -kind.most if kind.signed else 0.0
    return PlannedFault(
        fault['what'], fault['part'], robot, begin, end,
        _range(value, low, kind.most, f"{source}: 'value'"),
        _range(chance, 0.0, 1.0, f"{source}: 'chance'")[0])


def _known(kind: str, key: Any, known: Iterable[str], source: str) -> None:
    if key not in (choices := list(known)):
        raise ModelError(f'{source}: unknown {kind} {quoted(str(key))}: '
                         f'{describe_choices(str(key), choices)}')


def _range(value: Any, low: float, high: float, label: str) -> tuple[float, float]:
    """Return a number twice, or the ends of a range."""
    ends = list(value) if isinstance(value, (list, tuple)) and len(value) == 2 else [value] * 2
    for end in ends:
        if isinstance(end, bool) or not isinstance(end, (int, float)) or not (
                math.isfinite(end) and low <= end <= high):
            limits = f'from {low:g}' if math.isinf(high) else f'from {low:g} to {high:g}'
            raise ModelError(f'{label} must be a number {limits} or [low, high], got '
                             f'{format_value(value)}')
    if ends[0] > ends[1]:
        raise ModelError(f'{label}: low must not be above high, got {format_value(value)}')
    return float(ends[0]), float(ends[1])
