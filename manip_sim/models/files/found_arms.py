# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Sort the joints of third-party models into subsystems, by names, and find where arms end."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
import re

import mujoco

from manip_sim.models.files.body_tree import BodyTree, FINGERS, Limbs, MAX_FINGERS, words_of
from manip_sim.models.files.found_hands import (
    carries_arms, FoundHand, hand_below, LEAST_OF_ARM, lone_hands)
from manip_sim.models.robots.robot_model import classify
from manip_sim.quoting import quoted_names

_END_WORDS = {'tool', 'flange', 'tcp', 'ee', 'eef', 'hand', 'gripper', 'attachment', 'pinch'}
#: A chain of at most this fraction of the joints of the longest one is not an arm.
_ARM_SHARE = 0.5
#: An arm on a floating root has at most so many joints, unless a name says that it is one.
_MOST_OF_ARM = 8
#: Arms that are nearer to each other along an axis are not beside each other along it [m].
_BESIDE_M = 0.05
#: Words for a subsystem besides the words of ``classify``, in the order in which they are tried.
_WORDS = {
    'base': {'wheel', 'wheels', 'caster', 'castor', 'steer', 'steering'},
    'head': {'head', 'neck', 'eye', 'eyes', 'antenna', 'camera', 'cam'},
    'legs': {'leg', 'legs', 'hip', 'knee', 'ankle', 'ank', 'foot', 'toe', 'thigh', 'calf', 'shin',
             'shank', 'tarsus', 'plantar', 'achilles', 'abduction', 'abad', 'coxa', 'femur',
             'tibia', 'hx', 'hy', 'kn', 'haa', 'hfe', 'kfe', 'ffe', 'faa', 'hr'},
    'torso': {'waist', 'spine', 'abdomen', 'lift', 'trunk', 'chest', 'column'}}
#: Words in names of bodies, which decide where the names of joints do not.
_BODY_WORDS = {
    'base': {'wheel', 'wheels', 'caster', 'castor'},
    'legs': {'leg', 'thigh', 'calf', 'shin', 'shank', 'coxa', 'femur', 'tibia', 'foot', 'toe',
             'paw'}}
#: Words of an arm, also beside those above, as in ``shoulder_lift``.
_OF_ARM = {'shoulder', 'elbow', 'wrist'}
#: Of these, the words that no leg has: some name the hip of a quadruped its shoulder.
_ARM_BEYOND_SHOULDER = {'elbow', 'wrist'}
#: Words of legs that arms have, too.
_OF_SHOULDERS = {'abduction'}
#: Between the names of the links that a joint connects, as in torso_to_thigh.
_TO = re.compile(r'_to_(?=.)')
#: The name of a root's joint, which is a hinge if the file does not say that it is free.
_FLOATING_BASE = {'floating', 'base'}
_SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)
#: Joints of a root that moves in the plane are named after an axis: x, y, theta.
_AXIS = re.compile(r'(?:^|_)(x|y|th|theta)$')


def classify_joints(tree: BodyTree, declared: Mapping[str, str], fingers: Collection[int],
                    notes: list[str]) -> dict[int, str]:
    """
    Return the subsystems of joints by id, without free joints.

    In this order decide: the description; the name of the joint; the name of the body that it
    moves, for wheels and legs; the name of its actuator; what the joint is and where, see
    :class:`Limbs`. Joints of a limb
    that has a leg's name, and neither an elbow nor a wrist nor fingers, are legs, and those that
    carry nothing but legs and wheels are base. A joint that is torso by a word of :data:`_WORDS`
    is arm if it moves at most one limb, as the waist of an arm on a table does, and so is one of
    legs that moves one limb with fingers.

    :param declared: subsystems by name of the joint, which take precedence
    :param fingers: ids of the joints of hands
    :param notes: gets a sentence for each subsystem that no name decides
    """
    model = tree.model
    subsystems: dict[int, str] = {}
    unnamed: set[int] = set()
    by_actuator = _by_actuators(tree)
    for joint in range(model.njnt):
        if int(model.jnt_type[joint]) == 0:
            continue
        name = tree.joint_name(joint)
        subsystems[joint] = (declared.get(name) or _by_name(name) or _by_body(tree, joint)
                             or by_actuator.get(joint, 'arm'))
        if name not in declared and not _by_name(name) and joint not in fingers:
            unnamed.add(joint)
    free = {joint for joint in unnamed if subsystems[joint] == 'arm'}
    _correct_base(tree, subsystems, declared)
    limbs = Limbs(tree)
    _complete_wheels(tree, limbs, subsystems, free)
    for joint in free.difference(limbs.leading):  # One that moves the whole robot is of the base.
        if 'pelvis' in words_of(tree.joint_name(joint)):
            subsystems[joint] = 'torso'
    free |= {joint for joint in limbs.legs_with_shoulders() if subsystems.get(joint) == 'arm'
             and tree.joint_name(joint) not in declared and joint not in fingers}
    _find_unnamed(tree, limbs, subsystems, free, notes)
    _complete_legs(tree, limbs, subsystems, declared, fingers)
    _correct_single_limbs(tree, subsystems, declared, fingers)
    return subsystems


