# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The newest states of the node, as plain numbers, and how fast its simulation time runs."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import FloatArray
from manip_sim.viewer.page.diagnosis import ShownStatus

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
