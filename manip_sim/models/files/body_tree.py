# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The tree of bodies of a compiled model: the bodies below each one, and what drives a joint."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
import re

import mujoco
import numpy as np

_JOINT = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
_WORD, _LETTERS = re.compile(r'[A-Z]?[a-z]+|[A-Z]+(?![a-z])'), re.compile(r'[A-Za-z]+')
_SIDES = {'left': 'left', 'l': 'left', 'lh': 'left', 'right': 'right', 'r': 'right', 'rh': 'right'}
#: Parts of bodies that are written in one word with a side before or an axis behind them.
_JOINED = re.compile(
    r'(left|right|upper|lower|[lrfbu])?(thigh|shin|shank|calf|foot|toe|ankle|knee|femur|tibia|hip|'
    r'leg|finger|thumb|hand|wrist|elbow|shoulder|head|neck|wheel)s?(r?[xyz]|[pr]|joint|link)?')
SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


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
        moved = {int(self.model.jnt_bodyid[joint]) for joint in joints}
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
                (one, first), (other, second) = ((name[:1].lower(), name[1:]) for name in names)
                if first == second and {one, other} == {'l', 'r'}:
                    return [_SIDES[one], _SIDES[other]]
        return sides

    def driven(self, actuator: int) -> set[int]:
        """Return the joints that an actuator acts on, directly, by a tendon or at a site."""
        kind = int(self.model.actuator_trntype[actuator])
        target = int(self.model.actuator_trnid[actuator, 0])
        if kind in _JOINT:
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
        pairs = self._tied_pairs()
        while True:
            more = {other for pair in pairs if pair & coupled for other in pair} - coupled
            if not more:
                return coupled
            coupled |= more

    def followers(self) -> set[int]:
        """Return the joints whose position an equality constraint makes one of another joint."""
        model, joint = self.model, int(mujoco.mjtEq.mjEQ_JOINT)
        return set(model.eq_obj1id[(model.eq_type == joint) & (model.eq_obj2id >= 0)].tolist())

    def _tied_pairs(self) -> list[set[int]]:
        model, joint = self.model, int(mujoco.mjtEq.mjEQ_JOINT)
        tied = np.flatnonzero((model.eq_type == joint) & (model.eq_obj2id >= 0))
        return [{int(model.eq_obj1id[i]), int(model.eq_obj2id[i])} for i in tied]

    def tied_bodies(self) -> list[tuple[int, int]]:
        """Return the pairs of bodies that connect and weld constraints tie to each other."""
        model, kinds = self.model, mujoco.mjtEq
        tied = np.flatnonzero(np.isin(
            model.eq_type, [int(kinds.mjEQ_CONNECT), int(kinds.mjEQ_WELD)]))
        pairs = []
        for equality in tied.tolist():
            ids = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
            if int(model.eq_objtype[equality]) == int(mujoco.mjtObj.mjOBJ_SITE):
                ids = int(model.site_bodyid[ids[0]]), int(model.site_bodyid[ids[1]])
            pairs.append(ids)
        return pairs

    def is_scalar(self, joint: int) -> bool:
        """Return whether a joint is a hinge or a slide."""
        return int(self.model.jnt_type[joint]) in SCALAR
