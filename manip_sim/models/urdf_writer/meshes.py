# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The mesh files that a URDF refers to, and meshes as STL."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
import struct
from typing import Any

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.models.urdf_writer.numbers import matrix_of
from manip_sim.resources import PACKAGE, share_directory

#: A sphere of radius 1 [m], for ellipsoids.
UNIT_SPHERE = f'package://{PACKAGE}/assets/meshes/unit_sphere.stl'
#: Key, in place of the name of a mesh, of another file of that sphere.
ELLIPSOID = '<ellipsoid>'
#: Formats that RViz and MoveIt read too; only MuJoCo reads its .msh.
_READABLE = ('.stl', '.obj', '.dae')


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


def files_of_meshes(spec: mujoco.MjSpec, model: mujoco.MjModel) -> dict[str, MeshFile]:
    """
    Return the files that the meshes were read from, by name of the mesh.

    Left out: meshes without a file that others read, and rotated ones with a scale per axis.

    :param spec: the ``mujoco.MjSpec``, whose files are absolute paths
    :param model: compiled from it
    """
    found = {}
    for mesh in spec.meshes:
        file = Path(mesh.file)
        turn, scale = matrix_of(_unit(mesh.refquat)).T, np.array(mesh.scale, dtype=float)
        turned = not np.allclose(turn, np.eye(3), atol=1e-12)
        if (file.suffix.lower() not in _READABLE or not file.is_absolute()
                or (turned and np.ptp(scale) > 0.0)):
            continue
        index = model.mesh(mesh.name).id
        # The compiler has moved the vertices into the inertial frame of the mesh.
        back = matrix_of(model.mesh_quat[index]).T
        position = -back @ (scale * (turn @ np.asarray(mesh.refpos)) + model.mesh_pos[index])
        found[mesh.name] = MeshFile(uri_of(file), scale, position, back @ turn)
    return found


def stl_of(model: mujoco.MjModel, mesh: int) -> bytes:
    """Return a compiled mesh as binary STL, in its own frame."""
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    vertices = model.mesh_vert[first:first + count]
    first, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    return binary_stl(vertices[model.mesh_face[first:first + count]])


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
