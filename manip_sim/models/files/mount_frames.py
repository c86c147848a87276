# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Add bodies at bodies or sites that a file or its description names."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.algebra import length
from manip_sim.arrays import FloatArray
from manip_sim.errors import UnknownNameError
from manip_sim.quaternion import quat_wxyz_from_rpy


def quat_wxyz_of(orientation: ArrayLike) -> FloatArray:
    """
    Return the quaternion w, x, y, z of a rotation in a description, normalised, shape (4,).

    :param orientation: roll, pitch, yaw [rad], shape (3,), or w, x, y, z, shape (4,)
    """
    numbers = np.asarray(orientation, dtype=float)
    if numbers.shape == (3,):
        return quat_wxyz_from_rpy(numbers)
    unit: FloatArray = numbers / length(numbers)
    return unit


def free_name(taken: Collection[str], wanted: str) -> str:
    """Return a name that is not taken: the wanted one, or that with a number."""
    name, number = wanted, 1
    while name in taken:
        name, number = f'{wanted}{number}', number + 1
    return name


def find_place(spec: mujoco.MjSpec, name: str, where: str) -> tuple[str, Any]:
    """Return ``body`` or ``site``, and the element of that name; a body goes before a site."""
    body = spec.body(name)
    if body is not None and name != 'world':
        return 'body', body
    site = spec.site(name)
    if site is not None:
        return 'site', site
    raise UnknownNameError(f'body or site in {where}', name, [
        element.name for element in [*spec.bodies[1:], *spec.sites]])


def add_body_at(model: mujoco.MjModel, place: tuple[str, Any], name: str, position: ArrayLike,
                orientation: ArrayLike) -> Any:
    """
    Add a body without mass.

    :param model: the spec before edits, compiled; gives the poses of sites
    :param place: ``body`` or ``site``, and the element
    :param position: in the body or site [m], shape (3,)
    :param orientation: in the body or site, see :func:`quat_wxyz_of`
    """
    kind, element = place
    pos, quat = np.asarray(position, dtype=float), quat_wxyz_of(orientation)
    parent = element
    if kind == 'site':
        parent = element.parent
        site = model.site(element.name)
        turned, whole = np.empty(3), np.empty(4)
        mujoco.mju_rotVecQuat(turned, pos, site.quat)
        mujoco.mju_mulQuat(whole, site.quat, quat)
        pos, quat = site.pos + turned, whole
    return parent.add_body(name=name, pos=pos, quat=quat)
