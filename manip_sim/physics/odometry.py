# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Odometry: the pose of a mobile base relative to where its joints are zero, and its twist."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.physics.poses_and_twists import Pose
from manip_sim.quaternion import wxyz_to_xyzw


@dataclass(frozen=True)
class Odometry:
    """
    The pose and the twist of a base at one instant.

    :ivar position: in the frame of the odometry [m], shape (3,)
    :ivar quat_xyzw: orientation in that frame, shape (4,)
    :ivar linear: velocity in the base's own axes [m/s], shape (3,)
    :ivar angular: velocity in the base's own axes [rad/s], shape (3,)
    """

    position: FloatArray
    quat_xyzw: FloatArray
    linear: FloatArray
    angular: FloatArray


class OdometryReader:
    """
    A reader of a mobile base's odometry; the odometry frame is fixed in ``world``.

    It coincides with the frame of the base when the joints of the base are at zero.

    :param model: the compiled ``mujoco.MjModel``
    :param joints: that move the base, such as ``SimulatedRobot.twist_joints``
    :ivar base: name of the body that moves
    :ivar origin: pose of the frame of the odometry in ``world``
    """

    def __init__(self, model: mujoco.MjModel, joints: Sequence[str]) -> None:
        moved_by = [model.joint(name) for name in joints]
        # Bodies come after their parents.
        body = max(int(joint.bodyid[0]) for joint in moved_by)
        self.base: str = model.body(body).name
        data = mujoco.MjData(model)
        for joint in moved_by:
            data.qpos[joint.qposadr[0]] = 0.0
        mujoco.mj_kinematics(model, data)
        self._position = data.xpos[body].copy()
        self._quat_wxyz = data.xquat[body].copy()
        self.origin = Pose(self._position, wxyz_to_xyzw(self._quat_wxyz))

    def read(self, model: mujoco.MjModel, data: mujoco.MjData) -> Odometry:
        """
        Return the state of the base at the instant of the last ``mj_forward``.

        :param model: the ``mujoco.MjModel``, in which the robot is unchanged
        :param data: its ``mujoco.MjData``
        """
        body = int(model.body(self.base).id)
        inverse, quat_wxyz = np.empty(4), np.empty(4)
        position, velocity = np.empty(3), np.empty(6)
        mujoco.mju_negQuat(inverse, self._quat_wxyz)
        mujoco.mju_rotVecQuat(position, data.xpos[body] - self._position, inverse)
        mujoco.mju_mulQuat(quat_wxyz, inverse, data.xquat[body])
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, velocity, 1)
        return Odometry(position, wxyz_to_xyzw(quat_wxyz), velocity[3:], velocity[:3])
