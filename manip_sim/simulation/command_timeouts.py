# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Which parts have had no fresh command for too long."""

from __future__ import annotations

from collections.abc import Iterable


class CommandTimeouts:
    """
    When each part had its last command, and after how long without another it is left alone.

    :param parts: names of parts that do not overlap; none has a time-out at first
    :ivar counts: how often each part had no fresh command for too long
    """

    def __init__(self, parts: Iterable[str]) -> None:
        self._timeout_s = dict.fromkeys(parts, 0.0)
        self._last_s: dict[str, float] = {}
        self.counts = dict.fromkeys(self._timeout_s, 0)

    def set(self, part: str, timeout_s: float) -> None:
        """
        Change the time-out of a part.

        :param timeout_s: simulation time [s]; 0 is never
        """
        self._timeout_s[part] = timeout_s

    def renew(self, parts: Iterable[str], now_s: float) -> None:
        """
        Count from now on.

        :param parts: that have a fresh command
        :param now_s: simulation time [s]
        """
        for part in parts:
            self._last_s[part] = now_s

    def forget(self, parts: Iterable[str]) -> None:
        """Let parts rest: what they were told is done."""
        for part in parts:
            self._last_s.pop(part, None)

    def clear(self) -> None:
        """Let all parts rest."""
        self._last_s.clear()

    @property
    def pending(self) -> bool:
        """Whether a part that has had a command may come to have none for too long."""
        return any(self._timeout_s[part] for part in self._last_s)

    def overdue(self, now_s: float) -> list[str]:
        """
        Return the parts whose last command is too old.

        :param now_s: simulation time [s]
        """
        return [part for part, last_s in self._last_s.items()
                if 0.0 < self._timeout_s[part] <= now_s - last_s + 1e-9]

    def count(self, part: str) -> None:
        """Count that a part is overdue, and let it rest."""
        del self._last_s[part]
        self.counts[part] += 1
