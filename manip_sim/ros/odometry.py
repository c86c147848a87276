# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Publish the odometry of a mobile base."""

from __future__ import annotations

from nav_msgs.msg import Odometry
from rclpy.node import Node

from manip_sim.ros import messages
from manip_sim.ros.log import RejectionLog
from manip_sim.ros.publishers import create_output
from manip_sim.simulation import Simulation
from manip_sim.simulation.odometry import OdometryReader


class OdometryPublisher:
    """
    Publishes where a base is in the frame of its odometry, and its velocity in its own axes.

    It is exact: the covariances are zero.

    :param node: the node
    :param reader: reads the base
    :param topic: where it is published
    :param frame: name of the frame of the odometry
    :param frame_prefix: beginning of the names of frames
    :param log: counts and tells what could not be published
    """

    def __init__(self, node: Node, reader: OdometryReader, topic: str, frame: str,
                 frame_prefix: str, log: RejectionLog) -> None:
        self._reader = reader
        self._output = create_output(node, log, Odometry, topic)
        self._frame_id = frame_prefix + frame
        self._child_frame_id = frame_prefix + reader.base

    def publish(self, simulation: Simulation) -> None:
        """Publish the odometry of the present instant, if somebody listens."""
        if not self._output.wanted:
            return
        found = self._reader.read(simulation.model, simulation.data)
        message = Odometry(child_frame_id=self._child_frame_id)
        message.header.stamp = messages.stamp_of(simulation.time_ns)
        message.header.frame_id = self._frame_id
        pose, twist = message.pose.pose, message.twist.twist
        pose.position.x, pose.position.y, pose.position.z = found.position.tolist()
        turn = pose.orientation
        turn.x, turn.y, turn.z, turn.w = found.quat_xyzw.tolist()
        twist.linear.x, twist.linear.y, twist.linear.z = found.linear.tolist()
        twist.angular.x, twist.angular.y, twist.angular.z = found.angular.tolist()
        self._output.publish(message)
