# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Publish the URDF of each robot, and what a URDF does not say of its joints."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, replace
import json
from typing import TYPE_CHECKING

from rclpy.publisher import Publisher
from std_msgs.msg import String

from manip_sim.interface.ros2_control import hardware_of
from manip_sim.interface.scope import Scope
from manip_sim.interface.topics import BY_NAME
from manip_sim.models import World
from manip_sim.models.urdf_writer import Hardware, urdfs_of
from manip_sim.ros.lazy_publishers import create_publisher
from manip_sim.simulation import SimulatedRobot

if TYPE_CHECKING:
    from manip_sim.ros.sim_node import SimNode


class DynamicsPublisher:
    """A latched publisher of ``~/dynamics``, which says what a URDF does not: JSON by joint."""

    def __init__(self, node: SimNode) -> None:
        self._publisher = create_publisher(node, BY_NAME['~/dynamics'])
        self._simulation = node.simulation
        self._gravity_compensation = node.declared.value('gravity_compensation')

    def publish(self) -> None:
        self._publisher.publish(String(data=json.dumps({
            'timestep': self._simulation.timestep_s,
            'gravity_compensation': self._gravity_compensation,
            'joints': {name: asdict(joint) for robot in self._simulation.robots.values()
                       for name, joint in robot.dynamics().items()}}, allow_nan=False)))


class DescriptionPublisher:
    """
    Latched publishers of ``robot_description`` of each robot.

    A ``<ros2_control>`` tag for the present control modes names the topics as they are called
    after remapping.

    :param world: the world of the robots, as it is at the start
    """

    def __init__(self, node: SimNode, world: World) -> None:
        self._node = node
        self._world = world
        self._simulation = node.simulation
        self._has_tag = node.declared.value('ros2_control_tag')
        self._robots: dict[Scope, SimulatedRobot] = {}
        self._publishers: dict[Scope, Publisher] = {}
        self._hardware: dict[str, Hardware] = {}
        for scope, robot in node.robots.items():
            self._add(scope, robot)

    def _add(self, scope: Scope, robot: SimulatedRobot) -> None:
        row, node = BY_NAME['robot_description'], self._node
        self._robots[scope] = robot
        self._publishers[scope] = create_publisher(
            node, replace(row, name=scope.topic(row.name)))
        if self._has_tag:
            value = node.declared.value
            self._hardware[robot.name] = hardware_of(
                self._simulation, robot, scope, value('ros2_control_plugin'),
                value('stepping') == 'lockstep', node.resolve_topic_name,
                node.get_fully_qualified_name(), node.instruments.rates_hz)

    def publish(self) -> None:
        """
        Publish the descriptions, once.

        :raises ModelError: if the world does not compile
        """
        self._publish(self._world, self._robots)

    def add(self, scope: Scope, robot: SimulatedRobot) -> None:
        self._add(scope, robot)
        self._publish(self._simulation.world, [scope])

    def remove(self, scope: Scope) -> None:
        self._hardware.pop(self._robots.pop(scope).name, None)
        self._node.destroy_publisher(self._publishers.pop(scope))

    def _publish(self, world: World, scopes: Iterable[Scope]) -> None:
        urdfs = urdfs_of(world, self._hardware)
        for scope in scopes:
            urdf = urdfs[self._robots[scope].name]
            self._publishers[scope].publish(String(data=urdf.xml))
            if urdf.notes:
                name = f'{scope.name}: ' if scope.name else ''
                self._node.notes.append(f'{name}robot_description: {"; ".join(urdf.notes)}')
