# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Joints that move together: couplings, tendons and loops, and the joints that actuators move."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise
from typing import Any

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.models.actuators import JOINT_TRANSMISSIONS

_WRAP, _EQUALITY = mujoco.mjtWrap, mujoco.mjtEq
_TENDON = int(mujoco.mjtTrn.mjTRN_TENDON)
_SITE = (int(mujoco.mjtTrn.mjTRN_SITE), int(mujoco.mjtTrn.mjTRN_SLIDERCRANK))
#: Number of positions in a joint's range at which velocity ratios are computed.
_PLACES = 5
_STEP = 1e-6


class JointCouplings:
    """
    The joint equalities among some joints: one joint is a polynomial of another one.

    :param model: the compiled ``mujoco.MjModel``; constraints that are active at its start count
    :param joints: ids of scalar joints
    """

    def __init__(self, model: mujoco.MjModel, joints: Iterable[int]) -> None:
        ids = set(joints)
        self._zeros = {j: float(model.qpos0[model.jnt_qposadr[j]]) for j in ids}
        self._ranges = {j: model.jnt_range[j].copy() for j in ids if model.jnt_limited[j]}
        self._neighbours: dict[int, list[tuple[int, FloatArray, bool]]] = {j: [] for j in ids}
        is_joint = model.eq_type == int(mujoco.mjtEq.mjEQ_JOINT)
        for equality in np.flatnonzero(is_joint & (model.eq_active0 != 0)):
            follower, leader = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
            if follower in ids and leader in ids:
                polynomial = model.eq_data[equality, :5].copy()
                self._neighbours[leader].append((follower, polynomial, False))
                self._neighbours[follower].append((leader, polynomial, True))

    def group(self, joint: int) -> frozenset[int]:
        """Return a joint and the joints that move with it."""
        group, waiting = {joint}, [joint]
        while waiting:
            for other, _, _ in self._neighbours[waiting.pop()]:
                if other not in group:
                    group.add(other)
                    waiting.append(other)
        return frozenset(group)

    def follow(self, positions: Mapping[int, float]) -> dict[int, float]:
        """
        Return the positions of joints that are coupled to others.

        :param positions: of some joints, by id [rad or m]; of two that are coupled to the same
            one, the first one counts
        :returns: the positions given, and the positions of other joints that follow from them
        """
        known = dict(positions)
        waiting = list(known)
        while waiting:
            joint = waiting.pop(0)
            for other, polynomial, inverse in self._neighbours[joint]:
                if other in known:
                    continue
                offset = known[joint] - self._zeros[joint]
                value = (self._solve(polynomial, offset, other) if inverse
                         else _value(polynomial, offset))
                if value is not None:
                    known[other] = value + self._zeros[other]
                    waiting.append(other)
        return known

    def ratios(self, joint: int) -> list[dict[int, float]]:
        """Return the velocities of coupled joints per that of one, at positions in its range."""
        low, high = self._ranges.get(joint, (self._zeros[joint], self._zeros[joint]))
        ratios = []
        for place in np.linspace(low + _STEP, high - _STEP, _PLACES):
            before = self.follow({joint: place - _STEP})
            after = self.follow({joint: place + _STEP})
            ratios.append({other: (after[other] - before[other]) / (2.0 * _STEP)
                          for other in before if other in after})
        return ratios

    def _solve(self, polynomial: FloatArray, value: float, joint: int) -> float | None:
        """Return the offset nearest to zero at which a polynomial has a value, or None."""
        if not polynomial[2:].any():
            return (value - polynomial[0]) / polynomial[1] if polynomial[1] else None
        roots = np.roots([*polynomial[:0:-1], polynomial[0] - value])
        real = roots.real[np.abs(roots.imag) < _STEP]
        if joint in self._ranges:
            low, high = self._ranges[joint] - self._zeros[joint]
            real = real[(real > low - _STEP) & (real < high + _STEP)]
        return float(real[np.argmin(np.abs(real))]) if len(real) else None


def _value(polynomial: FloatArray, offset: float) -> float:
    """Return the value of a polynomial by Horner's rule; ``np.polyval`` takes far longer."""
    value = 0.0
    for coefficient in polynomial[::-1].tolist():
        value = value * offset + coefficient
    return value


def actuated_joints(model: mujoco.MjModel, actuator: int) -> list[int]:
    """Return the joints that an actuator acts on, through any transmission."""
    kind = int(model.actuator_trntype[actuator])
    target, reference = model.actuator_trnid[actuator].tolist()
    if kind in JOINT_TRANSMISSIONS:
        return [target]
    if kind == _TENDON:
        return _tendon_joints(model, target)
    if kind in _SITE:
        bodies = [int(model.site_bodyid[site]) if site >= 0 else 0 for site in (target, reference)]
        return joints_between(model, *bodies)
    return []


