# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The topics and ros2_control interfaces of a world: rows of the tables, filled in."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from itertools import groupby
from types import MappingProxyType

from manip_sim.control.surroundings import Surroundings
from manip_sim.interface.topics import (
    Action, ACTIONS, ARM, BY_NAME, CAMERA, GRIPPER, LIDAR, MEASURED, OBJECT, PART, Scope, SENSOR,
    TOKEN, Topic, TOPICS)
from manip_sim.models.urdf_writer import Hardware, OWN_PLUGIN, TOPIC_PLUGIN
from manip_sim.physics.parts import Part
from manip_sim.sensing.instruments import Instrument, WRENCH
from manip_sim.simulation import SimulatedRobot, Simulation

#: Fields of rows that are of the world, not of a robot.
_OF_WORLD = ('task', 'arena', 'loose', 'bodies')


def actions_of(parts: Mapping[str, Part]) -> list[Action]:
    """
    Return the actions that the node has for a robot where control_msgs is installed.

    :param parts: by name: ``arm``, ``base``, ``right``, ``right/gripper`` ...
    """
    return [replace(pattern, name=pattern.name.replace(GRIPPER, name).replace(PART, name))
            for pattern in ACTIONS for name, part in parts.items()
            if part.actuators and (part.gripper is not None) == (GRIPPER in pattern.name)]


def topics_of(parts: Mapping[str, Part], twist: bool, rows: Iterable[Topic] = TOPICS
              ) -> list[Topic]:
    """
    Return the topics that the node has for a robot, but for topics of objects and cameras.

    Rows of the table that follow each other are filled in together, part by part, arm by arm.

    :param parts: by name: ``arm``, ``base``, ``right``, ``right/gripper`` ...
    :param twist: whether the base takes a twist
    :param rows: of the table
    """
    arms = [name.split('/')[0] for name, part in parts.items() if part.gripper is not None]
    topics: list[Topic] = []
    for per, group in groupby(rows, lambda row: row.per):
        patterns = list(group)
        if not per:
            topics += (row for row in patterns if row.needs not in _OF_WORLD
                       and (twist or row.needs != 'twist'))
        elif per in (PART, ARM):
            topics += (row.filled_in(name) for name in (parts if per == PART else arms)
                       for row in patterns if _has(row, name, parts))
    return topics


def topics_of_objects(names: Iterable[str]) -> list[Topic]:
    """Return the topics that the node has for free bodies."""
    return [row.filled_in(name) for name in names for row in TOPICS
            if row.per == OBJECT and row.needs == 'object']


def topics_of_surroundings(surroundings: Surroundings) -> list[Topic]:
    """Return the topics that the node has for bodies, mocap bodies and joints of the arena."""
    there = {'arena/joint_states': surroundings.joints,
             'arena/joint_command': surroundings.actuators,
             'actuators/states': surroundings.other_actuators,
             'actuators/command': surroundings.other_actuators}
    return [*(BY_NAME[name] for name, has in there.items() if has),
            *(row.filled_in(name) for name in surroundings.mocap_names if TOKEN.fullmatch(name)
              for row in TOPICS if row.by in ('object_pose', 'mocap_pose')), BY_NAME['~/pull']]


def topics_of_cameras(cameras: Mapping[str, bool]) -> list[Topic]:
    """
    Return the topics that the node has for cameras.

    :param cameras: that are chosen, by name: whether with depth
    """
    return [row.filled_in(name) for name, depth in cameras.items() for row in TOPICS
            if row.per == CAMERA and (depth or row.needs != 'depth')]


def topics_of_lidars(lidars: Mapping[str, bool]) -> list[Topic]:
    """
    Return the topics that the node has for lidars.

    :param lidars: by name: whether with several rings
    """
    return [BY_NAME[f'{LIDAR}/points' if rings else f'{LIDAR}/scan'].filled_in(name)
            for name, rings in lidars.items()]


def truths(rows: Iterable[Topic]) -> list[Topic]:
    """
    Return the topics with exact values beside those that noise or latency may change.

    :param rows: of one robot, without its namespace
    """
    return [replace(row, name=f'truth/{row.name}', meaning=f'exactly: {row.meaning}')
            for row in rows if row.by in MEASURED]


