# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Topics, interfaces and sensors of a robot for ros2_control."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from manip_sim.interface.scope import Scope
from manip_sim.interface.world_topics import topics_of_instruments
from manip_sim.models.urdf_writer import Hardware, OWN_PLUGIN, TOPIC_PLUGIN
from manip_sim.simulation import SimulatedRobot, Simulation

#: What the topics of a robot are called for ros2_control, whose joint_state_broadcaster and whose
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
    own = set(robot.sensor_names)
    imus = {found.name: resolve(scope.topic(row.name))
            for found, _, row in topics_of_instruments(simulation, {scope: robot})
            if found.kind == 'imu' and found.sensors[0] in own}
    return Hardware(
        robot.command_interfaces(), resolve(scope.topic('joint_states')),
        resolve(scope.topic('joint_command')), plugin, node, modes, wrenches, lockstep, imus,
        {name: rates_hz[name] for name in imus if name in rates_hz})
