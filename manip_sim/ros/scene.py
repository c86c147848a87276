# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Publish what tools such as RViz show of a world: frames, odometry of bases, markers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any


from manip_sim.errors import ParameterError
from manip_sim.interface.parameters import periods_per_message
from manip_sim.interface.scope import Scope
from manip_sim.quoting import quoted
from manip_sim.ros.log import RejectionLog
from manip_sim.ros.markers import MarkerPublisher
from manip_sim.ros.messages import WORLD
from manip_sim.ros.odometry import OdometryPublisher
from manip_sim.ros.transforms import offer_transforms
from manip_sim.runtime import SimulationThread
from manip_sim.simulation import SimulatedRobot, Simulation
from manip_sim.simulation.frames import FrameTree
from manip_sim.simulation.odometry import OdometryReader

#: Is to be called when objects have come or gone.
Follower = Callable[[Simulation], None]
#: The frame in which a mobile base has its odometry (REP 105), after the robot's prefix.
ODOM = 'odom'


def check_frame_prefix(prefix: str) -> str:
    """
    Check a prefix of the names of frames, and return it.

    :raises ParameterError: if it begins with '/' or contains spaces or unprintable characters
    """
    if prefix.startswith('/') or any(not c.isprintable() or c.isspace() for c in prefix):
        raise ParameterError(f"parameter 'frame_prefix': {quoted(prefix)} cannot begin the name "
                             "of a frame: it must not begin with '/' or contain spaces")
    return prefix


def publish_scene(node: Any, value: Callable[[str], Any], robots: Mapping[Scope, SimulatedRobot],
                  simulation: Simulation, thread: SimulationThread, log: RejectionLog
                  ) -> list[Follower]:
    """
    Publish odometry each period, and frames and markers at their rate.

    :param value: returns the value of a parameter
    :param robots: by their scope
    :param simulation: what is seen
    :param thread: runs it
    :param log: counts and logs what could not be published
    :returns: functions to be called when objects have come or gone
    """
    prefix = value('frame_prefix')
    readers = {}
    for scope, robot in robots.items():
        if robot.twist_joints:
            frame = value(scope.parameter('prefix')) + ODOM
            readers[frame] = OdometryReader(simulation.model, robot.twist_joints)
            odometry = OdometryPublisher(node, readers[frame], scope.topic('odom'), frame, prefix,
                                         log)
            thread.observe(odometry.publish, look=odometry.look)
    every = _divider(node, value('publish_rate'), value('tf_rate'))
    end_effectors = {scope.topic(arm): reader for scope, robot in robots.items()
                     for arm, reader in robot.end_effectors.items()}
    markers = MarkerPublisher(node, end_effectors, prefix + WORLD, log)
    thread.observe(markers.publish, every, markers.look)
    if not value('publish_tf'):
        return []
    sites = [site for reader in end_effectors.values()
             for site in (reader.ft_frame, reader.grip_site)]
    placed = [(frame, reader.origin) for frame, reader in readers.items()]
    transforms = offer_transforms(
        node, lambda simulation: FrameTree(simulation.model, sites, placed), prefix, log)
    if transforms is None:
        return []
    transforms.follow(simulation)
    thread.observe(transforms.publish, every, transforms.look)
    return [transforms.follow]


def _divider(node: Any, publish_rate: float, tf_rate: float) -> int:
    every = periods_per_message(publish_rate, tf_rate)
    rate = publish_rate / every
    if abs(rate - tf_rate) > 1e-6 * tf_rate:
        node.notes.append(
            f'tf_rate: {tf_rate:g} Hz is not publish_rate, {publish_rate:g} Hz, divided by a '
            f'whole number; /tf and ~/markers come with {rate:g} Hz')
    return every
