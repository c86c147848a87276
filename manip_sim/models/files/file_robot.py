# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Robots from files, completed by their description and by inference, with arms or without."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
import math
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.bases import MobileBaseModel, RobotBaseModel
from manip_sim.models.files.actuation import own_each_joint
from manip_sim.models.files.body_tree import BodyTree, is_unlimited, PALM_WORDS, words_of
from manip_sim.models.files.file_gripper import BuiltInGripper
from manip_sim.models.files.fingers import digest_of, digest_of_meshes
from manip_sim.models.files.found_arms import (
    ALONE, classify_joints, find_arms, FoundArm, lone_hands_as_arms)
from manip_sim.models.files.found_hands import find_hands, FoundHand, hand_below
from manip_sim.models.files.model_file import depth_in_floor, ModelFile, read_model
from manip_sim.models.files.part_descriptions import (
    ArmDescription, FrameDescription, OwnHandDescription, RobotDescription)
from manip_sim.models.files.scenery import MocapBodies
from manip_sim.models.grippers import GripperModel
from manip_sim.models.loading import compile_copy, compile_without_meshes
from manip_sim.models.robots import ManipulatorModel, Placement, RobotModel
from manip_sim.models.spec_edits import add_body_at, find_place, free_name, weld_joints
from manip_sim.models.user_files import Files, stem_of

#: Height above the floor at which the fingers of a hand alone stay [m].
_CLEARANCE_M = 0.05


@dataclass
class RobotPlan:
    """
    A robot's file, completed by its description and by inference.

    :ivar start: where scalar joints start, by name [rad or m]
    :ivar subsystems: by name of the joint, without joints of hands
    :ivar ends: the end effector body by arm; empty for a robot without arms
    :ivar hands: the file's own hands by arm
    :ivar arms: where the arms were found
    :ivar loose_actuators: names of the actuators that are of no part
    :ivar inferred: the inferences and omissions, in sentences
    :ivar keyframes: positions of scalar joints by keyframe and name [rad or m]
    :ivar mocap: the mocap bodies that come with the robot, or None
    :ivar depth_in_floor: how far it is raised where nothing else places it [m]
    """

    file: Path
    description: RobotDescription
    where: str
    spec: mujoco.MjSpec
    start: dict[str, float]
    subsystems: dict[str, str]
    ends: dict[str, str]
    hands: dict[str, BuiltInGripper]
    arms: dict[str, FoundArm]
    loose_actuators: set[str]
    inferred: list[str]
    keyframes: dict[str, dict[str, float]]
    mocap: MocapBodies | None
    depth_in_floor: float


def plan_robot(file: Path, description: RobotDescription, source: str, files: Files | None = None
               ) -> RobotPlan:
    """
    Read a robot and complete it.

    :raises ModelError: if the file or what the description says of it cannot be used
    :raises UnknownNameError: if the description has a name that the file lacks
    """
    model_file = read_model(file, description, source, files=files, visual=False)
    _hang_fingers_on_palm(model_file)
    spec, tree, notes = model_file.spec, model_file.tree, model_file.inferred
    start = model_file.start
    if not any(tree.is_scalar(joint) for joint in range(tree.model.njnt)):
        fixed = [f' ({note})' for note in notes if note.startswith('fixed')]
        raise ModelError(f'{file} is not a robot: it has no hinge or slide joint{"".join(fixed)}; '
                         'an object without joints goes to objects, a mount to base')
    mocap = model_file.mocap
    if mocap is not None:
        notes += mocap.notes() if description.mocap else mocap.left_out()
        mocap = mocap.at_start(tree.model, start) if description.mocap else None
    _check_joints(tree, description, source)
    file_hands = _find_hands(tree, description, source)
    subsystems = classify_joints(tree, description.subsystems,
                                 {joint for hand in file_hands for joint in hand.joints}, notes)
    arms = _find_arms(model_file, tree, subsystems, file_hands, description, source)
    hands = {side: arm.hand for side, arm in arms.items() if arm.hand is not None}
    shapes = _HandShapes(model_file, hands)
    if description.foot is None and {arm.why for arm in arms.values()} == {ALONE}:
        description = _raised(shapes.tree().model, model_file.inferred, description)
    depth = _depth(model_file, description)
    if len(arms) == 2:
        _find_torso(tree, subsystems, arms, description.subsystems)
    _sort_others(tree, subsystems, arms, description.subsystems)
    of_hands = {a for hand in hands.values() for a in hand.actuators}
    others = [a for a in range(tree.model.nu) if a not in of_hands]
    loose, changes = own_each_joint(spec, tree, others)
    notes += changes
    ends = {side: _add_end(spec, tree, side, arm, description, source, notes)
            for side, arm in arms.items()}
    own_hands = {side: _own_hand(spec, shapes, side, hand.in_tree(tree, shapes.light),
                                 description, source, start) for side, hand in hands.items()}
    of_hand_joints = {j for hand in hands.values() for j in hand.joints}
    by_name = {tree.joint_name(j): part for j, part in subsystems.items()
               if j not in of_hand_joints}
    for name, limit in description.velocity_limits.items():
        joint = spec.joint(name)
        joint.userdata = [limit, *list(joint.userdata)[1:]]
    notes += [f'{part}: {", ".join(joints)}' for part in ('base', 'torso', 'head', 'legs', 'other')
              if (joints := [name for name, subsystem in by_name.items() if subsystem == part])]
    return RobotPlan(file, description, source, spec, start, by_name, ends, own_hands, arms, loose,
                     notes, model_file.keyframes, mocap, depth)


