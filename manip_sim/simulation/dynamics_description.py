# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Properties of a joint besides the links that its torque depends on, and the limits of control.

A URDF has no place for most of it. With the links of ``robot_description`` it is everything
that a controller needs to compute the torques of the simulation.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
import math

import mujoco
import numpy as np

from manip_sim.control.controlled_joints import ControlledJoints
from manip_sim.models.actuators import declared_velocity, FrictionLaw


@dataclass(frozen=True)
class JointDynamics:
    """
    One joint, which obeys ``M(q) a + armature a + h(q, v) = effort - damping v - friction``.

    ``friction`` is up to :attr:`friction_loss` against the motion, and a spring pulls with
    ``stiffness (spring_position - q)``. Units are SI, with m and N for sliding joints. What
    depends on the velocity is described by ``manip_sim.models.friction_and_armature.FrictionLaw``.

    :ivar armature: inertia of the rotor reflected to the joint [kg m^2 or kg]
    :ivar damping: [N m s/rad or N s/m]
    :ivar friction_loss: dry friction [N m or N]
    :ivar static_friction: dry friction at rest [N m or N]; None if it is :attr:`friction_loss`
    :ivar stribeck_velocity: at which it is between both [rad/s or m/s]; None if there is none
    :ivar stiffness: of a spring [N m/rad or N/m]
    :ivar spring_position: where the spring is at rest [rad or m]
    :ivar position_range: lowest and highest [rad or m]; None if it is not limited
    :ivar velocity_limit: [rad/s or m/s]; None if there is none
    :ivar effort_range: lowest and highest, gravity compensation included [N m or N]; None if it is
        not limited at the joint
    :ivar acceleration_limit: of setpoints [rad/s^2 or m/s^2]; None for joints without a controller
    :ivar knee_velocity: up to which all of the effort range is there [rad/s or m/s]; None: always
    :ivar no_load_velocity: at which no effort is left [rad/s or m/s]; None: there always is
    """

    armature: float
    damping: float
    friction_loss: float
    static_friction: float | None
    stribeck_velocity: float | None
    stiffness: float
    spring_position: float
    position_range: tuple[float, float] | None
    velocity_limit: float | None
    effort_range: tuple[float, float] | None
    acceleration_limit: float | None
    knee_velocity: float | None
    no_load_velocity: float | None


def joint_dynamics(model: mujoco.MjModel, joints: ControlledJoints, names: Iterable[str],
                   laws: Mapping[str, FrictionLaw]) -> dict[str, JointDynamics]:
    """
    Return the dynamics of joints by name.

    :param model: the compiled ``mujoco.MjModel``
    :param joints: those that have a controller
    :param names: of hinge and slide joints
    :param laws: of joints whose friction or torque limit depends on the velocity
    """
    return {name: _of_joint(model, joints, name, laws.get(name)) for name in names}


def _of_joint(model: mujoco.MjModel, joints: ControlledJoints, name: str, law: FrictionLaw | None
              ) -> JointDynamics:
    joint = int(model.joint(name).id)
    dof = int(model.jnt_dofadr[joint])
    velocity = float(declared_velocity(model, joint))
    acceleration = None
    law = law or FrictionLaw()
    stribeck = _finite(law.stribeck_velocity)
    if name in joints.names:
        index = joints.find([name])
        velocity = float(joints.velocity_limits(index)[0])
        acceleration = float(joints.acceleration_limits(index)[0])
    return JointDynamics(
        armature=float(model.dof_armature[dof]),
        # Some releases of MuJoCo have polynomials here, whose first coefficient is linear.
        damping=float(np.reshape(model.dof_damping, (model.nv, -1))[dof, 0]),
        friction_loss=float(model.dof_frictionloss[dof]) if stribeck is None else law.coulomb,
        static_friction=None if stribeck is None else law.static, stribeck_velocity=stribeck,
        stiffness=float(np.reshape(model.jnt_stiffness, (model.njnt, -1))[joint, 0]),
        spring_position=float(model.qpos_spring[model.jnt_qposadr[joint]]),
        position_range=_range(model.jnt_limited[joint], model.jnt_range[joint]),
        velocity_limit=_finite(velocity),
        effort_range=_range(model.jnt_actfrclimited[joint], model.jnt_actfrcrange[joint]),
        acceleration_limit=acceleration, knee_velocity=_finite(law.knee),
        no_load_velocity=_finite(law.no_load))


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _range(limited: int, ends: Iterable[float]) -> tuple[float, float] | None:
    low, high = ends
    return (float(low), float(high)) if limited else None
