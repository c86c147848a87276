# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Find the hands in a robot's file by names, and how their fingers close by trying it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
import contextlib
import copy
from dataclasses import dataclass
from functools import partial
import hashlib
import os
from typing import Any, TypeVar

import mujoco
import numpy as np

from manip_sim.algebra import length, product
from manip_sim.arrays import FloatArray
from manip_sim.models.actuators import position_servos
from manip_sim.models.archive import to_binary
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


#: Words in the names of frames between the fingertips, in order of preference.
_GRASP_WORDS = (
    {'pinch'}, {'grasp'}, {'grip'}, {'tcp'}, {'gripperframe'}, {'gripper', 'frame'})
#: Duration and physics step of a trial in which a finger moves [s].
_TRIAL_S, _TRIAL_STEP_S = 0.5, 0.002
#: A relative change of the distance of the fingers up to this one decides nothing.
_TELLING = 0.02
#: A fingertip that moves at most this fraction of the greatest motion counts as still.
_STILL = 0.1
#: Range of the control of an actuator that nothing limits.
UNLIMITED = (-1.0, 1.0)
#: A control range may exceed what the joint can reach by this fraction of the joint's range.
_BEYOND = 0.5
#: Time constant of the fingers in a trial [s].
_SLOWNESS_S = 0.01
#: A finger opens again if it comes back by at least this share of its way.
_OPENS_AGAIN = 0.7
#: Shares of the way to the end of the range, or of a motor's effort, that are tried where a finger
#: does not open again.
_SHORTER = (0.75, 0.5, 0.25)

#: Opening and closing control, and whether a trial decided which is which.
Closing = tuple[float, float, bool]
#: Closings of actuators by name, and other closings of those that would not open again.
Closings = tuple[dict[str, Closing], dict[str, Closing]]
Result = TypeVar('Result')
#: Results for hands with their shapes, by digest, and the most that are kept.
_known: dict[bytes, Any] = {}
_MOST_KNOWN = 400


def once(key: bytes, compute: Callable[[], Result]) -> Result:
    """Return the result of a computation, of an earlier one with the same key if there was one."""
    digest = hashlib.blake2b(key).digest()
    if digest not in _known:
        result = compute()
        if len(_known) >= _MOST_KNOWN:
            _known.clear()
        _known[digest] = result
    known: Result = copy.deepcopy(_known[digest])
    return known


def digest_of(model: mujoco.MjModel) -> bytes:
    """Return a digest of a compiled model."""
    return hashlib.blake2b(to_binary(model)).digest()


def digest_of_meshes(spec: mujoco.MjSpec) -> bytes:
    """
    Return a digest of the meshes of a spec: of their files the size and the time of change.

    It differs each time if the origin of a mesh is not known.
    """
    digest = hashlib.blake2b()
    for mesh in spec.meshes:
        digest.update(repr((mesh.name, mesh.file, mesh.maxhullvert, *[
            list(numbers) for numbers in (mesh.scale, mesh.refpos, mesh.refquat)])).encode())
        if mesh.file in spec.assets:
            digest.update(spec.assets[mesh.file])
        elif os.path.isabs(mesh.file) and os.path.isfile(mesh.file):
            status = os.stat(mesh.file)
            digest.update(repr((status.st_size, status.st_mtime_ns, status.st_ino)).encode())
        else:
            digest.update(os.urandom(16) if mesh.file or not len(mesh.uservert) else repr(
                (list(mesh.uservert), list(mesh.userface))).encode())
    return digest.digest()


def _apart(points: FloatArray) -> float:
    """Return the mean distance between points [m]."""
    if len(points) < 2:
        return 0.0
    distances = np.linalg.norm(points[:, None] - points[None], axis=2)
    return float(distances.sum() / (len(points) * (len(points) - 1)))


def _relative(low: float, high: float) -> float:
    return float((high - low) / max(low, high)) if max(low, high) > 0.0 else 0.0


