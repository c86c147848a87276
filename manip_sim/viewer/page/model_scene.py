# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The bodies of a model as scene nodes, their poses by joints, and arrows and points over them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import functools
import math
import re
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
import trimesh

from manip_sim.algebra import matrix_of
from manip_sim.arrays import FloatArray
from manip_sim.viewer.page.latest import plain

_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
_FREE = int(mujoco.mjtJoint.mjJNT_FREE)


class Kinematics:
    """The kinematics of a model; its ``mujoco.MjData`` is current after :meth:`compute`."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        self.data = mujoco.MjData(model)
        self._scalar = {model.joint(i).name: int(model.jnt_qposadr[i]) for i in range(model.njnt)
                        if int(model.jnt_type[i]) in _SCALAR}
        self._free = {model.body(int(model.jnt_bodyid[i])).name: int(model.jnt_qposadr[i])
                      for i in range(model.njnt) if int(model.jnt_type[i]) == _FREE}
        self.compute()

    @property
    def scalar_joints(self) -> list[str]:
        """The joints that :meth:`set_joints` takes."""
        return list(self._scalar)

    @property
    def free_bodies(self) -> list[str]:
        """The bodies that :meth:`place` takes."""
        return list(self._free)

    def set_joints(self, names: Sequence[str], positions: Sequence[float] | FloatArray
                   ) -> None:
        """Set the positions of scalar joints [rad or m]; unknown names are ignored."""
        for name, position in zip(names, positions):
            if name in self._scalar:
                self.data.qpos[self._scalar[name]] = position

    def place(self, body: str, position: FloatArray, quat_wxyz: FloatArray) -> None:
        """Set the pose of a free body in ``world`` [m]; other bodies are ignored."""
        address = self._free.get(body)
        if address is not None:
            self.data.qpos[address:address + 3] = position
            self.data.qpos[address + 3:address + 7] = quat_wxyz

    def compute(self) -> None:
        mujoco.mj_kinematics(self.model, self.data)


#: Scale of the font of 12 pixels; width of a character and height of a line in it [pixels].
_SCALE, _CHARACTER, _LINE = 0.8, 5.8, 15.0
#: Least time between two arrangements [s]; a change that is not sent [pixels].
_PERIOD_S, _SAME_IMAGE = 0.1, 0.5
#: A label that is nearer to the camera, or behind it, is not shown [m].
_NEAREST_M = 0.05


def arrange(corners: FloatArray, widths: FloatArray) -> FloatArray:
    """
    Return where labels do not overlap: each moved up or down by as few lines as possible.

    :param corners: left upper corners of labels, to the right and down [pixels], shape (n, 2)
    :param widths: of the labels [pixels], shape (n,)
    :returns: the corners that are free, shape (n, 2)
    """
    places = corners.copy()
    count = len(places)
    lines = sorted(range(-count, count + 1), key=abs)
    done = np.zeros(count, dtype=bool)
    for i in np.argsort(corners[:, 1], kind='stable').tolist():
        x = places[i, 0]
        beside = done & (places[:, 0] < x + widths[i]) & (x < places[:, 0] + widths)
        taken = places[beside, 1]
        places[i, 1] += _LINE * next(n for n in lines if not (
            np.abs(taken - places[i, 1] - _LINE * n) < _LINE).any())
        done[i] = True
    return places


class BodyLabels:
    """The names of the bodies that have joints."""

    def __init__(self, server: Any, model: mujoco.MjModel) -> None:
        self._server = server
        self._bodies = sorted(set(model.jnt_bodyid.tolist()))
        self._names = [plain(model.body(body).name) for body in self._bodies]
        self._widths = np.array([_CHARACTER * (len(name) + 1) for name in self._names])
        self._shown = False
        self._due_s = -math.inf
        #: By browser: its labels, and where they were last.
        self._labels: dict[int, tuple[list[Any], FloatArray]] = {}

    def show(self, shown: bool) -> None:
        """Show or hide the names, from the next :meth:`update` on."""
        self._shown, self._due_s = shown, -math.inf
        if not shown:
            for labels, _ in self._labels.values():
                for label in labels:
                    label.remove()
            self._labels = {}

    def update(self, now_s: float, posture: Kinematics) -> None:
        """Place the labels beside their bodies as each browser sees them; wall time [s]."""
        if not self._shown or now_s < self._due_s or not self._bodies:
            return
        self._due_s = now_s + _PERIOD_S
        clients = self._server.get_clients()
        self._labels = {
            number: labels for number, labels in self._labels.items() if number in clients}
        points = posture.data.xpos[self._bodies]
        for number, client in clients.items():
            if number not in self._labels:
                self._labels[number] = [client.scene.add_label(
                    f'/labels/{i}', name, font_screen_scale=_SCALE)
                    for i, name in enumerate(self._names)], np.full((len(points), 2), np.inf)
            self._place(number, client.camera, points)

    def _place(self, number: int, camera: Any, points: FloatArray) -> None:
        axes = matrix_of(camera.wxyz)  # To the right, down, ahead.
        places = (points - camera.position) @ axes
        seen = places[:, 2] > _NEAREST_M
        scale = np.where(seen, places[:, 2], 1.0) * (
            2.0 * math.tan(camera.fov / 2.0) / max(1, camera.image_height))  # [m per pixel]
        corners = places[:, :2] / scale[:, None]
        labels, before = self._labels[number]
        if np.abs(corners - before).max() < _SAME_IMAGE:
            return
        moved = arrange(corners, np.where(seen, self._widths, 0.0)) - corners
        self._labels[number] = labels, corners
        for i, label in enumerate(labels):
            label.visible = bool(seen[i])
            label.position = points[i] + scale[i] * (axes[:, :2] @ moved[i])


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

    :ivar rgba: in [0, 1]
    :ivar vertices: in the frame of the body [m], shape (n, 3)
    :ivar faces: indices of vertices, shape (n_faces, 3)
    """

    body: int
    rgba: tuple[float, ...]
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
            matrix = np.eye(4)
            matrix[:3, :3] = matrix_of(model.geom_quat[geom])
            matrix[:3, 3] = model.geom_pos[geom]
            key = (int(model.geom_bodyid[geom]), rgba,
                   int(model.geom_group[geom]) >= COLLISION_GROUP)
            alike.setdefault(key, []).append(shape.copy().apply_transform(matrix))
    meshes = []
    for (body, rgba, collides), shapes in alike.items():
        firsts = np.cumsum([0, *(len(shape.vertices) for shape in shapes)])
        meshes.append(BodyMesh(
            body, rgba, collides, np.concatenate([shape.vertices for shape in shapes]),
            np.concatenate([shape.faces + first for shape, first in zip(shapes, firsts)])))
    return meshes


