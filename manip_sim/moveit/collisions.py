# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Pairs of links that MoveIt need not check for collisions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import mujoco
import numpy as np

from manip_sim.models import World
from manip_sim.models.couplings import JointCouplings
from manip_sim.models.loading import compile_spec
from manip_sim.models.robots import RobotModel
from manip_sim.models.urdf_writer.kinematic_tree import subtree
from manip_sim.moveit.srdf import GroupState

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

    :param links: names by id of the body
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
    for place, body in enumerate(bodies):
        for other in bodies[:place]:
            if int(model.body_weldid[body]) == int(model.body_weldid[other]):
                yield body, other


class _Sampler:
    """
    Looks for collisions of a robot with itself.

    :param model: as from :func:`_without_filters`
    :param links: names by id of the body
    :ivar bodies: ids of those with shapes that collide, parents first
    """

    def __init__(self, model: mujoco.MjModel, robot: RobotModel, links: Mapping[int, str]) -> None:
        self._links = links
        self._model, self._data = model, mujoco.MjData(model)
        self._body_of_geom = np.asarray(model.geom_bodyid, dtype=np.int64)
        with_shapes = set(self._body_of_geom[model.geom_contype != 0].tolist())
        tree = subtree(model, model.body(robot.root_body).id)
        self.bodies = [body for body in tree if body in with_shapes]
        self._joints = [
            joint for joint in range(model.njnt) if int(model.jnt_bodyid[joint]) in set(tree)
            and int(model.jnt_type[joint]) in (int(mujoco.mjtJoint.mjJNT_HINGE),
                                               int(mujoco.mjtJoint.mjJNT_SLIDE))]
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
        random, count = np.random.default_rng(_SEED), len(self.bodies)
        always = np.ones(self._model.nbody ** 2, dtype=bool)
        near = np.zeros_like(always)
        for _ in range(_SAMPLES):
            self._place_at_random(random)
            numbers, distances = self._contacts()
            near[numbers] = True
            inside = np.zeros_like(always)
            inside[numbers[distances < 0.0]] = True
            always &= inside
        every = self.names((self.bodies[i], self.bodies[j])
                           for i in range(count) for j in range(i))
        return (self._of_numbers(np.flatnonzero(always)),
                every - self._of_numbers(np.flatnonzero(near)))

    def _place_at_random(self, random: Any) -> None:
        positions = random.uniform(self._low, self._high)
        self._data.qpos[self._qpos] = positions
        for group in self._groups:
            # One joint of those that are coupled says where the others are.
            leader = group[random.integers(len(group))]
            follow = self._couplings.follow({leader: float(positions[self._index[leader]])})
            self._data.qpos[[self._qpos[self._index[joint]] for joint in follow]] = [
                *follow.values()]

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
