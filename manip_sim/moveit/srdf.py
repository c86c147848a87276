# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The SRDF of a robot: groups that MoveIt plans for, postures, pairs that may touch."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.models.robots import ManipulatorModel
from manip_sim.models.urdf_writer import Urdf
from manip_sim.models.urdf_writer.kinematic_tree import KinematicTree, subtree
from manip_sim.models.urdf_writer.link_shapes import text_of
from manip_sim.physics.parts import Part
from manip_sim.simulation import Simulation
from manip_sim.simulation.robot import SimulatedRobot

START, OPEN, CLOSED = 'start', 'open', 'closed'
#: Gripper actions; +1 closes.
_ACTIONS = {OPEN: -1.0, CLOSED: 1.0}
#: Fingers slower than this are at rest [rad/s or m/s]; longest wait for them to settle [s].
_RESTS, _PATIENCE_S = 1e-4, 6.0
_PERIOD_S = 0.05
#: Of positions where fingers have come to rest.
_DIGITS = 4


@dataclass(frozen=True)
class Group:
    """
    A planning group.

    :ivar part: name of the part that it is
    :ivar joints: scalar joints, in the order of the part
    :ivar active: the joints that are planned for: neither followers nor passive
    :ivar driven: the joints that a trajectory for the part's controller names
    :ivar base: and ``tip``: first and last link, where it is a chain; else empty
    :ivar parent: of a gripper: the group that it is on
    :ivar parent_link: of a gripper: the last link of that group
    :ivar subgroups: names of the groups that it consists of instead
    """

    name: str
    part: str
    joints: tuple[str, ...]
    active: tuple[str, ...]
    driven: tuple[str, ...]
    base: str = ''
    tip: str = ''
    links: tuple[str, ...] = ()
    parent: str = ''
    parent_link: str = ''
    subgroups: tuple[str, ...] = ()

    @property
    def is_gripper(self) -> bool:
        """Whether it is an end effector."""
        return bool(self.parent)


def find_groups(model: mujoco.MjModel, robot: SimulatedRobot, urdf: Urdf
                ) -> tuple[list[Group], list[str]]:
    """
    Return the groups of a robot; a mobile base is driven by velocities and is none.

    :param model: the compiled ``mujoco.MjModel`` that the URDF was written from
    :returns: the groups, and the scalar joints that nothing drives and that follow none
    """
    finder = _Finder(model, robot, urdf)
    groups = []
    for name, part in robot.parts.items():
        if part.gripper is None and part.atomic == (name,) and name != 'base' and part.joints:
            groups.append(finder.subsystem(name, part))
    arms = [group for group in groups if group.part in ('right', 'left')]
    if len(arms) == 2:
        first, second = arms
        groups.append(Group(
            'arm', 'arm', first.joints + second.joints, first.active + second.active,
            first.driven + second.driven, subgroups=(first.name, second.name)))
    return groups + finder.grippers([group.name for group in groups]), [
        joint for joint in robot.joint_names
        if joint not in finder.followers and joint not in finder.actuated]


