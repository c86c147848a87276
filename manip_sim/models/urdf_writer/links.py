# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
The links and joints of a robot as in URDF, with the shapes and meshes of links.

They are a tree with one joint between two links. A body with several joints, or with a joint that
is not at its origin, becomes a chain of links, of which only the last one has mass.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
import struct
from types import MappingProxyType
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.algebra import matrix_of
from manip_sim.arrays import FloatArray
from manip_sim.frame_names import FrameNames, ROOT
from manip_sim.models.robots import ManipulatorModel, RobotModel
from manip_sim.resources import PACKAGE, share_directory
from manip_sim.sensing.instruments import instrument_sites

_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
#: From MuJoCo's camera, which looks along -z with y up, to an optical frame: along z, y down.
_TO_OPTICAL = np.diag([1.0, -1.0, -1.0])
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
class Link:
    """
    A link of a URDF.

    :ivar body: id of the body whose mass and shapes it has; None if it has none
    """

    name: str
    body: int | None = None


@dataclass(frozen=True)
class Joint:
    """
    A joint of a URDF.

    :ivar kind: ``fixed``, ``revolute``, ``continuous``, ``prismatic`` or ``floating``
    :ivar position: of the child in the parent with the joint at zero [m], shape (3,)
    :ivar rotation: of the child in the parent with the joint at zero, shape (3, 3)
    :ivar id: of the joint in the model, or None
    :ivar axis: in the child, of unit length, shape (3,); None if it has none
    """

    name: str
    kind: str
    parent: str
    child: str
    position: FloatArray
    rotation: FloatArray
    id: int | None = None
    axis: FloatArray | None = None


class KinematicTree:
    """
    Links and joints, each after its parent.

    :param model: the compiled ``mujoco.MjModel``
    :param joint_names: names that are taken already
    :param frame_names: of all frames of the model but joints, taken already
    :ivar links: the first one is the root
    :ivar joints: one for each other link
    :ivar link_of_body: names by id of the body
    :ivar link_of_site: names by id of the site
    :ivar link_of_camera: names by id of the camera; its optical frame is another link
    """

    def __init__(self, model: mujoco.MjModel, joint_names: set[str], frame_names: set[str]
                 ) -> None:
        self._model = model
        self.links: list[Link] = [Link(ROOT)]
        self.joints: list[Joint] = []
        self.link_of_body: dict[int, str] = {}
        self.link_of_site: dict[int, str] = {}
        self.link_of_camera: dict[int, str] = {}
        self._link_names = {ROOT, *frame_names}
        self._joint_names = set(joint_names)

    def take_name(self, name: str, otherwise: str) -> str:
        """Reserve a name for a link, with something appended until it is free, and return it."""
        while name in self._link_names:
            name += otherwise
        self._link_names.add(name)
        return name

    def add_fixed(self, link: Link, parent: str, position: FloatArray, rotation: FloatArray
                  ) -> None:
        """
        Add a link that does not move in its parent.

        :param position: in the parent [m], shape (3,)
        :param rotation: in the parent, shape (3, 3)
        """
        name = f'{link.name}_fixed_joint'
        while name in self._joint_names:
            name += '_'
        self._joint_names.add(name)
        self.links.append(link)
        self.joints.append(Joint(name, 'fixed', parent, link.name, position, rotation))


def robot_tree(model: mujoco.MjModel, robot: RobotModel, lidars: Iterable[str] = ()
               ) -> KinematicTree:
    """
    Return the tree of a robot with everything mounted on it, in ``world``.

    :param model: the compiled ``mujoco.MjModel`` of a world with the robot
    :param robot: a robot of that world
    :param lidars: names of the lidars of the world
    """
    sites = []
    if isinstance(robot, ManipulatorModel):
        for gripper in robot.grippers.values():
            sensor = model.sensor(gripper.important_sensors['force_ee'])
            sites += [int(sensor.objid[0]),
                      int(model.site(gripper.important_sites['grip_site']).id)]
    sites += [int(model.site(name).id) for name in [*instrument_sites(model), *lidars]]
    return build_tree(model, model.body(robot.root_body).id, list(dict.fromkeys(sites)))


