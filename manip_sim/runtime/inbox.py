# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What the simulation's thread waits for beside the time."""

from __future__ import annotations

import threading


class Inbox:
    """Lets other threads wake the one that waits."""

    def __init__(self) -> None:
        self._woken = threading.Event()

    def wake(self) -> None:
        """Let the present wait end, or the next one if there is none; any thread may call this."""
        self._woken.set()

    def wait(self, timeout_s: float) -> None:
        """
        Wait until there may be something to do.

        :param timeout_s: for so long at most [s]
        """
        if self._woken.wait(timeout_s):
            self._woken.clear()

    def take(self, most: int = 1) -> None:
        """
        Take what has come, without waiting.

        :param most: of each topic
        """
