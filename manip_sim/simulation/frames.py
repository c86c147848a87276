# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
The tree of frames of a world: their names, their parents, and their poses in their parents.

There is one frame for each body, with the body's name; one for each requested site, as a child of
its body; two for each camera, MuJoCo's and the optical one; one for each joint between a body and
its parent that needs one; and those that the caller places in the root, ``world``.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.models.quaternion import wxyz_to_xyzw
from manip_sim.models.urdf_writer.tree import OPTICAL
from manip_sim.simulation.joint_frames import JointFrames
from manip_sim.simulation.poses import Pose

#: The root of the tree.
WORLD = 'world'
#: From MuJoCo's camera, which looks along -z with y up, to REP 103's optical frame, which looks
#: along z with y down: half a turn about x, as w, x, y, z.
_TO_OPTICAL = np.array([0.0, 1.0, 0.0, 0.0])
_FIXED_CAMERA = int(mujoco.mjtCamLight.mjCAMLIGHT_FIXED)


@dataclass(frozen=True)
class Frame:
    """
    A frame and its parent.

    :ivar name: unique among frames
    :ivar parent: name of another frame, or ``world``
    """

    name: str
    parent: str


class FrameTree:
    """
    The frames of a model; poses are rows x, y, z [m] and quaternion x, y, z, w.

    :param model: the compiled ``mujoco.MjModel``
    :param sites: names of sites that are frames too
    :param placed: names of further frames, and their poses in ``world``
    :ivar model: the model
    :ivar moving: frames that move in their parent: bodies with joints and mocap bodies, frames
        of joints between bodies, and cameras that follow something
    :ivar static: frames that do not move in their parent
    :ivar static_poses: of :attr:`static` in their parents, shape (n, 7)
    """

    def __init__(self, model: mujoco.MjModel, sites: Iterable[str] = (),
                 placed: Iterable[tuple[str, Pose]] = ()) -> None:
        self.model = model
        self.moving: list[Frame] = []
        self.static: list[Frame] = []
        self._names = {WORLD}
        self._bodies = [WORLD]
        self._cameras: list[int] = []
        self._joint_frames: list[JointFrames] = []
        static_poses: list[FloatArray] = []
        moving: list[int] = []
        for body in range(1, model.nbody):
            frame = self._add(model.body(body).name or f'body_{body}', '_body',
                              self._bodies[model.body_parentid[body]])
            self._bodies.append(frame.name)
            if model.body_jntnum[body] or model.body_mocapid[body] >= 0:
                self.moving.append(frame)
                moving.append(body)
            else:
                self.static.append(frame)
                static_poses.append(_row(model.body_pos[body], model.body_quat[body]))
        for body in moving:
            self._add_joints(JointFrames(model, body), body)
        self._moving = np.array(moving, dtype=np.int64)
        self._parents: Any = model.body_parentid[self._moving]
        for site in (model.site(name).id for name in sites):
            self.static.append(self._add(model.site(site).name, '_site',
                                         self._bodies[model.site_bodyid[site]]))
            static_poses.append(_row(model.site_pos[site], model.site_quat[site]))
        for camera in range(model.ncam):
            self._add_camera(camera, static_poses)
        for name, pose in placed:
            self.static.append(self._add(name, '_frame', WORLD))
            static_poses.append(np.concatenate([pose.position, pose.quat_xyzw]))
        self.static_poses = np.array(static_poses).reshape(-1, 7)

    def _add(self, name: str, otherwise: str, parent: str) -> Frame:
        # Sites, cameras and bodies may share a name in MuJoCo, frames cannot.
        while name in self._names:
            name += otherwise
        self._names.add(name)
        return Frame(name, parent)

    def _add_joints(self, frames: JointFrames, body: int) -> None:
        if frames.joints:
            self._joint_frames.append(frames)
        for joint in frames.joints:
            name = self.model.joint(joint).name or f'joint_{joint}'
            self.moving.append(self._add(f'{name}_link', '_',
                                         self._bodies[self.model.body_parentid[body]]))

    def _add_camera(self, camera: int, static_poses: list[FloatArray]) -> None:
        model = self.model
        fixed = int(model.cam_mode[camera]) == _FIXED_CAMERA
        parent = self._bodies[int(model.cam_bodyid[camera])] if fixed else WORLD
        frame = self._add(model.camera(camera).name or f'camera_{camera}', '_camera', parent)
        if fixed:
            self.static.append(frame)
            static_poses.append(_row(model.cam_pos[camera], model.cam_quat[camera]))
        else:
            self.moving.append(frame)
            self._cameras.append(camera)
        self.static.append(self._add(frame.name + OPTICAL, '_', frame.name))
        static_poses.append(_row(np.zeros(3), _TO_OPTICAL))

    def moving_poses(self, data: mujoco.MjData) -> FloatArray:
        """
        Return the poses of :attr:`moving` in their parents, at the last ``mj_forward``.

        :param data: the ``mujoco.MjData`` of :attr:`model`
        :returns: in the order of :attr:`moving`, shape (n, 7)
        """
        poses = np.empty((len(self.moving), 7))
        count = len(self._moving)
        children, parents = self._moving, self._parents
        axes = data.xmat[parents].reshape(-1, 3, 3)
        poses[:count, :3] = np.einsum('nji,nj->ni', axes, data.xpos[children] - data.xpos[parents])
        poses[:count, 3:] = np.einsum('ijk,nj,nk->ni', _INVERSE_PRODUCT, data.xquat[parents],
                                      data.xquat[children])
        others = [pose for frames in self._joint_frames for pose in frames.poses(data)]
        others += [(data.cam_xpos[camera], _quat_wxyz(data.cam_xmat[camera]))
                   for camera in self._cameras]
        for row, (position, quat_wxyz) in enumerate(others, start=count):
            poses[row] = _row(position, quat_wxyz)
        return poses


def _row(position: Any, quat_wxyz: Any) -> FloatArray:
    return np.concatenate([position, wxyz_to_xyzw(quat_wxyz)])


def _quat_wxyz(matrix: Any) -> FloatArray:
    quat_wxyz = np.empty(4)
    mujoco.mju_mat2Quat(quat_wxyz, matrix)
    return quat_wxyz


def _inverse_product() -> FloatArray:
    """Return t with t[i, j, k] p[j] c[k] = p^-1 c as x, y, z, w, for p and c as w, x, y, z."""
    table, product, inverse = np.empty((4, 4, 4)), np.empty(4), np.empty(4)
    for j, p in enumerate(np.eye(4)):
        for k, c in enumerate(np.eye(4)):
            mujoco.mju_negQuat(inverse, p)
            mujoco.mju_mulQuat(product, inverse, c)
            table[:, j, k] = wxyz_to_xyzw(product)
    return table


_INVERSE_PRODUCT = _inverse_product()