def _hang_fingers_on_palm(model_file: ModelFile) -> None:
    """
    Take the new root of a hand for its palm whose fingers are roots of their own in the file.

    Converters write hands so: a link that is fixed to the world becomes shapes of the world body.
    """
    root, before = model_file.spec.worldbody.first_body(), model_file.tree
    names = {before.name(body) for body in range(1, before.model.nbody)}
    # A limb with a palm, or a hand by itself, is an arm.
    if root.name in names or find_hands(before) or any(
            words_of(name) & PALM_WORDS for name in names):
        return
    tree = BodyTree(compile_copy(model_file.spec, str(model_file.file), visual=False))
    if {joint for hand in find_hands(tree) for joint in hand.joints} == {*range(tree.model.njnt)}:
        model_file.tree = tree


class _HandShapes:
    """
    The tree of a robot as it was read, of which only hands move, and with all shapes of these.

    :ivar light: the tree without meshes, of which all moves
    :ivar key: digest of the tree with its meshes
    """

    def __init__(self, model_file: ModelFile, hands: Mapping[str, FoundHand]) -> None:
        self._spec, self._file = model_file.spec.copy(), str(model_file.file)
        tree = model_file.tree
        welds = tree.model.body_weldid
        carriers = {int(welds[hand.body]) for hand in hands.values()} - {0}
        self._bodies = {tree.name(body) for hand in hands.values()
                        for body in tree.below(hand.body)} | {
            name for body in np.flatnonzero(np.isin(welds, list(carriers))).tolist()
            if not self._spec.body(name := tree.name(body)).explicitinertial}
        self.light, self.key = tree, b''
        if hands:
            self.light = BodyTree(compile_without_meshes(self._spec, self._file, ()))
            self.key = digest_of(self.light.model) + digest_of_meshes(self._spec)
        # With what carries it, as MuJoCo lets fingers touch a palm that cannot move.
        self._joints = {tree.joint_name(joint) for joint in (
            *tree.joints(carriers), *(j for hand in hands.values() for j in hand.joints))}
        self.tree = cache(self._compile)

    def _compile(self) -> BodyTree:
        weld_joints(self._spec, self._joints)
        return BodyTree(compile_without_meshes(self._spec, self._file, self._bodies))


