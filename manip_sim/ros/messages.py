# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Messages from states: the one place that makes stamps."""

from __future__ import annotations

from array import array

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from sensor_msgs.msg import JointState

from manip_sim.simulation.poses import Pose, Twist
from manip_sim.simulation.state import State, Wrench
from manip_sim.typing import FloatArray, IntArray

WORLD = 'world'


def stamp_of(time_ns: int) -> Time:
    """Return a stamp for a simulation time in nanoseconds."""
    return Time(sec=time_ns // 1_000_000_000, nanosec=time_ns % 1_000_000_000)


def nanoseconds_of(stamp: Time) -> int:
    """Return the nanoseconds of a stamp."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def joint_state(stamp: Time, names: list[str], state: State, part: slice | IntArray) -> JointState:
    """
    Return the joint states of a part.

    :param part: which of the state's joints
    """
    message = JointState()
    message.header.stamp = stamp
    message.name = names
    message.position = _doubles(state.position[part])
    message.velocity = _doubles(state.velocity[part])
    message.effort = _doubles(state.effort[part])
    return message


def _doubles(numbers: FloatArray) -> array[float]:
    # rclpy takes an array.array as it is; lists and numpy arrays are checked number by number.
    return array('d', numbers.tobytes())


def wrench_stamped(stamp: Time, frame_id: str, wrench: Wrench) -> WrenchStamped:
    """Return a wrench in a frame."""
    message = WrenchStamped()
    message.header.stamp = stamp
    message.header.frame_id = frame_id
    force, torque = message.wrench.force, message.wrench.torque
    force.x, force.y, force.z = wrench.force.tolist()
    torque.x, torque.y, torque.z = wrench.torque.tolist()
    return message


def pose_stamped(stamp: Time, pose: Pose, frame_id: str = WORLD) -> PoseStamped:
    """
    Return where a frame is in the world.

    :param frame_id: name of the frame ``world``, which may have a prefix
    """
    message = PoseStamped()
    message.header.stamp = stamp
    message.header.frame_id = frame_id
    position, orientation = message.pose.position, message.pose.orientation
    position.x, position.y, position.z = pose.position.tolist()
    orientation.x, orientation.y, orientation.z, orientation.w = pose.quat_xyzw.tolist()
    return message


def twist_stamped(stamp: Time, twist: Twist, frame_id: str = WORLD) -> TwistStamped:
    """
    Return how fast a frame moves, in world axes.

    :param frame_id: name of the frame ``world``, which may have a prefix
    """
    message = TwistStamped()
    message.header.stamp = stamp
    message.header.frame_id = frame_id
    linear, angular = message.twist.linear, message.twist.angular
    linear.x, linear.y, linear.z = twist.linear.tolist()
    angular.x, angular.y, angular.z = twist.angular.tolist()
    return message
