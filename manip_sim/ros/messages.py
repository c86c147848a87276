# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Messages made of stamps and numbers; the one place that makes stamps."""

from __future__ import annotations

from array import array
from collections.abc import Sequence

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from manip_sim.arrays import FloatArray

WORLD = 'world'


def stamp_of(time_ns: int) -> Time:
    """Return a stamp for a simulation time in nanoseconds."""
    return Time(sec=time_ns // 1_000_000_000, nanosec=time_ns % 1_000_000_000)


def nanoseconds_of(stamp: Time) -> int:
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


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


def wrench_stamped(frame_id: str, stamp: Time, numbers: FloatArray) -> WrenchStamped:
    """
    Return a wrench in a frame.

    :param numbers: force [N] and torque [N m], shape (6,)
    """
    message = WrenchStamped()
    message.header.stamp = stamp
    message.header.frame_id = frame_id
    force, torque = message.wrench.force, message.wrench.torque
    force.x, force.y, force.z, torque.x, torque.y, torque.z = numbers.tolist()
    return message


def pose_stamped(frame_id: str, stamp: Time, numbers: FloatArray) -> PoseStamped:
    """
    Return a pose in a frame.

    :param numbers: position [m], and quaternion x, y, z, w, shape (7,)
    """
    message = PoseStamped()
    message.header.stamp = stamp
    message.header.frame_id = frame_id
    place, turn = message.pose.position, message.pose.orientation
    place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w = numbers.tolist()
    return message


def twist_stamped(frame_id: str, stamp: Time, numbers: FloatArray) -> TwistStamped:
    """
    Return a twist in the axes of a frame.

    :param numbers: linear velocity [m/s] and angular velocity [rad/s], shape (6,)
    """
    message = TwistStamped()
    message.header.stamp = stamp
    message.header.frame_id = frame_id
    linear, angular = message.twist.linear, message.twist.angular
    linear.x, linear.y, linear.z, angular.x, angular.y, angular.z = numbers.tolist()
    return message