@contextlib.contextmanager
def _without_warnings() -> Iterator[None]:
    """Suppress MuJoCo's warnings of a trial that fails."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


def integrates(model: mujoco.MjModel, actuator: int) -> bool:
    """Return whether a servo integrates its control: that is the velocity of its setpoint."""
    return bool(position_servos(model, actuator)) and int(
        model.actuator_dyntype[actuator]) == int(mujoco.mjtDyn.mjDYN_INTEGRATOR)


def control_range(model: mujoco.MjModel, actuator: int) -> tuple[float, float] | None:
    """
    Return the control range of an actuator; a servo's is cut if it far exceeds its joint's.

    Of one that integrates its control, it is the range of the integral.

    :returns: lowest and highest control; None if nothing limits it or the range is empty
    """
    reach = _reach(model, actuator)
    if integrates(model, actuator):
        low, high = model.actuator_actrange[actuator]
        return (float(low), float(high)) if low < high else reach
    if model.actuator_ctrllimited[actuator]:
        low, high = model.actuator_ctrlrange[actuator]
        if reach:
            # A target that is a little beyond the joint's range makes the servo press.
            beyond = _BEYOND * (reach[1] - reach[0])
            if low < reach[0] - beyond or high > reach[1] + beyond:
                low, high = max(low, reach[0]), min(high, reach[1])
        return (float(low), float(high)) if low < high else None
    if reach:
        return reach
    gain = model.actuator_gainprm[actuator, 0]
    if (model.actuator_forcelimited[actuator] and gain > 0.0
            and not position_servos(model, actuator)):
        low, high = model.actuator_forcerange[actuator] / gain
        return float(low), float(high)
    return None


def _reach(model: mujoco.MjModel, actuator: int) -> tuple[float, float] | None:
    """Return the controls at which a servo rests at the ends of its joint's range, or None."""
    joint = int(model.actuator_trnid[actuator, 0])
    is_joint = int(model.actuator_trntype[actuator]) == int(mujoco.mjtTrn.mjTRN_JOINT)
    if not (is_joint and position_servos(model, actuator) and model.jnt_limited[joint]):
        return None
    bias = model.actuator_biasprm[actuator]
    ends = (-(bias[0] + bias[1] * model.jnt_range[joint] * model.actuator_gear[actuator, 0])
            / model.actuator_gainprm[actuator, 0])
    return float(ends.min()), float(ends.max())