def build_tree(model: mujoco.MjModel, root: int, sites: list[int], placed: Collection[str] = ()
               ) -> KinematicTree:
    """
    Return the tree of a body and all below it.

    :param model: the compiled ``mujoco.MjModel``
    :param root: id of a child of the world body, or 0 for the whole world
    :param sites: ids of sites below it that become links; all fixed cameras become links too
    :param placed: names of further frames, which no link has
    """
    bodies, names = subtree(model, root), FrameNames(model, placed)
    tree = KinematicTree(
        model, {_joint_name(model, j) for b in bodies for j in joints_of_body(model, b)},
        {*names.bodies, *names.cameras, *names.opticals, *(names.sites[site] for site in sites),
         *placed})
    tree.link_of_body = {body: names.bodies[body] for body in bodies}
    for body in bodies:
        if body > 0:
            _add_body(model, tree, body)
        for site in sites:
            if int(model.site_bodyid[site]) == body:
                tree.link_of_site[site] = names.sites[site]
                tree.add_fixed(Link(names.sites[site]), names.bodies[body], model.site_pos[site],
                               matrix_of(model.site_quat[site]))
    for camera in range(model.ncam):
        fixed = int(model.cam_mode[camera]) == int(mujoco.mjtCamLight.mjCAMLIGHT_FIXED)
        if fixed and int(model.cam_bodyid[camera]) in tree.link_of_body:
            name = tree.link_of_camera[camera] = names.cameras[camera]
            tree.add_fixed(Link(name), tree.link_of_body[int(model.cam_bodyid[camera])],
                           model.cam_pos[camera], matrix_of(model.cam_quat[camera]))
            tree.add_fixed(Link(names.opticals[camera]), name, np.zeros(3), _TO_OPTICAL)
    return tree


def subtree(model: mujoco.MjModel, root: int) -> list[int]:
    """Return the ids of a body and of all below it, parents first."""
    bodies = {root}
    for body in range(root + 1, model.nbody):
        if int(model.body_parentid[body]) in bodies:
            bodies.add(body)
    return sorted(bodies)


def joints_of_body(model: mujoco.MjModel, body: int) -> range:
    """Return the ids of the joints of a body."""
    first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    return range(first, first + count)


def _joint_name(model: mujoco.MjModel, joint: int) -> str:
    return model.joint(joint).name or f'joint_{joint}'


def _add_body(model: mujoco.MjModel, tree: KinematicTree, body: int) -> None:
    name = tree.link_of_body[body]
    parent = tree.link_of_body.get(int(model.body_parentid[body]), ROOT)
    position, rotation = model.body_pos[body], matrix_of(model.body_quat[body])
    moves = list(_moves(model, body))
    for number, (joint, kind, before, turn, after) in enumerate(moves, 1):
        last = number == len(moves) and not after.any()
        child = name if last else tree.take_name(f'{_joint_name(model, joint)}_link', '_')
        axis = None if kind == 'floating' else model.jnt_axis[joint]
        tree.links.append(Link(child, body if last else None))
        tree.joints.append(Joint(
            _joint_name(model, joint), kind, parent, child, position + rotation @ before,
            rotation @ turn, joint, axis))
        parent, position, rotation = child, after, np.eye(3)
        if last:
            return
    tree.add_fixed(Link(name, body), parent, position, rotation)


def _moves(model: mujoco.MjModel, body: int
           ) -> Iterator[tuple[int, str, FloatArray, FloatArray, FloatArray]]:
    """
    Return the joints of a body one after the other.

    :returns: id, kind, position and rotation of the joint's frame at zero in the frame before it,
        and the position of the next frame in the joint's frame
    """
    for joint in joints_of_body(model, body):
        kind, axis = int(model.jnt_type[joint]), model.jnt_axis[joint]
        zero, limited = float(model.qpos0[model.jnt_qposadr[joint]]), model.jnt_limited[joint]
        if kind == _HINGE:
            anchor, quat = model.jnt_pos[joint], np.empty(4)
            mujoco.mju_axisAngle2Quat(quat, axis, -zero)
            yield (joint, 'revolute' if limited else 'continuous', anchor, matrix_of(quat),
                   -anchor)
        elif kind == _SLIDE:
            yield joint, 'prismatic', -axis * zero, np.eye(3), np.zeros(3)
        else:
            yield joint, 'floating', np.zeros(3), np.eye(3), np.zeros(3)


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
