# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Publish the URDF of each robot, the dynamics of its joints, and the composed model."""

from __future__ import annotations

from array import array
from collections.abc import Iterable
from dataclasses import asdict, replace
import json

from rclpy.publisher import Publisher
from std_msgs.msg import String, UInt8MultiArray

from manip_sim.interface.topics import BY_NAME, Scope
from manip_sim.interface.world_topics import hardware_of
from manip_sim.models import World
from manip_sim.models.urdf_writer import Hardware, urdfs_of
from manip_sim.ros.channel_publishers import InstrumentPublishers
from manip_sim.ros.feature import create_publisher, Feature, NodeContext
from manip_sim.simulation import SimulatedRobot


class DynamicsPublisher(Feature):
    """A latched publisher of ``~/dynamics``, which says what a URDF does not: JSON by joint."""

    def __init__(self, context: NodeContext) -> None:
        self._publisher = create_publisher(context, BY_NAME['~/dynamics'])
        self._simulation = context.simulation
        self._gravity_compensation = context.parameters.value('gravity_compensation')
        self._robots: list[str] = []

    def started(self) -> None:
        self.publish()

    def world_changed(self) -> None:
        if [*self._simulation.robots] != self._robots:
            self.publish()

    def publish(self) -> None:
        self._robots = [*self._simulation.robots]
        self._publisher.publish(String(data=json.dumps({
            'timestep': self._simulation.timestep_s,
            'gravity_compensation': self._gravity_compensation,
            'joints': {name: asdict(joint) for robot in self._simulation.robots.values()
                       for name, joint in robot.dynamics().items()}}, allow_nan=False)))


class DescriptionPublisher(Feature):
    """
    Latched publishers of ``robot_description`` of each robot.

    A ``<ros2_control>`` tag for the present control modes names the topics as they are called
    after remapping.

    :param world: the world of the robots, as it is at the start
    :param instruments: that its sensors are
    """

    def __init__(self, context: NodeContext, world: World, instruments: InstrumentPublishers
                 ) -> None:
        self._context = context
        self._world = world
        self._instruments = instruments
        self._simulation = context.simulation
        self._has_tag = context.parameters.value('ros2_control_tag')
        self._robots: dict[Scope, SimulatedRobot] = {}
        self._publishers: dict[Scope, Publisher] = {}
        self._hardware: dict[str, Hardware] = {}
        for scope, robot in context.robots.items():
            self._add(scope, robot)

    def _add(self, scope: Scope, robot: SimulatedRobot) -> None:
        row, context = BY_NAME['robot_description'], self._context
        self._robots[scope] = robot
        self._publishers[scope] = create_publisher(
            context, replace(row, name=scope.topic(row.name)))
        if self._has_tag:
            value = context.parameters.value
            self._hardware[robot.name] = hardware_of(
                self._simulation, robot, scope, value('ros2_control_plugin'),
                value('stepping') == 'lockstep', context.node.resolve_topic_name,
                context.node.get_fully_qualified_name(), self._instruments.rates_hz)

    def started(self) -> None:
        """
        Publish the descriptions.

        :raises ModelError: if the world does not compile
        """
        self._publish(self._world, self._robots)

    def robot_added(self, scope: Scope, robot: SimulatedRobot) -> None:
        self._add(scope, robot)
        self._publish(self._simulation.world, [scope])

    def robot_removed(self, scope: Scope) -> None:
        self._hardware.pop(self._robots.pop(scope).name, None)
        self._context.node.destroy_publisher(self._publishers.pop(scope))

    def _publish(self, world: World, scopes: Iterable[Scope]) -> None:
        urdfs = urdfs_of(world, self._hardware)
        for scope in scopes:
            urdf = urdfs[self._robots[scope].name]
            self._publishers[scope].publish(String(data=urdf.xml))
            if urdf.notes:
                name = f'{scope.name}: ' if scope.name else ''
                self._context.notes.append(f'{name}robot_description: {"; ".join(urdf.notes)}')


class ModelPublisher(Feature):
    """
    Latched publishers of the composed model; it comes again when robots or objects come or go.

    ``~/mjcf`` is its MJCF, ``~/mjcf_archive`` a zip archive of the MJCF and of the files, such as
    meshes, that it refers to.

    :param world: as it is at the start
    """

    def __init__(self, context: NodeContext, world: World) -> None:
        self._mjcf = create_publisher(context, BY_NAME['~/mjcf'])
        self._archive = create_publisher(context, BY_NAME['~/mjcf_archive'])
        self._simulation, self._world = context.simulation, world

    def started(self) -> None:
        self._publish(self._world)

    def world_changed(self) -> None:
        self._publish(self._simulation.world)

    def _publish(self, world: World) -> None:
        """
        Publish the model.

        :raises ModelError: if a file cannot be read
        """
        xml, archive = world.to_xml_and_archive()
        self._mjcf.publish(String(data=xml))
        self._archive.publish(UInt8MultiArray(data=array('B', archive)))
