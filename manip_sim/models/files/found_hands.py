# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Find the hands in a robot's file by the names of joints and actuators."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from manip_sim.models.files.body_tree import (
    BodyTree, FINGERS, Limbs, MAX_FINGERS, PALM_WORDS, turns_farther_than, words_of)

#: Words that only parts of hands have, of joints and of bodies: the carriage of a lift or a gantry
#: is not a finger. A wrist with a hand may have words of hands too.
_FINGER_WORDS = {'finger', 'fingers', 'thumb', 'knuckle', 'jaw', 'carriage'}
_FINGER_BODY_WORDS = _FINGER_WORDS - {'carriage'}
_HAND_WORDS = {'gripper', 'grip', 'grasp', 'claw', 'hand', 'gl', 'pinch'}
#: Words of what drives a flying robot.
_FLIGHT_WORDS = {'thrust', 'thruster', 'rotor', 'propeller', 'gimbal'}
#: Words of joints that are not of fingers, whatever they move is called.
_ARM_WORDS = {'shoulder', 'elbow', 'wrist'}
#: Words of joints that no hand carries.
_CARRIED_BY_NO_HAND = _ARM_WORDS | {'arm'}

#: Groups of fingers that share more than this fraction of the joints before them are one hand.
_SHARED = 0.5
#: Fingers that hang on chains of at least so many joints of their own are of several hands.
LEAST_OF_ARM = 3
#: A finger has at most so many times the joints of another; axes of two fingers are parallel if
#: the cosine of their angle is greater than this.
_UNEQUAL, _ONE_DIRECTION = 2, 0.9
#: A hinge of a finger turns by no more than this [rad].
_FINGER_TURNS_RAD = 1.5 * np.pi


@dataclass(frozen=True)
class FoundHand:
    """
    A hand within a robot: everything below a body.

    :ivar body: id of that body; its own joints are not of the hand
    :ivar actuators: ids of the actuators that act only on these
    """

    body: int
    joints: tuple[int, ...]
    actuators: tuple[int, ...]

    def in_tree(self, tree: BodyTree, other: BodyTree) -> FoundHand:
        """Return the hand by its ids in another tree with the same names."""
        model = other.model
        joints, actuators = ([str(element(i).name) for i in ids] for element, ids in (
            (tree.model.joint, self.joints), (tree.model.actuator, self.actuators)))
        return FoundHand(int(model.body(tree.name(self.body)).id),
                         tuple(int(model.joint(name).id) for name in joints),
                         tuple(int(model.actuator(name).id) for name in actuators))


def hand_below(tree: BodyTree, body: int) -> FoundHand:
    """Return the bodies below a body as a hand."""
    joints = tree.joints(sorted(tree.below(body) - {body}))
    actuators = [a for a in range(tree.model.nu)
                 if tree.driven(a) and tree.driven(a) <= set(joints)]
    return FoundHand(body, tuple(joints), tuple(actuators))


def carries_arms(tree: BodyTree, body: int, others: Collection[int]) -> bool:
    """
    Return whether a chain below a body has several joints with words of arms: no hand carries one.

    :param others: joints whose words count for nothing, as in a robot called arm
    """
    words = _CARRIED_BY_NO_HAND - frozenset().union(
        *(words_of(tree.joint_name(joint)) for joint in others))
    of_arms = {joint for joint in set(hand_below(tree, body).joints) - set(others)
               if words_of(tree.joint_name(joint)) & words}
    return any(len(of_arms.intersection(tree.joints(tree.path(end)))) >= LEAST_OF_ARM
               for end in tree.ends(of_arms))


def find_hands(tree: BodyTree) -> list[FoundHand]:
    """
    Return the hands of a robot, at most one for each side, or for each arm without a side.

    The body of a hand is the last one that carries all joints with a finger's name, or with a
    gripper's if none has a finger's, and the joints that are coupled to them. The bodies that
    joints move may have the names of fingers instead. One that carries all fingers turns the hand,
    and what carries arms, too, is none.
    """
    fingers = {j for j in range(tree.model.njnt) if tree.is_scalar(j) and _is_of_finger(tree, j)}
    named = {j for j in range(tree.model.njnt)
             if tree.is_scalar(j) and words_of(tree.joint_name(j)) & _HAND_WORDS}
    for actuator in range(tree.model.nu):
        words = words_of(str(tree.model.actuator(actuator).name))
        if words & _FINGER_WORDS:
            fingers |= {joint for joint in tree.driven(actuator) if not _turns_palm(tree, joint)}
        elif words & _HAND_WORDS:
            named |= tree.driven(actuator)
    if named:
        named -= set(Limbs(tree).legs_with_shoulders())
    by_side: dict[str | None, set[int]] = {}
    for joints in (fingers, named):
        sides = _by_side(tree, joints)
        for side, of_side in sides.items():
            # A joint with a gripper's name may be the wrist's if there are fingers.
            if side not in by_side and not (side is None and by_side):
                by_side[side] = of_side
    hands = []
    for joints in by_side.values():
        for of_hand in _by_arm(tree, tree.coupled(joints)):
            of_hand = _without_wrist(tree, of_hand)
            body = _common_carrier(tree, of_hand)
            if body and not carries_arms(tree, body, of_hand):
                hands.append(hand_below(tree, _with_branches(tree, body)))
    return [hand for hand in hands if hand.joints]