def geom_rgba(model: mujoco.MjModel, geom: int) -> tuple[float, ...]:
    """Return the colour of a geom or its material, times the mean one of its texture."""
    rgba = np.array(model.geom_rgba[geom], dtype=float)
    material = int(model.geom_matid[geom])
    if material >= 0:
        if np.allclose(rgba, _NO_RGBA):
            rgba = np.array(model.mat_rgba[material], dtype=float)
        texture = int(np.atleast_1d(model.mat_texid[material])[_RGB])
        if texture >= 0:
            channels = int(model.tex_nchannel[texture])
            size = int(model.tex_width[texture]) * int(model.tex_height[texture]) * channels
            begin = int(model.tex_adr[texture])
            pixels = model.tex_data[begin:begin + size].reshape(-1, channels)
            rgba[:3] *= np.resize(pixels.mean(axis=0), 3) / 255.0
    return tuple(round(float(value), 4) for value in rgba)


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
        sphere = _unit_sphere().copy().apply_scale(size[0])
        # A ring of vertices at the equator belongs to the lower half.
        sphere.vertices[:, 2] += np.where(sphere.vertices[:, 2] > 1e-9, size[1], -size[1])
        return sphere
    if kind == _MESH:
        mesh = int(model.geom_dataid[geom])
        begin, vertices = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        first, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
        surface = trimesh.Trimesh(model.mesh_vert[begin:begin + vertices],
                                  model.mesh_face[first:first + faces], process=False)
        return surface if faces > _MANY_FACES else surface.smooth_shaded
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


