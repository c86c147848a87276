# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Where a mobile base has come since its joints were at zero, and how fast it goes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.models.quaternion import wxyz_to_xyzw
from manip_sim.simulation.poses import Pose


@dataclass(frozen=True)
class Odometry:
    """
    A base at one instant.

    :ivar position: in the frame of the odometry [m], shape (3,)
    :ivar quat_xyzw: how it is turned there, shape (4,)
    :ivar linear: velocity in the base's own axes [m/s], shape (3,)
    :ivar angular: in the base's own axes [rad/s], shape (3,)
    """

    position: FloatArray
    quat_xyzw: FloatArray
    linear: FloatArray
    angular: FloatArray


class OdometryReader:
    """
    Reads a mobile base; the frame of its odometry is fixed in ``world``.

    That frame is where the base's frame is while the base's joints are at zero.

    :param model: the compiled ``mujoco.MjModel``
    :param joints: by which the base moves, such as ``SimulatedRobot.twist_joints``
    :ivar base: the body that moves, by its name
    :ivar origin: where the frame of the odometry is in ``world``
    """

    def __init__(self, model: mujoco.MjModel, joints: Sequence[str]) -> None:
        moved_by = [model.joint(name) for name in joints]
        # Bodies come after those they hang on.
        self._body = max(int(joint.bodyid[0]) for joint in moved_by)
        self.base: str = model.body(self._body).name
        data = mujoco.MjData(model)
        for joint in moved_by:
            data.qpos[joint.qposadr[0]] = 0.0
        mujoco.mj_kinematics(model, data)
        self._position = data.xpos[self._body].copy()
        self._quat_wxyz = data.xquat[self._body].copy()
        self.origin = Pose(self._position, wxyz_to_xyzw(self._quat_wxyz))

    def read(self, model: mujoco.MjModel, data: mujoco.MjData) -> Odometry:
        """
        Return the base at the instant of the last ``mj_forward``.

        :param model: the ``mujoco.MjModel``, in which the robot is what and where it was
        :param data: its ``mujoco.MjData``
        """
        inverse, quat_wxyz = np.empty(4), np.empty(4)
        position, velocity = np.empty(3), np.empty(6)
        mujoco.mju_negQuat(inverse, self._quat_wxyz)
        mujoco.mju_rotVecQuat(position, data.xpos[self._body] - self._position, inverse)
        mujoco.mju_mulQuat(quat_wxyz, inverse, data.xquat[self._body])
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, self._body, velocity, 1)
        return Odometry(position, wxyz_to_xyzw(quat_wxyz), velocity[3:], velocity[:3])
