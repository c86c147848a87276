# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The ``<ros2_control>`` tag: which hardware component of ros2_control commands which joint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from xml.etree import ElementTree

#: Hardware component from apt, which reads and writes joint states.
TOPIC_PLUGIN = 'joint_state_topic_hardware_interface/JointStateTopicSystem'
#: Hardware component of the package in ``hardware/``, which knows lock-step and sensors too.
OWN_PLUGIN = 'manip_sim_hardware/ManipSimSystem'
PLUGINS = (TOPIC_PLUGIN, OWN_PLUGIN)
#: A threshold below zero lets the plugin publish in each cycle; else it is silent while states and
#: commands agree, and a command timeout of the node would stop the robot.
_ALWAYS = '-1'
_STATES = ('position', 'velocity', 'effort')
_WRENCH = tuple(f'{kind}.{axis}' for kind in ('force', 'torque') for axis in 'xyz')
_IMU = (*(f'orientation.{axis}' for axis in 'xyzw'), *(
    f'{kind}.{axis}' for kind in ('angular_velocity', 'linear_acceleration') for axis in 'xyz'))


@dataclass(frozen=True)
class Hardware:
    """
    What the ``<ros2_control>`` tag says of the robot.

    :ivar interfaces: ``position``, ``velocity`` or ``effort`` by name of the joint with commands
    :ivar states_topic: where the joint states come from
    :ivar commands_topic: where the joint commands go to
    :ivar plugin: one of :data:`PLUGINS`; what follows is for the second one alone
    :ivar node: name of the node whose parameters select control modes, with its namespace
    :ivar mode_parameters: the parameter ``control_mode.<part>`` of each joint that has one
    :ivar wrench_topics: topics of wrenches, by name of the sensor
    :ivar lockstep: whether the physics waits for commands
    :ivar imu_topics: topics of IMUs, by name of the sensor
    :ivar rates_hz: of the sensors that measure less often than joint states come, by name [Hz]
    """

    interfaces: Mapping[str, str]
    states_topic: str = '/robot_joint_states'
    commands_topic: str = '/robot_joint_commands'
    plugin: str = TOPIC_PLUGIN
    node: str = '/manip_sim'
    mode_parameters: Mapping[str, str] = field(default_factory=dict)
    wrench_topics: Mapping[str, str] = field(default_factory=dict)
    lockstep: bool = False
    imu_topics: Mapping[str, str] = field(default_factory=dict)
    rates_hz: Mapping[str, float] = field(default_factory=dict)


def add_hardware(robot: ElementTree.Element, hardware: Hardware, joints: Sequence[str],
                 mimics: Sequence[str]) -> None:
    """
    Add the tag to a URDF: joints with commands first, as the hardware requires, then the others.

    Mimic joints have no command interface, because ros2_control rejects that. With the second
    plugin the joints of a part have the interfaces of all modes, of which controllers claim one.

    :param joints: names of all scalar joints
    :param mimics: names of those that follow another one
    """
    tag = ElementTree.SubElement(robot, 'ros2_control', name=robot.get('name', ''), type='system')
    system = ElementTree.SubElement(tag, 'hardware')
    ElementTree.SubElement(system, 'plugin').text = hardware.plugin
    own = hardware.plugin == OWN_PLUGIN
    parameters = {'joint_states_topic': hardware.states_topic,
                  'joint_commands_topic': hardware.commands_topic}
    if own:
        parameters |= {'node': hardware.node, 'lockstep': str(hardware.lockstep).lower()}
    else:
        parameters['trigger_joint_command_threshold'] = _ALWAYS
    for name, value in parameters.items():
        ElementTree.SubElement(system, 'param', name=name).text = value
    driven = [name for name in joints if name in hardware.interfaces and name not in mimics]
    for name in [*driven, *(name for name in joints if name not in driven)]:
        joint = ElementTree.SubElement(tag, 'joint', name=name)
        parameter = hardware.mode_parameters.get(name) if own else None
        if name in driven:
            if parameter is not None:
                ElementTree.SubElement(joint, 'param', name='mode_parameter').text = parameter
            for command in _STATES if parameter else [hardware.interfaces[name]]:
                ElementTree.SubElement(joint, 'command_interface', name=command)
        for state in _STATES:
            ElementTree.SubElement(joint, 'state_interface', name=state)
    for topics, interfaces in ((hardware.wrench_topics, _WRENCH), (hardware.imu_topics, _IMU)):
        for name, topic in topics.items() if own else ():
            sensor = ElementTree.SubElement(tag, 'sensor', name=name)
            ElementTree.SubElement(sensor, 'param', name='topic').text = topic
            if name in hardware.rates_hz:
                rate = repr(float(hardware.rates_hz[name]))
                ElementTree.SubElement(sensor, 'param', name='rate').text = rate
            for interface in interfaces:
                ElementTree.SubElement(sensor, 'state_interface', name=interface)