class _Finder:
    def __init__(self, model: mujoco.MjModel, robot: SimulatedRobot, urdf: Urdf) -> None:
        self._model, self._robot, self._tree = model, robot, urdf.tree
        self.followers = {model.joint(joint).name for joint in urdf.mimics}
        self.actuated = {*robot.joints.names, *(
            joint for part in robot.parts.values() for joint in part.driven_joints if joint), *(
            joint for gripper in robot.grippers.values() for joint in gripper.joints.names)}

    def subsystem(self, name: str, part: Part) -> Group:
        driven = tuple(joint for joint in part.driven_joints if joint is not None)
        base, tip = self._chain(name, part)
        return Group(name, name, part.joints, self._active(part), driven, base, tip)

    def _active(self, part: Part, first: tuple[str, ...] = ()) -> tuple[str, ...]:
        """Return the joints that are planned for, those that take commands first."""
        joints = dict.fromkeys([*(joint for joint in first if joint in part.joints), *part.joints])
        return tuple(joint for joint in joints
                     if joint not in self.followers and joint in self.actuated)

    def _chain(self, name: str, part: Part) -> tuple[str, str]:
        """Return the links before and after the joints of an arm, if they are a chain."""
        model, arm = self._robot.robot_model, 'right' if name == 'arm' else name
        if not isinstance(model, ManipulatorModel) or arm not in model.eef_name:
            return '', ''
        tip = self._tree.link_of_body[self._model.body(model.eef_name[arm]).id]
        path = _path(self._tree, tip)
        moving = [joint for joint in path if joint.kind != 'fixed'][:len(part.joints)]
        if {joint.name for joint in moving} != set(part.joints):
            return '', ''
        return moving[-1].parent, tip

    def grippers(self, groups: list[str]) -> list[Group]:
        model = self._robot.robot_model
        if not isinstance(model, ManipulatorModel):
            return []
        gripper_groups = []
        for arm, gripper in model.grippers.items():
            part = self._robot.parts[f'{arm}/gripper']
            parent = arm if arm in groups else 'arm'
            eef = self._tree.link_of_body[self._model.body(model.eef_name[arm]).id]
            below = subtree(self._model, self._model.body(gripper.root_body).id)
            links = tuple(link for body in below
                          if (link := self._tree.link_of_body[body]) != eef)
            commanded = self._robot.grippers[part.name].joints.names
            gripper_groups.append(Group(
                'gripper' if len(model.arms) == 1 else f'{arm}_gripper', part.name, part.joints,
                self._active(part, commanded), commanded, links=links,
                parent=parent if parent in groups else '', parent_link=eef))
        return [group for group in gripper_groups if group.parent and group.links]


def _path(tree: KinematicTree, link: str) -> list[Any]:
    """Return the joints from a link up to the root, the nearest first."""
    joint_of = {joint.child: joint for joint in tree.joints}
    path = []
    while link in joint_of:
        path.append(joint_of[link])
        link = joint_of[link].parent
    return path


@dataclass(frozen=True)
class GroupState:
    """
    Where the joints are.

    :ivar name: ``start``, ``open`` or ``closed``
    :ivar part: the gripper that was moved, or None at the start
    :ivar position: of all scalar joints by name, within their limits [rad or m]
    """

    name: str
    part: str | None
    position: dict[str, float]


def find_postures(simulation: Simulation, robot: SimulatedRobot) -> list[GroupState]:
    """
    Return the start posture, and postures of each empty gripper opened (-1) and closed (+1).

    :param simulation: at its start; it is there again afterwards
    """
    start = _positions(simulation, robot)
    postures = [GroupState(START, None, start)]
    for part, gripper in robot.grippers.items():
        if not gripper.part.joints or not gripper.dof:
            continue
        for name, action in _ACTIONS.items():
            simulation.reset()
            robot.apply(robot.parse.action(part, np.full(gripper.dof, action)))
            _settle(simulation, robot, gripper.part.dof_addresses)
            moved = _positions(simulation, robot, _DIGITS)
            postures.append(GroupState(name, part, {
                **start, **{joint: moved[joint] for joint in gripper.part.joints}}))
    simulation.reset()
    return postures


def _settle(simulation: Simulation, robot: SimulatedRobot, dofs: Any) -> None:
    steps = max(1, round(_PERIOD_S / simulation.timestep_s))
    for _ in range(round(_PATIENCE_S / _PERIOD_S)):
        simulation.advance(steps)
        velocity: FloatArray = np.abs(simulation.data.qvel[dofs])
        if not robot.moving and velocity.max(initial=0.0) < _RESTS:
            return


def _positions(simulation: Simulation, robot: SimulatedRobot, digits: int = 15
               ) -> dict[str, float]:
    positions = {}
    for name, value in zip(robot.joint_names, robot.state().position):
        joint = simulation.model.joint(name)
        low, high = joint.range if joint.limited[0] else (-np.inf, np.inf)
        positions[name] = float(np.clip(round(value, digits), low, high))
    return positions


def write_srdf(name: str, groups: Iterable[Group], postures: Iterable[GroupState],
               passive: Iterable[str], disabled: Mapping[frozenset[str], str]) -> str:
    """
    Return the SRDF.

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


def _add_state(robot: ElementTree.Element, group: Group, posture: GroupState) -> None:
    element = ElementTree.SubElement(robot, 'group_state', name=posture.name, group=group.name)
    for joint in group.active:
        ElementTree.SubElement(element, 'joint', name=joint,
                               value=text_of(posture.position[joint]))
