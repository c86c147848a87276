# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
The entities of a world, robots and free bodies, at one instant.

Their poses, twists, bounds and contacts are read, and free bodies are placed.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from manip_sim.algebra import wxyz_to_xyzw, xyzw_to_wxyz
from manip_sim.arrays import FloatArray, IntArray
from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.physics.poses_and_twists import Pose, Twist

_GEOM = mujoco.mjtGeom
_BODY = int(mujoco.mjtObj.mjOBJ_XBODY)


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
    :returns: None without geoms
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


def body_pose(data: mujoco.MjData, body: int) -> FloatArray:
    """
    Return the pose of a body in ``world`` at the instant of the last ``mj_kinematics``.

    :returns: position [m] and quaternion x, y, z, w, shape (7,)
    """
    return np.concatenate([data.xpos[body], wxyz_to_xyzw(data.xquat[body])])


@dataclass(frozen=True)
class EntityState:
    """
    The state of an entity at one instant; plain copies.

    :ivar pose: of its body's frame
    :ivar twist: of its body's frame
    :ivar linear_acceleration: of the frame's origin, in world axes [m/s^2], shape (3,)
    :ivar angular_acceleration: in world axes [rad/s^2], shape (3,)
    """

    pose: Pose
    twist: Twist
    linear_acceleration: FloatArray
    angular_acceleration: FloatArray


class Entities:
    """
    The robots, each with everything mounted on it, and the free bodies of a world.

    :param model: the compiled ``mujoco.MjModel``
    :param robots: the body whose pose is the robot's, such as its mobile base, by the name of
        the robot as an entity
    :param roots: the root bodies of the robots, never counted as free bodies
    """

    def __init__(self, model: mujoco.MjModel, robots: Mapping[str, str],
                 roots: Collection[str]) -> None:
        self._model = model
        self._bodies: dict[str, int] = {
            robot: model.body(frame).id for robot, frame in robots.items()}
        self._joints: dict[str, tuple[int, int]] = {}
        free = model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)
        for body, *addresses in zip(*(field[free].tolist() for field in (
                model.jnt_bodyid, model.jnt_qposadr, model.jnt_dofadr))):
            name = mujoco.mj_id2name(model, _BODY, body)
            if name and name not in roots:
                self._bodies[name] = body
                self._joints[name] = addresses[0], addresses[1]

    @property
    def names(self) -> list[str]:
        """Names of all entities, the robots first."""
        return list(self._bodies)

    def is_free(self, name: str) -> bool:
        """
        Return whether an entity is a free body, which :meth:`place` can move.

        :raises UnknownNameError: if the entity is unknown
        """
        self._body(name)
        return name in self._joints

    def _body(self, name: str) -> int:
        if name not in self._bodies:
            raise UnknownNameError('entity', name, self._bodies)
        return self._bodies[name]

    @property
    def free_names(self) -> list[str]:
        """Names of the free bodies."""
        return list(self._joints)

    def pose(self, data: mujoco.MjData, name: str) -> FloatArray:
        """
        Return the pose of an entity's body at the instant of the last ``mj_forward``.

        :param data: the ``mujoco.MjData``
        :returns: position [m] and quaternion x, y, z, w in ``world``, shape (7,)
        :raises UnknownNameError: if the entity is unknown
        """
        return body_pose(data, self._body(name))

    def twist(self, data: mujoco.MjData, name: str) -> FloatArray:
        """
        Return the twist of an entity's body at the instant of the last ``mj_forward``.

        :param data: the ``mujoco.MjData``
        :returns: linear [m/s] and angular velocity [rad/s] in the axes of ``world``, shape (6,)
        :raises UnknownNameError: if the entity is unknown
        """
        velocity = np.empty(6)
        mujoco.mj_objectVelocity(self._model, data, _BODY, self._body(name), velocity, 0)
        return np.concatenate([velocity[3:], velocity[:3]])

    def read(self, data: mujoco.MjData, name: str) -> EntityState:
        """
        Return the state of an entity at the instant of the last ``mj_forward``.

        :param data: the ``mujoco.MjData``
        :raises UnknownNameError: if the entity is unknown
        """
        body = self._body(name)
        pose, twist = self.pose(data, name), self.twist(data, name)
        acceleration = np.zeros(6)
        if self._model.body_weldid[body]:  # A body fixed to the world has none.
            # MuJoCo computes this by itself only if a sensor needs it.
            mujoco.mj_rnePostConstraint(self._model, data)
            mujoco.mj_objectAcceleration(self._model, data, _BODY, body, acceleration, 0)
            # In MuJoCo the world accelerates upwards in place of gravity.
            acceleration[3:] += self._model.opt.gravity
        return EntityState(Pose(pose[:3], pose[3:]), Twist(twist[:3], twist[3:]),
                           acceleration[3:], acceleration[:3])

    def bounds(self, data: mujoco.MjData, name: str, in_world: bool = False) -> Box | None:
        """
        Return the smallest box around the shapes of an entity, of a robot with all of its links.

        :param data: the ``mujoco.MjData`` at the instant of the last ``mj_forward``
        :param in_world: along the axes of ``world``; else along the axes of the entity's body,
            from its origin
        :returns: None if it has no shapes
        :raises UnknownNameError: if the entity is unknown
        """
        body, model = self._body(name), self._model
        geoms = np.flatnonzero(model.body_rootid[model.geom_bodyid] == model.body_rootid[body])
        frame = 0 if in_world else body
        return box_around(model, data, geoms.tolist(), data.xpos[frame],
                          data.xmat[frame].reshape(3, 3))

    def place(self, data: mujoco.MjData, name: str, pose: Pose | None, twist: Twist | None
              ) -> None:
        """
        Set the pose and the twist of a free body.

        :param data: the ``mujoco.MjData``; all of it belongs to the new state afterwards
        :param pose: of the body; None leaves it where it is
        :param twist: None leaves its velocity in world axes as it is
        :raises CommandError: if the entity is not free
        :raises UnknownNameError: if the entity is unknown
        """
        if not self.is_free(name):
            raise CommandError(f"'{name}' cannot be moved, only free bodies can: "
                               + (', '.join(self._joints) or 'there are none here'))
        qpos, dof = self._joints[name]
        twist = twist or self.read(data, name).twist
        if pose is not None:
            data.qpos[qpos:qpos + 3] = pose.position
            data.qpos[qpos + 3:qpos + 7] = xyzw_to_wxyz(pose.quat_xyzw)
        # A free joint's linear velocity is in world axes, its angular velocity in the body's.
        to_body, angular = np.empty(4), np.empty(3)
        mujoco.mju_negQuat(to_body, data.qpos[qpos + 3:qpos + 7])
        mujoco.mju_rotVecQuat(angular, twist.angular, to_body)
        data.qvel[dof:dof + 3] = twist.linear
        data.qvel[dof + 3:dof + 6] = angular
        mujoco.mj_forward(self._model, data)