def _by_name(name: str) -> str | None:
    """
    Return the subsystem that the name of a joint says, ``arm`` by a word of arms, or None.

    If it names two links, as ``torso_to_thigh``, the second one decides.
    """
    name = _TO.split(name)[-1]
    subsystem = classify(name)
    if subsystem != 'arm':
        return subsystem
    words = words_of(name)
    if words & _OF_ARM:
        return 'arm'
    if words >= _FLOATING_BASE:
        return 'base'
    return next((part for part, known in _WORDS.items() if words & known), None)


def _by_body(tree: BodyTree, joint: int) -> str | None:
    """Return the subsystem that the name of the body says that a joint moves, or None."""
    words = words_of(tree.name(tree.body_of(joint)))
    return next((part for part, known in _BODY_WORDS.items() if words & known), None)


def _by_actuators(tree: BodyTree) -> dict[int, str]:
    """Return the subsystems of joints that the names of actuators say that drive them alone."""
    parts = {}
    for actuator in range(tree.model.nu):
        driven, part = tree.driven(actuator), _by_name(str(tree.model.actuator(actuator).name))
        if len(driven) == 1 and part is not None:
            parts[next(iter(driven))] = part
    return parts


def _find_unnamed(tree: BodyTree, limbs: Limbs, subsystems: dict[int, str], free: set[int],
                  notes: list[str]) -> None:
    """Find planar bases, wheels and legs by what their joints are."""
    for part, joints, why in (
            ('base', limbs.planar_base(), 'they move the whole robot in a plane'),
            ('base', limbs.moving_root(), 'they move the whole robot without limits'),
            ('base', limbs.wheels(free), 'they turn without limits about horizontal axes and '
             'carry nothing'),
            ('legs', limbs.legs(free.union(limbs.legs_with_shoulders())),
             'these limbs are alike, in pairs or too many for a hand'),
            ('legs', limbs.standing_pair(free), 'they are all that a floating robot stands on')):
        joints = [joint for joint in joints if joint in free and subsystems[joint] == 'arm']
        if joints:
            subsystems.update(dict.fromkeys(joints, part))
            first = str(tree.model.joint(joints[0]).name)
            notes.append(f'{part} is a guess: {why}; subsystems: {{{first}: other}} in a YAML '
                         'file, and so on for each joint, changes it')


def _complete_wheels(tree: BodyTree, limbs: Limbs, subsystems: dict[int, str], free: set[int]
                     ) -> None:
    """
    Assign joints between the trunk and wheels to the base, and joints of limbs tied to them.

    Two limbs or more have wheels: an arm may end in a tool that is called a wheel. Limbs with the
    name of a leg are legs.

    :param free: the joints whose subsystem nothing else decides; joints of the base are taken out
    """
    def carries_wheels(limb: int) -> bool:
        joints = limbs.joints(limb)
        ends = tree.ends(j for j in joints if j in subsystems)
        return len(joints) > 1 and 'legs' not in map(subsystems.get, joints) and all(
            subsystems.get(joint) == 'base' for joint in tree.joints(ends))

    groups = [group for group in limbs.tied(limbs.trunk) if any(map(carries_wheels, group))]
    if len(groups) > 1:
        joints = {joint for group in groups for limb in group for joint in limbs.joints(limb)}
        subsystems.update(dict.fromkeys(joints & free, 'base'))
        free -= joints


