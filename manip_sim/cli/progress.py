# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Show on a terminal how far long work has come, in one line that is erased at the end."""

from __future__ import annotations

import sys
import time

#: Shortest time between two lines [s].
_PERIOD_S = 0.2


class ProgressBar:
    """
    A line on standard error, if that is a terminal.

    :param what: is counted, such as ``episodes``
    """

    def __init__(self, what: str) -> None:
        self._what = what
        self._shows = sys.stderr is not None and sys.stderr.isatty()
        self._last_s = 0.0

    def show(self, done: int, more: str = '') -> None:
        """Show how much is done, and a text behind it."""
        if self._shows and time.monotonic() - self._last_s > _PERIOD_S:
            self._last_s = time.monotonic()
            print(f'\r\x1b[K{done} {self._what}{more}', end='', file=sys.stderr, flush=True)

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(self, *_: object) -> None:
        if self._shows:
            print('\r\x1b[K', end='', file=sys.stderr, flush=True)
