# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The chains of a robot's arms, and the frames that Cartesian commands may refer to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco

from manip_sim.arrays import IntArray
from manip_sim.models.robots import RobotModel
from manip_sim.physics.end_effectors import EndEffectorReader
from manip_sim.physics.parts import Part
from manip_sim.physics.robot_frames import Frame, RobotFrames


@dataclass(frozen=True, eq=False)
class KinematicChain:
    """
    The joints of an arm between two frames, from the mount to the end effector.

    :ivar tip: the end effector, ``grip_site``
    :ivar origin: site ``<arm>_center``, or else the body that the arm is mounted on
    :ivar qpos: addresses of the arm's joints in ``qpos``, shape (n,)
    """

    tip: Frame
    origin: Frame
    qpos: IntArray


def find_chains(model: mujoco.MjModel, robot: RobotModel, parts: Mapping[str, Part],
                end_effectors: Mapping[str, EndEffectorReader]) -> dict[str, KinematicChain]:
    """
    Return the chains of a robot's arms that have a gripper and driven joints, by arm.

    :param model: the compiled ``mujoco.MjModel``
    :param parts: of the robot, by name
    :param end_effectors: readers of the grippers, by arm
    """
    chains = {}
    for arm, reader in end_effectors.items():
        joints = [j for j in parts[arm].driven_joints if j] if arm in parts else []
        if not joints:
            continue
        tip = model.site(reader.grip_site)
        body = int(model.body_parentid[int(model.joint(joints[0]).bodyid[0])])
        center = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE,
                                   f'{robot.naming_prefix}{arm}_center')
        origin = Frame(model.body(body).name, body)
        if center >= 0:
            origin = Frame(model.site(center).name, int(model.site_bodyid[center]), center)
        chains[arm] = KinematicChain(Frame(tip.name, int(tip.bodyid[0]), int(tip.id)), origin,
                                     parts[arm].qpos_addresses)
    return chains


def find_frames(model: mujoco.MjModel, robot: RobotModel,
                end_effectors: Mapping[str, EndEffectorReader]) -> RobotFrames:
    """
    Return the links of a robot and of its mounted parts, and the sites of its grippers.

    :param model: the compiled ``mujoco.MjModel``
    :param end_effectors: readers of the grippers, by arm
    """
    bodies = [*robot.bodies, *(body for part in robot.models for body in part.bodies)]
    return RobotFrames(model, bodies, [site for reader in end_effectors.values()
                                       for site in (reader.grip_site, reader.ft_frame)])
