# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
The links and joints of a robot as in URDF: a tree with one joint between two links.

A body with several joints, or with a joint that is not at its origin, becomes a chain of links,
of which only the last one has mass.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.frame_names import FrameNames, ROOT
from manip_sim.models.robots import ManipulatorModel, RobotModel
from manip_sim.quaternion import matrix_of
from manip_sim.sensing.instruments import instrument_sites

_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
#: From MuJoCo's camera, which looks along -z with y up, to an optical frame: along z, y down.
_TO_OPTICAL = np.diag([1.0, -1.0, -1.0])


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
        """
        Reserve a name for a link, and return it.

        :param name: the wanted name
        :param otherwise: appended to it until it is free
        """
        while name in self._link_names:
            name += otherwise
        self._link_names.add(name)
        return name

    def add_fixed(self, link: Link, parent: str, position: FloatArray, rotation: FloatArray
                  ) -> None:
        """
        Add a link that does not move in its parent.

        :param link: a link with a name of its own
        :param parent: name of its parent
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
            _add_camera(model, tree, camera, names)
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


def _add_camera(model: mujoco.MjModel, tree: KinematicTree, camera: int, names: FrameNames
                ) -> None:
    name = tree.link_of_camera[camera] = names.cameras[camera]
    tree.add_fixed(Link(name), tree.link_of_body[int(model.cam_bodyid[camera])],
                   model.cam_pos[camera], matrix_of(model.cam_quat[camera]))
    tree.add_fixed(Link(names.opticals[camera]), name, np.zeros(3), _TO_OPTICAL)


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
