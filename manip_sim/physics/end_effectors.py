# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Read a gripper's force/torque sensor, its pose and twist, and the external wrench."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.frame_names import FrameNames
from manip_sim.models.grippers import GripperModel
from manip_sim.physics.external_wrench import ExternalWrench
from manip_sim.physics.physics import Physics
from manip_sim.physics.poses_and_twists import Pose, Twist

_SITE = int(mujoco.mjtObj.mjOBJ_SITE)
#: Quantities that can be read of a gripper.
READINGS = ('pose', 'twist', 'wrench', 'external_wrench')


@dataclass(frozen=True)
class Wrench:
    """
    A force and a torque in one frame.

    :ivar force: [N], shape (3,)
    :ivar torque: about the frame's origin [N m], shape (3,)
    """

    force: FloatArray
    torque: FloatArray


@dataclass(frozen=True)
class EndEffector:
    """
    A gripper as seen from the world and from its force/torque sensor.

    :ivar pose: of ``grip_site``
    :ivar twist: of ``grip_site``
    :ivar wrench: what ``force_ee`` and ``torque_ee`` measure, in ``ft_frame``
    :ivar external_wrench: what the world exerts on the tool, the mean over the last control
        period, filtered and tared, in ``ft_frame``
    """

    pose: Pose
    twist: Twist
    wrench: Wrench
    external_wrench: Wrench


class EndEffectorReader:
    """
    A reader of one gripper.

    :param physics: of the world
    :param gripper: a gripper of the model
    :ivar external: what the world exerts on the tool
    """

    def __init__(self, physics: Physics, gripper: GripperModel) -> None:
        self._physics = physics
        sensors, sites = gripper.important_sensors, gripper.important_sites
        self._names = sensors['force_ee'], sensors['torque_ee'], sites['grip_site']
        physics.on_change(self._find)
        self.external = ExternalWrench(physics, sensors['force_ee'])

    def _find(self) -> None:
        model = self._physics.model
        force, torque, grip_site = self._names
        self._sensors = np.concatenate([
            model.sensor(name).adr[0] + np.arange(3) for name in (force, torque)])
        self._ft_frame = int(model.sensor(force).objid[0])
        self._grip_site = model.site(grip_site).id

    @property
    def wrench_frame(self) -> str:
        """Name of the frame of the wrenches, among the frames of bodies and cameras."""
        return FrameNames(self._physics.model).sites[self._ft_frame]

    @property
    def ft_frame(self) -> str:
        """Name of the site of the wrenches."""
        name: str = self._physics.model.site(self._ft_frame).name
        return name

    @property
    def grip_site(self) -> str:
        """Name of the frame of the poses and twists."""
        name: str = self._physics.model.site(self._grip_site).name
        return name

    def read(self, data: mujoco.MjData) -> EndEffector:
        """
        Return the gripper's state at the instant of the last ``mj_forward``, exactly.

        :param data: the ``mujoco.MjData``
        """
        return end_effector(*(getattr(self, name)(data) for name in READINGS))

    def position(self, data: mujoco.MjData) -> FloatArray:
        """
        Return the position of ``grip_site`` in ``world``.

        :param data: the ``mujoco.MjData``
        :returns: [m], shape (3,), a copy
        """
        return np.array(data.site_xpos[self._grip_site])

    def pose(self, data: mujoco.MjData) -> FloatArray:
        """
        Return the pose of ``grip_site`` in ``world``.

        :param data: the ``mujoco.MjData``
        :returns: position [m] and quaternion x, y, z, w, shape (7,)
        """
        pose, quat_wxyz = np.empty(7), np.empty(4)
        mujoco.mju_mat2Quat(quat_wxyz, data.site_xmat[self._grip_site])
        pose[:3] = data.site_xpos[self._grip_site]
        pose[3:6], pose[6] = quat_wxyz[1:], quat_wxyz[0]
        return pose

    def twist(self, data: mujoco.MjData) -> FloatArray:
        """
        Return the twist of ``grip_site``, in the axes of ``world``.

        :param data: the ``mujoco.MjData``
        :returns: linear [m/s] and angular velocity [rad/s], shape (6,)
        """
        twist, velocity = np.empty(6), np.empty(6)
        mujoco.mj_objectVelocity(self._physics.model, data, _SITE, self._grip_site, velocity, 0)
        twist[:3], twist[3:] = velocity[3:], velocity[:3]
        return twist

    def wrench(self, data: mujoco.MjData) -> FloatArray:
        """
        Return what ``force_ee`` and ``torque_ee`` measure, in ``ft_frame``.

        :param data: the ``mujoco.MjData``
        :returns: force [N] and torque [N m], shape (6,), a copy
        """
        measured: FloatArray = data.sensordata[self._sensors]
        return measured

    def external_wrench(self, data: mujoco.MjData) -> FloatArray:
        """
        Return what the world exerts on the tool, the mean over the last control period.

        :param data: the ``mujoco.MjData``
        :returns: force [N] and torque [N m], filtered and tared, in ``ft_frame``, shape (6,)
        """
        return self.external.read(data)


def end_effector(pose: FloatArray, twist: FloatArray, wrench: FloatArray, external: FloatArray
                 ) -> EndEffector:
    """Return the state of a gripper, from its :data:`READINGS` as :class:`EndEffectorReader`'s."""
    return EndEffector(
        pose=Pose(pose[:3], pose[3:]), twist=Twist(twist[:3], twist[3:]),
        wrench=Wrench(wrench[:3], wrench[3:]),
        external_wrench=Wrench(external[:3], external[3:]))
