# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The world as a motion planner for one robot sees it: solids, where they are, grasps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import mujoco
import numpy as np

from manip_sim.algebra import matrix_of, relative_quat_wxyz, wxyz_to_xyzw
from manip_sim.arrays import FloatArray, IntArray
from manip_sim.models.urdf_writer.links import (
    collides, geoms_of_body, subtree, triangles_of, unit_sphere)
from manip_sim.physics.entities import bodies_in_contact, body_pose, pulling_bodies

BOX, SPHERE, CYLINDER, MESH = 'box', 'sphere', 'cylinder', 'mesh'
#: Objects that have moved less are not published again [m], [rad].
MOVED_M, TURNED_RAD = 0.005, 0.02
#: Number of looks for which an object has to be grasped, and not grasped, to count as such.
_GRASPED, _RELEASED = 2, 3
#: Planners take shapes that touch for a collision, but robots stand against what does not move:
#: this distance is kept there [m].
_CLEARANCE_M = 0.001
#: Size of the box that stands for an infinite plane [m].
_PLANE_WIDTH_M, _PLANE_THICKNESS_M = 20.0, 0.1
_GEOM = mujoco.mjtGeom


@dataclass(frozen=True)
class Solid:
    """
    A shape that collides.

    :ivar kind: :data:`BOX`, :data:`SPHERE`, :data:`CYLINDER` or :data:`MESH`
    :ivar dimensions: x, y, z; radius; height and radius; of a mesh none [m]
    :ivar pose: in the frame of its object: position [m] and quaternion x, y, z, w, shape (7,)
    :ivar triangles: corners of a mesh's triangles, counterclockwise seen from outside, in the
        frame of the mesh [m], shape (n, 3, 3)
    """

    kind: str
    dimensions: tuple[float, ...]
    pose: FloatArray
    triangles: FloatArray | None = None


@dataclass(frozen=True)
class Obstacle:
    """
    A body that is not the robot's, with its shapes.

    :ivar name: of the body; ``arena`` is the world body
    :ivar body: its id
    :ivar solids: its shapes, in its frame
    :ivar mass: of the body [kg]
    """

    name: str
    body: int
    solids: tuple[Solid, ...]
    mass: float


@dataclass(frozen=True)
class HeldObject:
    """
    A grasp of an object.

    :ivar link: of the gripper, to which the object counts as fixed
    :ivar touch_links: all links of the gripper
    :ivar pose: of the object in the link: position [m], quaternion x, y, z, w, shape (7,)
    """

    link: str
    touch_links: tuple[str, ...]
    pose: FloatArray


@dataclass(frozen=True)
class Changes:
    """
    Difference from the scene as it was at the look before.

    :ivar added: objects that are not held any more, and where they are in ``world``
    :ivar moved: objects that have moved, and where they are in ``world``
    :ivar attached: objects that are held since now, or are held otherwise
    :ivar detached: objects that are not held any more; MoveIt then has them in its world, where
        they were held; :attr:`added` has them at the next look
    """

    added: dict[str, FloatArray] = field(default_factory=dict)
    moved: dict[str, FloatArray] = field(default_factory=dict)
    attached: dict[str, HeldObject] = field(default_factory=dict)
    detached: list[str] = field(default_factory=list)


