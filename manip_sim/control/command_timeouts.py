# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Timeouts of parts that have had no fresh command for too long."""

from __future__ import annotations

from collections.abc import Iterable
import math


class CommandTimeouts:
    """
    The time of each part's last command, and how long it lasts without a fresh one.

    :param parts: names of parts that do not overlap; none has a timeout at first
    :ivar counts: number of timeouts of each part
    """

    remembered = ('_timeout_s', '_last_s', 'counts')
    #: Only counted.
    undigested = ('counts',)

    def __init__(self, parts: Iterable[str]) -> None:
        self._timeout_s = dict.fromkeys(parts, 0.0)
        self._last_s: dict[str, float] = {}
        self.counts = dict.fromkeys(self._timeout_s, 0)

    def __getitem__(self, part: str) -> float:
        """Return the timeout of a part, simulation time [s]; 0 for none."""
        return self._timeout_s[part]

    def set(self, part: str, timeout_s: float) -> None:
        """
        Change the timeout of a part.

        :param timeout_s: simulation time [s]; 0 for none
        """
        self._timeout_s[part] = timeout_s

    def renew(self, parts: Iterable[str], now_s: float) -> None:
        """
        Restart the timeouts of parts.

        :param parts: those that have a fresh command
        :param now_s: simulation time [s]
        """
        for part in parts:
            self._last_s[part] = now_s

    def forget(self, parts: Iterable[str]) -> None:
        """Stop watching parts whose commands are done."""
        for part in parts:
            self._last_s.pop(part, None)

    def clear(self) -> None:
        """Stop watching all parts."""
        self._last_s.clear()

    @property
    def pending(self) -> bool:
        """True if any part that is watched has a timeout."""
        return bool(self._last_s) and any([self._timeout_s[part] for part in self._last_s])

    @property
    def first_s(self) -> float:
        """Time at which the first part is overdue, or a little before [s]; infinite for none."""
        if not self._last_s:
            return math.inf
        return min([last_s + self._timeout_s[part] - 2e-9
                    for part, last_s in self._last_s.items() if self._timeout_s[part] > 0.0],
                   default=math.inf)

    def overdue(self, now_s: float) -> list[str]:
        """
        Return the parts whose last command is older than their timeout.

        :param now_s: simulation time [s]
        """
        parts = []
        for part, last_s in self._last_s.items():
            if 0.0 < self._timeout_s[part] <= now_s - last_s + 1e-9:
                parts.append(part)
        return parts

    def count(self, part: str) -> None:
        """Count a timeout of a part, and stop watching it."""
        del self._last_s[part]
        self.counts[part] += 1
