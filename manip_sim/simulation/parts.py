# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The parts of a robot that are seen and commanded apart, with their addresses in the model."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from manip_sim.models.grippers import GripperModel
from manip_sim.models.robots import ManipulatorModel, RobotModel
from manip_sim.models.robots.robot_model import SUBSYSTEMS
from manip_sim.typing import IntArray

_JOINT_TRANSMISSIONS = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


@dataclass(frozen=True)
class Part:
    """
    A subsystem or a gripper: names in the model's order, addresses resolved once.

    :ivar name: ``arm``, ``base``, ``torso``, ``head``, ``legs`` or ``<arm>/gripper``
    :ivar joints: scalar joints
    :ivar actuators: all actuators
    :ivar qpos_addresses: of the joints in ``qpos``, shape (n_joints,)
    :ivar dof_addresses: of the joints in ``qvel``, shape (n_joints,)
    :ivar actuator_ids: of the actuators in ``ctrl``, shape (n_actuators,)
    :ivar driven_joints: the joint that each actuator drives, or None
    :ivar gripper: the gripper's model, where the part is one
    """

    name: str
    joints: tuple[str, ...]
    actuators: tuple[str, ...]
    qpos_addresses: IntArray
    dof_addresses: IntArray
    actuator_ids: IntArray
    driven_joints: tuple[str | None, ...]
    gripper: GripperModel | None = None


def find_parts(model: Any, robot: RobotModel) -> Iterator[Part]:
    """
    Yield the parts that a robot has: its subsystems, then its grippers.

    :param model: the compiled ``mujoco.MjModel``
    """
    for subsystem in SUBSYSTEMS:
        joints, actuators = robot.joints_of(subsystem), robot.actuators_of(subsystem)
        if joints or actuators:
            yield _part(model, subsystem, joints, actuators)
    if isinstance(robot, ManipulatorModel):
        for arm, gripper in robot.grippers.items():
            yield _part(model, f'{arm}/gripper', gripper.joints, gripper.actuators, gripper)


def _part(model: Any, name: str, joints: list[str], actuators: list[str],
          gripper: GripperModel | None = None) -> Part:
    scalar = [joint for joint in joints if int(model.joint(joint).type[0]) in _SCALAR]
    ids = np.array([model.joint(joint).id for joint in scalar], dtype=np.int64)
    actuator_ids = np.array([model.actuator(a).id for a in actuators], dtype=np.int64)
    return Part(
        name=name, joints=tuple(scalar), actuators=tuple(actuators),
        qpos_addresses=model.jnt_qposadr[ids].astype(np.int64),
        dof_addresses=model.jnt_dofadr[ids].astype(np.int64),
        actuator_ids=actuator_ids,
        driven_joints=tuple(_driven_joint(model, int(a)) for a in actuator_ids),
        gripper=gripper)


def _driven_joint(model: Any, actuator: int) -> str | None:
    if int(model.actuator_trntype[actuator]) not in _JOINT_TRANSMISSIONS:
        return None
    name: str = model.joint(int(model.actuator_trnid[actuator, 0])).name
    return name
