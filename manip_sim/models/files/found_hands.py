# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Find the hands in a robot's file by the names of joints and actuators."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

from manip_sim.models.files.body_tree import BodyTree, words_of

#: Words that only parts of hands have, and words that a wrist with a hand may have too.
_FINGER_WORDS = {'finger', 'fingers', 'thumb', 'knuckle', 'jaw', 'carriage'}
_HAND_WORDS = {'gripper', 'grip', 'grasp', 'claw', 'hand', 'gl', 'pinch'}

#: So many chains on one fixed body are fingers, fewer may be arms.
FINGERS = 3
#: Groups of fingers that share more than this fraction of the joints before them are one hand.
_SHARED = 0.5
#: Fingers that hang on chains of at least so many joints of their own are of several hands.
_LEAST_OF_ARM = 3


@dataclass(frozen=True)
class FoundHand:
    """
    A hand within a robot: all that is below a body.

    :ivar body: id of that body; its own joints are not of the hand
    :ivar actuators: ids of the actuators that act only on these
    """

    body: int
    joints: tuple[int, ...]
    actuators: tuple[int, ...]


def hand_below(tree: BodyTree, body: int) -> FoundHand:
    """Return what is below a body as a hand."""
    joints = tree.joints(sorted(tree.below(body) - {body}))
    actuators = [a for a in range(tree.model.nu)
                 if tree.driven(a) and tree.driven(a) <= set(joints)]
    return FoundHand(body, tuple(joints), tuple(actuators))


def find_hands(tree: BodyTree) -> list[FoundHand]:
    """
    Return the hands of a robot, at most one for each side, or for each arm without a side.

    The body of a hand is the last one that carries all joints with a finger's name, or with a
    gripper's if none has a finger's, and the joints that are coupled to them.
    """
    fingers = {j for j in range(tree.model.njnt)
               if tree.is_scalar(j) and words_of(_name(tree, j)) & _FINGER_WORDS}
    named = {j for j in range(tree.model.njnt)
             if tree.is_scalar(j) and words_of(_name(tree, j)) & _HAND_WORDS}
    for actuator in range(tree.model.nu):
        words = words_of(str(tree.model.actuator(actuator).name))
        if words & _FINGER_WORDS:
            fingers |= tree.driven(actuator)
        elif words & _HAND_WORDS:
            named |= tree.driven(actuator)
    by_side: dict[str | None, set[int]] = {}
    for joints in (fingers, named):
        sides = _by_side(tree, joints)
        for side, of_side in sides.items():
            # A joint with a gripper's name may be the wrist's if there are fingers.
            if side not in by_side:
                by_side[side] = of_side
    hands = []
    for joints in by_side.values():
        for of_hand in _by_arm(tree, tree.coupled(joints)):
            body = _common_carrier(tree, of_hand)
            if body:
                hands.append(hand_below(tree, _with_branches(tree, body)))
    return [hand for hand in hands if hand.joints]


def hands_of_hand(tree: BodyTree, hand: FoundHand) -> list[str]:
    """
    Return the names of the bodies that carry the fingers of a hand, if it may be several hands.

    These are bodies fixed to its own that carry two chains or more each, and all of its fingers.
    """
    rigid, fingers = tree.model.body_weldid, set(hand.joints)
    carriers: dict[int, int] = {}
    first = [joint for joint in hand.joints if not fingers.intersection(
        tree.joints(tree.path(tree.parent(int(tree.model.jnt_bodyid[joint])))))]
    for joint in first:
        carrier = tree.parent(int(tree.model.jnt_bodyid[joint]))
        if rigid[carrier] != rigid[hand.body]:
            return []
        carriers[carrier] = carriers.get(carrier, 0) + 1
    several = len(carriers) > 1 and min(carriers.values()) > 1 and hand.body not in carriers
    return [tree.name(body) for body in carriers] if several else []


