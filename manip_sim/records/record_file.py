# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Write MCAP files as rosbag2 does, readable if the writer dies, and types of messages."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import functools
import os
from pathlib import Path
import sys
import time
from types import SimpleNamespace
from typing import Any, TypeVar

import numpy as np

from manip_sim.errors import RecordError

#: Fields of each type, without the separator `/msg/` in its name.
_FIELDS = {
    'builtin_interfaces/Time': 'int32 sec; uint32 nanosec',
    'geometry_msgs/Point': 'float64 x; float64 y; float64 z',
    'geometry_msgs/Pose': 'geometry_msgs/Point position; geometry_msgs/Quaternion orientation',
    'geometry_msgs/PoseStamped': 'std_msgs/Header header; geometry_msgs/Pose pose',
    'geometry_msgs/Quaternion': 'float64 x 0; float64 y 0; float64 z 0; float64 w 1',
    'geometry_msgs/Twist': 'geometry_msgs/Vector3 linear; geometry_msgs/Vector3 angular',
    'geometry_msgs/TwistStamped': 'std_msgs/Header header; geometry_msgs/Twist twist',
    'geometry_msgs/Vector3': 'float64 x; float64 y; float64 z',
    'geometry_msgs/Wrench': 'geometry_msgs/Vector3 force; geometry_msgs/Vector3 torque',
    'geometry_msgs/WrenchStamped': 'std_msgs/Header header; geometry_msgs/Wrench wrench',
    'rosgraph_msgs/Clock': 'builtin_interfaces/Time clock',
    'sensor_msgs/CompressedImage': 'std_msgs/Header header; string format; uint8[] data',
    'sensor_msgs/Imu': 'std_msgs/Header header; geometry_msgs/Quaternion orientation; '
                       'float64[9] orientation_covariance; '
                       'geometry_msgs/Vector3 angular_velocity; '
                       'float64[9] angular_velocity_covariance; '
                       'geometry_msgs/Vector3 linear_acceleration; '
                       'float64[9] linear_acceleration_covariance',
    'sensor_msgs/JointState': 'std_msgs/Header header; string[] name; float64[] position; '
                              'float64[] velocity; float64[] effort',
    'sensor_msgs/LaserScan': 'std_msgs/Header header; float32 angle_min; float32 angle_max; '
                             'float32 angle_increment; float32 time_increment; '
                             'float32 scan_time; float32 range_min; float32 range_max; '
                             'float32[] ranges; float32[] intensities',
    'sensor_msgs/MagneticField': 'std_msgs/Header header; geometry_msgs/Vector3 magnetic_field; '
                                 'float64[9] magnetic_field_covariance',
    'sensor_msgs/Range': 'std_msgs/Header header; uint8 radiation_type; float32 field_of_view; '
                         'float32 min_range; float32 max_range; float32 range; float32 variance',
    'std_msgs/Bool': 'bool data',
    'std_msgs/Float64': 'float64 data',
    'std_msgs/Float64MultiArray': 'std_msgs/MultiArrayLayout layout; float64[] data',
    'std_msgs/Header': 'builtin_interfaces/Time stamp; string frame_id',
    'std_msgs/MultiArrayDimension': 'string label; uint32 size; uint32 stride',
    'std_msgs/MultiArrayLayout': 'std_msgs/MultiArrayDimension[] dim; uint32 data_offset',
    'std_msgs/String': 'string data'}
_SEPARATOR = '=' * 80


def full_name(name: str) -> str:
    """Return ``std_msgs/msg/Bool``, the name of a type in messages, from ``std_msgs/Bool``."""
    return name.replace('/', '/msg/')


@functools.cache
def definition(name: str) -> str:
    """
    Return the definition of a type such as ``std_msgs/Bool``, and of those it refers to.

    :raises RecordError: if it is not known here and no such package is installed
    """
    def text(kind: str) -> str:
        fields = _FIELDS.get(kind.replace('/msg/', '/'))
        return installed(kind) if fields is None else fields.replace('; ', '\n')

    return joined(full_name(name), text)


