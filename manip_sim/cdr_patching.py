# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Replace the stamp and the numbers in the bytes of a message that is serialized once (CDR)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from manip_sim.arrays import FloatArray

#: Size of the header of serialized data, which says how the data is encoded (OMG CDR) [bytes];
#: what follows is aligned from there.
_ENCODING_SIZE = 4
#: A stamp and the bits of doubles that no name contains, because they are not valid UTF-8.
_MARKED_NS = 0x71FEFDFC * 1_000_000_000 + 0x3AFBFAF9
_MARKED_BITS = 0x6AFFFEFD_F8000000


class PatchedBytes:
    """
    The bytes of messages that differ in their stamps and numbers only.

    ``serialize`` is called once with marked numbers; where these are found in the serialized
    data, others are written later.

    :param serialize: returns the bytes of the message for a time [ns] and for numbers, shape
        (count,)
    """

    def __init__(self, serialize: Callable[[int, FloatArray], bytes], count: int) -> None:
        marks = _MARKED_BITS + np.arange(count, dtype=np.uint64)
        self._buffer = bytearray(serialize(_MARKED_NS, marks.view(np.float64)))
        self._content = memoryview(self._buffer)
        aligned = memoryview(self._buffer)[_ENCODING_SIZE:]
        self._words = np.frombuffer(aligned, np.uint32, len(aligned) // 4)
        self._doubles = np.frombuffer(aligned, np.float64, len(aligned) // 8)
        bits = self._doubles.view(np.uint64)
        self._places = np.flatnonzero(np.isin(bits, marks))
        #: Index of the number of each place.
        self._sources = (bits[self._places] - np.uint64(_MARKED_BITS)).astype(np.int64)
        self._in_order = np.array_equal(self._sources, np.arange(count))
        seconds, nanoseconds = divmod(_MARKED_NS, 1_000_000_000)
        self._seconds = np.flatnonzero(self._words == seconds)
        self._nanoseconds = np.flatnonzero(self._words == nanoseconds)

    def cut(self, size: int) -> None:
        """Cut off the bytes behind the message."""
        self._content = self._content[:size]

    def at(self, time_ns: int, numbers: FloatArray) -> bytes:
        """
        Return the bytes of a message.

        :param time_ns: simulation time [ns]
        """
        self._words[self._seconds], self._words[self._nanoseconds] = divmod(
            time_ns, 1_000_000_000)
        self._doubles[self._places] = numbers if self._in_order else numbers[self._sources]
        return bytes(self._content)
