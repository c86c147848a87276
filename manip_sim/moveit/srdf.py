# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The SRDF of a robot: what MoveIt needs to know beside the URDF."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from xml.etree import ElementTree

from manip_sim.models.urdf_writer.numbers import text_of
from manip_sim.moveit.groups import Group
from manip_sim.moveit.postures import Posture, START


def write_srdf(name: str, groups: Iterable[Group], postures: Iterable[Posture],
               passive: Iterable[str], disabled: Mapping[frozenset[str], str]) -> str:
    """
    Return the SRDF.

    :param name: of the robot, as in the URDF
    :param groups: the planning groups; one that consists of others comes after them
    :param postures: that become group states
    :param passive: joints that are not planned for
    :param disabled: reason by pair of links
    """
    robot, groups = ElementTree.Element('robot', name=name), list(groups)
    for group in groups:
        _add_group(robot, group)
    for posture in postures:
        for group in groups:
            if posture.part == group.part or (posture.name == START and group.active):
                _add_state(robot, group, posture)
    for group in groups:
        if group.is_gripper:
            ElementTree.SubElement(robot, 'end_effector', {
                'name': group.name, 'parent_link': group.parent_link, 'group': group.name,
                'parent_group': group.parent})
    for joint in passive:
        ElementTree.SubElement(robot, 'passive_joint', name=joint)
    for pair, reason in sorted((sorted(pair), reason) for pair, reason in disabled.items()):
        ElementTree.SubElement(robot, 'disable_collisions', {
            'link1': pair[0], 'link2': pair[1], 'reason': reason})
    ElementTree.indent(robot)
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(robot, encoding="unicode")}\n'


def _add_group(robot: ElementTree.Element, group: Group) -> None:
    element = ElementTree.SubElement(robot, 'group', name=group.name)
    if group.subgroups:
        for name in group.subgroups:
            ElementTree.SubElement(element, 'group', name=name)
    elif group.tip:
        ElementTree.SubElement(element, 'chain', base_link=group.base, tip_link=group.tip)
    else:
        for link in group.links:
            ElementTree.SubElement(element, 'link', name=link)
        for joint in group.joints:
            ElementTree.SubElement(element, 'joint', name=joint)


def _add_state(robot: ElementTree.Element, group: Group, posture: Posture) -> None:
    element = ElementTree.SubElement(robot, 'group_state', name=posture.name, group=group.name)
    for joint in group.active:
        ElementTree.SubElement(element, 'joint', name=joint,
                               value=text_of(posture.position[joint]))