def installed(kind: str) -> str:
    """
    Return the definition of a type such as ``std_msgs/msg/Bool`` in an installed package.

    :raises RecordError: if it is not installed
    """
    prefixes = [*os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep), sys.prefix]
    for prefix in filter(None, prefixes):
        file = Path(prefix, 'share', f'{kind}.msg')
        if file.is_file():
            return file.read_text()
    raise RecordError(f'the definition of {kind} is not installed')


@functools.cache
def encoder(name: str) -> Callable[[Any], bytes]:
    """Return what writes messages of a type such as ``std_msgs/Bool``, as mappings, as CDR."""
    # It is public only as part of a writer of files.
    from mcap_ros2._dynamic import serialize_dynamic
    encode: Callable[[Any], bytes] = serialize_dynamic(full_name(name), definition(name))[
        full_name(name)]
    return encode


@functools.cache
def decoder(name: str) -> Callable[[bytes], Any]:
    """Return what reads messages of a type such as ``std_msgs/Bool`` from CDR."""
    from mcap_ros2._dynamic import generate_dynamic
    decode: Callable[[bytes], Any] = generate_dynamic(full_name(name), definition(name))[
        full_name(name)]
    return decode


def new_message(name: str) -> Any:
    """
    Return a message of a type such as ``std_msgs/Bool``, to be filled and :func:`encoded`.

    :raises RecordError: if it has no :func:`definition`
    """
    return decoder(name)(encoder(name)({}))


def encoded(name: str, message: Any) -> bytes:
    """
    Return a message of :func:`new_message` as CDR.

    :raises AttributeError: if a field was set that the type does not have
    :raises Exception: anything, if a value does not fit its field
    """
    return encoder(name)(_fields(message))


def _fields(value: Any) -> Any:
    """Return the fields of a message by name; NumPy arrays become lists, as the encoder needs."""
    if isinstance(value, SimpleNamespace):
        for name in vars(value):  # Fields are in slots.
            raise AttributeError(f'{type(value).__name__} has no field {name!r}')
        return {name: _fields(getattr(value, name)) for name in value.__slots__}
    if isinstance(value, list):
        return [_fields(item) for item in value]
    return value.tolist() if isinstance(value, np.ndarray) else value


def joined(kind: str, text_of: Callable[[str], str]) -> str:
    """
    Return the definition of a type followed by those that it refers to, as rosbag2 stores it.

    :param kind: such as ``std_msgs/msg/Bool``
    :param text_of: returns the fields of a type, one a line
    """
    known = [kind]
    parts: list[str] = []
    for name in known:
        title = f'{_SEPARATOR}\nMSG: {name.replace("/msg/", "/")}\n' if parts else ''
        text = text_of(name).rstrip('\n')
        parts.append(title + text)
        package = name.partition('/')[0]
        for line in text.splitlines():
            field = line.partition('#')[0].split()
            base = field[0].partition('[')[0].partition('<')[0] if field else ''
            if not base or base[0].islower() and '/' not in base:
                continue
            other = base if '/' in base else f'{package}/{base}'
            other = other if '/msg/' in other else full_name(other)
            if other not in known:
                known.append(other)
    return '\n'.join(parts)


#: A chunk is written at this size [bytes], and after this time [s].
_CHUNK_BYTES, _FLUSH_S = 2**18, 1.0
#: Greater than any chunk: we decide when one is written.
_NEVER = 2**40
_T = TypeVar('_T')


