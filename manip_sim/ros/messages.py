# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Messages made of stamps and numbers; the one place that makes and reads stamps."""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from manip_sim.arrays import FloatArray

WORLD = 'world'
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


def clock(stamp: Time, _: FloatArray) -> Clock:
    """Return a clock message; no numbers are used."""
    return Clock(clock=stamp)


def joint_state(names: Sequence[str], stamp: Time, numbers: FloatArray) -> JointState:
    """
    Return the joint states of a part.

    :param names: of its joints, n
    :param numbers: positions, velocities and efforts in SI units, shape (3 n,)
    """
    message = JointState()
    message.header.stamp = stamp
    message.name = list(names)
    # rclpy takes an array.array as it is; lists and numpy arrays are checked number by number.
    message.position, message.velocity, message.effort = (
        array('d', row.tobytes()) for row in numbers.reshape(3, len(names)))
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


def stamped(message_type: Any, frame_id: str, stamp: Time, numbers: FloatArray) -> Any:
    """
    Return a message with a header.

    :param numbers: as :func:`filled` takes them
    """
    message = message_type()
    message.header.stamp, message.header.frame_id = stamp, frame_id
    return filled(message, numbers)


#: Make a wrench, shape (6,), a pose, shape (7,), and a twist, shape (6,), in a frame.
wrench_stamped, pose_stamped, twist_stamped = (
    partial(stamped, kind) for kind in (WrenchStamped, PoseStamped, TwistStamped))
