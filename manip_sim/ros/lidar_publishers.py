# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Publish what lidars measure, and the exact values beside it, while somebody subscribes."""

from __future__ import annotations

from array import array
from collections.abc import Sequence

import numpy as np
from rclpy.parameter import Parameter
from sensor_msgs.msg import LaserScan, PointCloud2
from std_msgs.msg import Header

from manip_sim.arrays import FloatArray
from manip_sim.frame_names import FrameNames
from manip_sim.interface.parameters import periods_per_message
from manip_sim.interface.world_topics import topics_of_lidars, truths
from manip_sim.models.lidar_models import LidarModel
from manip_sim.ros.feature import Feature
from manip_sim.ros.lazy_publishers import create_output, Output
from manip_sim.ros.messages import stamp_of
from manip_sim.ros.node_context import NodeContext
from manip_sim.ros.point_clouds import point_cloud
from manip_sim.sensing.lidars import Lidar
from manip_sim.simulation import Simulation

#: x, y, z, the number of the ring and two bytes to fill up.
_POINT = np.dtype({'names': [*'xyz', 'ring'], 'formats': [*[np.float32] * 3, np.uint16],
                   'itemsize': 16})


def laser_scan(head: Header, lidar: Lidar, ranges: FloatArray, period_s: float) -> LaserScan:
    """
    Return the scan of a planar lidar; all rays are of one instant.

    :param ranges: shape (samples,)
    :param period_s: time between two scans [s]
    """
    rays = lidar.rays
    return LaserScan(
        header=head, angle_min=rays.angle_min, angle_increment=rays.angle_increment,
        angle_max=rays.angle_min + (rays.samples - 1) * rays.angle_increment,
        scan_time=period_s, range_min=rays.range_min, range_max=rays.range_max,
        ranges=array('f', ranges.astype(np.float32).tobytes()))


def ring_cloud(head: Header, lidar: Lidar, ranges: FloatArray) -> PointCloud2:
    """
    Return the points of a lidar with several rings, NaN where there is none; a row is a ring.

    :param ranges: shape (rings * samples,)
    """
    rings, samples, _ = lidar.directions.shape
    found = np.where(np.isfinite(ranges), ranges, np.nan).reshape(rings, samples)
    points = np.zeros((rings, samples), _POINT)
    for axis, name in enumerate('xyz'):
        points[name] = found * lidar.directions[..., axis]
    points['ring'] = np.arange(rings)[:, np.newaxis]
    return point_cloud(head, points)


class LidarPublisher:
    """
    The topics of one lidar.

    :ivar every: number of control periods for each scan
    :ivar topic: name of the topic
    """

    def __init__(self, context: NodeContext, found: LidarModel) -> None:
        self._context, self._thread = context, context.thread
        self._name, self._sensing = found.name, context.simulation.lidars.sensing(found.name)
        model = context.simulation.model
        self._frame_id = context.frame_prefix + FrameNames(model).sites[model.site(found.name).id]
        self.every = periods_per_message(1.0 / context.thread.period_s, found.rate_hz)
        self._rows = topics_of_lidars({found.name: found.rays.rings > 1})
        self.topic = self._rows[0].name
        #: By the method of the lidars that returns their ranges.
        self._outputs = {'measured': create_output(context, self._rows[0])}
        context.thread.observe(self._publish, self.every, self._has_subscribers)
        if found.noise:
            self._publish_truth()

    def publish_truth(self) -> None:
        """Also publish exact values, below ``truth/``, if noise or latency of its robot is set."""
        if self._sensing.settings.measures:
            self._publish_truth()

    def _publish_truth(self) -> None:
        if 'exact' not in self._outputs:
            (row,) = truths(self._rows)
            self._context.table.append(row)
            self._outputs = {**self._outputs, 'exact': create_output(self._context, row)}

    def _has_subscribers(self) -> bool:
        return any(output.has_subscribers for output in self._outputs.values())

    def _publish(self, simulation: Simulation) -> None:
        if not self._thread.is_due(self.every):
            return
        for ranges, output in self._outputs.items():
            if output.wanted:
                self._send(output, simulation, getattr(simulation.lidars, ranges)(self._name))

    def _send(self, output: Output, simulation: Simulation, ranges: FloatArray) -> None:
        head = Header(stamp=stamp_of(simulation.time_ns), frame_id=self._frame_id)
        lidar = simulation.lidars[self._name]
        output.publish(
            laser_scan(head, lidar, ranges, self.every * self._thread.period_s)
            if lidar.rays.rings == 1 else ring_cloud(head, lidar, ranges))


class Lidars(Feature):
    """The topics of the lidars of a world."""

    def __init__(self, context: NodeContext, lidars: list[LidarModel]) -> None:
        self._publishers = [LidarPublisher(context, found) for found in lidars]
        for found, publisher in zip(lidars, self._publishers):
            rate = 1.0 / (context.thread.period_s * publisher.every)
            context.notes.append(
                f'lidar {found.name}: {found.rays.rings} x {found.rays.samples} rays, '
                f'{rate:.4g} Hz, on {publisher.topic}')

    def parameters_changed(self, parameters: Sequence[Parameter]) -> None:
        for publisher in self._publishers:
            publisher.publish_truth()
