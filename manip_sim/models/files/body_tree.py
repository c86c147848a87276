# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
The tree of bodies of a compiled model, and bases, wheels and legs by its joints.

A limb is what moves on a rigid link; the trunk is the first link that carries several limbs.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
import re

import mujoco
import numpy as np

from manip_sim.algebra import length
from manip_sim.arrays import FloatArray
from manip_sim.models.actuators import JOINT_TRANSMISSIONS, SCALAR
from manip_sim.models.couplings import tied_bodies

_WORD, _LETTERS = re.compile(r'[A-Z]?[a-z]+|[A-Z]+(?![a-z])'), re.compile(r'[A-Za-z]+')
_SIDES = {'left': 'left', 'l': 'left', 'lh': 'left', 'right': 'right', 'r': 'right', 'rh': 'right'}
#: Parts of bodies that are written in one word with a side before or an axis behind them.
_JOINED = re.compile(
    r'(left|right|upper|lower|[lrfbu])?(thigh|shin|shank|calf|foot|toe|ankle|knee|femur|tibia|hip|'
    r'leg|finger|thumb|hand|wrist|elbow|shoulder|head|neck|wheel)s?(r?[xyz]|[pr]|joint|link)?')
#: A hand has at most so many fingers, and one of two hands of a file so many at least; more limbs
#: that are alike are legs.
MAX_FINGERS, FINGERS = 5, 3
#: Words in the name of a body that carries fingers.
PALM_WORDS = {'gripper', 'hand', 'palm', 'claw'}
#: Words in the name of a hip that some call a shoulder, those that only arms and hands have, and
#: those that only legs have.
_HIP_WORDS, _BEYOND_HIP = {'shoulder'}, {'elbow', 'wrist', 'finger', 'thumb'}
_FOOT_WORDS = {'foot', 'toe', 'paw'}
#: The fewest limbs that may be legs by their places alone.
_LEAST_LEGS = 4
#: Two limbs alone are legs if they have so many joints, and end so near to the floor, as a share
#: of the height of the trunk.
_LEAST_JOINTS, _ON_FLOOR = 3, 0.2
#: A hinge that turns farther than this has no limits in practice [rad].
_UNLIMITED_RAD = 100.0
#: Likewise a slide [m].
_UNLIMITED_M = 20.0
#: Wheels have axes, and planes normals, that deviate by less than this from the ideal [sine].
_ALIGNED = 0.1
#: Limbs are mirrored if the places of their roots are so within this share of their distance.
_MIRRORED = 0.1
#: Limbs are in a row if their places deviate from a line by less than this share of its length.
_IN_ROW = 0.2
#: Places that are nearer are one [m].
_APART_M = 1e-6


@lru_cache(maxsize=4096)
def words_of(name: str) -> frozenset[str]:
    """
    Return the words of a name in lower case: ``left_hand2`` has ``left`` and ``hand``.

    Those in joined words are added: ``lfemurrx`` has ``l`` and ``femur``, too, and ``RHIPp`` ``r``
    and ``hip``.
    """
    words = {word.lower() for word in _WORD.findall(name)}
    whole = {word.lower() for word in _LETTERS.findall(name)}
    joined = [match.groups() for match in map(_JOINED.fullmatch, words | whole) if match]
    return frozenset(words.union(*({part for part in parts[:2] if part} for parts in joined)))


def side_of(names: Iterable[str]) -> str | None:
    """Return ``left`` or ``right``, the side in the first name that has words of one side only."""
    for name in names:
        words = words_of(name)
        # A letter may be of something else, as in r2/left_arm.
        sides = words & {'left', 'right'} or {_SIDES[word] for word in words if word in _SIDES}
        if len(sides) == 1:
            return next(iter(sides))
    return None