def _complete_legs(tree: BodyTree, limbs: Limbs, subsystems: dict[int, str],
                   declared: Mapping[str, str], fingers: Collection[int]) -> None:
    """
    Assign joints without a part of their own to the legs of their limb, or to the base.

    Limbs that loops tie to each other are one, such as the rods of an ankle.
    """
    def can_change(joint: int) -> bool:
        name = tree.joint_name(joint)
        return subsystems.get(joint) == 'arm' and name not in declared and joint not in fingers

    of_others = _by_actuators(tree)

    def may_be_of_shoulder(joint: int) -> bool:
        words = words_of(tree.joint_name(joint))
        return (words & _WORDS['legs'] <= _OF_SHOULDERS and not _by_body(tree, joint)
                and of_others.get(joint) != 'legs')

    chains = [[joint for limb in group for joint in limbs.joints(limb)]
              for group in limbs.tied(limbs.trunk)]
    if not chains and not all(may_be_of_shoulder(joint) for joint in limbs.leading):
        chains = [limbs.leading]  # A leg alone.
    for chain in chains:
        joints = [joint for joint in chain if joint in subsystems]
        words = set().union(*(words_of(tree.joint_name(j)) for j in joints))
        parts = {subsystems[joint] for joint in joints}
        if 'legs' in parts <= {'legs', 'arm', 'base'} and not (
                words & _ARM_BEYOND_SHOULDER or set(joints) & set(fingers)):
            subsystems.update({joint: 'legs' for joint in joints if can_change(joint)})
    beyond = {subsystems[joint] for limb in limbs.on(limbs.trunk) for joint in limbs.joints(limb)
              if joint in subsystems}
    if 'legs' in beyond <= {'legs', 'base'}:
        subsystems.update({joint: 'base' for joint in limbs.leading if can_change(joint)})
    if 'legs' not in beyond and 'arm' in {subsystems.get(joint) for joint in limbs.leading}:
        subsystems.update({
            joint: 'arm' for joint in limbs.leading if subsystems.get(joint) == 'legs'
            and (name := tree.joint_name(joint)) not in declared
            and words_of(name) & _WORDS['legs'] <= _OF_SHOULDERS})


def _correct_base(tree: BodyTree, subsystems: dict[int, str], declared: Mapping[str, str]) -> None:
    """
    Assign the joints of a root to the base if all are named after the axes of a plane.

    So are three slides and a hinge or more that no actuator drives, of a root that carries joints
    that some do: they stand for the free joint of a robot, whatever its root is called.
    """
    model = tree.model
    driven: set[int] = set().union(*map(tree.driven, range(model.nu)))
    for root in (body for body in range(1, model.nbody) if tree.parent(body) == 0):
        joints = [joint for joint in tree.joints([root]) if tree.is_scalar(joint)]
        are_axes = len(joints) >= 2 and all(
            _AXIS.search(tree.joint_name(joint)) for joint in joints)
        slides = [int(model.jnt_type[joint]) == _SLIDE for joint in joints]
        floats = (sum(slides) == 3 < len(slides) and not driven.intersection(joints)
                  and driven.intersection(tree.joints(tree.below(root))))
        if are_axes or floats:
            subsystems.update({joint: 'base' for joint in joints
                               if tree.joint_name(joint) not in declared})


def _correct_single_limbs(tree: BodyTree, subsystems: dict[int, str], declared: Mapping[str, str],
                          fingers: Collection[int]) -> None:
    """
    Assign torso and leg joints to the arm where they move one limb, legs only with fingers.

    A torso that moves none is an arm, too, in a robot without legs.
    """
    most = 0 if 'legs' in subsystems.values() else -1
    for joint, subsystem in list(subsystems.items()):
        name = tree.joint_name(joint)
        if subsystem not in ('torso', 'legs') or name in declared or classify(name) == subsystem:
            continue
        below = set(tree.joints(tree.below(tree.body_of(joint))))
        limbs = {j for j in below - set(fingers) if subsystems.get(j) in ('arm', 'head', 'legs')}
        count = len(tree.ends(limbs))
        if most < count < 2 if subsystem == 'torso' else count < 2 and below.intersection(fingers):
            subsystems[joint] = 'arm'


#: Why a hand alone ends an arm, and one that a base or legs carry.
ALONE, CARRIED = 'the file is a hand alone', 'it carries a hand, and no arm is there'


