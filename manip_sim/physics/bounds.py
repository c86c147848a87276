# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The smallest boxes around the shapes of bodies, and whether they overlap a region."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray

_GEOM = mujoco.mjtGeom


@dataclass(frozen=True)
class Box:
    """
    A box along the axes of a frame.

    :ivar low: its lowest coordinates [m], shape (3,)
    :ivar high: its highest coordinates [m], shape (3,)
    """

    low: FloatArray
    high: FloatArray

    def overlaps(self, box: Box) -> bool:
        """Return whether it has a point in common with another box along the same axes."""
        return bool((self.low <= box.high).all() and (box.low <= self.high).all())


@dataclass(frozen=True)
class Sphere:
    """
    A sphere.

    :ivar center: [m], shape (3,)
    :ivar radius: [m]
    """

    center: FloatArray
    radius: float

    def overlaps(self, box: Box) -> bool:
        """Return whether it has a point in common with a box."""
        nearest = np.clip(self.center, box.low, box.high)
        return float(np.linalg.norm(nearest - self.center)) <= self.radius


def box_around(model: mujoco.MjModel, data: mujoco.MjData, geoms: Iterable[int],
               position: FloatArray, axes: FloatArray) -> Box | None:
    """
    Return the smallest box around geoms, along the axes of a frame and from its origin.

    Of height fields and signed distance fields it holds the box that MuJoCo has.

    :param data: at the instant of the last ``mj_kinematics``
    :param geoms: their numbers; planes, which have no end, are left out
    :param position: of the frame in ``world`` [m], shape (3,)
    :param axes: of the frame in ``world``, in columns, shape (3, 3)
    :returns: None if there are no geoms
    """
    boxes = [_box_of(model, data, geom, position, axes) for geom in geoms
             if int(model.geom_type[geom]) != int(_GEOM.mjGEOM_PLANE)]
    if not boxes:
        return None
    return Box(np.min([box.low for box in boxes], axis=0),
               np.max([box.high for box in boxes], axis=0))


def _box_of(model: mujoco.MjModel, data: mujoco.MjData, geom: int, position: FloatArray,
            axes: FloatArray) -> Box:
    turned = axes.T @ data.geom_xmat[geom].reshape(3, 3)
    center = axes.T @ (data.geom_xpos[geom] - position)
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    if kind == int(_GEOM.mjGEOM_MESH):
        mesh = int(model.geom_dataid[geom])
        first = int(model.mesh_vertadr[mesh])
        corners = model.mesh_vert[first:first + int(model.mesh_vertnum[mesh])] @ turned.T + center
        return Box(corners.min(axis=0), corners.max(axis=0))
    along = np.abs(turned[:, 2])
    if kind == int(_GEOM.mjGEOM_SPHERE):
        half = np.full(3, size[0])
    elif kind == int(_GEOM.mjGEOM_CAPSULE):
        half = size[0] + along * size[1]
    elif kind == int(_GEOM.mjGEOM_CYLINDER):
        half = size[0] * np.sqrt(np.maximum(1.0 - along**2, 0.0)) + along * size[1]
    elif kind == int(_GEOM.mjGEOM_ELLIPSOID):
        half = np.sqrt((turned**2) @ size**2)
    else:
        center = center + turned @ model.geom_aabb[geom, :3]
        half = np.abs(turned) @ model.geom_aabb[geom, 3:]
    return Box(center - half, center + half)
