# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""An input that shows what is measured, or for a while what a person has just requested."""

from __future__ import annotations

#: What a person has requested is shown at least so long [s], and until nothing moves.
_HOLD_S = 1.0


class Following:
    """
    The choice whether an input shows the measured or the requested value.

    A goal that is not reached, such as one behind an obstacle, is given up when all is still.
    """

    def __init__(self) -> None:
        self._until_s: float | None = None

    def asked(self, now_s: float) -> None:
        """Note that a person has changed the input; ``now_s`` is wall time [s]."""
        self._until_s = now_s + _HOLD_S

    def follows(self, now_s: float, moving: bool) -> bool:
        """
        Tell whether the input is to show the measured value.

        :param now_s: wall time [s]
        :param moving: whether what is measured changes, or cannot because of a pause
        """
        if self._until_s is None:
            return True
        if moving:
            self._until_s = max(self._until_s, now_s + 0.2 * _HOLD_S)
        if now_s > self._until_s:
            self._until_s = None
        return self._until_s is None
