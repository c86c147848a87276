# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The parts of a robot with their addresses in the model, and readers of its end effectors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.frame_names import FrameNames
from manip_sim.models.actuators import SCALAR
from manip_sim.models.bases import MobileBaseModel
from manip_sim.models.grippers import GripperModel
from manip_sim.models.robots import ManipulatorModel, RobotModel
from manip_sim.models.robots.robot_model import driven_joint, SUBSYSTEMS
from manip_sim.physics.external_wrench import ExternalWrench
from manip_sim.physics.physics import Physics
from manip_sim.physics.poses_and_twists import Pose, Twist

_SITE = int(mujoco.mjtObj.mjOBJ_SITE)
#: Quantities that can be read of a gripper.
READINGS = ('pose', 'twist', 'wrench', 'external_wrench')


@dataclass(frozen=True, eq=False)
class Part:
    """
    A subsystem, one of its arms or a gripper: names in the model's order, and addresses.

    :ivar name: ``arm``, ``base``, ``torso``, ``head``, ``legs``, ``right``, ``left`` or
        ``<arm>/gripper``
    :ivar atomic: names of the parts that it consists of, which do not overlap; mostly its own
    :ivar joints: scalar joints
    :ivar actuators: all actuators
    :ivar qpos_addresses: of the joints in ``qpos``, shape (n_joints,)
    :ivar dof_addresses: of the joints in ``qvel``, shape (n_joints,)
    :ivar actuator_ids: of the actuators in ``ctrl``, shape (n_actuators,)
    :ivar driven_joints: the joint that each actuator drives, or None
    :ivar gripper: the gripper's model if the part is a gripper, with a state of its own, or None
    :ivar sideways: whether twists may move the part along y, if it is a mobile base
    """

    name: str
    atomic: tuple[str, ...]
    joints: tuple[str, ...]
    actuators: tuple[str, ...]
    qpos_addresses: IntArray
    dof_addresses: IntArray
    actuator_ids: IntArray
    driven_joints: tuple[str | None, ...]
    gripper: GripperModel | None = None
    sideways: bool = True


def find_parts(model: mujoco.MjModel, robot: RobotModel) -> dict[str, Part]:
    """
    Return the parts that a robot has: its subsystems, its arms, its grippers.

    The only arm is also the part ``right``; two arms are ``right`` and ``left``, and ``arm`` is
    both.

    :param model: the compiled ``mujoco.MjModel``
    """
    parts: dict[str, Part] = {}
    for subsystem in SUBSYSTEMS:
        joints, actuators = robot.joints_of(subsystem), robot.actuators_of(subsystem)
        if not (joints or actuators):
            continue
        if subsystem == 'arm' and isinstance(robot, ManipulatorModel):
            parts.update(_arms(model, robot, joints, actuators))
        else:
            parts[subsystem] = _part(model, subsystem, joints, actuators)
    if 'base' in parts and isinstance(robot.base, MobileBaseModel):
        parts['base'] = replace(parts['base'], sideways=robot.base.sideways)
    if isinstance(robot, ManipulatorModel):
        for arm, gripper in robot.grippers.items():
            name = f'{arm}/gripper'
            # Another simulation of the same robot must not change the state of its commands.
            parts[name] = _part(model, name, gripper.joints, gripper.actuators,
                                gripper=gripper.with_own_state())
    return parts


def atomic_parts(parts: Mapping[str, Part]) -> list[Part]:
    """Return the parts that do not overlap."""
    return [part for name, part in parts.items() if part.atomic == (name,)]


def find_places(model: mujoco.MjModel, parts: Iterable[Part]) -> None:
    """
    Find the addresses of parts in another model, in which they are the same.

    :param model: the compiled ``mujoco.MjModel``
    :param parts: whose arrays of addresses are changed in place
    """
    for part in parts:
        ids = [model.joint(joint).id for joint in part.joints]
        part.qpos_addresses[:] = model.jnt_qposadr[ids]
        part.dof_addresses[:] = model.jnt_dofadr[ids]
        part.actuator_ids[:] = [model.actuator(actuator).id for actuator in part.actuators]


def _arms(model: mujoco.MjModel, robot: ManipulatorModel, joints: list[str], actuators: list[str]
          ) -> dict[str, Part]:
    if len(robot.arms) == 1:
        return {'arm': _part(model, 'arm', joints, actuators),
                robot.arms[0]: _part(model, robot.arms[0], joints, actuators, ('arm',))}
    arms = {'arm': _part(model, 'arm', joints, actuators, robot.arms)}
    arm_of = {joint: _arm_of(model, robot, joint) for joint in joints}
    driven = dict(zip(arms['arm'].actuators, arms['arm'].driven_joints))
    for arm in robot.arms:
        arms[arm] = _part(model, arm, [j for j in joints if arm_of[j] == arm],
                          [a for a in actuators if arm_of.get(driven[a] or '', 'right') == arm])
    return arms


def _arm_of(model: mujoco.MjModel, robot: ManipulatorModel, joint: str) -> str:
    """Return the arm that a joint moves; what moves both or none belongs to the first one."""
    mover = int(model.joint(joint).bodyid[0])
    moved = []
    for arm, eef in robot.eef_name.items():
        body = model.body(eef).id
        while body not in (0, mover):
            body = int(model.body_parentid[body])
        if body == mover:
            moved.append(arm)
    return moved[0] if len(moved) == 1 else robot.arms[0]


def _part(model: mujoco.MjModel, name: str, joints: list[str], actuators: list[str],
          atomic: tuple[str, ...] = (), gripper: GripperModel | None = None) -> Part:
    scalar = [joint for joint in joints if int(model.joint(joint).type[0]) in SCALAR]
    ids = np.array([model.joint(joint).id for joint in scalar], dtype=np.int64)
    actuator_ids = np.array([model.actuator(a).id for a in actuators], dtype=np.int64)
    driven = tuple(driven_joint(model, int(a)) for a in actuator_ids)
    return Part(
        name=name, atomic=atomic or (name,), joints=tuple(scalar), actuators=tuple(actuators),
        qpos_addresses=model.jnt_qposadr[ids].astype(np.int64),
        dof_addresses=model.jnt_dofadr[ids].astype(np.int64),
        actuator_ids=actuator_ids, driven_joints=driven, gripper=gripper)


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
        pose = np.empty(7)
        mujoco.mju_mat2Quat(pose[2:6], data.site_xmat[self._grip_site])
        pose[6] = pose[2]  # MuJoCo has w first.
        pose[:3] = data.site_xpos[self._grip_site]
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