class PlanningScene:
    """
    The world around a robot, as a planner sees it.

    :param model: the compiled ``mujoco.MjModel``; another one needs another scene
    :param root: name of the robot's root body; all below it is the robot
    :param grippers: names of the bodies of each gripper
    :ivar obstacles: bodies with shapes, by name
    :ivar left_out: names of geoms that have no such shape
    :ivar holds: objects that are held, as of the last look
    """

    def __init__(self, model: mujoco.MjModel, root: str,
                 grippers: Mapping[str, tuple[str, ...]]) -> None:
        self._model = model
        robot_bodies = set(subtree(model, model.body(root).id))
        insets = _insets(model, robot_bodies)
        self.left_out: list[str] = []
        self.obstacles: dict[str, Obstacle] = {}
        for body in range(model.nbody):
            solids = tuple(self._solids(body, insets)) if body not in robot_bodies else ()
            if solids:
                name = model.body(body).name if body else 'arena'
                while not name or name in self.obstacles:
                    name += f'_{body}'
                self.obstacles[name] = Obstacle(name, body, solids, float(model.body_mass[body]))
        free = set(model.jnt_bodyid[model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)].tolist())
        self._free = [obstacle for obstacle in self.obstacles.values() if obstacle.body in free]
        self._grippers = [tuple(sorted(int(model.body(name).id) for name in bodies))
                          for bodies in grippers.values()]
        self._shown: dict[str, FloatArray] = {}
        self.holds: dict[str, HeldObject] = {}
        #: For how many looks in succession an object was grasped, or not.
        self._looks: dict[str, int] = {}

    def _solids(self, body: int, insets: Mapping[int, float]) -> Iterator[Solid]:
        for geom in geoms_of_body(self._model, body):
            if collides(self._model, geom):
                solids = list(solids_of(self._model, geom, insets.get(geom, 0.0)))
                yield from solids
                if not solids:
                    self.left_out.append(self._model.geom(geom).name or f'geom_{geom}')

    def look(self, data: mujoco.MjData) -> Changes:
        """Return the changes at the instant of the last ``mj_forward``."""
        changes = Changes()
        grasps = dict(self._grasps(data))
        for name, obstacle in self.obstacles.items():
            if obstacle in self._free:
                self._look_at_grasp(data, obstacle, grasps.get(name), changes)
            if name in self.holds or name in changes.detached:
                self._shown.pop(name, None)
                continue
            pose = body_pose(data, obstacle.body)
            if name not in self._shown:
                changes.added[name] = self._shown[name] = pose
            elif _differs(pose, self._shown[name]):
                changes.moved[name] = self._shown[name] = pose
        return changes

    def _look_at_grasp(self, data: mujoco.MjData, obstacle: Obstacle,
                       gripper: tuple[int, ...] | None, changes: Changes) -> None:
        name, held = obstacle.name, self.holds.get(obstacle.name)
        seen = None if gripper is None else self._name(gripper[0])
        unchanged = seen == (None if held is None else held.link)
        self._looks[name] = 0 if unchanged else self._looks.get(name, 0) + 1
        slipped = held is not None and _differs(
            _relative(data, self._model.body(held.link).id, obstacle.body), held.pose)
        if not slipped and self._looks[name] < (_RELEASED if gripper is None else _GRASPED):
            return
        self._looks[name] = 0
        if gripper is None:
            del self.holds[name]
            changes.detached.append(name)
        else:
            changes.attached[name] = self.holds[name] = HeldObject(
                self._name(gripper[0]), tuple(self._name(body) for body in gripper),
                _relative(data, gripper[0], obstacle.body))

    def _name(self, body: int) -> str:
        return str(self._model.body(body).name)

    def poses(self, data: mujoco.MjData) -> dict[str, FloatArray]:
        """Return the poses of the objects that are not held, which count as known from now on."""
        self._shown = {name: body_pose(data, obstacle.body)
                       for name, obstacle in self.obstacles.items() if name not in self.holds}
        return dict(self._shown)

    def _grasps(self, data: mujoco.MjData) -> Iterator[tuple[str, tuple[int, ...]]]:
        """Yield which objects are grasped by which gripper."""
        if not (self._free and self._grippers):
            return
        used, pairs = bodies_in_contact(self._model, data)
        for obstacle in self._free:
            for gripper in self._grippers:
                if _is_grasped(self._model, data, used, pairs, obstacle.body, gripper):
                    yield obstacle.name, gripper
                    break


def _is_grasped(model: mujoco.MjModel, data: mujoco.MjData, used: IntArray, pairs: IntArray,
                body: int, gripper: tuple[int, ...]) -> bool:
    """Return whether bodies of a gripper press on a body from opposite sides, or one sucks it."""
    pressing: dict[int, FloatArray] = {}
    force, pulling = np.empty(6), pulling_bodies(model, data)
    for index, (first, other) in zip(used.tolist(), pairs.tolist()):
        finger = first if other == body else other if first == body else -1
        if finger in gripper:
            if finger in pulling:
                return True
            mujoco.mj_contactForce(model, data, index, force)
            # The normal points from the first to the second of the two.
            normal = data.contact.frame[index, :3] * (force[0] if other == body else -force[0])
            pressing[finger] = pressing.get(finger, 0.0) + normal
    forces = list(pressing.values())
    return any(float(first @ other) < 0.0 for place, first in enumerate(forces)
               for other in forces[:place])


