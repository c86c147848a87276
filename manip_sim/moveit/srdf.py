# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The SRDF of a robot: groups that MoveIt plans for, postures, pairs that may touch."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.models import World
from manip_sim.models.actuators import SCALAR
from manip_sim.models.couplings import JointCouplings
from manip_sim.models.loading import compile_spec
from manip_sim.models.robots import ManipulatorModel, RobotModel
from manip_sim.models.urdf_writer import Urdf
from manip_sim.models.urdf_writer.links import subtree, text_of
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
        """True if it is an end effector."""
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
            driven = tuple(joint for joint in part.driven_joints if joint is not None)
            groups.append(Group(name, name, part.joints, finder.active(part), driven,
                                *finder.chain(name, part)))
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

    def active(self, part: Part, first: tuple[str, ...] = ()) -> tuple[str, ...]:
        """Return the joints that are planned for, those that take commands first."""
        joints = dict.fromkeys([*(joint for joint in first if joint in part.joints), *part.joints])
        return tuple(joint for joint in joints
                     if joint not in self.followers and joint in self.actuated)

    def chain(self, name: str, part: Part) -> tuple[str, str]:
        """Return the links before and after the joints of an arm, if they are a chain."""
        model, arm = self._robot.robot_model, 'right' if name == 'arm' else name
        if not isinstance(model, ManipulatorModel) or arm not in model.eef_name:
            return '', ''
        link = tip = self._tree.link_of_body[self._model.body(model.eef_name[arm]).id]
        joint_of = {joint.child: joint for joint in self._tree.joints}
        moving: list[Any] = []  # From the tip to the root.
        while link in joint_of and len(moving) < len(part.joints):
            moving += [joint_of[link]] if joint_of[link].kind != 'fixed' else []
            link = joint_of[link].parent
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
                self.active(part, commanded), commanded, links=links,
                parent=parent if parent in groups else '', parent_link=eef))
        return [group for group in gripper_groups if group.parent and group.links]


@dataclass(frozen=True)
class GroupState:
    """
    Named positions of joints.

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
            for _ in range(round(_PATIENCE_S / _PERIOD_S)):
                simulation.advance(max(1, round(_PERIOD_S / simulation.timestep_s)))
                speeds: FloatArray = np.abs(simulation.data.qvel[gripper.part.dof_addresses])
                if not robot.moving and speeds.max(initial=0.0) < _RESTS:
                    break
            moved = _positions(simulation, robot, _DIGITS)
            postures.append(GroupState(name, part, {
                **start, **{joint: moved[joint] for joint in gripper.part.joints}}))
    simulation.reset()
    return postures


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
    :param disabled: reason by pair of links
    """
    robot, groups = ElementTree.Element('robot', name=name), list(groups)
    for group in groups:
        element = ElementTree.SubElement(robot, 'group', name=group.name)
        for name in group.subgroups:
            ElementTree.SubElement(element, 'group', name=name)
        if group.tip:
            ElementTree.SubElement(element, 'chain', base_link=group.base, tip_link=group.tip)
        elif not group.subgroups:
            for link in group.links:
                ElementTree.SubElement(element, 'link', name=link)
            for joint in group.joints:
                ElementTree.SubElement(element, 'joint', name=joint)
    for posture in postures:
        for group in groups:
            if posture.part == group.part or (posture.name == START and group.active):
                element = ElementTree.SubElement(robot, 'group_state', name=posture.name,
                                                 group=group.name)
                for joint in group.active:
                    ElementTree.SubElement(element, 'joint', name=joint,
                                           value=text_of(posture.position[joint]))
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


#: Of random configurations; the seed is fixed, so that the same robot has the same file.
_SAMPLES, _SEED = 5000, 0
#: Shapes that come nearer than about this are taken for some that might collide [m].
_MARGIN_M = 0.01
#: Shapes nearer than this in a posture, such as closed fingers, count as touching [m].
_TOUCH_M = 1e-3
#: Of joints without a range [rad or m].
_ANYWHERE = (-np.pi, np.pi)
Pair = frozenset[str]


def disabled_pairs(world: World, robot: RobotModel, links: Mapping[int, str],
                   postures: Iterable[GroupState]) -> dict[Pair, str]:
    """
    Return the pairs of links that need not be checked for collisions, with the reason.

    ``User``: the model excludes them. ``Adjacent``: nothing with a shape is between them, or they
    cannot move relative to one another. ``Default``: they touch in a posture. ``Always``: they
    collide in all random configurations. ``Never``: they come near each other in none of them.

    :param postures: links that touch in one of these are not checked against each other
    """
    model, excluded = _without_filters(world, robot)
    sampler = _Sampler(model, robot, links)
    reasons: dict[Pair, str] = dict.fromkeys(sampler.names(excluded), 'User')
    for pair in sampler.names(_adjacent(model, sampler.bodies)):
        reasons.setdefault(pair, 'Adjacent')
    for posture in postures:
        for pair in sampler.touching(posture.position):
            reasons.setdefault(pair, 'Default')
    always, never = sampler.always_and_never()
    for pairs, reason in ((always, 'Always'), (never, 'Never')):
        for pair in pairs:
            reasons.setdefault(pair, reason)
    return reasons


