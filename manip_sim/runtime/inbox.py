# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What a thread that takes commands waits for: other threads, or messages in a subclass."""

from __future__ import annotations

import threading


class Inbox:
    """A signal by which other threads wake the one that waits."""

    def __init__(self) -> None:
        self._woken = threading.Event()

    def wake(self) -> None:
        """End the present wait, or the next one if nobody waits; any thread may call this."""
        self._woken.set()

    def wait(self, timeout_s: float) -> None:
        """
        Wait until there may be something to do.

        :param timeout_s: how long to wait at most [s]
        """
        if self._woken.wait(timeout_s):
            self._woken.clear()

    def take(self, most: int) -> None:
        """
        Take the messages that have come, without waiting; here there are none.

        :param most: how many of each topic
        """