_NOTHING = np.zeros((0, 3))
_CONTACTS, _POINT = 'contacts', (255, 140, 0)
_COLORS = {'contact_forces': (255, 200, 20), 'force': (230, 40, 40), 'torque': (70, 120, 255),
           'pull': (60, 200, 80)}
_SHAFT_M, _HEAD_M, _HEAD_LENGTH_M = 0.004, 0.01, 0.02
#: Smaller changes are not sent [m].
_SAME_ARROW_M = 2e-4


class Overlays:
    """Points and arrows over the scene."""

    def __init__(self, scene: Any) -> None:
        self._scene = scene
        self._shown: dict[str, tuple[FloatArray, Any]] = {}

    def show(self, points: FloatArray, arrows: Mapping[str, FloatArray]) -> None:
        """
        Show these points and arrows in place of the former ones.

        :param points: where bodies touch, in ``world`` [m], shape (n, 3)
        :param arrows: by what they show, from and to in ``world`` [m], shape (n, 2, 3)
        """
        self._show(_CONTACTS, points)
        for name in _COLORS:
            self._show(name, arrows.get(name, _NOTHING))

    def clear(self) -> None:
        self.show(_NOTHING, {})

    def _show(self, kind: str, numbers: FloatArray) -> None:
        before, handle = self._shown.pop(kind, (_NOTHING, None))
        alike = before.shape == numbers.shape
        # The number of points of a cloud may change, that of arrows may not.
        if handle is not None and (not len(numbers) or kind != _CONTACTS and not alike):
            handle.remove()
            handle = None
        if not len(numbers):
            return
        name = f'/overlays/{kind}'
        if handle is None and kind == _CONTACTS:
            handle = self._scene.add_point_cloud(
                name, numbers.astype(np.float32), _POINT, point_size=0.012,
                point_shape='circle', precision='float32')
        elif handle is None:
            handle = self._scene.add_arrows(
                name, numbers, _COLORS[kind], shaft_radius=_SHAFT_M, head_radius=_HEAD_M,
                head_length=_HEAD_LENGTH_M)
        elif alike and np.allclose(before, numbers, rtol=0.0, atol=_SAME_ARROW_M):
            numbers = before
        else:
            handle.points = numbers.astype(np.float32)
        self._shown[kind] = numbers, handle


ROOT = '/world'
#: Smaller changes of positions [m] and quaternions are not sent.
_SAME = 2e-5
_AXES_M, _AXES_RADIUS_M = 0.12, 0.003
_COLLISION = (255, 140, 40)
_GRID = {'cell_color': (150, 150, 150), 'section_color': (120, 120, 120)}
_FADE_M = 12.0
#: Vertical field of view at first [rad].
FIELD_OF_VIEW = math.radians(40.0)
#: First view: from the front right of the robot; factor on the least distance that fits.
FIRST = (0.78, -0.82, 0.42)
_ROOM = 1.15
#: Half edge of the box around the origin that is shown of a model without shapes [m].
_EMPTY_M = 1.0
#: Fixed shapes are shown as a whole if their half diagonal is at most so long, and their centre so
#: near to what moves [m]; walls and floors are not.
_FURNITURE_M, _NEAR_M = 1.5, 2.0
#: Length of the name of a body in the scene at most.
_MAX_NAME = 60