def topics_of_instruments(simulation: Simulation, robots: Mapping[Scope, SimulatedRobot]
                          ) -> list[tuple[Instrument, Scope, Topic]]:
    """
    Return the instruments with topics of their own, their namespace, and their topic without it.

    The force/torque sensor of a gripper is published as the wrench of its arm.

    :param robots: by the scope of their topics; instruments of other robots are left out
    """
    scopes = {sensor: scope for scope, robot in robots.items() for sensor in robot.sensor_names}
    elsewhere = {sensor for robot in simulation.robots.values() if robot not in robots.values()
                 for sensor in robot.sensor_names}
    of_arms = {reader.ft_frame for robot in robots.values()
               for reader in robot.end_effectors.values()}
    return [(instrument, scopes.get(instrument.sensors[0], Scope()),
             row.filled_in(instrument.topic))
            for instrument in simulation.sensors.instruments for row in TOPICS
            if row.per == SENSOR and row.by == instrument.kind
            and instrument.sensors[0] not in elsewhere
            and not (instrument.kind == WRENCH and instrument.elements[0] in of_arms)]


def topics_of_robot(scope: Scope, robot: SimulatedRobot) -> list[Topic]:
    """Return the topics of a robot in its namespace, and the topics of the world beside them."""
    return [replace(topic, name=scope.topic(topic.name))
            for topic in topics_of(robot.parts, bool(robot.twist_joints))]


def topics_of_world(simulation: Simulation, robots: Mapping[Scope, SimulatedRobot],
                    cameras: Mapping[str, bool] = MappingProxyType({}), task: bool = False
                    ) -> list[Topic]:
    """
    Return the topics that the node has for a world.

    :param robots: by the scope of their topics
    :param cameras: that are chosen, by name: whether with depth
    :param task: whether there is one
    """
    # A name that is absolute or private is the world's, and found with each robot.
    return list(dict.fromkeys([
        *(topic for scope, robot in robots.items() for topic in topics_of_robot(scope, robot)),
        *topics_of_objects(simulation.entities.free_names), *topics_of_cameras(cameras),
        *(replace(row, name=scope.topic(row.name))
          for _, scope, row in topics_of_instruments(simulation, robots)),
        *topics_of_lidars({name: lidar.rays.rings > 1
                           for name, lidar in simulation.lidars.items()}),
        *topics_of_surroundings(simulation.surroundings), *[BY_NAME['~/task']] * task]))


def _has(row: Topic, name: str, parts: Mapping[str, Part]) -> bool:
    """Return whether a part or an arm has a topic."""
    if row.per == PART and (parts[name].gripper is not None) != (GRIPPER in row.name):
        return False
    return not row.needs or bool(name in parts and getattr(parts[name], row.needs))


#: Names of the topics of a robot for ros2_control, whose joint_state_broadcaster and whose
#: controllers use the other names.
REMAPPED = {'joint_states': 'robot_joint_states', 'joint_command': 'robot_joint_commands'}
STALLS = (f'ros2_control_tag with stepping lockstep: {TOPIC_PLUGIN} does not answer the states '
          'one by one, so that simulated time stands still; set ros2_control_plugin to '
          f'{OWN_PLUGIN}, or stepping to realtime')


def remapped(topic: str) -> str:
    """Return the absolute name of a topic of a robot after :data:`REMAPPED`."""
    space, slash, name = topic.rpartition('/')
    return f'/{space}{slash}{REMAPPED.get(name, name)}'


def hardware_of(simulation: Simulation, robot: SimulatedRobot, scope: Scope, plugin: str,
                lockstep: bool, resolve: Callable[[str], str], node: str = '/manip_sim',
                rates_hz: Mapping[str, float] = MappingProxyType({})) -> Hardware:
    """
    Return the hardware of the ``<ros2_control>`` tag, in the present control modes.

    :param simulation: of the world
    :param robot: the robot
    :param scope: of its topics and parameters
    :param plugin: the hardware component
    :param lockstep: whether the physics waits for commands
    :param resolve: returns what a topic is called
    :param node: name of the node, with its namespace
    :param rates_hz: of the sensors with fewer messages than control periods [Hz]
    """
    modes = {joint: scope.parameter(f'control_mode.{name}') for name, part in robot.parts.items()
             if part.gripper is None and part.atomic == (name,) for joint in part.joints}
    wrenches = {f'{arm}_{topic}': resolve(scope.topic(f'{arm}/{topic}'))
                for arm in robot.end_effectors for topic in ('wrench', 'external_wrench')}
    sensors = set(robot.sensor_names)
    imus = {instrument.name: resolve(scope.topic(row.name))
            for instrument, _, row in topics_of_instruments(simulation, {scope: robot})
            if instrument.kind == 'imu' and instrument.sensors[0] in sensors}
    return Hardware(
        robot.command_interfaces(), resolve(scope.topic('joint_states')),
        resolve(scope.topic('joint_command')), plugin, node, modes, wrenches, lockstep, imus,
        {name: rates_hz[name] for name in imus if name in rates_hz})
