# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Read a robot's file and complete it by its description and by inference."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.files.actuation import own_each_joint
from manip_sim.models.files.arms import find_arms, FoundArm
from manip_sim.models.files.classification import classify_joints
from manip_sim.models.files.description import (
    ArmDescription, Frame, OwnHandDescription, RobotDescription)
from manip_sim.models.files.frames import add_body_at, find_place, free_name
from manip_sim.models.files.hands import find_hands, FoundHand, hand_below
from manip_sim.models.files.own_hand import OwnHand
from manip_sim.models.files.overlaps import exclude_overlaps
from manip_sim.models.files.reading import ModelFile, read_model
from manip_sim.models.files.start import start_pose
from manip_sim.models.files.tree import BodyTree

_KEYFRAMES = ('home',)


@dataclass
class RobotPlan:
    """
    A robot's file, completed by its description and by inference.

    :ivar file: the model
    :ivar description: what the YAML file says
    :ivar where: the file that the description was read from, for messages
    :ivar spec: the ``mujoco.MjSpec``, completed
    :ivar start: where scalar joints start, by name [rad or m]
    :ivar subsystems: by name of the joint, without joints of hands
    :ivar ends: the end effector body by arm; empty for a robot without arms
    :ivar hands: the file's own hands by arm
    :ivar still: names of the actuators that hold still
    :ivar inferred: what was inferred or left out, in sentences
    """

    file: Path
    description: RobotDescription
    where: str
    spec: mujoco.MjSpec
    start: dict[str, float]
    subsystems: dict[str, str]
    ends: dict[str, str]
    hands: dict[str, OwnHand]
    still: set[str]
    inferred: list[str]


def plan_robot(file: Path, description: RobotDescription, where: str) -> RobotPlan:
    """
    Read a robot and complete it.

    :param file: MJCF or URDF
    :param where: the file that the description was read from, for messages
    :raises ModelError: if the file or what the description says of it cannot be used
    :raises UnknownNameError: if the description has a name that the file lacks
    """
    keyframe = description.start if isinstance(description.start, str) else None
    model_file = read_model(file, _KEYFRAMES, keyframe)
    spec, tree, notes = model_file.spec, model_file.tree, model_file.inferred
    start = start_pose(model_file, description.start, where)
    if not any(tree.is_scalar(joint) for joint in range(tree.model.njnt)):
        raise ModelError(f'{file} is not a robot: it has no hinge or slide joint')
    notes += exclude_overlaps(spec, tree.model, start, file)
    _check_joints(tree, description, where)
    found = _find_hands(tree, description, where)
    subsystems = classify_joints(tree, description.subsystems,
                                 {joint for hand in found for joint in hand.joints})
    arms = _find_arms(model_file, tree, subsystems, found, description, where)
    hands = {side: arm.hand for side, arm in arms.items() if arm.hand is not None}
    of_hands = {a for hand in hands.values() for a in hand.actuators}
    others = [a for a in range(tree.model.nu) if a not in of_hands]
    still, changes = own_each_joint(spec, tree, others, start)
    notes += changes
    ends = {side: _add_end(spec, tree, side, arm, description, where, notes)
            for side, arm in arms.items()}
    own = {side: _own_hand(spec, tree, side, hand, description, where, start)
           for side, hand in hands.items()}
    of_hand_joints = {j for hand in hands.values() for j in hand.joints}
    by_name = {str(tree.model.joint(j).name): part for j, part in subsystems.items()
               if j not in of_hand_joints}
    _limit_velocities(spec, description.velocity_limits)
    notes += _subsystem_notes(by_name)
    return RobotPlan(file, description, where, spec, start, by_name, ends, own, still, notes)


def _check_joints(tree: BodyTree, description: RobotDescription, where: str) -> None:
    names = [str(tree.model.joint(j).name) for j in range(tree.model.njnt)]
    for key, joints in (('subsystems', description.subsystems),
                        ('velocity_limits', description.velocity_limits)):
        for joint in joints:
            if joint not in names:
                raise UnknownNameError(f"joint in '{key}' of {where}", joint, names)


def _hand_description(arm: ArmDescription | None) -> OwnHandDescription | None:
    """Return the description of a file's own hand; None if it says that there is none."""
    if arm is None or arm.hand is None:
        return OwnHandDescription()
    if isinstance(arm.hand, str):
        return None if arm.hand == 'none' else OwnHandDescription(body=arm.hand)
    return arm.hand


