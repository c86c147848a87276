# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Joints that actuators, tendons and constraints of a compiled model act on."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import pairwise
from typing import Any

import mujoco
import numpy as np

_TRANSMISSION, _WRAP, _EQUALITY = mujoco.mjtTrn, mujoco.mjtWrap, mujoco.mjtEq
_JOINT = (int(_TRANSMISSION.mjTRN_JOINT), int(_TRANSMISSION.mjTRN_JOINTINPARENT))
_TENDON = int(_TRANSMISSION.mjTRN_TENDON)
_SITE = (int(_TRANSMISSION.mjTRN_SITE), int(_TRANSMISSION.mjTRN_SLIDERCRANK))


def actuated_joints(model: mujoco.MjModel, actuator: int) -> list[int]:
    """
    Return the joints that an actuator acts on, through any transmission.

    :param model: a compiled ``mujoco.MjModel``
    :param actuator: id of the actuator
    """
    kind = int(model.actuator_trntype[actuator])
    target, reference = model.actuator_trnid[actuator].tolist()
    if kind in _JOINT:
        return [target]
    if kind == _TENDON:
        return tendon_joints(model, target)
    if kind in _SITE:
        bodies = [int(model.site_bodyid[site]) if site >= 0 else 0 for site in (target, reference)]
        return joints_between(model, *bodies)
    return []


def tendon_joints(model: mujoco.MjModel, tendon: int) -> list[int]:
    """Return the joints that a fixed tendon lists, or between whose links a spatial one runs."""
    first = int(model.tendon_adr[tendon])
    wraps = range(first, first + int(model.tendon_num[tendon]))
    fixed = [int(model.wrap_objid[wrap]) for wrap in wraps
             if int(model.wrap_type[wrap]) == int(_WRAP.mjWRAP_JOINT)]
    if fixed:
        return fixed
    joints: dict[int, None] = {}
    for one, other in pairwise(_wrapped_body(model, wrap) for wrap in wraps):
        if one is not None and other is not None:
            joints.update(dict.fromkeys(joints_between(model, one, other)))
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

    :param model: a compiled ``mujoco.MjModel``
    """
    moved = {joint for actuator in range(model.nu) for joint in actuated_joints(model, actuator)}
    # A stiffness is one number or several, depending on the version of MuJoCo.
    moved.update(j for j in range(model.njnt) if np.any(model.jnt_stiffness[j]))
    for tendon in range(model.ntendon):
        if np.any(model.tendon_stiffness[tendon]):
            moved.update(tendon_joints(model, tendon))
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
    for _, one, other in _equalities(model, _EQUALITY.mjEQ_JOINT):
        yield one, *(() if other < 0 else (other,))
    for _, one, other in _equalities(model, _EQUALITY.mjEQ_TENDON):
        yield [*tendon_joints(model, one), *(tendon_joints(model, other) if other >= 0 else ())]
    for equality, one, other in _equalities(model, _EQUALITY.mjEQ_CONNECT, _EQUALITY.mjEQ_WELD):
        yield joints_between(model, *_tied_bodies(model, equality, one, other))


def _fixed(model: mujoco.MjModel) -> Iterator[Iterable[int]]:
    """Yield the joints that a constraint holds alone, or by a weld to world or a mocap body."""
    for _, one, other in _equalities(model, _EQUALITY.mjEQ_JOINT):
        if other < 0:
            yield (one,)
    for equality, one, other in _equalities(model, _EQUALITY.mjEQ_WELD):
        bodies = _tied_bodies(model, equality, one, other)
        if any(not int(model.body_weldid[body]) or int(model.body_mocapid[body]) >= 0
               for body in bodies):
            yield joints_between(model, *bodies)


def _tied_bodies(model: mujoco.MjModel, equality: int, one: int, other: int) -> tuple[int, int]:
    if int(model.eq_objtype[equality]) == int(mujoco.mjtObj.mjOBJ_SITE):
        return int(model.site_bodyid[one]), int(model.site_bodyid[other])
    return one, other


def joints_between(model: mujoco.MjModel, one: int, other: int) -> list[int]:
    """Return the joints that move one body relative to another."""
    apart = _ancestry(model, one) ^ _ancestry(model, other)
    return [joint for joint in range(model.njnt) if int(model.jnt_bodyid[joint]) in apart]


def _ancestry(model: mujoco.MjModel, body: int) -> set[int]:
    bodies = set()
    while body:
        bodies.add(body)
        body = int(model.body_parentid[body])
    return bodies
