# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
The fields of the ROS messages in records, which are written without ROS.

Types and names are those of common_interfaces and rcl_interfaces, release Jazzy.
"""

from __future__ import annotations

from collections.abc import Callable
import functools
import os
from pathlib import Path
import sys
from types import SimpleNamespace
from typing import Any

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
    """
    Return the name of a type as in messages, such as ``std_msgs/msg/Bool``.

    :param name: such as ``std_msgs/Bool``
    """
    return name.replace('/', '/msg/')


@functools.cache
def definition(name: str) -> str:
    """
    Return the definition of a type such as ``std_msgs/Bool``, and of those it refers to.

    :raises RecordError: if it is not known here and no such package is installed
    """
    return joined(full_name(name), _text)


def _text(kind: str) -> str:
    fields = _FIELDS.get(kind.replace('/msg/', '/'))
    return installed(kind) if fields is None else fields.replace('; ', '\n')


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