class Fingers:
    """
    The moving parts of a hand.

    :param start: where joints start, by name; of others than those of the tree, too [rad or m]
    """

    def __init__(self, tree: BodyTree, hand: FoundHand, start: Mapping[str, float]) -> None:
        self._model = model = tree.model
        self._tree, self._hand = tree, hand
        self._data = mujoco.MjData(model)
        for joint in range(model.njnt):
            name = str(model.joint(joint).name)
            if name in start:
                self._data.joint(name).qpos[0] = start[name]
        mujoco.mj_forward(model, self._data)
        below = tree.below(hand.body)
        moved: set[int] = set().union(
            *(tree.below(int(model.jnt_bodyid[joint])) for joint in hand.joints))
        self._moved, self._palm = sorted(moved), sorted(below - moved)
        ends = [b for b in sorted(moved) if not (tree.below(b) - {b}) & moved]
        self._tips = [self._farthest_geom(body) for body in ends]

    @property
    def out_of_touch(self) -> list[str]:
        """Names of the bodies that move if no shape of them can touch an object, else empty."""
        model, moved = self._model, self._moved
        # Objects have bit 1 of contype and conaffinity, as all shapes have by default.
        touching = (model.geom_contype | model.geom_conaffinity) & 1
        if touching[np.isin(model.geom_bodyid, moved)].any():
            return []
        return [self._tree.name(body) for body in moved]

    def _farthest_geom(self, body: int) -> tuple[int, int]:
        """Return the id of a body and of its geom farthest from the hand's body, -1 for none."""
        model, data = self._model, self._data
        # The last body of a finger may be a frame without a geom; then its parent counts.
        while not model.body_geomnum[body] and self._tree.parent(body) not in self._palm:
            body = self._tree.parent(body)
        first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
        if not count:
            return body, -1
        geoms = range(first, first + count)
        origin = data.xpos[self._hand.body]
        return body, max(geoms, key=lambda g: length(data.geom_xpos[g] - origin))

    def _tip_points(self, data: mujoco.MjData) -> FloatArray:
        return np.array([data.geom_xpos[geom] if geom >= 0 else data.xpos[body]
                         for body, geom in self._tips])

    def _palm_point(self, data: mujoco.MjData) -> FloatArray:
        geoms = [g for g in range(self._model.ngeom) if self._model.geom_bodyid[g] in self._palm]
        points = data.geom_xpos[geoms] if geoms else data.xpos[[self._hand.body]]
        middle: FloatArray = np.asarray(points).mean(axis=0)
        return middle

    def grasp_frame(self) -> str | None:
        """
        Return a frame whose name says that it is between the fingertips, or None.

        It is a site, or else a body on the palm without shapes, such as a frame of a URDF.
        """
        model, below = self._model, self._tree.below(self._hand.body)
        sites = [str(model.site(i).name) for i in range(model.nsite)
                 if model.site_bodyid[i] in below]
        links = [self._tree.name(body) for body in self._palm
                 if body != self._hand.body and not model.body_geomnum[body]]
        for frames in (sites, links):
            for words in _GRASP_WORDS:
                for name in frames:
                    if words <= words_of(name):
                        return name
        return None

    def grasp_point(self) -> FloatArray:
        """
        Return the mean of the fingertips in the frame of the hand's body [m], shape (3,).

        For a hand with one moving finger it is the mean of its tip and the palm; for one without,
        the origin of the body.
        """
        data, body = self._data, self._hand.body
        if not self._tips:
            return np.zeros(3)
        points = self._tip_points(data)
        if len(points) == 1:
            points = np.vstack([points, self._palm_point(data)])
        local: FloatArray = product(
            data.xmat[body].reshape(3, 3).T, points.mean(axis=0) - data.xpos[body])
        return local

    def closing(self, actuators: Sequence[str]) -> Closings:
        """Return how actuators close, as :meth:`_ends` and :meth:`_reopening` say."""
        if not actuators:
            return {}, {}
        trial = self._trial_model()
        ends = self._ends(trial, [int(self._model.actuator(name).id) for name in actuators])
        trial.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        by_name, changed = ({str(self._model.actuator(i).name): closing
                             for i, closing in closings.items()}
                            for closings in (ends, self._reopening(trial, ends)))
        return by_name, changed

    def _ends(self, trial: mujoco.MjModel, actuators: Sequence[int]) -> dict[int, Closing]:
        """
        Return the opening and the closing control of actuators.

        Each is driven to both ends of its range while the others hold. The closing end is that at
        which the fingertips that it moves are nearer to each other, or nearer to the palm if that
        changes more; the upper end if neither changes.

        :returns: by id, opening and closing control, and whether the trial decided
        """
        closings = {}
        for actuator in actuators:
            limits = control_range(self._model, actuator) or UNLIMITED
            with _without_warnings():
                low, high = (self._tips_at(trial, actuator, control) for control in limits)
            # Positive where the fingers are farther apart at the upper end.
            change = self._change(low, high)
            is_clear = abs(change) > _TELLING
            closings[actuator] = (
                *(limits[::-1] if is_clear and change > 0.0 else limits), is_clear)
        return closings

    def _reopening(self, trial: mujoco.MjModel, closing: Mapping[int, Closing]
                   ) -> dict[int, Closing]:
        """
        Return closings from which the fingers open again, where the given ones lock a hand.

        All actuators close at once, with contacts of the hand, and open again. One that does not
        come back closes less far, or with less effort, see :data:`_SHORTER`. What never opens
        again stays as it is.

        :returns: those that are other ones, by id
        """
        # Slow ones get more time before they count.
        long_s = 2.0 * _TRIAL_S
        stuck = self._stuck(trial, closing, _TRIAL_S) and self._stuck(trial, closing, long_s)
        reopening: dict[int, Closing] = {}
        if not stuck:
            return reopening
        for share in _SHORTER:
            changed = {actuator: self._lessened(actuator, closing[actuator], share)
                       for actuator in stuck}
            still = self._stuck(trial, {**closing, **reopening, **changed}, long_s)
            reopening.update({actuator: changed[actuator] for actuator in stuck - still})
            stuck &= still
        return reopening

    def _lessened(self, actuator: int, closing: Closing, share: float) -> Closing:
        """Return a closing that goes less far, or with less effort."""
        opened, closed, is_clear = closing
        if position_servos(self._model, actuator):
            return opened, opened + share * (closed - opened), is_clear
        return opened, share * closed, is_clear

    def _stuck(self, model: Any, closing: Mapping[int, Closing], duration_s: float) -> set[int]:
        """Return the actuators that close and do not open again, none if a trial fails."""
        data = copy.copy(self._data)
        ids, lengths = list(closing), []
        for other in range(model.nu):
            data.ctrl[other] = self._holding_control(other)
        for end in (0, 1, 0):
            data.ctrl[ids] = [closing[actuator][end] for actuator in ids]
            try:
                with _without_warnings():
                    mujoco.mj_step(model, data, round(duration_s / _TRIAL_STEP_S))
            except mujoco.FatalError:  # More contacts than MuJoCo has memory for.
                return set()
            lengths.append(data.actuator_length[ids].copy())
        way, back = np.abs(lengths[1] - lengths[0]), np.abs(lengths[2] - lengths[1])
        if not np.isfinite(lengths).all():
            return set()
        moves = way > _STILL * np.abs(way).max(initial=0.0)
        return {ids[i] for i in np.flatnonzero(moves & (back < _OPENS_AGAIN * way))}

    def _change(self, low: FloatArray, high: FloatArray) -> float:
        """
        Return how much farther apart fingertips are at the upper end, over the greater distance.

        :param low: palm and tips at the lower end [m], shape (1 + number of tips, 3)
        :param high: the same at the upper end
        """
        if not (self._tips and np.isfinite(low).all() and np.isfinite(high).all()):
            return 0.0
        moved = np.linalg.norm(high[1:] - low[1:], axis=1)
        moves = moved > _STILL * moved.max()
        pair = moves if moves.sum() > 1 or len(moves) != 2 else np.array([True, True])
        changes = [_relative(_apart(low[1:][pair]), _apart(high[1:][pair])),
                   _relative(*(np.linalg.norm(end[1:][moves] - end[0], axis=1).mean()
                               for end in (low, high)))] if moves.any() else [0.0]
        return max(changes, key=abs)

    def _trial_model(self) -> mujoco.MjModel:
        """Return a copy of the model without gravity and contacts, where only the hand touches."""
        model = copy.copy(self._model)
        model.opt.timestep = _TRIAL_STEP_S
        model.opt.integrator = int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
        off = mujoco.mjtDisableBit
        model.opt.disableflags |= int(
            off.mjDSBL_GRAVITY | off.mjDSBL_AUTORESET | off.mjDSBL_CONTACT)
        elsewhere = ~np.isin(model.geom_bodyid, [*self._palm, *self._moved])
        model.geom_contype[elsewhere] = model.geom_conaffinity[elsewhere] = 0
        hand = list(self._hand.actuators)
        model.actuator_ctrlrange[hand] = [
            control_range(self._model, actuator) or UNLIMITED for actuator in hand]
        model.actuator_ctrllimited[hand] = 1
        for actuator in range(model.nu):
            if integrates(self._model, actuator):  # The trials set positions.
                model.actuator_dyntype[actuator] = int(mujoco.mjtDyn.mjDYN_NONE)
                model.actuator_actadr[actuator], model.actuator_actnum[actuator] = -1, 0
                model.actuator_ctrllimited[actuator] = 0
        # Only where the fingers come to rest counts, so they may be slow, which makes them stable.
        moments = np.zeros((model.nu, model.nv))
        data = self._data
        mujoco.mju_sparse2dense(moments, data.actuator_moment.reshape(-1), data.moment_rownnz,
                                data.moment_rowadr, data.moment_colind)
        stiffness = np.zeros(model.nv)
        for actuator in filter(partial(position_servos, model), self._hand.actuators):
            stiffness += -model.actuator_biasprm[actuator, 1] * moments[actuator]**2
        model.dof_armature[:] += stiffness * _SLOWNESS_S**2
        damping = np.asarray(model.dof_damping).reshape(model.nv, -1)
        damping[:, 0] += 2.0 * stiffness * _SLOWNESS_S
        model.dof_damping[:] = damping.reshape(model.dof_damping.shape)
        return model

    def _tips_at(self, model: mujoco.MjModel, actuator: int, control: float) -> FloatArray:
        """Return palm and fingertips after an actuator has moved them [m], shape (n, 3)."""
        data = copy.copy(self._data)
        for other in range(model.nu):
            data.ctrl[other] = self._holding_control(other)
        data.ctrl[actuator] = control
        mujoco.mj_step(model, data, round(_TRIAL_S / _TRIAL_STEP_S))
        return np.vstack([self._palm_point(data), *self._tip_points(data)])

    def _holding_control(self, actuator: int) -> float:
        model = self._model
        if not position_servos(model, actuator):
            return 0.0
        bias, length = model.actuator_biasprm[actuator], self._data.actuator_length[actuator]
        return float(-(bias[0] + bias[1] * length) / model.actuator_gainprm[actuator, 0])