def _tendon_joints(model: mujoco.MjModel, tendon: int) -> list[int]:
    """Return the joints that a fixed tendon lists, or between whose links a spatial one runs."""
    first = int(model.tendon_adr[tendon])
    wraps = range(first, first + int(model.tendon_num[tendon]))
    fixed = [int(model.wrap_objid[wrap]) for wrap in wraps
             if int(model.wrap_type[wrap]) == int(_WRAP.mjWRAP_JOINT)]
    if fixed:
        return fixed
    joints: dict[int, None] = {}
    for body, next_body in pairwise(_wrapped_body(model, wrap) for wrap in wraps):
        if body is not None and next_body is not None:
            joints.update(dict.fromkeys(joints_between(model, body, next_body)))
    return list(joints)


def _wrapped_body(model: mujoco.MjModel, wrap: int) -> int | None:
    """Return the body of a point that a tendon runs through, None for a pulley."""
    kind, element = int(model.wrap_type[wrap]), int(model.wrap_objid[wrap])
    if kind == int(_WRAP.mjWRAP_SITE):
        return int(model.site_bodyid[element])
    if kind in (int(_WRAP.mjWRAP_SPHERE), int(_WRAP.mjWRAP_CYLINDER)):
        return int(model.geom_bodyid[element])
    return None


def moved_joints(model: mujoco.MjModel) -> set[int]:
    """
    Return the joints that something moves or holds.

    That is an actuator, a spring, a constraint that fixes the joint, or a coupling (an equality of
    joints or tendons, or a loop that a connect or weld constraint closes) to such a joint.
    """
    moved = {joint for actuator in range(model.nu) for joint in actuated_joints(model, actuator)}
    # A stiffness is one number or several, depending on the version of MuJoCo.
    moved.update(j for j in range(model.njnt) if np.any(model.jnt_stiffness[j]))
    for tendon in range(model.ntendon):
        if np.any(model.tendon_stiffness[tendon]):
            moved.update(_tendon_joints(model, tendon))
    groups = [set(group) for group in _coupled(model)]
    moved.update(*_fixed(model))
    while True:
        reached = [group for group in groups if group & moved and not group <= moved]
        if not reached:
            return moved
        moved.update(*reached)


def _equalities(model: mujoco.MjModel, *kinds: Any) -> Iterator[tuple[int, int, int]]:
    types = [int(kind) for kind in kinds]
    for equality in np.flatnonzero(model.eq_active0).tolist():
        if int(model.eq_type[equality]) in types:
            yield equality, int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])


def _coupled(model: mujoco.MjModel) -> Iterator[Iterable[int]]:
    for _, first, second in _equalities(model, _EQUALITY.mjEQ_JOINT):
        yield first, *(() if second < 0 else (second,))
    for _, first, second in _equalities(model, _EQUALITY.mjEQ_TENDON):
        yield [*_tendon_joints(model, first),
               *(_tendon_joints(model, second) if second >= 0 else ())]
    for equality, _, _ in _equalities(model, _EQUALITY.mjEQ_CONNECT, _EQUALITY.mjEQ_WELD):
        yield joints_between(model, *tied_bodies(model, equality))


def _fixed(model: mujoco.MjModel) -> Iterator[Iterable[int]]:
    """Yield the joints that a constraint holds alone, or by a weld to world or a mocap body."""
    for _, first, second in _equalities(model, _EQUALITY.mjEQ_JOINT):
        if second < 0:
            yield (first,)
    for equality, _, _ in _equalities(model, _EQUALITY.mjEQ_WELD):
        bodies = tied_bodies(model, equality)
        if any(not int(model.body_weldid[body]) or int(model.body_mocapid[body]) >= 0
               for body in bodies):
            yield joints_between(model, *bodies)


def tied_bodies(model: mujoco.MjModel, equality: int) -> tuple[int, int]:
    """Return the bodies that a connect or weld constraint ties to each other, also at sites."""
    first, second = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
    if int(model.eq_objtype[equality]) == int(mujoco.mjtObj.mjOBJ_SITE):
        return int(model.site_bodyid[first]), int(model.site_bodyid[second])
    return first, second


def joints_between(model: mujoco.MjModel, first: int, second: int) -> list[int]:
    """Return the joints that move one body relative to another."""
    apart = _ancestry(model, first) ^ _ancestry(model, second)
    return [joint for joint in range(model.njnt) if int(model.jnt_bodyid[joint]) in apart]


def _ancestry(model: mujoco.MjModel, body: int) -> set[int]:
    bodies = set()
    while body:
        bodies.add(body)
        body = int(model.body_parentid[body])
    return bodies