def _raised(model: mujoco.MjModel, notes: list[str], description: RobotDescription
            ) -> RobotDescription:
    """Return a description that keeps the fingers of a hand alone above the floor."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    geoms = [geom for geom in range(model.ngeom) if model.geom_bodyid[geom]]
    reach = max((math.dist(data.geom_xpos[geom], data.xpos[1]) + float(model.geom_rbound[geom])
                 for geom in geoms), default=0.0)
    height = round(reach + _CLEARANCE_M, 3)
    notes.append(f'it is fixed {height:g} m above the floor, in the air')
    return description.model_copy(update={'foot': [0.0, 0.0, -height]})


def _depth(model_file: ModelFile, description: RobotDescription) -> float:
    """Return how far a robot is raised that the file puts into the floor, unless it has a foot."""
    if description.foot is not None:
        return 0.0
    depth = depth_in_floor(model_file.tree.model, model_file.start)
    if depth:
        model_file.inferred.append(
            f'raised by {depth:.3f} m, so that its lowest shape is just above the floor, unless '
            'it stands on a base or is placed; foot: [0, 0, 0] in a YAML file leaves '
            'its root on the floor')
    return depth


def _end_body(tree: BodyTree, arm: FoundArm) -> int:
    model = tree.model
    return int(model.site(arm.name).bodyid[0] if arm.kind == 'site' else model.body(arm.name).id)


def _find_torso(tree: BodyTree, subsystems: dict[int, str], arms: Mapping[str, FoundArm],
                declared: Mapping[str, str]) -> None:
    """Take from the arms the joints that move both."""
    shared = tree.common(_end_body(tree, arm) for arm in arms.values())
    for joint in tree.joints(tree.path(shared)):
        if subsystems.get(joint) == 'arm' and tree.joint_name(joint) not in declared:
            subsystems[joint] = 'torso'


def _sort_others(tree: BodyTree, subsystems: dict[int, str], arms: Mapping[str, FoundArm],
                 declared: Mapping[str, str]) -> None:
    """
    Take from the arms the joints that neither lead to an end nor belong to its hand.

    One that an equality constraint couples to other joints is of their part, and one on a head, a
    leg or a wheel of that.
    """
    model, used = tree.model, set()
    for arm in arms.values():
        used |= set(tree.joints(tree.path(_end_body(tree, arm))))
        used |= set(() if arm.hand is None else arm.hand.joints)
    # A joint below which a loop is closed may drive the arm, as the crank of a parallel one.
    loops = {body for pair in tree.tied_bodies() for body in pair if body} if arms else set()
    others = [joint for joint, part in subsystems.items()
              if part == 'arm' and joint not in used and str(model.joint(joint).name)
              not in declared and not tree.below(int(model.jnt_bodyid[joint])) & loops]
    subsystems.update(dict.fromkeys(others, 'other'))
    for joint in reversed(others):  # Joints further down are sorted first.
        body = int(model.jnt_bodyid[joint])
        leaders = {part for other in tree.coupled([joint])
                   if (part := subsystems[other]) != 'other' and (other in used or part != 'arm')}
        carried = {subsystems[j] for j in tree.joints(sorted(tree.below(body)))
                   if j != joint and j in subsystems}
        if leaders:
            subsystems[joint] = 'arm' if 'arm' in leaders else min(leaders)
        elif carried == {'base'}:  # Such as one that rolls all wheels.
            subsystems[joint] = 'base'
        else:
            subsystems[joint] = _part_of_carrier(tree, subsystems, joint)


def _part_of_carrier(tree: BodyTree, subsystems: Mapping[int, str], joint: int) -> str:
    """
    Return the part of what a joint moves on: a head, a leg, or a wheel; ``other`` if none.

    A joint of a head that turns without end is no part of it: it turns a laser.
    """
    body = tree.body_of(joint)
    above = [joint for joint in tree.joints(tree.path(tree.parent(body))) if joint in subsystems]
    part = subsystems[above[-1]] if above else 'other'
    if part in ('head', 'legs'):
        return 'other' if is_unlimited(tree.model, joint) else part
    carrier = int(tree.model.jnt_bodyid[above[-1]]) if above else 0
    beside = {subsystems.get(joint, 'base') for joint in tree.joints(sorted(tree.below(carrier)))}
    return 'base' if part == 'base' and beside <= {'base', 'other'} else 'other'


def _check_joints(tree: BodyTree, description: RobotDescription, source: str) -> None:
    names = [tree.joint_name(j) for j in range(tree.model.njnt)]
    for key, joints in (('subsystems', description.subsystems),
                        ('velocity_limits', description.velocity_limits)):
        for joint in joints:
            if joint not in names:
                raise UnknownNameError(f"joint in '{key}' of {source}", joint, names)


def _hand_description(arm: ArmDescription | None) -> OwnHandDescription | None:
    """Return the description of a file's own hand; None if it says that there is none."""
    if arm is None or arm.hand is None:
        return OwnHandDescription()
    if isinstance(arm.hand, str):
        return None if arm.hand == 'none' else OwnHandDescription(body=arm.hand)
    return arm.hand


