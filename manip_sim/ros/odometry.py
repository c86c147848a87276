# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Publish the odometry of a mobile base."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from builtin_interfaces.msg import Time
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.node import Node

from manip_sim.arrays import FloatArray
from manip_sim.interface.topics import BY_NAME
from manip_sim.ros.log import RejectionLog
from manip_sim.ros.outputs import create_output, Publication, Publications
from manip_sim.simulation import Simulation
from manip_sim.simulation.odometry import OdometryReader


class OdometryPublisher(Publications):
    """
    A publisher of a base's pose in the frame of its odometry, and of its twist in its own axes.

    They are exact: the covariances are zero.

    :param node: the node
    :param reader: reads the base
    :param topic: where it is published
    :param frame: name of the frame of the odometry
    :param frame_prefix: prefix of the names of frames
    :param log: counts and logs what could not be published
    """

    def __init__(self, node: Node, reader: OdometryReader, topic: str, frame: str,
                 frame_prefix: str, log: RejectionLog) -> None:
        super().__init__()

        def read(simulation: Simulation) -> FloatArray:
            found = reader.read(simulation.model, simulation.data)
            return np.concatenate([found.position, found.quat_xyzw, found.linear, found.angular])

        make = partial(odometry, frame_prefix + frame, frame_prefix + reader.base)
        row = replace(BY_NAME['odom'], name=topic)
        self.replace((Publication(create_output(node, log, row), make, read, 13),))


def odometry(frame_id: str, child_frame_id: str, stamp: Time, numbers: FloatArray) -> Odometry:
    """
    Return a message with the pose of a frame in another one, and its twist.

    :param numbers: position [m], quaternion x, y, z, w, and linear [m/s] and angular velocity
        [rad/s] in the axes of the frame that moves, shape (13,)
    """
    message = Odometry(child_frame_id=child_frame_id)
    message.header.stamp = stamp
    message.header.frame_id = frame_id
    pose, twist = message.pose.pose, message.twist.twist
    pose.position.x, pose.position.y, pose.position.z = numbers[:3].tolist()
    turn = pose.orientation
    turn.x, turn.y, turn.z, turn.w = numbers[3:7].tolist()
    twist.linear.x, twist.linear.y, twist.linear.z = numbers[7:10].tolist()
    twist.angular.x, twist.angular.y, twist.angular.z = numbers[10:].tolist()
    return message