class Scene:
    """A model in the scene of a page, with its bodies where a ``mujoco.MjData`` has them."""

    def __init__(self, server: Any, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._server = server
        self._model = model
        self._paths = _paths(model)
        self._frames = [server.scene.add_frame(
            path, show_axes=False, axes_length=_AXES_M, axes_radius=_AXES_RADIUS_M)
            for path in self._paths]
        self._sites = [server.scene.add_frame(
            f'{self._paths[int(model.site_bodyid[site])]}/site{site}', show_axes=False,
            axes_length=0.7 * _AXES_M, axes_radius=_AXES_RADIUS_M,
            position=model.site_pos[site], wxyz=model.site_quat[site])
            for site in range(model.nsite)
            if model.site(site).name.endswith(('ft_frame', 'grip_site'))]
        self._collision: list[Any] = []
        self._visual: list[Any] = []
        #: The shapes of bodies that can move, with the names of these.
        self._moving: list[tuple[str, Any]] = []
        for number, mesh in enumerate(body_meshes(model)):
            self._add_mesh(f'{self._paths[mesh.body]}/shape{number}', mesh)
        for geom in np.flatnonzero(model.geom_type == _PLANE).tolist():
            half = model.geom_size[geom, :2]
            quat = np.empty(4)
            mujoco.mju_mat2Quat(quat, data.geom_xmat[geom])
            server.scene.add_grid(
                f'{ROOT}/plane{geom}', position=data.geom_xpos[geom], wxyz=quat,
                width=2.0 * half[0] or 20.0, height=2.0 * half[1] or 20.0,
                infinite_grid=not half.all(), cell_size=0.25, section_size=1.0, cell_thickness=0.5,
                section_thickness=1.0, fade_distance=_FADE_M, shadow_opacity=0.25, **_GRID)
        self._positions = np.full((model.nbody, 3), np.nan)
        self._quats = np.full((model.nbody, 4), np.nan)
        self.update(data)

    def _add_mesh(self, name: str, mesh: Any) -> None:
        color = _COLLISION if mesh.collides else tuple(
            round(255 * value) for value in mesh.rgba[:3])
        opacity = 0.35 if mesh.collides else mesh.rgba[3] if mesh.rgba[3] < 1.0 else None
        handle = self._server.scene.add_mesh_simple(
            name, mesh.vertices, mesh.faces, color=color, opacity=opacity,
            visible=not mesh.collides, cast_shadow=not mesh.collides)
        (self._collision if mesh.collides else self._visual).append(handle)
        if self._model.body_weldid[mesh.body] and self._model.body(mesh.body).name:
            self._moving.append((self._model.body(mesh.body).name, handle))

    def update(self, data: mujoco.MjData) -> None:
        """Show where the bodies are; only those that moved in their parent are sent."""
        positions, quats = local_poses(self._model, data)
        moved = ~(np.abs(positions - self._positions) <= _SAME).all(axis=1)
        turned = ~(np.abs(quats - self._quats) <= _SAME).all(axis=1)
        self._positions[moved], self._quats[turned] = positions[moved], quats[turned]
        with self._server.atomic():
            for body in np.flatnonzero(moved).tolist():
                self._frames[body].position = positions[body]
            for body in np.flatnonzero(turned).tolist():
                self._frames[body].wxyz = quats[body]

    def show_frames(self, shown: bool) -> None:
        """Show or hide the axes of bodies that have joints, ``ft_frame`` and ``grip_site``."""
        jointed = set(self._model.jnt_bodyid.tolist())
        for body, frame in enumerate(self._frames):
            frame.show_axes = shown and body in jointed
        for site in self._sites:
            site.show_axes = shown

    def show_collision(self, shown: bool) -> None:
        for handle in self._collision:
            handle.visible = shown

    def let_drag(self, dragged: Callable[[str, str, Any, Any], None] | None) -> None:
        """
        Let bodies that can move be dragged with the mouse.

        :param dragged: is called, in the thread of the server, with the name of the body; with
            ``start``, ``update`` or ``end``; with the point that was taken hold of, and with
            where the mouse is in the plane of that point, in ``world`` [m]; None: nothing is
        """
        for body, handle in self._moving:
            handle.remove_drag_callback('all')
            if dragged is not None:
                handle.on_drag(_awaited(dragged, body))

    def remove(self) -> None:
        self._server.scene.remove_by_name(ROOT)


def _awaited(dragged: Callable[[str, str, Any, Any], None], body: str) -> Any:
    """Return a callback for drags of a body; the server keeps the order of awaited ones only."""
    async def call(event: Any) -> None:
        dragged(body, event.phase, event.start_position, event.end_position)
    return call


def _paths(model: mujoco.MjModel) -> list[str]:
    paths, taken = [ROOT], {ROOT}
    for body in range(1, model.nbody):
        name = re.sub(r'[^\w-]', '_', model.body(body).name[:_MAX_NAME]) or f'body{body}'
        path = f'{paths[int(model.body_parentid[body])]}/{name}'
        paths.append(path if path not in taken else f'{path}-{body}')
        taken.add(paths[-1])
    return paths


def local_poses(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[FloatArray, FloatArray]:
    """
    Return where each body is in the frame of its parent.

    :returns: positions [m], shape (n, 3), and quaternions (w, x, y, z), shape (n, 4), w >= 0
    """
    parents = model.body_parentid
    rotations = data.xmat.reshape(-1, 3, 3)
    positions = np.einsum('nji,nj->ni', rotations[parents], data.xpos - data.xpos[parents])
    inverse = data.xquat[parents] * [1.0, -1.0, -1.0, -1.0]
    a, b = inverse, data.xquat
    quats = np.stack([
        a[:, 0] * b[:, 0] - (a[:, 1:] * b[:, 1:]).sum(axis=1),
        a[:, 0] * b[:, 1] + a[:, 1] * b[:, 0] + a[:, 2] * b[:, 3] - a[:, 3] * b[:, 2],
        a[:, 0] * b[:, 2] - a[:, 1] * b[:, 3] + a[:, 2] * b[:, 0] + a[:, 3] * b[:, 1],
        a[:, 0] * b[:, 3] + a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1] + a[:, 3] * b[:, 0]], axis=1)
    quats *= np.where(quats[:, :1] < 0.0, -1.0, 1.0)
    return positions, quats


def first_view(model: mujoco.MjModel, data: mujoco.MjData, aspect: float, covered: float = 0.0,
               below: float = 0.0, direction: tuple[float, float, float] = FIRST
               ) -> tuple[FloatArray, FloatArray]:
    """
    Return where to look from and to, so that robots, objects and tables are seen.

    :param aspect: aspect ratio of the picture, width / height
    :param covered: how much of its width something covers on the right, from 0 to 1
    :param below: how much of its height something covers below, from 0 to 1
    :param direction: from which to look, in ``world``; not along z
    :returns: two positions in ``world`` [m]
    """
    corners = _corners(model, data)
    center = (corners.min(axis=0) + corners.max(axis=0)) / 2.0
    back = np.array(direction) / np.linalg.norm(direction)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    up = np.cross(back, right)
    tangent = math.tan(FIELD_OF_VIEW / 2.0)
    ahead = (corners - center) @ back
    # Each corner is to be between two planes through the camera on each axis: by their slopes, the
    # nearest camera, and the places beside the center that it may have at a distance.
    bounds = []
    for axis, low, high in (
            (right, tangent * aspect, tangent * aspect * (1.0 - 2.0 * covered)),
            (up, tangent * (1.0 - 2.0 * below), tangent)):
        aside = (corners - center) @ axis
        bounds.append((axis, low, high, float((ahead * high + aside).max()),
                       float((ahead * low - aside).max())))
    distance = _ROOM * max((above + under) / (low + high)
                           for _, low, high, above, under in bounds)
    for axis, low, high, above, under in bounds:
        center = center + axis * (above - under + distance * (low - high)) / 2.0
    return center + distance * back, center


def _corners(model: mujoco.MjModel, data: mujoco.MjData) -> FloatArray:
    """Return the corners of the shapes that move, and of furniture, in ``world``, shape (n, 3)."""
    signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(1, 8, 3)
    local = model.geom_aabb[:, None, :3] + signs * model.geom_aabb[:, None, 3:]
    world: FloatArray = data.geom_xpos[:, None] + np.einsum(
        'nij,nkj->nki', data.geom_xmat.reshape(-1, 3, 3), local)
    bounded = model.geom_rbound > 0.0  # Planes have no bounds.
    moving = bounded & (model.body_weldid[model.geom_bodyid] > 0)
    if moving.any():
        middle = world[moving].reshape(-1, 3).mean(axis=0)
        small = np.linalg.norm(model.geom_aabb[:, 3:], axis=1) <= _FURNITURE_M
        near = np.linalg.norm(world.mean(axis=1) - middle, axis=1) <= _NEAR_M
        bounded = moving | (bounded & small & near)
    shown = world[bounded] if bounded.any() else signs * _EMPTY_M
    return np.concatenate([shown.reshape(-1, 3), data.xpos[model.body_weldid > 0]])
