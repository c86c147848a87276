# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Make, read, serialize and patch messages of ROS; the one place that makes and reads stamps.

Serialized commands of one topic mostly differ in their stamps and numbers only. rclpy makes the
Python object of the first message. For later messages with the same bytes between stamps and
numbers (names, counts, flags), which are compared as one number, stamps and numbers are read where
they lie. This is the counterpart of :class:`~manip_sim.channels.contents.PatchedBytes`.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator, Mapping
import contextlib
from functools import cache, cached_property, partial
import importlib
import struct
import sys
from typing import Any

from builtin_interfaces.msg import Duration, Time
import numpy as np
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from trajectory_msgs.msg import JointTrajectory

from manip_sim.arrays import FloatArray
from manip_sim.channels.contents import CONTROL_MSGS, CONTROLLER_STATE, PatchedBytes
from manip_sim.control.command_parser import MAX_POINTS
from manip_sim.errors import CommandError, ManipSimError, MessageError
from manip_sim.ros_environment import apt_names

#: Number of layouts that are remembered: clients that name other joints may take turns.
_REMEMBERED = 4
#: Larger messages have no layout [bytes].
_LARGEST = 2**13
#: Bytes that begin data in plain CDR with the least significant byte first.
_ENCODING = b'\x00\x01'
#: Fields that are read in place: all doubles, and the numbers of stamps and durations.
_CODES = {'double': 'd', 'int32': 'i', 'uint32': 'I'}
_TIMES = ('builtin_interfaces/Time', 'builtin_interfaces/Duration')


def import_optional(module: str) -> Any:
    """
    Import a module.

    :param module: such as ``tf2_msgs.msg``
    :returns: the module, or None if its package is not installed
    :raises ModuleNotFoundError: if the package is installed and needs another one that is not
    """
    package = module.partition('.')[0]
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if str(error.name).partition('.')[0] != package:
            raise
        return None


def missing_note(missing: Mapping[str, str]) -> str:
    """
    Return the note of the packages that are not installed, on one line.

    :param missing: by package, such as ``tf2_msgs``, what does not exist without it
    """
    without = ', '.join(f'{feature} ({package})' for package, feature in missing.items())
    return (f'without packages that are not installed, there are no {without}; they are not '
            f'available from pip: apt install {apt_names(*missing)}, or build them')


WORLD = 'world'
#: The type of ``<part>/controller_state``.
CONTROLLER_TYPE = CONTROL_MSGS if hasattr(
    import_optional('control_msgs.msg'), 'JointTrajectoryControllerState') else CONTROLLER_STATE