@dataclass(frozen=True)
class Contacts:
    """
    The contacts of one instant that carry a force, or may.

    :ivar position: in ``world`` [m], shape (n, 3)
    :ivar force: on :attr:`body`, in the axes of ``world`` [N], shape (n, 3)
    :ivar body: of the two that touch, the one that can move; if both can, the later one in the
        model, such as the object and not the gripper, shape (n,)
    """

    position: FloatArray
    force: FloatArray
    body: IntArray


def bodies_in_contact(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[IntArray, IntArray]:
    """
    Return the contacts of geoms that carry a force, or may, at the last ``mj_forward``.

    :param model: the ``mujoco.MjModel``
    :param data: its ``mujoco.MjData``
    :returns: their numbers, shape (n,), and the ids of the two bodies of each, shape (n, 2)
    """
    contact = data.contact
    # Contacts of geoms, as opposed to flexes, that are among the constraints.
    used = np.flatnonzero((contact.efc_address >= 0) & (contact.geom >= 0).all(axis=1))
    return used, model.geom_bodyid[contact.geom[used]].astype(np.int64).reshape(-1, 2)


def pulling_bodies(model: mujoco.MjModel, data: mujoco.MjData) -> set[int]:
    """
    Return the ids of the bodies that adhesion holds to what they touch, such as suction cups.

    :param model: the ``mujoco.MjModel``
    :param data: its ``mujoco.MjData``
    """
    pulls = (model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_BODY)) & (data.actuator_force > 0.0)
    bodies: set[int] = set(model.actuator_trnid[pulls, 0].tolist())
    return bodies


def read_contacts(model: mujoco.MjModel, data: mujoco.MjData) -> Contacts:
    """
    Return the contacts of geoms at the instant of the last ``mj_forward``, copies.

    :param model: the ``mujoco.MjModel``
    :param data: its ``mujoco.MjData``
    """
    contact = data.contact
    used, body = bodies_in_contact(model, data)
    local = np.empty((len(used), 6))
    for row, index in zip(local, used.tolist()):
        mujoco.mj_contactForce(model, data, index, row)
    # MuJoCo gives the force on the second body, in axes that are the rows of the contact frame.
    force = np.einsum('nij,ni->nj', contact.frame[used].reshape(-1, 3, 3), local[:, :3])
    first = (body[:, 0] > body[:, 1]) & (model.body_weldid[body[:, 0]] > 0)
    first |= model.body_weldid[body[:, 1]] == 0
    force[first] *= -1.0
    return Contacts(contact.pos[used], force, np.where(first, body[:, 0], body[:, 1]))