def _find_hands(tree: BodyTree, description: RobotDescription, source: str) -> list[FoundHand]:
    """Return the hands that the description names, else those that are found."""
    declared = []
    for side, arm in description.by_arm.items():
        hand = _hand_description(arm)
        if hand is not None and hand.body is not None:
            bodies = {tree.name(body): body for body in range(1, tree.model.nbody)}
            if hand.body not in bodies:
                raise UnknownNameError(f"body in 'arms.{side}.hand' of {source}", hand.body,
                                       bodies)
            declared.append(hand_below(tree, bodies[hand.body]))
    return declared or find_hands(tree)


def _find_arms(model_file: ModelFile, tree: BodyTree, subsystems: Mapping[int, str],
               hands: list[FoundHand], description: RobotDescription, source: str
               ) -> dict[str, FoundArm]:
    if isinstance(description.arms, str):
        return {}
    declared = {str(side): arm for side, arm in description.by_arm.items()
                if arm.mount is not None}
    arms: dict[str, FoundArm]
    if declared:
        arms = {side: _declared_arm(model_file.spec, tree, side, arm, hands, source)
                for side, arm in declared.items()}
    else:
        notes = model_file.inferred
        arms = (lone_hands_as_arms(tree, subsystems, hands, notes)
                or find_arms(tree, subsystems, hands, notes))
        if arms:
            model_file.inferred.append('; '.join(
                f"{side} arm ends at {arm.kind} '{arm.name}': {arm.why}"
                for side, arm in arms.items()))
    for named in description.by_arm:
        if named not in arms:
            raise UnknownNameError(f"arm in 'arms' of {source}", named, arms)
    if set(arms) == {'left'}:
        raise ModelError(f"the only arm is called 'right', but 'arms' of {source} has 'left'")
    for side, arm in arms.items():
        if _hand_description(description.arm(side)) is None:
            arms[side] = FoundArm(arm.kind, arm.name, None, arm.why)
    return {side: arms[side] for side in ('right', 'left') if side in arms}


def _declared_arm(spec: mujoco.MjSpec, tree: BodyTree, side: str, arm: ArmDescription,
                  hands: list[FoundHand], source: str) -> FoundArm:
    name = arm.mount.at if isinstance(arm.mount, FrameDescription) else arm.mount
    if name is None:
        raise ModelError(f"'arms.{side}.mount' of {source} must say 'at' which body or site")
    kind, element = find_place(spec, name, f"'arms.{side}.mount' of {source}")
    body = element if kind == 'body' else element.parent
    below = tree.below(int(tree.model.body(body.name).id))
    hand = next((hand for hand in hands if hand.body in below), None)
    return FoundArm(kind, name, hand, 'declared')


def _add_end(spec: mujoco.MjSpec, tree: BodyTree, side: str, arm: FoundArm,
             description: RobotDescription, source: str, notes: list[str]) -> str:
    """Return the end effector body of an arm; a site or an offset needs a new one."""
    declared = description.arm(side)
    mount = declared.mount if declared is not None else None
    if arm.hand is not None:
        return tree.name(arm.hand.body)
    place = find_place(spec, arm.name, f"'arms.{side}.mount' of {source}")
    if arm.kind == 'body' and not isinstance(mount, FrameDescription):
        return arm.name
    frame = mount if isinstance(mount, FrameDescription) else FrameDescription()
    name = free_name({body.name for body in spec.bodies}, f'{side}_hand')
    add_body_at(tree.model, place, name, frame.position, frame.orientation)
    notes.append(f"new body '{name}' at {arm.kind} '{arm.name}' for a gripper")
    return name


def _own_hand(spec: mujoco.MjSpec, shapes: _HandShapes, side: str, hand: FoundHand,
              description: RobotDescription, source: str, start: dict[str, float]
              ) -> BuiltInGripper:
    declared = _hand_description(description.arm(side)) or OwnHandDescription()
    gripper = BuiltInGripper(side, declared, source, start)
    gripper.add_to(spec, shapes.light, hand, shapes.key, shapes.tree)
    return gripper