def _without_wrist(tree: BodyTree, joints: Collection[int]) -> set[int]:
    """Return the joints of a hand without one that turns all others, which are on two sides."""
    first = _first_bodies(tree, joints)
    above = {joint for joint in joints if tree.body_of(joint) in first}
    if len(above) != 1 or any(_is_of_finger(tree, joint) for joint in above):
        return set(joints)
    body = int(tree.model.jnt_bodyid[min(above)])
    others = set(joints) - above or set(tree.joints(tree.below(body) - {body}))
    is_wrist = len(_first_bodies(tree, others)) > 1 and not tree.coupled(above) & others
    return others if is_wrist else set(joints)


def hands_of_hand(tree: BodyTree, hand: FoundHand) -> list[str]:
    """
    Return the names of the bodies that carry the fingers of a hand, if it may be several hands.

    These are bodies fixed to its own that carry two chains or more each, and all of its fingers.
    """
    rigid, fingers = tree.model.body_weldid, set(hand.joints)
    carriers: dict[int, int] = {}
    first = [joint for joint in hand.joints if not fingers.intersection(
        tree.joints(tree.path(tree.parent(tree.body_of(joint)))))]
    for joint in first:
        carrier = tree.parent(tree.body_of(joint))
        if rigid[carrier] != rigid[hand.body]:
            return []
        carriers[carrier] = carriers.get(carrier, 0) + 1
    several = len(carriers) > 1 and min(carriers.values()) > 1 and hand.body not in carriers
    return [tree.name(body) for body in carriers] if several else []


def lone_hands(tree: BodyTree, subsystems: Mapping[int, str], hands: Collection[FoundHand]
               ) -> tuple[list[FoundHand], bool]:
    """
    Return the hands of a file without arms, none if it has others, and whether names say so.

    Names do if all joints but those of bases, legs and others are of hands that they tell.
    Otherwise it takes fingers by their kind, see :func:`_are_fingers`, on one fixed body, or on
    two that are out of reach of each other.

    :param subsystems: by id of the joint
    """
    scalar = {joint for joint in range(tree.model.njnt) if tree.is_scalar(joint)}
    of_arms = {joint for joint in scalar if subsystems[joint] == 'arm'}
    if hands and of_arms == {joint for hand in hands for joint in hand.joints}:
        return list(hands), True
    if of_arms != set(range(tree.model.njnt)):
        return [], False
    limbs = Limbs(tree)
    by_carrier = limbs.by_carrier(limbs.on(0))
    if not limbs.are_of_two_hands(list(by_carrier.values())):
        every = [limb for group in by_carrier.values() for limb in group]
        by_carrier = {tree.common(list(by_carrier)): every}
    if not all(body and _are_fingers(tree, limbs, group) for body, group in by_carrier.items()):
        return [], False
    return [hand_below(tree, body) for body in by_carrier], False


def _are_fingers(tree: BodyTree, limbs: Limbs, fingers: Sequence[int]) -> bool:
    """
    Return whether limbs of one body are the fingers of a hand, by their kind.

    There are two to five, none of which branches, turns by more than three quarters of a turn, has
    the name of a rotor or has more than twice the joints of another. Two are fingers if each has
    one degree of freedom and they move along or about one direction; longer ones may be arms. Four
    that stand in pairs are legs. The name of a body that carries fingers, such as palm, is enough
    where there are several or a single joint.
    """
    joints = [limbs.joints(limb) for limb in fingers]
    counts = [len({min(tree.coupled([joint])) for joint in of_limb}) for of_limb in joints]
    if len(fingers) > MAX_FINGERS or any(
            len(tree.ends(of_limb)) > 1 or any(
                turns_farther_than(_FINGER_TURNS_RAD, tree.model, j) or _drives_flight(tree, j)
                for j in of_limb)
            for of_limb in joints):
        return False
    if words_of(tree.name(tree.parent(fingers[0]))) & PALM_WORDS:
        return len(fingers) > 1 or counts == [1]
    if len(fingers) == 2:
        kinds = {int(tree.model.jnt_type[of_limb[0]]) for of_limb in joints}
        aligned = abs(float(limbs.axis(joints[0][0]) @ limbs.axis(joints[1][0])))
        return max(counts) == 1 and len(kinds) == 1 and aligned > _ONE_DIRECTION
    return len(fingers) >= FINGERS and max(counts) <= _UNEQUAL * min(counts) and not (
        limbs.in_pairs(fingers))


