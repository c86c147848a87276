# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The newest states of a node as plain numbers, and its diagnostics in words."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import FloatArray
from manip_sim.viewer.page.plain_text import Line
from manip_sim.viewer.page.robots import FIELDS

OK, WARN, ERROR = 0, 1, 2
_SIGNS = {OK: '', WARN: 'Warning: ', ERROR: 'Error: '}
#: Fates of commands: by the key of the node's count, in words.
_OUTCOMES = {
    'dropped': 'rejected', 'clamped': 'clamped', 'slowed': 'slowed down', 'timeouts': 'timed out',
    'faults': 'failed in the gripper', 'cartesian_unreachable': 'out of reach',
    'cartesian_joint_limit': 'stopped by joint limits', 'cartesian_singular': 'at a singularity',
    'cartesian_slowed': 'slower than requested', 'cartesian_aside': 'off the straight line'}


@dataclass(frozen=True)
class ShownStatus:
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

    def number(self, key: str) -> float | None:
        """Return the value of a key as a finite number; None if it has none."""
        try:
            number = float(self.values[key])
        except (KeyError, ValueError):
            return None
        return number if math.isfinite(number) else None


def command_fields(statuses: Iterable[ShownStatus]) -> dict[str, str]:
    """Return the fields that the commands of parts use, by topic, such as ``left/arm``."""
    return {status.name: status.values['command_interface'] for status in statuses
            if status.values.get('command_interface') in FIELDS}


def control_modes(statuses: Iterable[ShownStatus]) -> dict[str, str]:
    """Return the control modes of parts, by topic, such as ``left/arm``."""
    return {status.name: status.values['control_mode'] for status in statuses
            if 'control_mode' in status.values}


def in_words(statuses: Iterable[ShownStatus]) -> list[Line]:
    """Return a line for each status, the most severe first."""
    ranked = sorted(statuses, key=lambda status: -status.level)
    lines = [Line(_words(status), title=f'{_SIGNS[min(status.level, ERROR)]}{status.name}')
             for status in ranked if status.values or status.level]
    return lines or [Line('No diagnostics yet.')]


def _words(status: ShownStatus) -> str:
    values = status.values
    if 'real_time_factor' in values:
        words = _simulation(status)
    elif 'accepted' in values:
        words = _commands(status)
    elif status.name == 'cameras':
        words = _cameras(values)
    else:
        words = ', '.join(f'{key} {value}' for key, value in values.items())
    plain = status.level == OK and ('accepted' in values or 'real_time_factor' in values)
    return words if plain else '; '.join(text for text in (status.message, words) if text)


def _simulation(status: ShownStatus) -> str:
    values = status.values
    words = [f'{values.get("state", status.message)} at {values["real_time_factor"]} times real '
             'time', f'{values.get("missed_deadlines", "0")} deadlines missed']
    words += [f'{count} times {name.removeprefix("mjWARN_")}' for name, count in values.items()
              if name.startswith('mjWARN') and count != '0']
    words += [f'{count} {name.replace("_", " ")}' for name, count in values.items()
              if name.startswith('failed_') and count != '0']
    defects = values.get('start_defects', 'none')
    return '; '.join(words + ([] if defects == 'none' else [f'at the start: {defects}']))


def _commands(status: ShownStatus) -> str:
    words, values, age_s = [], status.values, status.number('age')
    if 'control_mode' in values:
        words.append(f'{values["control_mode"]} mode')
    if age_s is None:
        words.append('no command yet')
    else:
        words.append(f'{values["accepted"]} commands, {values.get("rate", "0.0")} per second, the '
                     f'last {age_s:.1f} s ago')
    words += [f'{values[key]} {outcome}' for key, outcome in _OUTCOMES.items()
              if values.get(key, '0') != '0']
    return '; '.join(words)


def _cameras(values: Mapping[str, str]) -> str:
    return '; '.join(f'{key.removesuffix(".rate")} {rate} images per second'
                     for key, rate in values.items() if key.endswith('.rate'))


_WINDOW_S = 2.0


class RealTimeFactor:
    """The real-time factor of the last two seconds of wall time."""

    def __init__(self) -> None:
        self._seen: deque[tuple[float, float]] = deque()

    def add(self, wall_s: float, time_s: float) -> None:
        """Add a pair of wall time and simulation time [s]."""
        if self._seen and time_s < self._seen[-1][1]:
            self._seen.clear()
        self._seen.append((wall_s, time_s))
        while len(self._seen) > 2 and self._seen[1][0] < wall_s - _WINDOW_S:
            self._seen.popleft()

    @property
    def factor(self) -> float | None:
        """Simulation time per wall time; None before the pairs span a second of wall time."""
        if not self._seen or self._seen[-1][0] < self._seen[0][0] + 0.5 * _WINDOW_S:
            return None
        (first_wall, first), (last_wall, last) = self._seen[0], self._seen[-1]
        return (last - first) / (last_wall - first_wall)


@dataclass(frozen=True)
class JointStates:
    """
    The joints of one robot at one instant.

    :ivar names: of the joints
    :ivar position: [rad or m], as long as the names
    :ivar velocity: [rad/s or m/s]
    :ivar effort: [N m or N]
    :ivar time_s: simulation time [s]
    """

    names: Sequence[str]
    position: FloatArray
    velocity: FloatArray
    effort: FloatArray
    time_s: float


@dataclass(frozen=True)
class PoseInWorld:
    """
    Where something is in ``world``.

    :ivar position: [m], shape (3,)
    :ivar quat_wxyz: shape (4,)
    """

    position: FloatArray
    quat_wxyz: FloatArray


@dataclass
class Latest:
    """
    The newest state of each kind.

    :ivar joints: by namespace of the robot's topics
    :ivar end_effectors: by namespace and arm
    :ivar wrenches: the external wrench, force and torque [N, N m], shape (6,), by namespace and
        arm
    :ivar objects: by name
    :ivar contacts: where bodies touch, in ``world`` [m], shape (n, 3)
    :ivar arrows: by what they show: from and to, in ``world`` [m], shape (n, 2, 3)
    :ivar images: by camera, shape (h, w, 3); removed when they are shown
    :ivar diagnostics: the statuses of the node
    :ivar joints_s: wall time of the newest joint states [s]
    """

    joints: dict[str, JointStates] = field(default_factory=dict)
    end_effectors: dict[tuple[str, str], PoseInWorld] = field(default_factory=dict)
    wrenches: dict[tuple[str, str], FloatArray] = field(default_factory=dict)
    objects: dict[str, PoseInWorld] = field(default_factory=dict)
    contacts: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    arrows: dict[str, FloatArray] = field(default_factory=dict)
    images: dict[str, NDArray[Any]] = field(default_factory=dict)
    diagnostics: list[ShownStatus] = field(default_factory=list)
    joints_s: float = 0.0
