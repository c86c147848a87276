# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The ``<ros2_control>`` tag for ``joint_state_topic_hardware_interface``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

_PLUGIN = 'joint_state_topic_hardware_interface/JointStateTopicSystem'
#: A threshold below zero lets the plugin publish in each cycle; else it is silent while states and
#: commands agree, and a command timeout of the node would stop the robot.
_ALWAYS = '-1'
_STATES = ('position', 'velocity', 'effort')


@dataclass(frozen=True)
class Hardware:
    """
    What the ``<ros2_control>`` tag says of the robot.

    :ivar interfaces: ``position``, ``velocity`` or ``effort`` by name of the joint with commands
    :ivar states_topic: where the joint states come from
    :ivar commands_topic: where the joint commands go to
    """

    interfaces: Mapping[str, str]
    states_topic: str = '/robot_joint_states'
    commands_topic: str = '/robot_joint_commands'


def add_hardware(robot: ElementTree.Element, hardware: Hardware, joints: Sequence[str],
                 mimics: Sequence[str]) -> None:
    """
    Add the tag to a URDF: joints with commands first, as the hardware requires, then the others.

    Mimic joints have no command interface, because ros2_control rejects that.

    :param joints: names of all scalar joints
    :param mimics: names of those that follow another one
    """
    tag = ElementTree.SubElement(robot, 'ros2_control', name=robot.get('name', ''), type='system')
    system = ElementTree.SubElement(tag, 'hardware')
    ElementTree.SubElement(system, 'plugin').text = _PLUGIN
    for name, topic in (('joint_states_topic', hardware.states_topic),
                        ('joint_commands_topic', hardware.commands_topic),
                        ('trigger_joint_command_threshold', _ALWAYS)):
        ElementTree.SubElement(system, 'param', name=name).text = topic
    driven = [name for name in joints if name in hardware.interfaces and name not in mimics]
    for name in [*driven, *(name for name in joints if name not in driven)]:
        joint = ElementTree.SubElement(tag, 'joint', name=name)
        if name in driven:
            ElementTree.SubElement(joint, 'command_interface', name=hardware.interfaces[name])
        for state in _STATES:
            ElementTree.SubElement(joint, 'state_interface', name=state)
