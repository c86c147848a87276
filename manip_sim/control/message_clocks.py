# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Which coordinates, such as joints, have their messages in common, each group with a clock."""

from __future__ import annotations

import copy
import math

import numpy as np

from manip_sim.arrays import as_slice, IntArray
from manip_sim.control.message_clock import MessageClock, STREAM_INTERVAL_S


class MessageClocks:
    """
    The clocks of coordinates, of which those that come in the same messages share one.

    :param count: number of coordinates
    """

    def __init__(self, count: int) -> None:
        self._of: list[MessageClock | None] = [None] * count
        self._by_indices: dict[bytes, MessageClock] = {}
        self._settings = [(STREAM_INTERVAL_S, 0.0)] * count

    def begun_anew(self) -> MessageClocks:
        """Return the clocks of no stream yet, with the settings of these."""
        clocks = MessageClocks(len(self._of))
        clocks._settings = self._settings
        return clocks

    def set(self, indices: IntArray, longest_s: float | None = None,
            hold_s: float | None = None) -> None:
        """
        Change what counts as a stream, and how long one goes on that stops.

        :param longest_s: longest interval between messages of a stream [s]; None: no change
        :param hold_s: after a message was due [s]; 0: two intervals; None: no change
        """
        for index in indices.tolist():
            before = self._settings[index]
            self._settings[index] = (before[0] if longest_s is None else longest_s,
                                     before[1] if hold_s is None else hold_s)
        # A clock that has seen no message would be a part of the state without meaning.
        known = [index for index in indices.tolist() if self._of[index] is not None]
        for clock, _ in self.of(np.array(known, dtype=np.int64), -math.inf):
            clock.longest_s, clock.hold_s = self._settings[clock.indices[0]]

    def settings(self, index: int) -> tuple[float, float]:
        """Return what :meth:`set` has set for a coordinate: longest interval, hold time [s]."""
        return self._settings[index]

    def forget(self, indices: IntArray) -> None:
        """Let the next messages of some coordinates be the first of a stream."""
        if self._by_indices:
            for clock, _ in self.of(indices, -math.inf):
                clock.forget()

    def of(self, indices: IntArray, now_s: float
           ) -> list[tuple[MessageClock, slice | IntArray]]:
        """
        Return the clocks for a message that comes now, and which of its coordinates are theirs.

        Coordinates that do not continue a stream begin one together.

        :param indices: of the coordinates that the message brings
        """
        clock = self._by_indices.get(indices.tobytes())
        if clock is not None:
            return [(clock, slice(None))]
        shares: dict[MessageClock | tuple[float, float], list[int]] = {}
        for place, index in enumerate(indices.tolist()):
            known = self._of[index]
            shares.setdefault(known if known is not None and known.continues(now_s)
                              else self._settings[index], []).append(place)
        return [(self._own(of, indices[places]), np.array(places))
                for of, places in shares.items()]

    def _own(self, of: MessageClock | tuple[float, float], indices: IntArray) -> MessageClock:
        """Return a clock for these coordinates alone, which continues that of more of them."""
        if not isinstance(of, MessageClock):
            clock = MessageClock(*of)
        else:
            clock = of if len(of.indices) == len(indices) else copy.copy(of)
        for index in indices.tolist():
            other = self._of[index]
            if other is not None and other is not clock:
                self._place(other, other.indices[other.indices != index])
            self._of[index] = clock
        self._place(clock, indices)
        return clock

    def _place(self, clock: MessageClock, indices: IntArray) -> None:
        key = clock.indices.tobytes()
        if self._by_indices.get(key) is clock:
            del self._by_indices[key]
        clock.indices, clock.where = indices, indices
        if not indices.size:
            return
        self._by_indices[indices.tobytes()] = clock
        clock.where = as_slice(indices)
