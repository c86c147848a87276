# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The shapes of a model as triangles: one mesh for all of a body that look the same."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import functools
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
import trimesh

from manip_sim.arrays import FloatArray

_TYPE = mujoco.mjtGeom
_PLANE, _MESH = int(_TYPE.mjGEOM_PLANE), int(_TYPE.mjGEOM_MESH)
_BOX, _CAPSULE = int(_TYPE.mjGEOM_BOX), int(_TYPE.mjGEOM_CAPSULE)
_CYLINDER = int(_TYPE.mjGEOM_CYLINDER)
_ROUND = (int(_TYPE.mjGEOM_SPHERE), int(_TYPE.mjGEOM_ELLIPSOID))
#: Shapes of this group and above are collision shapes, the others are visual.
COLLISION_GROUP = 3
#: The colour that MuJoCo gives to a geom without one; then that of its material is used.
_NO_RGBA = (0.5, 0.5, 0.5, 1.0)
_RGB = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)
#: Meshes of more faces are shown as they are, without sharp edges.
_MANY_FACES = 20_000


@dataclass(frozen=True)
class BodyMesh:
    """
    Shapes of one body that have the same colour.

    :ivar body: its id
    :ivar rgba: in [0, 1]
    :ivar collides: whether they are collision shapes
    :ivar vertices: in the frame of the body [m], shape (n, 3)
    :ivar faces: indices of vertices, shape (n_faces, 3)
    """

    body: int
    rgba: tuple[float, float, float, float]
    collides: bool
    vertices: FloatArray
    faces: NDArray[np.int64]


def body_meshes(model: mujoco.MjModel) -> list[BodyMesh]:
    """Return all shapes of a model except invisible ones (alpha 0), planes and height fields."""
    alike: dict[tuple[int, tuple[float, ...], bool], list[Any]] = {}
    for geom in range(model.ngeom):
        rgba = geom_rgba(model, geom)
        shape = _shape(model, geom)
        if rgba[3] > 0.0 and shape is not None:
            key = (int(model.geom_bodyid[geom]), rgba,
                   int(model.geom_group[geom]) >= COLLISION_GROUP)
            alike.setdefault(key, []).append(_placed(model, geom, shape))
    return [BodyMesh(body, rgba, collides, *_joined(shapes))  # type: ignore[arg-type]
            for (body, rgba, collides), shapes in alike.items()]


def planes(model: mujoco.MjModel) -> Iterator[int]:
    return (int(i) for i in np.flatnonzero(model.geom_type == _PLANE))


def geom_rgba(model: mujoco.MjModel, geom: int) -> tuple[float, ...]:
    """Return the colour of a geom or its material, times the mean one of its texture."""
    rgba = np.array(model.geom_rgba[geom], dtype=float)
    material = int(model.geom_matid[geom])
    if material >= 0:
        if np.allclose(rgba, _NO_RGBA):
            rgba = np.array(model.mat_rgba[material], dtype=float)
        texture = int(np.atleast_1d(model.mat_texid[material])[_RGB])
        if texture >= 0:
            rgba[:3] *= _mean_color(model, texture)
    return tuple(round(float(value), 4) for value in rgba)


def _mean_color(model: mujoco.MjModel, texture: int) -> FloatArray:
    channels = int(model.tex_nchannel[texture])
    size = int(model.tex_width[texture]) * int(model.tex_height[texture]) * channels
    begin = int(model.tex_adr[texture])
    mean: FloatArray = model.tex_data[begin:begin + size].reshape(-1, channels).mean(axis=0)
    return np.resize(mean, 3) / 255.0


def _shape(model: mujoco.MjModel, geom: int) -> Any:
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    if kind == _BOX:
        return _unit_box().copy().apply_scale(2.0 * size)
    if kind in _ROUND:
        return _unit_sphere().copy().apply_scale(
            size[0] if kind == _ROUND[0] else size)
    if kind == _CYLINDER:
        return _unit_cylinder().copy().apply_scale([size[0], size[0], 2.0 * size[1]])
    if kind == _CAPSULE:
        return _capsule(float(size[0]), float(size[1]))
    if kind == _MESH:
        return _mesh(model, int(model.geom_dataid[geom]))
    return None


@functools.cache
def _unit_box() -> Any:
    box = trimesh.creation.box()
    box.unmerge_vertices()  # So that its edges are sharp.
    return box


@functools.cache
def _unit_sphere() -> Any:
    return trimesh.creation.uv_sphere(radius=1.0, count=[20, 24])


@functools.cache
def _unit_cylinder() -> Any:
    return trimesh.creation.cylinder(radius=1.0, height=1.0, sections=32).smooth_shaded


def _capsule(radius: float, half_length: float) -> Any:
    sphere = _unit_sphere().copy().apply_scale(radius)
    # A ring of vertices at the equator belongs to the lower half.
    ends = np.where(sphere.vertices[:, 2] > 1e-9, half_length, -half_length)
    sphere.vertices[:, 2] += ends
    return sphere


def _mesh(model: mujoco.MjModel, mesh: int) -> Any:
    begin, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    first, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    found = trimesh.Trimesh(model.mesh_vert[begin:begin + count],
                            model.mesh_face[first:first + faces], process=False)
    return found if faces > _MANY_FACES else found.smooth_shaded


def _placed(model: mujoco.MjModel, geom: int, shape: Any) -> Any:
    matrix = np.eye(4)
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
    matrix[:3, :3], matrix[:3, 3] = rotation.reshape(3, 3), model.geom_pos[geom]
    return shape.copy().apply_transform(matrix)


def _joined(shapes: list[Any]) -> tuple[FloatArray, NDArray[np.int64]]:
    firsts = np.cumsum([0, *(len(shape.vertices) for shape in shapes)])
    return (np.concatenate([shape.vertices for shape in shapes]),
            np.concatenate([shape.faces + first for shape, first in zip(shapes, firsts)]))