def _without_filters(world: World, robot: RobotModel) -> tuple[Any, list[tuple[int, int]]]:
    """
    Return a model in which all colliding shapes of the robot collide with each other.

    :returns: the model, and the ids of the bodies whose collisions were excluded
    """
    spec = world.compose(objects=False)
    root = spec.body(robot.root_body)
    bodies = {body.name for body in [root, *root.find_all(mujoco.mjtObj.mjOBJ_BODY)]}
    for geom in spec.geoms:
        collides = bool(geom.contype or geom.conaffinity) and geom.parent.name in bodies
        geom.contype = geom.conaffinity = int(collides)
        geom.margin = _MARGIN_M
    excluded = [(exclude.bodyname1, exclude.bodyname2) for exclude in spec.excludes]
    for exclude in list(spec.excludes):
        spec.delete(exclude)
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)
    model = compile_spec(spec, world.name)
    return model, [(int(model.body(first).id), int(model.body(second).id))
                   for first, second in excluded]


def _adjacent(model: mujoco.MjModel, bodies: list[int]) -> Iterator[tuple[int, int]]:
    """Yield bodies with shapes that are next to each other, or fixed to each other."""
    shaped = set(bodies)
    for body in bodies:
        above = int(model.body_parentid[body])
        while above not in shaped and above:
            above = int(model.body_parentid[above])
        if above:
            yield body, above
    for body, other in combinations(bodies, 2):
        if model.body_weldid[body] == model.body_weldid[other]:
            yield body, other


class _Sampler:
    """
    Looks for collisions of a robot with itself.

    :param model: as from :func:`_without_filters`
    :ivar bodies: ids of those with shapes that collide, parents first
    """

    def __init__(self, model: mujoco.MjModel, robot: RobotModel, links: Mapping[int, str]) -> None:
        self._links = links
        self._model, self._data = model, mujoco.MjData(model)
        self._body_of_geom = np.asarray(model.geom_bodyid, dtype=np.int64)
        with_shapes = set(self._body_of_geom[model.geom_contype != 0].tolist())
        tree = subtree(model, model.body(robot.root_body).id)
        self.bodies = [body for body in tree if body in with_shapes]
        self._joints = [joint for joint in range(model.njnt)
                        if model.jnt_bodyid[joint] in tree and model.jnt_type[joint] in SCALAR]
        self._index = {joint: index for index, joint in enumerate(self._joints)}
        self._qpos = np.asarray(model.jnt_qposadr[self._joints], dtype=np.int64)
        self._low, self._high = np.where(
            model.jnt_limited[self._joints, None], model.jnt_range[self._joints], _ANYWHERE).T
        self._couplings = JointCouplings(model, self._joints)
        groups = {tuple(sorted(self._couplings.group(joint))) for joint in self._joints}
        #: Joints that are coupled.
        self._groups = sorted(group for group in groups if len(group) > 1)

    def touching(self, position: Mapping[str, float]) -> set[Pair]:
        """Return what touches with joints at positions by name."""
        for name, value in position.items():
            self._data.joint(name).qpos[0] = value
        numbers, distances = self._contacts()
        return self._of_numbers(numbers[distances < _TOUCH_M])

    def always_and_never(self) -> tuple[set[Pair], set[Pair]]:
        """Return what collided in every random configuration, and what never came near."""
        random = np.random.default_rng(_SEED)
        always = np.ones(self._model.nbody ** 2, dtype=bool)
        near = np.zeros_like(always)
        for _ in range(_SAMPLES):
            positions = random.uniform(self._low, self._high)
            self._data.qpos[self._qpos] = positions
            for group in self._groups:
                # One joint of those that are coupled says where the others are.
                leader = group[random.integers(len(group))]
                follow = self._couplings.follow({leader: float(positions[self._index[leader]])})
                self._data.qpos[[self._qpos[self._index[joint]] for joint in follow]] = [
                    *follow.values()]
            numbers, distances = self._contacts()
            near[numbers] = True
            inside = np.zeros_like(always)
            inside[numbers[distances < 0.0]] = True
            always &= inside
        return (self._of_numbers(np.flatnonzero(always)),
                self.names(combinations(self.bodies, 2)) - self._of_numbers(np.flatnonzero(near)))

    def _contacts(self) -> tuple[Any, Any]:
        """Return pairs of bodies that are near, each as one number, and distances [m]."""
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_collision(self._model, self._data)
        contacts = self._data.contact
        first, second = self._body_of_geom[contacts.geom].T
        return (np.minimum(first, second) * self._model.nbody + np.maximum(first, second),
                contacts.dist)

    def _of_numbers(self, numbers: Any) -> set[Pair]:
        return self.names(divmod(int(number), self._model.nbody) for number in numbers)

    def names(self, pairs: Iterable[tuple[int, int]]) -> set[Pair]:
        """Return the links of pairs of bodies, where both have shapes that collide."""
        shaped = set(self.bodies)
        return {frozenset((self._links[a], self._links[b])) for a, b in pairs
                if a in shaped and b in shaped}
