# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Read serialized commands of one topic, of which most differ in their stamps and numbers only.

rclpy makes the Python object of the first message. For later messages with the same bytes between
stamps and numbers (names, counts, flags), which are compared as one number, stamps and numbers are
read where they lie. This is the counterpart of :mod:`manip_sim.cdr_patching`.
"""

from __future__ import annotations

from array import array
import contextlib
import struct
import sys
from typing import Any

from manip_sim.ros.messages import aligned, ENCODING_SIZE, LENGTH_SIZE, read_command, SIZES

#: Number of layouts that are remembered: clients that name other joints may take turns.
_REMEMBERED = 4
#: Larger messages have no layout [bytes].
_LARGEST = 2**13
#: Bytes that begin data in plain CDR with the least significant byte first.
_ENCODING = b'\x00\x01'
#: Fields that are read in place: all doubles, and the numbers of stamps and durations.
_CODES = {'double': 'd', 'int32': 'i', 'uint32': 'I'}
_TIMES = ('builtin_interfaces/Time', 'builtin_interfaces/Duration')


class _Layout:
    """
    Places of stamps and doubles in the bytes of a message, and the bytes that later ones share.

    :param message: read by rclpy; becomes the message of later bytes
    :param data: its bytes
    :raises ValueError: if the bytes are not those of the message in the known encoding
    """

    def __init__(self, message: Any, data: bytes) -> None:
        if data[:len(_ENCODING)] != _ENCODING or sys.byteorder != 'little':
            raise ValueError('another encoding')
        self._message, self._data = message, data
        self._compared = bytearray(len(data))
        self._compare(0, ENCODING_SIZE)
        self._format = '<'
        self._scalars: list[tuple[Any, str]] = []
        self._arrays: list[tuple[Any, str, int, int]] = []
        self._message_end(message, 0, False)
        self._unpack = struct.Struct(self._format).unpack_from
        self._mask = int.from_bytes(self._compared, 'little')
        self._pattern = int.from_bytes(data, 'little') & self._mask
        self._check()

    def _check(self) -> None:
        """Check that what is read in place is what rclpy has read."""
        scalars = self._unpack(self._data)
        # NaN is not equal to itself.
        if any(repr(getattr(owner, name)) != repr(value)
               for (owner, name), value in zip(self._scalars, scalars)) or any(
                getattr(owner, name).tobytes() != self._data[begin:end]
                for owner, name, begin, end in self._arrays):
            raise ValueError('rclpy has read other numbers')

    def _compare(self, begin: int, end: int) -> None:
        if end > len(self._data):
            raise ValueError('the data ends early')
        self._compared[begin:end] = b'\xff' * (end - begin)

    def _fixed(self, place: int, size: int, count: int = 1) -> int:
        """Compare aligned numbers of a size; return where they end."""
        begin = aligned(place, size)
        self._compare(begin + ENCODING_SIZE, begin + size * count + ENCODING_SIZE)
        return begin + size * count

    def _length(self, place: int) -> tuple[int, int]:
        """Return the length of a sequence or text, and where it ends; it is compared."""
        end = self._fixed(place, LENGTH_SIZE)
        length: int = struct.unpack_from('<I', self._data, end - LENGTH_SIZE + ENCODING_SIZE)[0]
        return length, end

    def _message_end(self, message: Any, place: int, is_time: bool) -> int:
        """Note the places in a message, as ``_end`` in ``messages.py`` walks; return its end."""
        for name, kind in message.get_fields_and_field_types().items():
            value = getattr(message, name)
            if kind.startswith('sequence<') or kind.endswith(']'):
                place = self._sequence_end(message, name, kind, place)
            elif kind == 'double' or (is_time and kind in _CODES):
                begin = aligned(place, SIZES[kind])
                self._format += f'{begin + ENCODING_SIZE - struct.calcsize(self._format)}x'
                self._format += _CODES[kind]
                self._scalars.append((message, name))
                place = begin + SIZES[kind]
                if place + ENCODING_SIZE > len(self._data):
                    raise ValueError('the data ends early')
            else:
                place = self._value_end(kind, value, place)
        return place

    def _value_end(self, kind: str, value: Any, place: int) -> int:
        if kind in SIZES:
            return self._fixed(place, SIZES[kind])
        if kind.startswith('string'):
            length, place = self._length(place)
            return self._fixed(place, 1, length)
        if not hasattr(value, 'get_fields_and_field_types'):
            raise ValueError(f'fields of the type {kind} are not read in place')
        return self._message_end(value, place, kind in _TIMES)

    def _sequence_end(self, message: Any, name: str, kind: str, place: int) -> int:
        values, count = getattr(message, name), len(getattr(message, name))
        if kind.startswith('sequence<'):
            item_kind = kind[len('sequence<'):].rstrip('>').partition(',')[0]
            length, place = self._length(place)
            if length != count:
                raise ValueError('rclpy has read another number of values')
        else:
            item_kind = kind.partition('[')[0]
        if item_kind not in SIZES:
            for value in values:
                place = self._value_end(item_kind, value, place)
            return place
        if not count:
            return place
        if item_kind != 'double' or not isinstance(values, array):
            return self._fixed(place, SIZES[item_kind], count)
        begin = aligned(place, SIZES[item_kind]) + ENCODING_SIZE
        end = begin + SIZES[item_kind] * count
        if end > len(self._data):
            raise ValueError('the data ends early')
        self._arrays.append((message, name, begin, end))
        return end - ENCODING_SIZE

    def fits(self, bits: int, size: int) -> bool:
        """
        Return whether a message differs in stamps and doubles only.

        :param bits: its bytes as a number, the first one being the least significant
        :param size: number of its bytes
        """
        return size == len(self._data) and bits & self._mask == self._pattern

    def read(self, data: bytes) -> Any:
        """Return the message, with the stamps and doubles of bytes that fit."""
        for (owner, name), value in zip(self._scalars, self._unpack(data)):
            setattr(owner, name, value)
        for owner, name, begin, end in self._arrays:
            setattr(owner, name, array('d', data[begin:end]))
        return self._message


class MessageReader:
    """
    A reader of the messages of a topic, for one thread at a time.

    :param message_type: of the messages
    """

    def __init__(self, message_type: Any) -> None:
        self._message_type = message_type
        self._layouts: tuple[_Layout, ...] = ()

    def read(self, data: bytes) -> Any:
        """
        Return a message, which may change with the next call, but whose arrays will not.

        :param data: the serialized message
        :raises CommandError: if the data is too large, or not a message of this type
        """
        size = len(data)
        if size > _LARGEST:
            return read_command(self._message_type, data)
        bits = int.from_bytes(data, 'little')
        for layout in self._layouts:
            if layout.fits(bits, size):
                return layout.read(data)
        message = read_command(self._message_type, data)
        with contextlib.suppress(ValueError):  # Each message like this is read by rclpy.
            self._layouts = _Layout(message, data), *self._layouts[:_REMEMBERED - 1]
        return message
