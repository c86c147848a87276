# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The shapes and meshes of links, mesh files that a URDF refers to, and numbers as its text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
import struct
from types import MappingProxyType
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.quaternion import matrix_of
from manip_sim.resources import PACKAGE, share_directory

#: A sphere of radius 1 [m], for ellipsoids.
UNIT_SPHERE = f'package://{PACKAGE}/assets/meshes/unit_sphere.stl'
#: Key, in place of the name of a mesh, of another file of that sphere.
ELLIPSOID = '<ellipsoid>'
#: Formats that RViz and MoveIt read too; only MuJoCo reads its .msh.
_READABLE = ('.stl', '.obj', '.dae')
#: Times that each triangle of the icosahedron is divided into four.
_LEVELS = 3
_GEOM = mujoco.mjtGeom
#: Groups of geoms that MuJoCo shows by default.
_SHOWN_GROUPS = 3
#: Smaller numbers are zeros with the rounding error of a product of two rotations.
_NOTHING = 1e-16


@dataclass(frozen=True)
class MeshFile:
    """
    A mesh that a URDF can refer to.

    :ivar uri: ``package://...`` or ``file://...``
    :ivar scale: factors for the vertices in the file, shape (3,)
    :ivar position: of the file's frame in that of the compiled mesh [m], shape (3,)
    :ivar rotation: of that frame, shape (3, 3)
    """

    uri: str
    scale: FloatArray
    position: FloatArray
    rotation: FloatArray


def uri_of(file: Path) -> str:
    """Return ``package://manip_sim/...`` for a file of this package, else ``file://...``."""
    resolved = file.resolve()
    if resolved.is_relative_to(share_directory().resolve()):
        return f'package://{PACKAGE}/{resolved.relative_to(share_directory().resolve())}'
    return f'file://{resolved}'


def files_of_meshes(spec: mujoco.MjSpec, model: mujoco.MjModel,
                    held: Mapping[str, Path] = MappingProxyType({})) -> dict[str, MeshFile]:
    """
    Return the files that the meshes were read from, by name of the mesh.

    Left out: meshes without a file that others read, and rotated ones with a scale per axis.

    :param spec: the ``mujoco.MjSpec``, whose files are absolute paths
    :param held: the files whose contents the spec holds, by their names in it
    """
    files = {}
    for mesh in spec.meshes:
        file = held.get(mesh.file, Path(mesh.file))
        turn, scale = matrix_of(_unit(mesh.refquat)).T, np.array(mesh.scale, dtype=float)
        turned = not np.allclose(turn, np.eye(3), atol=1e-12)
        if (file.suffix.lower() not in _READABLE or not file.is_absolute()
                or (turned and np.ptp(scale) > 0.0)):
            continue
        index = model.mesh(mesh.name).id
        # The compiler has moved the vertices into the inertial frame of the mesh.
        back = matrix_of(model.mesh_quat[index]).T
        position = -back @ (scale * (turn @ np.asarray(mesh.refpos)) + model.mesh_pos[index])
        files[mesh.name] = MeshFile(uri_of(file), scale, position, back @ turn)
    return files


def triangles_of(model: mujoco.MjModel, mesh: int) -> Any:
    """Return the corners of a compiled mesh, in its own frame [m], shape (n, 3, 3), a copy."""
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    vertices = model.mesh_vert[first:first + count]
    first, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    return vertices[model.mesh_face[first:first + count]]


def stl_of(model: mujoco.MjModel, mesh: int) -> bytes:
    """Return a compiled mesh as binary STL, in its own frame."""
    return binary_stl(triangles_of(model, mesh))


def binary_stl(triangles: Any) -> bytes:
    """
    Return triangles as binary STL.

    :param triangles: corners, counterclockwise seen from outside [m], shape (n, 3, 3)
    """
    corners = np.asarray(triangles, dtype='<f4')
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    record = np.zeros(len(corners), dtype=[('numbers', '<f4', (4, 3)), ('unused', '<u2')])
    record['numbers'][:, 0], record['numbers'][:, 1:] = normals, corners
    return bytes(80) + struct.pack('<I', len(corners)) + record.tobytes()


def _unit(quat_wxyz: Any) -> FloatArray:
    quat = np.array(quat_wxyz, dtype=float)
    norm = float(np.linalg.norm(quat))
    return quat / norm if norm > 0.0 else np.array([1.0, 0.0, 0.0, 0.0])


def unit_sphere(levels: int = _LEVELS) -> FloatArray:
    """Return a subdivided icosahedron of radius 1 as triangles, shape (20 * 4**levels, 3, 3)."""
    triangles = _icosahedron()
    for _ in range(levels):
        a, b, c = triangles.transpose(1, 0, 2)
        ab, bc, ca = ((p + q) / np.linalg.norm(p + q, axis=1, keepdims=True)
                      for p, q in ((a, b), (b, c), (c, a)))
        triangles = np.concatenate([np.stack(corners, axis=1) for corners in (
            (a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    return triangles


def _icosahedron() -> FloatArray:
    """Return the icosahedron, by three orthogonal golden rectangles, shape (20, 3, 3)."""
    golden = (1.0 + 5.0**0.5) / 2.0
    rectangle = [(0.0, s, t * golden) for s in (-1.0, 1.0) for t in (-1.0, 1.0)]
    corners = np.array([np.roll(corner, shift) for shift in range(3) for corner in rectangle])
    faces = [three for three in combinations(corners, 3)
             if all(np.isclose(np.linalg.norm(p - q), 2.0) for p, q in combinations(three, 2))]
    outward = [three if np.linalg.det(three) > 0.0 else three[::-1] for three in faces]
    return np.asarray(np.array(outward) / np.hypot(1.0, golden))


@dataclass(frozen=True)
class Shape:
    """
    A shape of a link.

    :ivar tag: ``box``, ``cylinder``, ``sphere`` or ``mesh``
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


def text_of(values: ArrayLike) -> str:
    """Return numbers as the shortest text of the same doubles; less than 1e-16 becomes 0."""
    if isinstance(values, float):
        return _shortest(float(values))
    return ' '.join(map(_shortest, np.asarray(values, dtype=float).reshape(-1).tolist()))


def _shortest(number: float) -> str:
    if abs(number) < _NOTHING:
        return '0'
    return str(int(number)) if number.is_integer() and abs(number) < 1e15 else repr(number)