@dataclass(frozen=True)
class FoundArm:
    """
    End of an arm.

    :ivar kind: ``body`` or ``site``
    :ivar hand: the hand that the arm carries in the same file, or None
    :ivar why: how it was found, for messages
    """

    kind: str
    name: str
    hand: FoundHand | None
    why: str


def find_arms(tree: BodyTree, subsystems: Mapping[int, str], hands: Collection[FoundHand],
              notes: list[str]) -> dict[str, FoundArm]:
    """
    Return the arms by ``right`` and ``left``; a single one is ``right``.

    :param subsystems: by id of the joint
    :param notes: gets a sentence if there are several chains whose sides are not clear: no arms
    """
    hands = [*hands, *_hands_of_chains(tree, subsystems, hands)]
    joints = _joints_of_arms(tree, subsystems, hands)
    tips = _longest_chains(tree, _ends_of_arms(tree, joints), joints)
    if not hands and _is_worm(tree, tips, joints):
        notes.append(f'no arm is a guess: {len(joints)} joints in a row on a floating root are '
                     f'the links of a worm; arms: {{right: {{mount: {tree.name(tips[0])}}}}} in a '
                     'YAML file makes them an arm')
        return {}
    if not hands and all(_length(tree, tip, joints) < 2 for tip in tips) and (
            len(tips) > 1 or {'base', 'torso', 'head', 'legs'} & set(subsystems.values())):
        return {}  # Such as a laser that turns, or two antennas.
    by_side = _by_side(tree, tips, joints, hands, notes)
    arms = {side: _end_of(tree, tip, hands) for side, tip in by_side.items()}
    return {side: arms[side] for side in ('right', 'left') if side in arms}


def _is_worm(tree: BodyTree, tips: list[int], joints: Collection[int]) -> bool:
    """Return whether a floating robot is one chain with more joints than an arm has."""
    if len(tips) != 1 or _length(tree, tips[0], joints) <= _MOST_OF_ARM:
        return False
    way = tree.path(tips[0])
    return any(int(tree.model.jnt_type[joint]) == int(mujoco.mjtJoint.mjJNT_FREE)
               for joint in tree.joints(way[:1])) and not any(
        words_of(tree.name(body)) & _END_WORDS for body in tree.below(tips[0]))


def lone_hands_as_arms(tree: BodyTree, subsystems: Mapping[int, str],
                       hands: Collection[FoundHand], notes: list[str]) -> dict[str, FoundArm]:
    """
    Return the hands of a file without arms, one or two, as arms without joints.

    :param subsystems: by id of the joint
    :param notes: gets a sentence if no name says that they are hands
    """
    lone, is_named = lone_hands(tree, subsystems, hands)
    if not lone or len(lone) > 2:
        return {}
    sides = ['right']
    if len(lone) == 2:
        bodies = [hand.body for hand in lone]
        sides = [str(side) for side in tree.sides(bodies)]
        if set(sides) != {'right', 'left'}:
            by_place, why = _by_place(tree, bodies)
            notes.append(f"the hands' names have no side: {why}")
            sides = ['right' if by_place['right'] == body else 'left' for body in bodies]
    if not is_named:
        notes.append('right/gripper is a guess by the number and kind of the joints: '
                     'arms: none in a YAML file if it is no hand')
    joints = {joint for hand in lone for joint in hand.joints}
    why = ALONE if len(joints) == tree.model.njnt else CARRIED
    arms = {side: FoundArm('body', tree.name(hand.body), hand, why)
            for side, hand in zip(sides, lone)}
    return {side: arms[side] for side in ('right', 'left') if side in arms}


def _ends_of_arms(tree: BodyTree, joints: Collection[int]) -> list[int]:
    """
    Return where chains of joints end that may be arms.

    Excluded are chains of which all joints beyond the others follow another one, as in a
    parallelogram, and chains of which more than five hang on one link, as the rods of a platform.
    """
    tips, moved = tree.ends(joints), {tree.body_of(joint) for joint in joints}
    followers, limbs = tree.followers(), Limbs(tree)
    for crowd in (group for link in {0, *moved} for group in limbs.by_root(link)):
        if sum(bool(tree.below(limb) & moved) for limb in crowd) > MAX_FINGERS:
            tips = [tip for tip in tips if not set(crowd).intersection(tree.path(tip))]

    def leads(tip: int) -> bool:
        others = [set(tree.path(other)) for other in tips if other != tip]
        bodies = set(tree.path(tip)).difference(*others) & moved
        return not bodies or not followers.issuperset(set(tree.joints(bodies)) & set(joints))

    return [tip for tip in tips if leads(tip)]


