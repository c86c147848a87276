# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The diagnostics of a node in words."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

OK, WARN, ERROR = 0, 1, 2
_SIGNS = {OK: '', WARN: 'Warning: ', ERROR: 'Error: '}
#: What has become of commands: by the key of the node's count, in words.
_OUTCOMES = {
    'dropped': 'rejected', 'clamped': 'clamped', 'slowed': 'slowed down', 'timeouts': 'timed out',
    'faults': 'failed in the gripper', 'cartesian_unreachable': 'out of reach',
    'cartesian_joint_limit': 'stopped by joint limits', 'cartesian_singular': 'at a singularity',
    'cartesian_slowed': 'slower than requested'}
_NEVER = 'never'


@dataclass(frozen=True)
class Status:
    """
    A status of ``/diagnostics``.

    :ivar level: 0 is all right, 1 is a warning, more is an error
    :ivar name: what it is about, without the name of the node
    :ivar message: a summary in words
    :ivar values: by key, as in the message
    """

    level: int
    name: str
    message: str
    values: Mapping[str, str] = field(default_factory=dict)


def control_modes(statuses: Iterable[Status]) -> dict[str, str]:
    """Return the control modes of parts, by topic, such as ``left/arm``."""
    return {status.name: status.values['control_mode'] for status in statuses
            if 'control_mode' in status.values}


def in_words(statuses: Iterable[Status]) -> str:
    """Return the statuses as Markdown, the most severe first."""
    ranked = sorted(statuses, key=lambda status: -status.level)
    lines = [f'**{_SIGNS[min(status.level, ERROR)]}{status.name}**: {_words(status)}'
             for status in ranked if status.values or status.level]
    return '\n\n'.join(lines) or 'No diagnostics yet.'


def _words(status: Status) -> str:
    values = status.values
    if 'real_time_factor' in values:
        words = _simulation(status)
    elif 'accepted' in values:
        words = _commands(values)
    elif status.name == 'cameras':
        words = _cameras(values)
    else:
        words = ', '.join(f'{key} {value}' for key, value in values.items())
    plain = status.level == OK and ('accepted' in values or 'real_time_factor' in values)
    return words if plain else '; '.join(text for text in (status.message, words) if text)


def _simulation(status: Status) -> str:
    values = status.values
    words = [f'{values.get("state", status.message)} at {values["real_time_factor"]} times real '
             'time', f'{values.get("missed_deadlines", "0")} deadlines missed']
    words += [f'{count} times {name.removeprefix("mjWARN_")}' for name, count in values.items()
              if name.startswith('mjWARN') and count != '0']
    words += [f'{count} {name.replace("_", " ")}' for name, count in values.items()
              if name.startswith('failed_') and count != '0']
    defects = values.get('start_defects', 'none')
    return '; '.join(words + ([] if defects == 'none' else [f'at the start: {defects}']))


def _commands(values: Mapping[str, str]) -> str:
    words = []
    if 'control_mode' in values:
        words.append(f'{values["control_mode"]} mode')
    if values.get('age', _NEVER) == _NEVER:
        words.append('no command yet')
    else:
        words.append(f'{values["accepted"]} commands, {values.get("rate", "0.0")} per second, the '
                     f'last {float(values["age"]):.1f} s ago')
    words += [f'{values[key]} {outcome}' for key, outcome in _OUTCOMES.items()
              if values.get(key, '0') != '0']
    return '; '.join(words)


def _cameras(values: Mapping[str, str]) -> str:
    return '; '.join(f'{key.removesuffix(".rate")} {rate} images per second'
                     for key, rate in values.items() if key.endswith('.rate'))
