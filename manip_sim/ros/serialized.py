# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Messages that are serialized once; their stamps and numbers are then replaced in the bytes."""

from __future__ import annotations

import bisect
from collections.abc import Callable
from typing import Any

from builtin_interfaces.msg import Time
import numpy as np
from rclpy.serialization import deserialize_message, serialize_message

from manip_sim.arrays import FloatArray
from manip_sim.patching import PatchedBytes
from manip_sim.ros.messages import stamp_of

#: Returns the message for a stamp and for numbers, shape (count,).
Make = Callable[[Time, FloatArray], Any]


class SerializedMessage:
    """
    The bytes of messages that differ in their stamps and numbers only.

    If :class:`PatchedBytes` do not yield the message that ``make`` returns, as with a middleware
    that encodes in another way, :meth:`at` returns the messages of ``make`` themselves.

    :param make: returns the message
    :param count: how many numbers it takes
    """

    def __init__(self, make: Make, count: int) -> None:
        self._make = make
        self._count = count
        self._patched: PatchedBytes | None = None
        # A type that is not generated from a definition cannot be serialized.
        if hasattr(type(make(stamp_of(0), np.zeros(count))), '_TYPE_SUPPORT'):
            self._patched = PatchedBytes(self._serialize, count)
        if not self._is_right():
            self._patched = None

    @property
    def patches(self) -> bool:
        """Whether messages are bytes in which numbers are replaced."""
        return self._patched is not None

    def _serialize(self, time_ns: int, numbers: FloatArray) -> bytes:
        return bytes(serialize_message(self._make(stamp_of(time_ns), numbers)))

    def _is_right(self) -> bool:
        # Bytes cannot be compared: rclpy leaves those between aligned numbers as they were.
        time_ns, numbers = 1_000_000_002, np.linspace(0.1, 9.9, self._count, dtype=np.float64)
        made = self._make(stamp_of(time_ns), numbers)
        if self._patched is None or not _is_message(self.at(time_ns, numbers), made):
            return False
        # rclpy appends what happens to be in memory, up to the size that it has estimated.
        content = self._patched.at(time_ns, numbers)
        self._patched.cut(bisect.bisect_left(
            range(len(content)), True, key=lambda size: _is_message(content[:size], made)))
        return True

    def at(self, time_ns: int, numbers: FloatArray) -> Any:
        """
        Return a message, as bytes where that is possible.

        :param time_ns: simulation time [ns]
        :param numbers: as ``make`` takes them, shape (count,)
        """
        if self._patched is None:
            return self._make(stamp_of(time_ns), numbers)
        return self._patched.at(time_ns, numbers)


def _is_message(content: bytes, message: Any) -> bool:
    try:
        return bool(message == deserialize_message(content, type(message)))
    except RuntimeError:  # rclpy's, as the bytes are no such message.
        return False