def _longest_chains(tree: BodyTree, tips: Iterable[int], joints: Collection[int]) -> list[int]:
    length = {tip: _length(tree, tip, joints) for tip in tips}
    longest = max(length.values(), default=0)
    return [tip for tip, count in length.items() if count > _ARM_SHARE * longest]


def _joints_of_arms(tree: BodyTree, subsystems: Mapping[int, str], hands: Collection[FoundHand]
                    ) -> set[int]:
    of_hands = {joint for hand in hands for joint in hand.joints}
    # Others that move on the link that a hand hangs on, such as a camera, are beyond the end.
    rigid = tree.model.body_weldid.tolist()
    ends = {rigid[hand.body] for hand in hands} - {0}
    of_hands |= {j for j in subsystems if ends.intersection(
        rigid[body] for body in tree.path(tree.parent(tree.body_of(j))))}
    of_hands |= _joints_of_objects(tree)
    return {j for j, part in subsystems.items()
            if part == 'arm' and j not in of_hands and tree.is_scalar(j)}


def _joints_of_objects(tree: BodyTree) -> set[int]:
    """Return the joints of roots of which one body moves, if another root's joints are a chain."""
    model = tree.model
    of_root = {body: tree.joints(sorted(tree.below(body)))
               for body in range(1, model.nbody) if tree.parent(body) == 0}
    single = {body for body, joints in of_root.items()
              if len({tree.body_of(joint) for joint in joints}) == 1}
    if not any(joints for body, joints in of_root.items() if body not in single):
        return set()
    return {joint for body in single for joint in of_root[body]}


def _hands_of_chains(tree: BodyTree, subsystems: Mapping[int, str], hands: Collection[FoundHand]
                     ) -> list[FoundHand]:
    """Return the hands whose fingers, without names of fingers, are the chains of other arms."""
    joints = _joints_of_arms(tree, subsystems, hands)
    of_chains: list[FoundHand] = []
    groups = [_longest_chains(tree, tree.ends(joints), joints)]
    while groups:
        tips = groups.pop()
        if len(tips) < 2:
            continue
        carrier = tree.common(tips)
        branches: dict[int, list[int]] = {}
        for tip in tips:
            branches.setdefault(tree.path(tip)[len(tree.path(carrier))], []).append(tip)
        shared = _length(tree, carrier, joints)
        whole = max(_length(tree, tip, joints) for tip in tips)
        # No robot has three arms on a link that moves, unless their names have sides, but fingers
        # may have more joints than a wrist.
        above = joints.intersection(tree.joints(tree.path(carrier)))
        have_sides = whole - shared >= LEAST_OF_ARM and {'right', 'left'} <= set(tree.sides(tips))
        if len(branches) <= MAX_FINGERS and (
                shared > _ARM_SHARE * whole or (
                    shared and len(branches) >= FINGERS and not have_sides)
                ) and not carries_arms(tree, carrier, above):
            of_chains.append(hand_below(tree, carrier))
        else:
            groups += branches.values()
    return of_chains