class FileRobot(RobotModel, registered=False):
    """
    A robot from a file.

    :param plan: the file, completed by its description
    :param idn: number or word in names
    :ivar inferred: the inferences and omissions, in sentences
    """

    _refers_to_all = True  # As it was read with ``read_model``.

    def __init__(self, plan: RobotPlan, idn: int | str) -> None:
        self._plan = plan
        self._own_hands: dict[str, BuiltInGripper] = dict(plan.hands)
        self._subsystem_of_joint = plan.subsystems
        if plan.description.foot is not None:
            x, y, z = plan.description.foot
            self._foot_offset = (x, y, z)
        self._keyframes = plan.keyframes
        super().__init__(plan.file, idn=idn)
        self.inferred = [*plan.inferred, *(
            f'{arm} hand: {sentence}' for arm, hand in plan.hands.items()
            for sentence in hand.inferred)]

    def _read(self) -> Any:
        return self._plan.spec

    def _compile_alone(self) -> mujoco.MjModel:
        if self._spec_is_shared:
            return super()._compile_alone()
        return compile_without_meshes(self._spec, self.name, ())

    def _record(self) -> None:
        super()._record()
        hands = self._own_hands.values()
        not_ours = set().union(*(hand.names_in_file for hand in hands))
        self._joints = [name for name in self._joints if name not in not_ours]
        self._actuators = [name for name in self._actuators
                           if name not in not_ours | self._plan.loose_actuators]
        for hand in hands:
            hand.bind(self, self._own_model)

    def add_base(self, base: RobotBaseModel) -> None:
        """
        Put the robot on a base; a mobile one leaves the mocap bodies of the file out.

        :param base: as for :meth:`RobotModel.add_base`
        """
        super().add_base(base)
        mocap = self._plan.mocap
        if mocap is not None and isinstance(base, MobileBaseModel):
            kept = [said for said in self.inferred if said not in mocap.notes()]
            self.inferred = [*kept, *(f'{said}, as the robot stands on a mobile base'
                                      for said in mocap.left_out())]

    @property
    def bottom_offset(self) -> FloatArray:
        """
        From the root body to the floor that the robot stands on [m], shape (3,), a copy.

        Without a base it is below the lowest shape if the file puts that into the floor, unless
        :meth:`set_base_xpos` placed the robot.
        """
        offset = super().bottom_offset
        if self._base is None and self._may_be_raised:
            offset[2] -= self._plan.depth_in_floor
        return offset

    def _placed_copy(self, floor_xpos: ArrayLike | None) -> mujoco.MjSpec:
        spec = super()._placed_copy(floor_xpos)
        if floor_xpos is None and self._floor_xpos is None and self._base is None:
            spec.body(self._root().name).pos[2] += self._plan.depth_in_floor
        return spec

    def attach_to(self, spec: mujoco.MjSpec, frame: mujoco.MjsFrame,
                  floor_xpos: ArrayLike | None = None) -> None:
        """
        Add a copy of the robot, of everything mounted on it and of the file's mocap bodies.

        :param spec: the spec to add to
        :param frame: the frame of that spec to attach the robot to
        :param floor_xpos: as for :meth:`RobotModel.attach_to`
        """
        super().attach_to(spec, frame, floor_xpos)
        if self._plan.mocap is None or isinstance(self.base, MobileBaseModel):
            return
        in_file, root = self._own_model.body(self._root().name), spec.body(self.root_body)
        self._plan.mocap.add_to(spec, self.naming_prefix, self.name, *(
            np.concatenate([place.pos, place.quat]) for place in (in_file, root)))

    @property
    def type_name(self) -> str:
        """Name of the file, such as ``iiwa14``."""
        return stem_of(self.file)

    @property
    def described(self) -> dict[str, Any]:
        """The file's description, with nothing left to infer, as the keys of a YAML file."""
        model, plan = self._own_model, self._plan
        declared = plan.description.model_dump(exclude_unset=True)
        limited = {str(model.joint(joint).name): model.jnt_range[joint]
                   for joint in range(model.njnt) if model.jnt_limited[joint]}
        return {**declared, 'model': plan.file.name,
                'arms': {side: _described_arm(plan, side) for side in plan.ends} or 'none',
                'subsystems': {**dict(plan.subsystems), **declared.get('subsystems', {})},
                'start': {
                    joint: at if joint not in limited else float(np.clip(at, *limited[joint]))
                    for joint, at in plan.start.items()}}

    @property
    def default_base(self) -> str | None:
        """The base that the description names; None is the floor."""
        return self._plan.description.base

    @property
    def default_controller_config(self) -> dict[str, str]:
        """Names of controller settings in the description, by arm or subsystem."""
        arms = self._plan.description.by_arm.items()
        return {**self._plan.description.controllers,
                **{side: arm.controller for side, arm in arms if arm.controller is not None}}

    @property
    def init_qpos(self) -> FloatArray:
        """Start positions of the joints [rad or m], shape (dof,), a copy."""
        # A ball joint has no start: it stays at the unit quaternion, whose w is 1.
        return np.array([self._plan.start.get(joint, 1.0) for joint in self._joints])

    @property
    def base_xpos_offset(self) -> dict[str, Placement]:
        """Places of the robot by arena [m]: as described, else in front of table or bins."""
        declared = {arena: (float(x), float(y), float(z))
                    for arena, (x, y, z) in self._plan.description.placement.items()}
        return {'bins': (-0.5, -0.1, 0.0),
                'table': lambda table_length: (-0.16 - table_length / 2.0, 0.0, 0.0), **declared}


