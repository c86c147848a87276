# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Messages that are serialized once; their stamps and numbers are then replaced in the bytes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from builtin_interfaces.msg import Time
import numpy as np
from rclpy.serialization import deserialize_message, serialize_message

from manip_sim.arrays import FloatArray
from manip_sim.ros.messages import stamp_of

#: Returns the message for a stamp and for numbers, shape (count,).
Make = Callable[[Time, FloatArray], Any]
#: Size of the header of serialized data, which says how the data is encoded (OMG CDR) [bytes];
#: what follows is aligned from there.
_ENCODING_SIZE = 4
#: A stamp and the bits of doubles that no name contains, because they are not valid UTF-8.
_MARKED_NS = 0x71FEFDFC * 1_000_000_000 + 0x3AFBFAF9
_MARKED_BITS = 0x6AFFFEFD_F8000000


class SerializedMessage:
    """
    The bytes of messages that differ in their stamps and numbers only.

    ``make`` is called once with marked numbers; where these are found in the serialized data,
    others are written later. If this does not yield the message that ``make`` returns, as with a
    middleware that encodes in another way, :meth:`at` returns the messages of ``make`` themselves.

    :param make: returns the message
    :param count: how many numbers it takes
    """

    def __init__(self, make: Make, count: int) -> None:
        self._make = make
        self._count = count
        self._buffer = bytearray()
        self._mark()
        if not self._is_right():
            self._buffer = bytearray()

    @property
    def patches(self) -> bool:
        """Whether messages are bytes in which numbers are replaced."""
        return bool(self._buffer)

    def _mark(self) -> None:
        marks = _MARKED_BITS + np.arange(self._count, dtype=np.uint64)
        marked = self._make(stamp_of(_MARKED_NS), marks.view(np.float64))
        if not hasattr(type(marked), '_TYPE_SUPPORT'):  # Not a message type.
            return
        self._buffer = bytearray(serialize_message(marked))
        aligned = memoryview(self._buffer)[_ENCODING_SIZE:]
        self._words = np.frombuffer(aligned, np.uint32, len(aligned) // 4)
        self._doubles = np.frombuffer(aligned, np.float64, len(aligned) // 8)
        bits = self._doubles.view(np.uint64)
        self._places = np.flatnonzero(np.isin(bits, marks))
        #: Which number belongs to each place.
        self._sources = (bits[self._places] - np.uint64(_MARKED_BITS)).astype(np.int64)
        self._in_order = np.array_equal(self._sources, np.arange(self._count))
        stamp = stamp_of(_MARKED_NS)
        self._seconds = np.flatnonzero(self._words == stamp.sec)
        self._nanoseconds = np.flatnonzero(self._words == stamp.nanosec)

    def _is_right(self) -> bool:
        # Bytes cannot be compared: rclpy leaves those between aligned numbers as they were.
        time_ns, numbers = 1_000_000_002, np.linspace(0.1, 9.9, self._count, dtype=np.float64)
        made = self._make(stamp_of(time_ns), numbers)
        try:
            return self.patches and made == deserialize_message(
                self.at(time_ns, numbers), type(made))
        except RuntimeError:  # rclpy's, as the bytes are no such message.
            return False

    def at(self, time_ns: int, numbers: FloatArray) -> Any:
        """
        Return a message, as bytes where that is possible.

        :param time_ns: simulation time [ns]
        :param numbers: as ``make`` takes them, shape (count,)
        """
        if not self._buffer:
            return self._make(stamp_of(time_ns), numbers)
        self._words[self._seconds], self._words[self._nanoseconds] = divmod(
            time_ns, 1_000_000_000)
        self._doubles[self._places] = numbers if self._in_order else numbers[self._sources]
        return bytes(self._buffer)
