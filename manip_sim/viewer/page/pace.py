# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""How fast simulation time runs, from the stamps of states."""

from __future__ import annotations

from collections import deque

_WINDOW_S = 2.0


class Pace:
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