class RecordFile:
    """
    An MCAP file that is being written, in the profile ``ros2``.

    Chunks are handed to the operating system once they are complete, at the latest a second after
    their first message, so that the file can be read up to there when the process is killed. If
    the disk is full, incomplete data is cut off. All methods raise a RecordError if the file
    cannot be written.

    :param path: of the file
    :param overwrite: replace a file that is there
    :raises RecordError: if it is there, or ``mcap`` is not installed
    """

    def __init__(self, path: Path, overwrite: bool = False) -> None:
        try:
            from mcap.writer import CompressionType, LIBRARY_IDENTIFIER, Writer
        except ImportError as error:
            raise RecordError(f"records need the package {error.name or 'mcap'}: "
                              "pip install 'manip_sim[records]'") from error
        self.path = path
        self._error: RecordError | None = None
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._pending, self._written_s, self._complete = 0, time.monotonic(), 0
        try:
            self._file = _WholeWrites(path, overwrite)
        except FileExistsError:
            raise RecordError(f'{path} already exists and is not overwritten') from None
        except OSError as error:
            raise RecordError(f'{path}: {error.strerror or error}') from error
        self._writer = Writer(self._file, chunk_size=_NEVER, compression=CompressionType.LZ4,
                              enable_data_crcs=True)
        self._do(lambda: self._writer.start('ros2', f'{LIBRARY_IDENTIFIER} manip_sim'))

    def channel(self, topic: str, type_name: str, definition: str,
                metadata: Mapping[str, str] | None = None) -> int:
        """
        Add a topic, once.

        :param type_name: such as ``std_msgs/msg/Bool``
        :param metadata: of the topic, such as its quality of service
        :returns: its number for :meth:`write`
        """
        if topic not in self._channels:
            if type_name not in self._schemas:
                self._schemas[type_name] = self._writer.register_schema(
                    type_name, 'ros2msg', definition.encode())
            self._channels[topic] = self._writer.register_channel(
                topic, 'cdr', self._schemas[type_name], dict(metadata or {}))
        return self._channels[topic]

    def write(self, channel: int, time_ns: int, data: bytes, published_ns: int | None = None
              ) -> None:
        """
        Write a message.

        :param channel: from :meth:`channel`
        :param time_ns: when it was recorded [ns]
        :param data: serialized, as CDR
        :param published_ns: when it was published [ns]; None for the same time
        """
        self._check()
        self._writer.add_message(
            channel, time_ns, data, time_ns if published_ns is None else published_ns)
        self._pending += len(data)
        if self._pending > _CHUNK_BYTES:
            self.flush()
        self.flush_when_due()

    def flush_when_due(self) -> None:
        """Write the chunk that is begun if a second has passed; call it where no messages come."""
        if self._pending and time.monotonic() - self._written_s > _FLUSH_S:
            self.flush()

    def attach(self, name: str, media_type: str, data: bytes, time_ns: int = 0) -> None:
        """Attach a file, such as ``model.mjz`` of the type ``application/zip``; time in [ns]."""
        self.flush()
        self._do(lambda: self._writer.add_attachment(time_ns, time_ns, name, media_type, data))

    def describe(self, name: str, values: Mapping[str, str]) -> None:
        """Write metadata of all messages that follow, or of all earlier ones, by a name."""
        self.flush()
        self._do(lambda: self._writer.add_metadata(name, dict(values)))

    def flush(self) -> None:
        """Write the chunk that is begun."""
        self._do(self._writer.flush)
        self._pending, self._written_s = 0, time.monotonic()

    def close(self) -> None:
        """Write the index and close the file; what could not be written was reported before."""
        if self._error is None and not self._file.closed:
            self._do(self._writer.finish)
            self._file.close()

    def _check(self) -> None:
        if self._error is not None:
            raise self._error

    def _do(self, write: Callable[[], _T]) -> _T:
        self._check()
        try:
            result = write()
        except OSError as error:
            self._file.cut(self._complete)
            self._error = RecordError(
                f'{self.path}: {error.strerror or error}; what was recorded before can be read')
            raise self._error from error
        self._complete = self._file.tell()
        return result


class _WholeWrites:
    """A new file that is written without a buffer, and each time completely or with an error."""

    def __init__(self, path: Path, overwrite: bool) -> None:
        flags = os.O_WRONLY | os.O_CREAT | (os.O_TRUNC if overwrite else os.O_EXCL)
        self._descriptor = os.open(path, flags | os.O_CLOEXEC, 0o666)
        self._size = 0
        self.closed = False

    def write(self, data: Any) -> int:
        left = memoryview(data)
        while left:
            written = os.write(self._descriptor, left)
            self._size += written
            left = left[written:]
        return len(data)

    def tell(self) -> int:
        return self._size

    def flush(self) -> None:
        """Do nothing, without a buffer."""

    def cut(self, size: int) -> None:
        """Cut the file off at a size [bytes], and close it."""
        os.ftruncate(self._descriptor, size)
        self.close()

    def close(self) -> None:
        if not self.closed:
            self.closed = True
            os.close(self._descriptor)