def _by_side(tree: BodyTree, tips: list[int], joints: Collection[int],
             hands: Collection[FoundHand], notes: list[str]) -> dict[str, int]:
    """
    Return the tip of the longest chain by side, preferring end names; one alone is right.

    One without a side beside two with one is none. Two without a side are arms by their place if
    they have as many joints, or if they stand on two roots or carry two hands.
    """
    if len(tips) <= 1:
        return dict.fromkeys(['right'], tips[0]) if tips else {}
    by_side: dict[str | None, list[int]] = {}

    def rank(tip: int) -> tuple[int, bool]:
        return _length(tree, tip, joints), any(
            words_of(tree.name(body)) & _END_WORDS for body in tree.below(tip))

    ranked = sorted(tips, key=rank, reverse=True)
    for tip, side in zip(ranked, tree.sides(ranked)):
        by_side.setdefault(side, []).append(tip)
    if {'right', 'left'} < by_side.keys():
        del by_side[None]  # Between two arms, there is a head rather than another one.
    ambiguous = any(len(of_side) > 1 and rank(of_side[0]) == rank(of_side[1])
                    for of_side in by_side.values())
    are_two = len(tips) == 2 and (
        ambiguous or not tree.common(tips) or all(_hand_of(tree, tip, hands) for tip in tips))
    if set(by_side) == {None} and not (ambiguous or are_two):  # The others are rods beside an arm.
        return {'right': by_side[None][0]}
    shared = _length(tree, tree.common(tips), joints)
    if set(by_side) == {None} and are_two and rank(ranked[-1])[0] > shared + 1:
        sides, why = _by_place(tree, tips)
        right, left = (tree.name(sides[side]) for side in ('right', 'left'))
        notes.append(f"the arms' names have no side: {why}; arms: {{right: {{mount: {left}}}, "
                     f'left: {{mount: {right}}}}} in a YAML file changes it')
        return sides
    if set(by_side) != {'right', 'left'} or ambiguous:
        names = quoted_names([tree.name(tip) for tip in tips])
        notes.append(f'no arms: {len(tips)} chains of joints could be, they end at {names}; '
                     "declare 'arms' with the 'mount' of 'right' and 'left' in a YAML file")
        return {}
    return {side: of_side[0] for side, of_side in by_side.items() if side is not None}


def _by_place(tree: BodyTree, tips: list[int]) -> tuple[dict[str, int], str]:
    """
    Return which of two tips belongs to the right arm, and why.

    The arms' roots, or else their tips, decide: left is further along y, or if they are not
    beside each other, right is in front or above, or comes first in the file.
    """
    data = mujoco.MjData(tree.model)
    mujoco.mj_kinematics(tree.model, data)
    shared = len(tree.path(tree.common(tips)))
    for bodies in ([tree.path(tip)[shared] for tip in tips], tips):
        apart = data.xpos[bodies[1]] - data.xpos[bodies[0]]
        for axis, side, why in ((1, 'left', 'left is the one that stands further left, along y'),
                                (0, 'right', 'right is the one in front, along x'),
                                (2, 'right', 'right is the upper one')):
            if abs(apart[axis]) > _BESIDE_M:
                further, other = tips[int(apart[axis] > 0.0)], tips[int(apart[axis] <= 0.0)]
                return ({'left': further, 'right': other} if side == 'left' else
                        {'left': other, 'right': further}), why
    return {'right': tips[0], 'left': tips[1]}, 'right is the one that comes first in the file'


def _length(tree: BodyTree, body: int, joints: Collection[int]) -> int:
    """Return how many of the given joints move a body."""
    return len(set(tree.joints(tree.path(body))) & set(joints))


def _hand_of(tree: BodyTree, tip: int, hands: Collection[FoundHand]) -> FoundHand | None:
    """Return the hand that the end of an arm carries."""
    below = tree.below(tip)
    return next((hand for hand in hands if hand.body in below), None)


def _end_of(tree: BodyTree, tip: int, hands: Collection[FoundHand]) -> FoundArm:
    below = tree.below(tip)
    hand = _hand_of(tree, tip, hands)
    if hand is not None:
        return FoundArm('body', tree.name(hand.body), hand, 'it carries a hand')
    model = tree.model
    sites = [str(model.site(i).name) for i in range(model.nsite) if model.site_bodyid[i] in below]
    bodies = [tree.name(body) for body in sorted(below, reverse=True)]
    for kind, names, words in (
            ('body', bodies, {'hand'}), ('site', sites, {'attachment'}),
            ('body', bodies, _END_WORDS), ('site', sites, _END_WORDS)):
        named = [name for name in names if words_of(name) & words]
        exact = [name for name in named if kind == 'body' and name in ('right_hand', 'left_hand')]
        if words == {'hand'}:
            named = exact
        if named:
            return FoundArm(kind, named[0], None, 'by its name')
    leaves = [body for body in below if len(tree.below(body)) == 1]
    if len(leaves) == 1:
        return FoundArm('body', tree.name(leaves[0]), None, 'the last body')
    return FoundArm('body', tree.name(tip), None, 'the last body that moves')
