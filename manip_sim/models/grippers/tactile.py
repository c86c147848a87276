# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tactile sensors on the pads of grippers: points that feel how deep something presses in."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray

#: Distance between neighbouring points, about [m].
_PITCH_M = 0.004
#: Points around a finger.
_AROUND = 8
#: No viewer shows shapes of this group by default.
_GROUP = 5
#: A touch sensor encloses its pad: they have the same centre but for this [m].
_SAME_PLACE_M = 2e-4
_BOX, _CAPSULE = int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_CAPSULE)
_TOUCH, _TACTILE = '_touch', '_tactile'


def add_tactile_sensors(spec: mujoco.MjSpec, model: mujoco.MjModel, data: mujoco.MjData, eef: str
                        ) -> list[str]:
    """
    Add a tactile sensor to each pad that a touch sensor encloses.

    A pad that is a box has a grid of points, row by row, on the face through which the way from
    its centre to the grasp frame leaves it; a finger that is a capsule has rings of points. The
    sensor is named like the touch sensor, with ``_tactile`` at its end, and so are the shape and
    the mesh of its points.

    :returns: names of the sensors of all pads, also of those that were there
    """
    present, names = {sensor.name for sensor in spec.sensors}, []
    for name, pad in _pads(model):
        names.append(name)
        if name in present:
            continue
        size, rotation = model.geom_size[pad], data.geom_xmat[pad].reshape(3, 3)
        if model.geom_type[pad] == _BOX:
            inward = rotation.T @ (data.body(eef).xpos - data.geom_xpos[pad])
            grid = _face(size, inward)
        else:
            grid = _rings(float(size[0]), float(size[1]))
        body = spec.body(model.body(model.geom_bodyid[pad]).name)
        _add(spec, body, name, grid, model.geom_pos[pad], model.geom_quat[pad])
    return names


def _pads(model: mujoco.MjModel) -> Iterator[tuple[str, int]]:
    """Yield the name of a tactile sensor and the id of the geom for each pad."""
    for sensor in np.flatnonzero(model.sensor_type == mujoco.mjtSensor.mjSENS_TOUCH):
        name, site = model.sensor(sensor).name, model.sensor_objid[sensor]
        if not name.endswith(_TOUCH):
            continue
        for geom in range(model.ngeom):
            if (model.geom_bodyid[geom] == model.site_bodyid[site]
                    and model.geom_type[geom] == model.site_type[site] in (_BOX, _CAPSULE)
                    and model.geom_contype[geom] | model.geom_conaffinity[geom]
                    and np.allclose(model.geom_pos[geom], model.site_pos[site],
                                    atol=_SAME_PLACE_M)):
                yield name.removesuffix(_TOUCH) + _TACTILE, geom


class _Grid:
    """
    Points in rows, each with a normal and two tangents.

    :param points: in the frame of the pad [m], shape (rows, columns, 3)
    :param frames: normal and tangents, shape (rows, columns, 3, 3)
    """

    def __init__(self, points: FloatArray, frames: FloatArray, closed: bool = False) -> None:
        self.points, self.frames = points, frames
        rows, columns = points.shape[:2]
        ids = np.arange(rows * columns).reshape(rows, columns)
        if closed:
            ids = np.column_stack([ids, ids[:, 0]])
        near, far = ids[:-1], ids[1:]
        self.triangles = np.stack([
            near[:, :-1], far[:, :-1], near[:, 1:], far[:, 1:], near[:, 1:], far[:, :-1]], axis=-1)


def _centres(half: float) -> FloatArray:
    """Return the centres of equal cells of about the pitch, in (-half, half)."""
    count = max(2, round(2.0 * half / _PITCH_M))
    return half * ((2.0 * np.arange(count) + 1.0) / count - 1.0)


def _face(size: FloatArray, inward: FloatArray) -> _Grid:
    """Return points on the face of a box through which a way from its centre leaves it."""
    normal = int(np.abs(inward / size).argmax())
    first, second = (axis for axis in range(3) if axis != normal)
    across, along = np.meshgrid(_centres(size[first]), _centres(size[second]), indexing='ij')
    points = np.empty((*across.shape, 3))
    points[..., first], points[..., second] = across, along
    points[..., normal] = np.copysign(size[normal], inward[normal])
    frame = np.eye(3)[[normal, first, second]]
    frame[0] *= np.sign(inward[normal])
    return _Grid(points, np.broadcast_to(frame, (*across.shape, 3, 3)))


def _rings(radius: float, half: float) -> _Grid:
    """Return points around a capsule, on its straight part."""
    along, angle = np.meshgrid(_centres(half), 2.0 * np.pi / _AROUND * np.arange(_AROUND),
                               indexing='ij')
    zero = np.zeros_like(along)
    normal = np.stack([np.cos(angle), np.sin(angle), zero], axis=-1)
    around = np.stack([-np.sin(angle), np.cos(angle), zero], axis=-1)
    upward = np.broadcast_to([0.0, 0.0, 1.0], normal.shape)
    return _Grid(radius * normal + along[..., None] * upward,
                 np.stack([normal, upward, around], axis=-2), closed=True)


def _add(spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str, grid: _Grid, pos: FloatArray,
         quat_wxyz: FloatArray) -> None:
    """Add a sensor, with the mesh and the shape that MuJoCo takes its points from."""
    spec.add_mesh(name=name, inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
                  uservert=grid.points.ravel(), usernormal=grid.frames.ravel(),
                  userface=grid.triangles.ravel())
    # MuJoCo moves the points of a mesh to its centre; a shape of that mesh puts them back.
    body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, pos=pos,
                  quat=quat_wxyz, contype=0, conaffinity=0, group=_GROUP, mass=0.0)
    spec.add_sensor(name=name, type=mujoco.mjtSensor.mjSENS_TACTILE,
                    objtype=mujoco.mjtObj.mjOBJ_MESH, objname=name,
                    reftype=mujoco.mjtObj.mjOBJ_GEOM, refname=name)
