# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Messages of ROS made of fields and numbers; the one place that makes and reads stamps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
import importlib
from importlib import import_module
from typing import Any

from builtin_interfaces.msg import Duration, Time
from rclpy.qos import DurabilityPolicy, QoSProfile

from manip_sim.arrays import FloatArray
from manip_sim.channels.contents import CONTROL_MSGS, CONTROLLER_STATE
from manip_sim.ros_environment import apt_names


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
    return getattr(import_module(f'{package}.msg'), name)


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