def _find_hands(tree: BodyTree, description: RobotDescription, where: str) -> list[FoundHand]:
    """Return the hands that the description names, else those that are found."""
    declared = []
    for side, arm in description.arms.items():
        hand = _hand_description(arm)
        if hand is not None and hand.body is not None:
            bodies = {tree.name(body): body for body in range(1, tree.model.nbody)}
            if hand.body not in bodies:
                raise UnknownNameError(f"body in 'arms.{side}.hand' of {where}", hand.body,
                                       bodies)
            declared.append(hand_below(tree, bodies[hand.body]))
    return declared or find_hands(tree)


def _find_arms(model_file: ModelFile, tree: BodyTree, subsystems: Mapping[int, str],
               hands: list[FoundHand], description: RobotDescription, where: str
               ) -> dict[str, FoundArm]:
    declared = {str(side): arm for side, arm in description.arms.items() if arm.mount is not None}
    arms: dict[str, FoundArm]
    if declared:
        arms = {side: _declared_arm(model_file.spec, tree, side, arm, hands, where)
                for side, arm in declared.items()}
    else:
        arms = find_arms(tree, subsystems, hands)
        if arms:
            model_file.inferred.append('; '.join(
                f"{side} arm ends at {arm.kind} '{arm.name}': {arm.why}"
                for side, arm in arms.items()))
    for named in description.arms:
        if named not in arms:
            raise UnknownNameError(f"arm in 'arms' of {where}", named, arms)
    if set(arms) == {'left'}:
        raise ModelError(f"the only arm is called 'right', but 'arms' of {where} has 'left'")
    for side, arm in arms.items():
        if _hand_description(description.arm(side)) is None:
            arms[side] = FoundArm(arm.kind, arm.name, None, arm.why)
    return {side: arms[side] for side in ('right', 'left') if side in arms}


def _declared_arm(spec: mujoco.MjSpec, tree: BodyTree, side: str, arm: ArmDescription,
                  hands: list[FoundHand], where: str) -> FoundArm:
    name = arm.mount.at if isinstance(arm.mount, Frame) else arm.mount
    if name is None:
        raise ModelError(f"'arms.{side}.mount' of {where} must say 'at' which body or site")
    kind, element = find_place(spec, name, f"'arms.{side}.mount' of {where}")
    body = element if kind == 'body' else element.parent
    below = tree.below(int(tree.model.body(body.name).id))
    hand = next((hand for hand in hands if hand.body in below), None)
    return FoundArm(kind, name, hand, 'declared')


def _add_end(spec: mujoco.MjSpec, tree: BodyTree, side: str, arm: FoundArm,
             description: RobotDescription, where: str, notes: list[str]) -> str:
    """Return the end effector body of an arm; a site or an offset needs a new one."""
    declared = description.arm(side)
    mount = declared.mount if declared is not None else None
    if arm.hand is not None:
        return tree.name(arm.hand.body)
    place = find_place(spec, arm.name, f"'arms.{side}.mount' of {where}")
    if arm.kind == 'body' and not isinstance(mount, Frame):
        return arm.name
    frame = mount if isinstance(mount, Frame) else Frame()
    name = free_name({body.name for body in spec.bodies}, f'{side}_hand')
    add_body_at(spec, tree.model, place, name, frame.position, frame.orientation)
    notes.append(f"new body '{name}' at {arm.kind} '{arm.name}' for a gripper")
    return name


def _own_hand(spec: mujoco.MjSpec, tree: BodyTree, side: str, hand: FoundHand,
              description: RobotDescription, where: str, start: dict[str, float]) -> OwnHand:
    declared = _hand_description(description.arm(side)) or OwnHandDescription()
    own = OwnHand(side, declared, where, start)
    own.add_to(spec, tree, hand)
    return own


def _limit_velocities(spec: mujoco.MjSpec, limits: Mapping[str, float]) -> None:
    for name, limit in limits.items():
        joint = spec.joint(name)
        joint.userdata = [limit, *list(joint.userdata)[1:]]


def _subsystem_notes(subsystems: Mapping[str, str]) -> list[str]:
    notes = []
    for part in ('base', 'torso', 'head', 'legs'):
        joints = [joint for joint, of in subsystems.items() if of == part]
        if joints:
            notes.append(f'{part}: {", ".join(joints)}')
    return notes