def _with_branches(tree: BodyTree, body: int) -> int:
    """
    Return the body that carries a hand and what else moves on the same rigid link.

    Only parts up to the length of the fingers count, such as the propeller of Interbotix's
    grippers, and only on a link that moves: two arms hang on one that does not.
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


def _is_of_finger(tree: BodyTree, joint: int) -> bool:
    """Return whether a joint, or the body that it moves, has the name of a finger."""
    words = words_of(tree.joint_name(joint))
    body = words_of(tree.name(tree.body_of(joint)))
    return bool(words & _FINGER_WORDS and not _turns_palm(tree, joint)
                or body & _FINGER_BODY_WORDS and not words & _ARM_WORDS)


def _turns_palm(tree: BodyTree, joint: int) -> bool:
    """Return whether a joint moves a palm that carries fingers, after which it may be called."""
    body = tree.body_of(joint)
    words = words_of(tree.name(body))
    return bool(words & PALM_WORDS and not words & _FINGER_BODY_WORDS
                and tree.joints(tree.below(body) - {body}))


def _drives_flight(tree: BodyTree, joint: int) -> bool:
    """Return whether a joint, or the body that it moves, has the name of a rotor."""
    names = tree.joint_name(joint), tree.name(tree.body_of(joint))
    return any(words_of(name) & _FLIGHT_WORDS for name in names)


def _by_side(tree: BodyTree, joints: Iterable[int]) -> dict[str | None, set[int]]:
    every = list(joints)
    carriers = [tree.parent(tree.body_of(joint)) for joint in every]
    by_side: dict[str | None, set[int]] = {}
    for joint, side in zip(every, tree.sides(carriers)):
        by_side.setdefault(side, set()).add(joint)
    if len(by_side) > 1 and _is_one_hand(tree, by_side.values()):
        return {None: set().union(*by_side.values())}
    return by_side


def _by_arm(tree: BodyTree, joints: Collection[int]) -> list[set[int]]:
    """Return joints of fingers by the arm that carries them, if they hang on several."""
    carrier = _common_carrier(tree, joints)
    branches: dict[int, set[int]] = {}
    for joint in joints:
        way = [*tree.path(tree.parent(tree.body_of(joint))), 0]
        branches.setdefault(way[len(tree.path(carrier))], set()).add(joint)
    groups = list(branches.values())
    shared, *lengths = (sum(map(tree.is_scalar, tree.joints(tree.path(body))))
                        for body in (carrier, *(_common_carrier(tree, g) for g in groups)))
    is_several = len(groups) > 1 and min(lengths) >= LEAST_OF_ARM and (
        shared <= _SHARED * min(lengths))
    return groups if is_several or Limbs(tree).are_of_two_hands([
        _fingers_below(tree, _common_carrier(tree, group)) for group in groups]
    ) else [set(joints)]


def _fingers_below(tree: BodyTree, carrier: int) -> list[int]:
    """Return the first bodies of the fingers of a hand: the bodies that move on its body."""
    return sorted(_first_bodies(tree, hand_below(tree, carrier).joints))


def _first_bodies(tree: BodyTree, joints: Collection[int]) -> set[int]:
    """Return the bodies of joints that no other of these joints moves."""
    moved = {tree.body_of(joint) for joint in joints}
    return {body for body in moved if not moved.intersection(tree.path(tree.parent(body)))}


def _is_one_hand(tree: BodyTree, groups: Iterable[set[int]]) -> bool:
    """Return whether groups of joints are the left and right fingers of one hand."""
    groups = list(groups)
    carriers = [_common_carrier(tree, group) for group in groups]
    shared, *lengths = (sum(map(tree.is_scalar, tree.joints(tree.path(body))))
                        for body in [tree.common(carriers), *carriers])
    if any(first != second and first in tree.path(second)
           for first in carriers for second in carriers):
        return True  # What looks like a side is a letter of a finger's link.
    if min(lengths) - shared >= LEAST_OF_ARM:
        return False
    # Without arms, one finger on each side makes one hand.
    return shared > _SHARED * max(lengths) or not max(lengths) and (
        len(set(carriers)) == 1 or any(
            len(_fingers_below(tree, carrier)) == 1 for carrier in carriers))


def _common_carrier(tree: BodyTree, joints: Iterable[int]) -> int:
    return tree.common(tree.parent(tree.body_of(joint)) for joint in joints)