class FileManipulator(FileRobot, ManipulatorModel, registered=False):
    """
    A robot with arms from a file.

    A hand in the file is one of :attr:`grippers` from the start; mounting another gripper replaces
    it.

    :param plan: the file, completed by its description
    :param idn: number or word in names
    """

    def __init__(self, plan: RobotPlan, idn: int | str) -> None:
        super().__init__(plan, idn=idn)
        self._grippers.update(self._own_hands)

    @property
    def arm_type(self) -> str:
        """``single`` or ``bimanual``."""
        return 'single' if len(self._plan.ends) == 1 else 'bimanual'

    @property
    def _eef_name(self) -> dict[str, str]:
        return self._plan.ends

    @property
    def default_gripper(self) -> dict[str, str]:
        """Names of grippers in the description, by arm."""
        return {side: arm.gripper for side, arm in self._plan.description.by_arm.items()
                if arm.gripper is not None}

    @property
    def own_hands(self) -> tuple[str, ...]:
        """The arms that carry a hand of the robot's own file."""
        return tuple(self._own_hands)

    def add_gripper(self, gripper: GripperModel, arm_name: str | None = None) -> None:
        """
        Mount a gripper, in place of a hand of the robot's own file.

        :param gripper: the gripper; if it goes on several arms, each gets a copy of its own
        :param arm_name: an arm or its end effector body; None mounts on every arm
        :raises TypeError: if it is not a gripper
        :raises UnknownNameError: if the arm is unknown
        :raises ModelError: if the arm has a gripper already, or the gripper is mounted already
        """
        if isinstance(gripper, GripperModel):
            for arm in self.arms if arm_name is None else (self.arm_of(arm_name),):
                self.take_off_hand(arm)
        super().add_gripper(gripper, arm_name)

    def take_off_hand(self, arm: str) -> None:
        """
        Remove the hand of the robot's own file from an arm, if there is one.

        :param arm: ``right`` or ``left``
        """
        hand = self._own_hands.pop(arm, None)
        if hand is None:
            return
        del self._grippers[arm]
        hand.remove_from(self._spec)
        self._record()
        self.update_joints()
        self.update_actuators()


def _described_arm(plan: RobotPlan, side: str) -> dict[str, Any]:
    declared = plan.description.arm(side)
    values = {} if declared is None else declared.model_dump(exclude_unset=True)
    arm = {**values, 'mount': values.get('mount', plan.arms[side].name)}
    hand = plan.hands.get(side)
    if hand is None:
        return {**arm, 'hand': 'none'}
    hand_values = values.get('hand')
    return {**arm, 'hand': {
        **(hand_values if isinstance(hand_values, dict) else {}), 'body': hand.body,
        'grasp_point': hand.grasp_point.model_dump(), 'closing': hand.closing}}
