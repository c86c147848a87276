# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Geoms as the shapes of URDF: boxes, cylinders, spheres and meshes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.models.urdf_writer.meshes import ELLIPSOID, MeshFile, UNIT_SPHERE
from manip_sim.models.urdf_writer.numbers import matrix_of, text_of

_GEOM = mujoco.mjtGeom
#: Groups of geoms that MuJoCo shows by default.
_SHOWN_GROUPS = 3


@dataclass(frozen=True)
class Shape:
    """
    A shape of a link.

    :ivar tag: ``box``, ``cylinder``, ``sphere`` or ``mesh``
    :ivar attributes: of the XML element
    :ivar position: in the link [m], shape (3,)
    :ivar rotation: in the link, shape (3, 3)
    """

    tag: str
    attributes: Mapping[str, str]
    position: FloatArray
    rotation: FloatArray


def collides(model: mujoco.MjModel, geom: int) -> bool:
    """Return whether a geom can collide."""
    return bool(model.geom_contype[geom] or model.geom_conaffinity[geom])


def is_seen(model: mujoco.MjModel, geom: int) -> bool:
    """Return whether MuJoCo shows a geom by default and the geom is not fully transparent."""
    return int(model.geom_group[geom]) < _SHOWN_GROUPS and float(rgba_of(model, geom)[3]) > 0.0


def rgba_of(model: mujoco.MjModel, geom: int) -> FloatArray:
    """Return the colour of a geom or of its material, shape (4,)."""
    material = int(model.geom_matid[geom])
    return np.asarray(model.geom_rgba[geom] if material < 0 else model.mat_rgba[material],
                      dtype=float)


def geoms_of_body(model: mujoco.MjModel, body: int) -> range:
    """Return the ids of the geoms of a body."""
    first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
    return range(first, first + count)


def shapes_of(model: mujoco.MjModel, geom: int, meshes: Mapping[str, MeshFile]) -> Iterator[Shape]:
    """
    Yield the shapes that make up a geom; none if URDF has no such shape, or no file the mesh.

    :param meshes: files of meshes by name, and of a sphere of radius 1 by :data:`ELLIPSOID`
    """
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    position, rotation = model.geom_pos[geom], matrix_of(model.geom_quat[geom])

    def shape(tag: str, **attributes: Any) -> Shape:
        return Shape(tag, {key: text_of(value) for key, value in attributes.items()}, position,
                     rotation)

    if kind == int(_GEOM.mjGEOM_BOX):
        yield shape('box', size=2.0 * size)
    elif kind == int(_GEOM.mjGEOM_SPHERE):
        yield shape('sphere', radius=size[0])
    elif kind == int(_GEOM.mjGEOM_CYLINDER):
        yield shape('cylinder', radius=size[0], length=2.0 * size[1])
    elif kind == int(_GEOM.mjGEOM_CAPSULE):
        yield shape('cylinder', radius=size[0], length=2.0 * size[1])
        for end in (-size[1], size[1]):
            yield Shape('sphere', {'radius': text_of(size[0])},
                        position + rotation[:, 2] * end, rotation)
    elif kind == int(_GEOM.mjGEOM_ELLIPSOID):
        sphere = meshes[ELLIPSOID].uri if ELLIPSOID in meshes else UNIT_SPHERE
        yield Shape('mesh', {'filename': sphere, 'scale': text_of(size)}, position, rotation)
    elif kind == int(_GEOM.mjGEOM_MESH):
        file = meshes.get(model.mesh(int(model.geom_dataid[geom])).name)
        if file is not None:
            yield Shape('mesh', {'filename': file.uri, 'scale': text_of(file.scale)},
                        position + rotation @ file.position, rotation @ file.rotation)