def solids_of(model: mujoco.MjModel, geom: int, inset: float = 0.0) -> Iterator[Solid]:
    """
    Yield the shapes that make up a geom, in the frame of its body; none for a height field.

    A plane is a wide flat box below it, as planners know no half spaces.

    :param inset: by which the surface of a primitive lies inside of the geom's [m]
    """
    kind, size = int(model.geom_type[geom]), np.array(model.geom_size[geom], dtype=float)
    position, rotation = model.geom_pos[geom], matrix_of(model.geom_quat[geom])
    quat_xyzw = wxyz_to_xyzw(model.geom_quat[geom])

    def solid(shape: str, *dimensions: float, along: float = 0.0,
              triangles: FloatArray | None = None) -> Solid:
        return Solid(shape, tuple(max(float(d), 1e-6) for d in dimensions), np.concatenate([
            position + rotation[:, 2] * along, quat_xyzw]), triangles)

    if kind == int(_GEOM.mjGEOM_PLANE):
        yield solid(BOX, _PLANE_WIDTH_M, _PLANE_WIDTH_M, _PLANE_THICKNESS_M,
                    along=-inset - _PLANE_THICKNESS_M / 2.0)
    elif kind == int(_GEOM.mjGEOM_BOX):
        yield solid(BOX, *(2.0 * (size - inset)))
    elif kind == int(_GEOM.mjGEOM_SPHERE):
        yield solid(SPHERE, size[0] - inset)
    elif kind == int(_GEOM.mjGEOM_CYLINDER):
        yield solid(CYLINDER, 2.0 * (size[1] - inset), size[0] - inset)
    elif kind == int(_GEOM.mjGEOM_CAPSULE):
        yield solid(CYLINDER, 2.0 * size[1], size[0] - inset)
        for end in (-size[1], size[1]):
            yield solid(SPHERE, size[0] - inset, along=end)
    elif kind == int(_GEOM.mjGEOM_ELLIPSOID):
        yield solid(MESH, triangles=unit_sphere(2) * (size - inset))
    elif kind == int(_GEOM.mjGEOM_MESH):
        yield solid(MESH, triangles=np.asarray(
            triangles_of(model, int(model.geom_dataid[geom])), dtype=float))


def _insets(model: mujoco.MjModel, robot_bodies: set[int]) -> dict[int, float]:
    """Return by how much fixed geoms that touch fixed geoms of the robot are made smaller [m]."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    fixed = [geom for geom in range(model.ngeom) if collides(model, geom)
             and int(model.body_weldid[model.geom_bodyid[geom]]) == 0]
    robot = [geom for geom in fixed if int(model.geom_bodyid[geom]) in robot_bodies]
    insets = {}
    for geom in fixed:
        nearest = min((mujoco.mj_geomDistance(model, data, robot_geom, geom, 1.0, None)
                       for robot_geom in robot), default=1.0) if geom not in robot else 1.0
        # A geom deeper inside of the robot is not one that it only stands on.
        if -_CLEARANCE_M < nearest < _CLEARANCE_M:
            insets[geom] = _CLEARANCE_M - nearest
    return insets


def _relative(data: mujoco.MjData, link: int, body: int) -> FloatArray:
    position = data.xmat[link].reshape(3, 3).T @ (data.xpos[body] - data.xpos[link])
    return np.concatenate([position, wxyz_to_xyzw(
        relative_quat_wxyz(data.xquat[link], data.xquat[body]))])


def _differs(pose: FloatArray, other: FloatArray) -> bool:
    """Return whether two poses differ by more than the thresholds."""
    cosine = min(abs(float(pose[3:] @ other[3:])), 1.0)
    return bool(np.linalg.norm(pose[:3] - other[:3]) > MOVED_M
                or 2.0 * np.arccos(cosine) > TURNED_RAD)
