# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Groups of joints that MoveIt plans for: the parts of the robot, and its grippers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco

from manip_sim.models.robots import ManipulatorModel
from manip_sim.models.urdf_writer import Urdf
from manip_sim.models.urdf_writer.tree import KinematicTree, subtree
from manip_sim.simulation.parts import Part
from manip_sim.simulation.robot import SimulatedRobot


@dataclass(frozen=True)
class Group:
    """
    A planning group.

    :ivar name: in the SRDF
    :ivar part: name of the part that it is
    :ivar joints: scalar joints, in the order of the part
    :ivar active: those of them that are planned for: neither followers nor passive
    :ivar driven: those that a trajectory for the part's controller names
    :ivar base: and ``tip``: first and last link, where it is a chain; else empty
    :ivar links: of a gripper
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


def find_groups(model: mujoco.MjModel, robot: SimulatedRobot, urdf: Urdf) -> list[Group]:
    """
    Return the groups of a robot; a mobile base is driven by velocities and is none.

    :param model: the compiled ``mujoco.MjModel`` that the URDF was written from
    """
    finder = _Finder(model, robot, urdf)
    groups = []
    for name, part in robot.parts.items():
        if part.gripper is None and part.atomic == (name,) and name != 'base' and part.joints:
            groups.append(finder.subsystem(name, part))
    arms = [group for group in groups if group.part in ('right', 'left')]
    if len(arms) == 2:
        one, other = arms
        groups.append(Group(
            'arm', 'arm', one.joints + other.joints, one.active + other.active,
            one.driven + other.driven, subgroups=(one.name, other.name)))
    return groups + finder.grippers([group.name for group in groups])


def passive_joints(model: mujoco.MjModel, robot: SimulatedRobot, urdf: Urdf) -> list[str]:
    """Return the scalar joints that nothing drives and that follow none."""
    finder = _Finder(model, robot, urdf)
    return [joint for joint in robot.joint_names
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
        found = []
        for arm, gripper in model.grippers.items():
            part = self._robot.parts[f'{arm}/gripper']
            parent = arm if arm in groups else 'arm'
            eef = self._tree.link_of_body[self._model.body(model.eef_name[arm]).id]
            below = subtree(self._model, self._model.body(gripper.root_body).id)
            links = tuple(link for body in below
                          if (link := self._tree.link_of_body[body]) != eef)
            commanded = self._robot.grippers[part.name].joints.names
            found.append(Group(
                'gripper' if len(model.arms) == 1 else f'{arm}_gripper', part.name, part.joints,
                self._active(part, commanded), commanded, links=links,
                parent=parent if parent in groups else '', parent_link=eef))
        return [group for group in found if group.parent and group.links]


def _path(tree: KinematicTree, link: str) -> list[Any]:
    """Return the joints from a link up to the root, the nearest first."""
    joint_of = {joint.child: joint for joint in tree.joints}
    path = []
    while link in joint_of:
        path.append(joint_of[link])
        link = joint_of[link].parent
    return path