class BodyTree:
    """The tree of bodies of a model, by ids; body 0 is the world."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        self._parents = model.body_parentid.tolist()
        self._joints_of: dict[int, list[int]] = {}
        self._below: dict[int, set[int]] = {}
        for joint, body in enumerate(model.jnt_bodyid.tolist()):
            self._joints_of.setdefault(body, []).append(joint)

    def name(self, body: int) -> str:
        """Return the name of a body."""
        return str(self.model.body(body).name)

    def joint_name(self, joint: int) -> str:
        """Return the name of a joint."""
        return str(self.model.joint(joint).name)

    def body_of(self, joint: int) -> int:
        """Return the body that a joint moves."""
        return int(self.model.jnt_bodyid[joint])

    def parent(self, body: int) -> int:
        """Return the parent of a body."""
        return int(self._parents[body])

    def path(self, body: int) -> list[int]:
        """Return the bodies from the root to a body, both included; none for the world."""
        path = []
        while body:
            path.append(body)
            body = self.parent(body)
        return path[::-1]

    def below(self, body: int) -> set[int]:
        """Return a body and all bodies below it."""
        if body not in self._below:
            bodies = {body}
            for other in range(body + 1, self.model.nbody):
                if self._parents[other] in bodies:
                    bodies.add(other)
            self._below[body] = bodies
        return set(self._below[body])

    def joints(self, bodies: Iterable[int]) -> list[int]:
        """Return the joints of some bodies, in the order of the bodies."""
        return [joint for body in bodies for joint in self._joints_of.get(body, [])]

    def ends(self, joints: Iterable[int]) -> list[int]:
        """Return the bodies of some joints that have no other body of these joints below them."""
        moved = set(map(self.body_of, joints))
        return sorted(body for body in moved if not (self.below(body) - {body}) & moved)

    def common(self, bodies: Iterable[int]) -> int:
        """Return the last body that the paths to some bodies share; 0 if there is none."""
        paths = [self.path(body) for body in bodies]
        last = 0
        for level in zip(*paths):
            if len(set(level)) > 1:
                break
            last = level[0]
        return last

    def sides(self, bodies: Sequence[int]) -> list[str | None]:
        """
        Return the sides of bodies by the names of bodies, else of joints, on the ways to them.

        Words that the ways share count last, as the name of a robot called r2. Two names that
        differ in their first letter, l and r, have sides, too.
        """
        shared, joint = len(self.path(self.common(bodies))), self.model.joint
        ways = [self.path(body) for body in bodies]
        of_joints = [side_of(str(joint(index).name) for index in self.joints(way[shared:]))
                     for way in ways]
        if not {'right', 'left'} <= set(of_joints):  # One side alone is that of a finger.
            of_joints = [None] * len(ways)
        sides = [side_of(map(self.name, way[shared:])) or by_joint
                 or side_of(map(self.name, way[:shared]))
                 for way, by_joint in zip(ways, of_joints)]
        if len(ways) == 2 and sides == [None, None]:
            for names in zip(*(map(self.name, way[shared:]) for way in ways)):
                (side, first), (other_side, second) = (
                    (name[:1].lower(), name[1:]) for name in names)
                if first == second and {side, other_side} == {'l', 'r'}:
                    return [_SIDES[side], _SIDES[other_side]]
        return sides

    def driven(self, actuator: int) -> set[int]:
        """Return the joints that an actuator acts on, directly, by a tendon or at a site."""
        kind = int(self.model.actuator_trntype[actuator])
        target = int(self.model.actuator_trnid[actuator, 0])
        if kind in JOINT_TRANSMISSIONS:
            return {target}
        if kind == int(mujoco.mjtTrn.mjTRN_TENDON):
            return self._joints_of_tendon(target)
        if kind == int(mujoco.mjtTrn.mjTRN_SITE):
            return set(self.joints(self.path(int(self.model.site_bodyid[target]))))
        return set()

    def _joints_of_tendon(self, tendon: int) -> set[int]:
        model = self.model
        first = int(model.tendon_adr[tendon])
        wraps = range(first, first + int(model.tendon_num[tendon]))
        kinds = [int(model.wrap_type[wrap]) for wrap in wraps]
        ids = [int(model.wrap_objid[wrap]) for wrap in wraps]
        joints = {i for k, i in zip(kinds, ids) if k == int(mujoco.mjtWrap.mjWRAP_JOINT)}
        sites = [i for k, i in zip(kinds, ids) if k == int(mujoco.mjtWrap.mjWRAP_SITE)]
        bodies = [int(model.site_bodyid[site]) for site in sites]
        # A joint that moves some of the sites, but not all, changes the length.
        shared = set(self.path(self.common(bodies))) if bodies else set()
        return joints.union(*(self.joints(set(self.path(body)) - shared) for body in bodies))

    def coupled(self, joints: Iterable[int]) -> set[int]:
        """Return joints and those that equality constraints couple to them."""
        coupled = set(joints)
        model, joint = self.model, int(mujoco.mjtEq.mjEQ_JOINT)
        tied = np.flatnonzero((model.eq_type == joint) & (model.eq_obj2id >= 0))
        pairs = [{int(model.eq_obj1id[i]), int(model.eq_obj2id[i])} for i in tied]
        while True:
            more = {other for pair in pairs if pair & coupled for other in pair} - coupled
            if not more:
                return coupled
            coupled |= more

    def followers(self) -> set[int]:
        """Return the joints whose position an equality constraint makes one of another joint."""
        model, joint = self.model, int(mujoco.mjtEq.mjEQ_JOINT)
        return set(model.eq_obj1id[(model.eq_type == joint) & (model.eq_obj2id >= 0)].tolist())

    def tied_bodies(self) -> list[tuple[int, int]]:
        """Return the pairs of bodies that connect and weld constraints tie to each other."""
        model, kinds = self.model, mujoco.mjtEq
        tied = np.flatnonzero(np.isin(
            model.eq_type, [int(kinds.mjEQ_CONNECT), int(kinds.mjEQ_WELD)]))
        return [tied_bodies(model, equality) for equality in tied.tolist()]

    def is_scalar(self, joint: int) -> bool:
        """Return whether a joint is a hinge or a slide."""
        return int(self.model.jnt_type[joint]) in SCALAR


def is_unlimited(model: mujoco.MjModel, joint: int) -> bool:
    """Return whether a joint is a hinge that turns on and on."""
    return turns_farther_than(_UNLIMITED_RAD, model, joint)


def turns_farther_than(angle: float, model: mujoco.MjModel, joint: int) -> bool:
    """Return whether a joint is a hinge whose range is greater than an angle [rad]."""
    return int(model.jnt_type[joint]) == int(mujoco.mjtJoint.mjJNT_HINGE) and (
        not model.jnt_limited[joint] or bool(np.ptp(model.jnt_range[joint]) > angle))


def slides_on(model: mujoco.MjModel, joint: int) -> bool:
    """Return whether a joint is a slide that ends nowhere in practice."""
    return int(model.jnt_type[joint]) == int(mujoco.mjtJoint.mjJNT_SLIDE) and (
        not model.jnt_limited[joint] or bool(np.ptp(model.jnt_range[joint]) > _UNLIMITED_M))


class Limbs:
    """The limbs of a model at zero, and what its leading joints are: those that move all of it."""

    def __init__(self, tree: BodyTree) -> None:
        self._tree, self._model = tree, tree.model
        self._data = mujoco.MjData(tree.model)
        mujoco.mj_kinematics(tree.model, self._data)
        mujoco.mj_comPos(tree.model, self._data)
        rigid = tree.model.body_weldid.tolist()
        self._limbs_on: dict[int, list[int]] = {}
        for body in range(1, tree.model.nbody):
            if tree.joints([body]):
                self._limbs_on.setdefault(rigid[tree.parent(body)], []).append(body)
        self.leading: list[int] = []
        link = 0
        while len(limbs := self.on(link)) == 1:
            self.leading += tree.joints(limbs)
            link = limbs[0]
        self.trunk = link

    def on(self, link: int) -> list[int]:
        """Return the first bodies of the limbs that a rigid link carries; 0 is the fixed one."""
        return self._limbs_on.get(link, [])

    def by_root(self, link: int) -> list[list[int]]:
        """Return the limbs on a rigid link by their roots: several are a robot and its scene."""
        by_root: dict[int, list[int]] = {}
        for limb in self.on(link):
            by_root.setdefault(self._tree.path(limb)[0], []).append(limb)
        return list(by_root.values())

    def tied(self, link: int) -> list[list[int]]:
        """Return the limbs on a rigid link, those together that loops tie to each other."""
        limbs = self.on(link)
        limb_of = {body: limb for limb in limbs for body in self._tree.below(limb)}
        group_of = {limb: [limb] for limb in limbs}
        for first, second in self._tree.tied_bodies():
            if first in limb_of and second in limb_of:
                group, added = group_of[limb_of[first]], group_of[limb_of[second]]
                if group is not added:
                    group += added
                    group_of.update(dict.fromkeys(added, group))
        return [group for limb, group in group_of.items() if limb == group[0]]

    def joints(self, limb: int) -> list[int]:
        """Return the joints of a limb."""
        return self._tree.joints(sorted(self._tree.below(limb)))

    def planar_base(self) -> list[int]:
        """
        Return the joints that move the whole robot in a plane: two slides, and a hinge across.

        The plane is horizontal, or one body has all three, as planar walkers have.
        """
        joints = [joint for joint in self.leading if self._tree.is_scalar(joint)][:3]
        axes = self._data.xaxis[joints]
        kinds = [int(self._model.jnt_type[joint]) for joint in joints]
        slide = int(mujoco.mjtJoint.mjJNT_SLIDE)
        if len(joints) < 3 or kinds.count(slide) != 2:
            return []
        along = [axis for axis, kind in zip(axes, kinds) if kind == slide]
        hinge = next(axis for axis, kind in zip(axes, kinds) if kind != slide)
        is_plane = max(abs(float(np.dot(first, second))) for first, second in (
            along, (along[0], hinge), (along[1], hinge))) < _ALIGNED
        of_one_body = len(set(self._model.jnt_bodyid[joints].tolist())) == 1
        return joints if is_plane and (of_one_body or _is_vertical(hinge)) else []

    def moving_root(self) -> list[int]:
        """Return the joints of a leading body that slides without limits along two axes."""
        for body in dict.fromkeys(self._model.jnt_bodyid[self.leading].tolist()):
            joints = [joint for joint in self._tree.joints([body]) if self._tree.is_scalar(joint)]
            axes = [self._data.xaxis[joint] for joint in joints if slides_on(self._model, joint)]
            if len(axes) > 1 and abs(float(np.dot(axes[0], axes[1]))) < _ALIGNED:
                return joints
        return []

    def wheels(self, among: Iterable[int]) -> list[int]:
        """
        Return the joints of wheels: two or more hinges without limits on the trunk.

        Their axes are horizontal, and nothing moves on them but what turns on and on, too, as the
        rollers of omnidirectional wheels do. A vertical hinge may steer one.
        """
        candidates = set(among)
        groups = [[limb for limb in limbs if candidates.issuperset(self.joints(limb))
                   and self._is_wheel(limb)] for limbs in self.by_root(self.trunk)]
        return [joint for wheels in groups if len(wheels) > 1
                for limb in wheels for joint in self.joints(limb)]

    def _is_wheel(self, limb: int) -> bool:
        """
        Return whether a limb is a hinge of a wheel, with rollers or without.

        One that follows a joint with limits, such as the piston of an arm, is none.
        """
        axle, *others = self.joints(limb)
        rollers = self.on(limb)
        if len(rollers) == 1 and self._tree.joints([limb]) == [axle] and (
                _is_vertical(self._data.xaxis[axle])):
            return self._is_wheel(rollers[0])
        turning = self._tree.coupled((axle, *others))
        return (all(is_unlimited(self._model, joint) for joint in turning)
                and abs(float(self._data.xaxis[axle, 2])) < _ALIGNED
                and len(rollers) == len(others) != 1)

    def legs(self, among: Iterable[int]) -> list[int]:
        """
        Return the joints of legs: limbs of the trunk that are alike, more than a hand has fingers.

        Four are enough if they stand in pairs on both sides of the middle, and not in a row: a
        hand has a thumb, or a finger in the middle.
        """
        if not self._is_floating_trunk():
            return []
        candidates = set(among)
        alike: dict[tuple[int, int, int], list[int]] = {}
        for limb in self.on(self.trunk):
            root = self._tree.path(limb)[0]
            joints = self.joints(limb)
            if candidates.issuperset(joints) and len(set(self._model.jnt_bodyid[joints])) > 1:
                kind = root, len(joints), len(self._tree.ends(joints))
                alike.setdefault(kind, []).append(limb)
        return [joint for limbs in alike.values() if len(limbs) >= _LEAST_LEGS
                and (len(limbs) > MAX_FINGERS or self.in_pairs(limbs) and not self._in_row(limbs))
                and not self.are_of_two_hands(list(self.by_carrier(limbs).values()))
                for limb in limbs for joint in self.joints(limb)]

    def standing_pair(self, among: Iterable[int]) -> list[int]:
        """
        Return the joints of two limbs that mirror each other, the only ones on a floating trunk.

        They end where the file has the floor: z = 0.
        """
        limbs, height = self.on(self.trunk), float(self._data.xpos[self.trunk, 2])
        joints = [self.joints(limb) for limb in limbs]
        lengths = [len(of_limb) for of_limb in joints]
        floats = self.leading and not any(map(self._tree.is_scalar, self.leading))
        if not floats or len(limbs) != 2 or lengths[0] != lengths[1] or lengths[0] < _LEAST_JOINTS:
            return []
        stand = all(len(self._tree.ends(of_limb)) == 1 and abs(self._lowest(limb)) < (
            _ON_FLOOR * height) for limb, of_limb in zip(limbs, joints))
        every = [joint for of_limb in joints for joint in of_limb]
        return every if stand and set(every) <= set(among) and self.in_pairs(limbs) else []

    def _lowest(self, limb: int) -> float:
        """Return the height of the lowest point of a limb [m], of its frames and its shapes."""
        model, data, bodies = self._model, self._data, sorted(self._tree.below(limb))
        geoms = np.flatnonzero(np.isin(model.geom_bodyid, bodies))
        upward = data.geom_xmat[geoms].reshape(-1, 3, 3)[:, 2]
        centres, halves = model.geom_aabb[geoms, :3], model.geom_aabb[geoms, 3:]
        below = np.abs(upward) * halves - upward * centres
        return float(min([*data.geom_xpos[geoms, 2] - below.sum(axis=1), *data.xpos[bodies, 2]]))

    def legs_with_shoulders(self) -> list[int]:
        """
        Return the joints of legs with names of arms: no robot has so many arms.

        Each has a shoulder, and a foot, or no elbow, wrist or finger.
        """
        words = {limb: frozenset().union(*(words_of(str(self._model.joint(joint).name))
                                           for joint in self.joints(limb)))
                 for limb in self.on(self.trunk)}
        return self.legs([joint for limb, of_limb in words.items() for joint in self.joints(limb)
                          if of_limb & _HIP_WORDS and (
                              of_limb & _FOOT_WORDS or not of_limb & _BEYOND_HIP)])

    def _is_floating_trunk(self) -> bool:
        """Return whether nothing is above the trunk but joints that move the whole robot."""
        scalar = [joint for joint in self.leading if self._tree.is_scalar(joint)]
        kinds = [int(self._model.jnt_type[joint]) for joint in scalar]
        bodies = {int(self._model.jnt_bodyid[joint]) for joint in scalar}
        return not scalar or scalar == self.planar_base() or (
            kinds.count(int(mujoco.mjtJoint.mjJNT_SLIDE)) > 1 and len(bodies) == 1)

    def in_pairs(self, limbs: Sequence[int]) -> bool:
        """Return whether limbs stand in pairs that mirror each other, with none in the middle."""
        rotation = self._data.xmat[self._tree.parent(limbs[0])].reshape(3, 3)
        # Some files have the frames of all links in one place, where only masses are apart.
        for places in (self._data.xpos[list(limbs)], self._data.subtree_com[list(limbs)]):
            local = (places - places.mean(axis=0)) @ rotation
            size = float(np.abs(local).max(initial=0.0))
            if len(limbs) % 2 == 0 and any(
                    _mirrors(local, axis, _MIRRORED * size) for axis in range(3)):
                return True
        return False

    def _in_row(self, limbs: Sequence[int]) -> bool:
        """Return whether limbs begin beside each other, as the fingers of a palm do."""
        places = self._data.xpos[list(limbs)]
        sizes = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
        return bool(sizes[0] > _APART_M and sizes[1] < _IN_ROW * sizes[0])

    def by_carrier(self, limbs: Iterable[int]) -> dict[int, list[int]]:
        """Return limbs by the body that they hang on."""
        by_carrier: dict[int, list[int]] = {}
        for limb in limbs:
            by_carrier.setdefault(self._tree.parent(limb), []).append(limb)
        return by_carrier

    def are_of_two_hands(self, groups: Sequence[Sequence[int]]) -> bool:
        """
        Return whether groups of limbs are fingers of two hands.

        They are alike, and out of reach of each other or on bodies with names of hands.
        """
        if len(groups) != 2 or min(map(len, groups)) < FINGERS:
            return False
        tree, carriers = self._tree, [self._tree.parent(group[0]) for group in groups]
        are_named = len(set(carriers)) > 1 and all(
            words_of(tree.name(body)) & PALM_WORDS for body in carriers)
        lengths = [sorted(len(self.joints(limb)) for limb in group) for group in groups]
        first, second = (self._data.xpos[list(group)].mean(axis=0) for group in groups)
        return lengths[0] == lengths[1] and (are_named or length(first - second) > sum(
            max(map(self._reach, group)) for group in groups))

    def _reach(self, limb: int) -> float:
        """Return how far from the root of a limb its shapes and frames are at most [m]."""
        model, data = self._model, self._data
        bodies = sorted(self._tree.below(limb))
        geoms = np.flatnonzero(np.isin(model.geom_bodyid, bodies))
        distances = [*np.linalg.norm(data.xpos[bodies] - data.xpos[limb], axis=1),
                     *np.linalg.norm(data.geom_xpos[geoms] - data.xpos[limb], axis=1)]
        return float(max(distances))

    def axis(self, joint: int) -> FloatArray:
        """Return the direction of the axis of a joint, shape (3,)."""
        direction: FloatArray = self._data.xaxis[joint]
        return direction


def _is_vertical(axis: FloatArray) -> bool:
    return float(np.hypot(axis[0], axis[1])) < _ALIGNED


def _mirrors(places: FloatArray, axis: int, tolerance: float) -> bool:
    """Return whether places, shape (n, 3), mirror each other along an axis, and none is on it."""
    image = places.copy()
    image[:, axis] *= -1.0
    nearest = np.linalg.norm(places[:, None] - image[None], axis=2).min(axis=1)
    return bool((nearest < tolerance).all() and (np.abs(places[:, axis]) > tolerance).all())