#: Of topics whose last message is kept for subscribers that come later.
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def stamp_of(time_ns: int) -> Time:
    """Return a stamp for a simulation time in nanoseconds."""
    return Time(sec=time_ns // 1_000_000_000, nanosec=time_ns % 1_000_000_000)


def nanoseconds_of(stamp: Time) -> int:
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def seconds_of(stamp: Time | Duration) -> float:
    """Return a stamp or a duration in seconds."""
    return float(stamp.sec + stamp.nanosec * 1e-9)


@cache
def message_class(kind: str) -> Any:
    """Return the class of a type of messages, such as ``std_msgs/Bool``."""
    package, _, name = kind.partition('/')
    return getattr(importlib.import_module(f'{package}.msg'), name)


def message_of(kind: str, fields: Mapping[str, Any]) -> Any:
    """Return a message of a type with the values of fields, as :func:`fill` takes them."""
    return fill(message_class(kind)(), fields)


def fill(message: Any, fields: Mapping[str, Any]) -> Any:
    """
    Set fields of a message.

    :param fields: values by name; messages in them are mappings too
    :returns: the message
    """
    types = message.get_fields_and_field_types()
    for name, value in fields.items():
        inner = types[name].removeprefix('sequence<').removesuffix('>')
        if isinstance(value, Mapping):
            value = message_of(inner, value)
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            value = [message_of(inner, item) for item in value]
        setattr(message, name, value)
    return message


def checked(message_type: Any) -> Any:
    """Return a message that checks its fields; rclpy would serialize a wrong type as garbage."""
    message = message_type(check_fields=True)
    for name in message.get_fields_and_field_types():
        value = getattr(message, name)
        if hasattr(value, 'get_fields_and_field_types'):
            setattr(message, name, checked(type(value)))
    return message


def filled(message: Any, numbers: FloatArray) -> Any:
    """
    Set the doubles of a message and of the messages in it, in the order of the definitions.

    Arrays, such as covariances, stay as they are.

    :param numbers: positions [m] before quaternions x, y, z, w; linear before angular velocities
        [m/s, rad/s]; forces before torques [N, N m]; as many as there are doubles
    :returns: the message
    """
    _fill(message, iter(numbers.tolist()))
    return message


def _fill(message: Any, numbers: Iterator[float]) -> None:
    for name, kind in message.get_fields_and_field_types().items():
        if kind == 'double':
            setattr(message, name, next(numbers))
        elif hasattr(getattr(message, name), 'get_fields_and_field_types'):
            _fill(getattr(message, name), numbers)


def numbers_of(message: Any) -> list[float]:
    """Return the numbers of a vector, a point or a quaternion x, y, z, w."""
    return [getattr(message, name) for name in message.get_fields_and_field_types()]


#: More than any command but a trajectory needs [bytes].
_MAX_SIZE = 2**18
#: Enough for the points of many joints with velocities and accelerations [bytes].
_MAX_TRAJECTORY_SIZE = 2**24
_MAX_JOINTS = 1000


def read_message(message_type: Any, data: bytes, most: int = _MAX_SIZE, noun: str = 'a command',
                 error: type[ManipSimError] = MessageError) -> Any:
    """
    Return the message that was serialized.

    rclpy makes Python objects of a message in one call, in which no other thread runs: 100 000
    points of a trajectory would stop the physics for more than a second. So sizes are checked
    first.

    :param most: size of the data at most [bytes], but of a trajectory
    :param noun: has this size at most, for the message
    :param error: the exception to raise
    :raises ManipSimError: that exception, if the data is too large, or not a message of this type
    """
    trajectory = message_type is JointTrajectory
    if trajectory:
        most = _MAX_TRAJECTORY_SIZE
    if len(data) > most:
        raise error(f'the message has {len(data)} bytes, {noun} has {most} at most')
    try:
        if trajectory:
            _check_counts(data)
        return deserialize_message(data, message_type)
    except (struct.error, RuntimeError) as cause:
        raise error('the data cannot be read as a message of the type '
                    f'{message_type.__name__}') from cause


#: The same for a command, which raises ``CommandError``.
read_command = partial(read_message, error=CommandError)


def trajectory_fields(part: str, message: JointTrajectory) -> tuple[Any, Any, Any, Any]:
    """
    Return the times of a trajectory's points [s], and positions, velocities and accelerations.

    Velocities and accelerations that no point has are None.

    :param part: that it is for, named in errors
    :raises CommandError: if a point has an effort
    """
    points = message.points
    times_s = [seconds_of(point.time_from_start) for point in points]
    positions, velocities, accelerations = (
        None if all(not len(getattr(p, name)) for p in points)
        else [np.asarray(getattr(p, name)) for p in points]
        for name in ('positions', 'velocities', 'accelerations'))
    if any(len(p.effort) for p in points):
        raise CommandError(f'{part}: effort is not supported in trajectories, leave it empty')
    return times_s, positions or [], velocities, accelerations


def _check_counts(data: bytes) -> None:
    """Check how many names and points a serialized ``JointTrajectory`` has (OMG CDR, 9.3)."""
    number = struct.Struct('<I' if data[1:2] == b'\x01' else '>I')

    def read(offset: int) -> tuple[int, int]:
        """Return the number at the next multiple of four bytes, and where it ends."""
        offset += -offset % 4
        value: int = number.unpack_from(data, offset)[0]
        return value, offset + 4
    # The header begins with a stamp of 8 bytes; then a frame, the names of joints and the points.
    length, offset = read(_ENCODING_SIZE + 8)
    count, offset = read(offset + length)
    if count > _MAX_JOINTS:
        raise CommandError(f'a trajectory may have at most {_MAX_JOINTS} joints, got {count}')
    for _ in range(count):
        length, offset = read(offset)
        offset += length
    count, _ = read(offset)
    if count > MAX_POINTS:
        raise CommandError(f'a trajectory may have at most {MAX_POINTS} points, got {count}')


#: Bytes that name the encoding, and bytes of the length of a sequence or text.
_ENCODING_SIZE = _LENGTH_SIZE = 4
#: Of the types of fields [bytes].
_SIZES = {'boolean': 1, 'octet': 1, 'int8': 1, 'uint8': 1, 'int16': 2, 'uint16': 2, 'int32': 4,
          'uint32': 4, 'float': 4, 'int64': 8, 'uint64': 8, 'double': 8}

#: Returns the message for a stamp and for numbers, shape (count,).
Make = Callable[[Time, FloatArray], Any]


class SerializedMessage:
    """
    The bytes of messages that differ in their stamps and numbers only.

    If :class:`PatchedBytes` do not yield the message that ``make`` returns, as with a middleware
    that encodes in another way, :meth:`at` returns the messages of ``make`` themselves.

    :param make: returns the message
    :param count: how many numbers it takes
    :param patches: whether messages differ in their stamps and doubles only
    """

    def __init__(self, make: Make, count: int, patches: bool = True) -> None:
        self._make, self._count, self._may_patch = make, count, patches

    @cached_property
    def _patched(self) -> PatchedBytes | None:
        # A type that is not generated from a definition cannot be serialized.
        if not (self._may_patch and hasattr(
                type(self._make(stamp_of(0), np.zeros(self._count))), '_TYPE_SUPPORT')):
            return None
        patched = PatchedBytes(self._serialize, self._count)
        return patched if self._is_right(patched) else None

    def prepare(self) -> None:
        """Take the time now that the first message would take in addition; again, nothing."""
        _ = self._patched

    @property
    def patches(self) -> bool:
        """True if messages are bytes in which numbers are replaced."""
        return self._patched is not None

    def _serialize(self, time_ns: int, numbers: FloatArray) -> bytes:
        return bytes(serialize_message(self._make(stamp_of(time_ns), numbers)))

    def _is_right(self, patched: PatchedBytes) -> bool:
        # Bytes cannot be compared: rclpy leaves those between aligned numbers as they were.
        time_ns, numbers = 1_000_000_002, np.linspace(0.1, 9.9, self._count, dtype=np.float64)
        made, data = self._make(stamp_of(time_ns), numbers), self._serialize(time_ns, numbers)
        try:
            # rclpy appends what happens to be in memory, up to the size that it has estimated.
            patched.cut(_Layout(deserialize_message(data, type(made)), data).end)
            return bool(made == deserialize_message(patched.at(time_ns, numbers), type(made)))
        except (RuntimeError, ValueError):  # The bytes cannot be read as such a message.
            return False

    def at(self, time_ns: int, numbers: FloatArray) -> Any:
        """
        Return a message, as bytes where that is possible.

        :param time_ns: simulation time [ns]
        :param numbers: as ``make`` takes them, shape (count,)
        """
        if self._patched is None:
            return self._make(stamp_of(time_ns), numbers)
        return self._patched.at(time_ns, numbers)


def _aligned(place: int, size: int) -> int:
    return -(-place // size) * size


class _Layout:
    """
    Places of stamps and doubles in the bytes of a message, and the bytes that later ones share.

    :param message: read by rclpy; becomes the message of later bytes
    :param data: its bytes
    :raises ValueError: if the bytes are not those of the message in the known encoding
    :ivar end: of the message in the data, whose size may be greater
    """

    def __init__(self, message: Any, data: bytes) -> None:
        if data[:len(_ENCODING)] != _ENCODING or sys.byteorder != 'little':
            raise ValueError('another encoding')
        self._message, self._data = message, data
        self._compared = bytearray(len(data))
        self._compare(0, _ENCODING_SIZE)
        self._format = '<'
        self._scalars: list[tuple[Any, str]] = []
        self._arrays: list[tuple[Any, str, int, int]] = []
        self.end = self._message_end(message, 0, False) + _ENCODING_SIZE
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
        begin = _aligned(place, size)
        self._compare(begin + _ENCODING_SIZE, begin + size * count + _ENCODING_SIZE)
        return begin + size * count

    def _length(self, place: int) -> tuple[int, int]:
        """Return the length of a sequence or text, and where it ends; it is compared."""
        end = self._fixed(place, _LENGTH_SIZE)
        length: int = struct.unpack_from('<I', self._data, end - _LENGTH_SIZE + _ENCODING_SIZE)[0]
        return length, end

    def _message_end(self, message: Any, place: int, is_time: bool) -> int:
        """Note the places in a message that begins at a place; return where it ends."""
        for name, kind in message.get_fields_and_field_types().items():
            value = getattr(message, name)
            if kind.startswith('sequence<') or kind.endswith(']'):
                place = self._sequence_end(message, name, kind, place)
            elif kind == 'double' or (is_time and kind in _CODES):
                begin = _aligned(place, _SIZES[kind])
                self._format += f'{begin + _ENCODING_SIZE - struct.calcsize(self._format)}x'
                self._format += _CODES[kind]
                self._scalars.append((message, name))
                place = begin + _SIZES[kind]
                if place + _ENCODING_SIZE > len(self._data):
                    raise ValueError('the data ends early')
            else:
                place = self._value_end(kind, value, place)
        return place

    def _value_end(self, kind: str, value: Any, place: int) -> int:
        if kind in _SIZES:
            return self._fixed(place, _SIZES[kind])
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
        if item_kind not in _SIZES:
            for value in values:
                place = self._value_end(item_kind, value, place)
            return place
        if not count:
            return place
        if item_kind != 'double' or not isinstance(values, array):
            return self._fixed(place, _SIZES[item_kind], count)
        begin = _aligned(place, _SIZES[item_kind]) + _ENCODING_SIZE
        end = begin + _SIZES[item_kind] * count
        if end > len(self._data):
            raise ValueError('the data ends early')
        self._arrays.append((message, name, begin, end))
        return end - _ENCODING_SIZE

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