def lone_hand(tree: BodyTree, subsystems: Mapping[int, str], hands: Collection[FoundHand]
              ) -> FoundHand | None:
    """
    Return the hand if a file has nothing else, or None.

    That is a hand with all joints of the file, or at least three chains on one fixed body.

    :param subsystems: by id of the joint
    """
    scalar = {joint for joint in range(tree.model.njnt) if tree.is_scalar(joint)}
    if len(scalar) < tree.model.njnt or any(subsystems[joint] != 'arm' for joint in scalar):
        return None
    for hand in hands:
        if scalar <= set(hand.joints):
            return hand
    carrier = _common_carrier(tree, scalar)
    moved = {int(tree.model.jnt_bodyid[joint]) for joint in scalar}
    first = [body for body in moved if not moved.intersection(tree.path(tree.parent(body)))]
    if carrier and len(first) >= FINGERS and len(tree.ends(scalar)) == len(first):
        return hand_below(tree, carrier)
    return None


def _with_branches(tree: BodyTree, body: int) -> int:
    """
    Return the body that carries a hand and what else moves on the same rigid link.

    Only what is no longer than the fingers counts, such as the propeller of Interbotix's grippers,
    and only on a link that moves: two arms hang on one that does not.
    """
    rigid, parts = tree.model.body_weldid, tree.below(body)
    if not rigid[body]:
        return body

    def length(below: set[int]) -> int:
        return max(sum(map(tree.is_scalar, tree.joints(set(tree.path(end)) & below)))
                   for end in below)

    longest = length(parts - {body})
    roots = [other for other in range(1, tree.model.nbody)
             if other not in parts and tree.joints([other])
             and rigid[tree.parent(other)] == rigid[body]]
    return tree.common([body, *(tree.parent(root) for root in roots
                                if length(tree.below(root)) <= longest)])


def _name(tree: BodyTree, joint: int) -> str:
    return str(tree.model.joint(joint).name)


def _by_side(tree: BodyTree, joints: Iterable[int]) -> dict[str | None, set[int]]:
    every = list(joints)
    carriers = [tree.parent(int(tree.model.jnt_bodyid[joint])) for joint in every]
    found: dict[str | None, set[int]] = {}
    for joint, side in zip(every, tree.sides(carriers)):
        found.setdefault(side, set()).add(joint)
    if len(found) > 1 and _is_one_hand(tree, found.values()):
        return {None: set().union(*found.values())}
    return found


def _by_arm(tree: BodyTree, joints: Collection[int]) -> list[set[int]]:
    """Return joints of fingers by the arm that carries them, if they hang on several."""
    carrier = _common_carrier(tree, joints)
    branches: dict[int, set[int]] = {}
    for joint in joints:
        way = [*tree.path(tree.parent(int(tree.model.jnt_bodyid[joint]))), 0]
        branches.setdefault(way[len(tree.path(carrier))], set()).add(joint)
    groups = list(branches.values())
    shared, *lengths = (sum(map(tree.is_scalar, tree.joints(tree.path(body))))
                        for body in (carrier, *(_common_carrier(tree, g) for g in groups)))
    is_several = len(groups) > 1 and min(lengths) >= _LEAST_OF_ARM and (
        shared <= _SHARED * min(lengths))
    return groups if is_several else [set(joints)]


def _is_one_hand(tree: BodyTree, groups: Iterable[set[int]]) -> bool:
    """Return whether groups of joints are the left and right fingers of one hand."""
    carriers = [_common_carrier(tree, group) for group in groups]
    shared, *lengths = (sum(map(tree.is_scalar, tree.joints(tree.path(body))))
                        for body in [tree.common(carriers), *carriers])
    return shared > _SHARED * max(lengths)


def _common_carrier(tree: BodyTree, joints: Iterable[int]) -> int:
    return tree.common([tree.parent(int(tree.model.jnt_bodyid[joint])) for joint in joints])
