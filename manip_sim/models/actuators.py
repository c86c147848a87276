# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Actuators of joints: kinds, gains, limits, and the dependence of friction on the velocity.

A position servo with integrator dynamics follows its activation instead of its control: ``act`` is
the setpoint and ``ctrl`` the velocity of the setpoint, which MuJoCo integrates in each step.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
import math
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.errors import ModelError

#: Types of joints with one degree of freedom.
SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
#: Types of transmissions to one joint.
JOINT_TRANSMISSIONS = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
#: Lag of a position servo whose gains are derived [s]: damping over stiffness.
_LAG_S = 0.013
#: Velocity limit of a joint that declares none [rad/s or m/s].
_DEFAULT_VELOCITY = np.pi


def is_position_servo(actuator: Any) -> bool:
    """
    Return whether an actuator pulls its transmission towards a length that the control sets.

    :param actuator: of a ``mujoco.MjSpec``
    """
    return bool(int(actuator.gaintype) == int(mujoco.mjtGain.mjGAIN_FIXED)
                and int(actuator.biastype) == int(mujoco.mjtBias.mjBIAS_AFFINE)
                and actuator.gainprm[0] > 0.0 and actuator.biasprm[1] < 0.0)


def position_servos(model: mujoco.MjModel, actuators: ArrayLike) -> BoolArray:
    """
    Return which actuators of a compiled model are position servos, as :func:`is_position_servo`.

    :param actuators: their ids, of any shape
    :returns: of that shape
    """
    ids = np.asarray(actuators, dtype=int)
    return np.asarray((model.actuator_gaintype[ids] == int(mujoco.mjtGain.mjGAIN_FIXED))
                      & (model.actuator_biastype[ids] == int(mujoco.mjtBias.mjBIAS_AFFINE))
                      & (model.actuator_gainprm[ids, 0] > 0.0)
                      & (model.actuator_biasprm[ids, 1] < 0.0))


def position_servos_without_dynamics(spec: mujoco.MjSpec, names: Iterable[str]) -> list[str]:
    """Return the names of the position servos without activation dynamics."""
    none = int(mujoco.mjtDyn.mjDYN_NONE)
    return [name for name in names if is_position_servo(spec.actuator(name))
            and int(spec.actuator(name).dyntype) == none]


def add_setpoint_activation(spec: mujoco.MjSpec, names: Iterable[str]) -> None:
    """
    Give actuators an activation that holds their setpoint.

    The control range becomes the activation range too, which is not enforced. If it is inherited
    from a joint, MuJoCo's compiler fills in the activation range.

    :param spec: the ``mujoco.MjSpec``, changed in place
    :raises ModelError: if a plugin computes the force of one of them
    """
    for name in names:
        actuator = spec.actuator(name)
        if actuator.plugin.active:
            raise ModelError(f"the force of actuator '{name}' comes from a plugin, so its joint "
                             'cannot have control modes: make it a motor or a servo')
        if not actuator.inheritrange:
            actuator.actrange = actuator.ctrlrange.copy()
        if is_position_servo(actuator):
            actuator.ctrllimited = 0  # The range is one of positions, not of velocities.
        actuator.dyntype = mujoco.mjtDyn.mjDYN_INTEGRATOR
        actuator.dynprm[0] = 1.0
        actuator.actlimited = 0


def check_single(actuators: Sequence[str], joints: Sequence[str]) -> None:
    """
    Check that each joint has only one actuator.

    :param joints: the joint that each of the actuators drives
    :raises ModelError: naming the joint and two of its actuators
    """
    driver: dict[str, str] = {}
    for actuator, joint in zip(actuators, joints):
        if joint in driver:
            raise ModelError(f"joint '{joint}' is driven by two actuators, '{driver[joint]}' and "
                             f"'{actuator}': give it one")
        driver[joint] = actuator


def check_kinds(model: mujoco.MjModel, actuators: Sequence[str]) -> None:
    """
    Check that actuators can be made servos.

    :raises ModelError: naming one that is neither motor nor servo
    """
    biases = [int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE)]
    for name in actuators:
        index = model.actuator(name).id
        if (int(model.actuator_gaintype[index]) != int(mujoco.mjtGain.mjGAIN_FIXED)
                or int(model.actuator_biastype[index]) not in biases):
            raise ModelError(f"actuator '{name}' must be a motor, or a position or velocity servo:"
                             ' its gain must be fixed and its bias none or affine')


def stiffness_and_damping(model: mujoco.MjModel, ids: IntArray, dofs: IntArray
                          ) -> tuple[FloatArray, FloatArray]:
    """
    Return the gains of actuators as servos, from the model, or derived from the inertia.

    :param ids: of the actuators
    :param dofs: of the joints that they drive
    :returns: kp and kv at the actuators, each of shape (n,)
    """
    kp = -model.actuator_biasprm[ids, 1].copy()
    kv = -model.actuator_biasprm[ids, 2].copy()
    affine = model.actuator_biastype[ids] == int(mujoco.mjtBias.mjBIAS_AFFINE)
    position_servo = position_servos(model, ids)
    velocity_servo = affine & (kp == 0.0) & (kv > 0.0)
    # The inertia of the joint as the actuator sees it through its gear.
    inertia = model.dof_M0[dofs] / model.actuator_gear[ids, 0]**2
    # Critical damping, kv = 2 sqrt(kp M), with the lag wanted, kv / kp, or the kv of the model.
    derived_kp = 4.0 * inertia / _LAG_S**2
    damped_kp = np.minimum(kv**2 / (4.0 * inertia), derived_kp)
    kp = np.where(position_servo, kp, np.where(velocity_servo, damped_kp, derived_kp))
    kv = np.where((position_servo | velocity_servo) & (kv > 0.0), kv,
                  2.0 * np.sqrt(np.maximum(kp * inertia, 0.0)))
    return kp, kv


def velocity_limit(model: mujoco.MjModel, joint_ids: IntArray, ids: IntArray) -> FloatArray:
    """Return velocity limits [rad/s or m/s], (n,): declared, of a velocity servo, or a default."""
    limit = np.minimum(declared_velocity(model, joint_ids), velocity_of_servos(model, ids))
    return np.where(np.isfinite(limit), limit, _DEFAULT_VELOCITY)


def effort_range(model: mujoco.MjModel, joint_ids: IntArray, ids: IntArray) -> FloatArray:
    """Return the effort range of joints [N m or N], infinite without a limit, shape (n, 2)."""
    gear = model.actuator_gear[ids, :1]
    motor = (model.actuator_biasprm[ids, 1:3] == 0.0).all(axis=1)
    gain = np.where(motor, model.actuator_gainprm[ids, 0], 0.0)[:, None]
    motor_limited = motor & (model.actuator_ctrllimited[ids] != 0)
    ranges = [
        np.where(model.actuator_forcelimited[ids, None] != 0,
                 model.actuator_forcerange[ids] * gear, (-np.inf, np.inf)),
        np.where(model.jnt_actfrclimited[joint_ids, None] != 0,
                 model.jnt_actfrcrange[joint_ids], (-np.inf, np.inf)),
        np.where(motor_limited[:, None], model.actuator_ctrlrange[ids] * gain * gear,
                 (-np.inf, np.inf))]
    # A negative gear reverses a range.
    ordered = np.sort(np.stack(ranges), axis=2)
    return np.stack([ordered[..., 0].max(axis=0), ordered[..., 1].min(axis=0)], axis=1)


@dataclass(frozen=True)
class FrictionLaw:
    """
    Dependence of friction and torque limit of a joint on its velocity; none if infinite.

    Friction is ``coulomb + (static - coulomb) / (1 + (v / stribeck_velocity)^2)`` (D. P. Hess and
    A. Soom, Journal of Tribology 112(1), 1990). The torque limit in the direction of motion falls
    linearly from all of it at ``knee`` to nothing at ``no_load``.

    :ivar coulomb: dry friction at speed [N m or N]
    :ivar static: dry friction at rest [N m or N]
    :ivar stribeck_velocity: at which half of the difference is left [rad/s or m/s]
    :ivar knee: [rad/s or m/s]
    :ivar no_load: [rad/s or m/s]
    """

    coulomb: float = 0.0
    static: float = 0.0
    stribeck_velocity: float = math.inf
    knee: float = math.inf
    no_load: float = math.inf

    @property
    def acts(self) -> bool:
        """True if anything depends on the velocity."""
        return math.isfinite(self.stribeck_velocity) or math.isfinite(self.no_load)


def declared_velocity(model: mujoco.MjModel, joints: ArrayLike) -> FloatArray:
    """
    Return the velocity limits of joints, from ``user[0]``, infinite where none is declared.

    :param joints: ids of joints, of any shape
    :returns: limits [rad/s or m/s], of that shape
    """
    joints = np.asarray(joints, dtype=int)
    if not model.nuser_jnt:
        return np.full(joints.shape, np.inf)
    declared = model.jnt_user[joints, 0]
    return np.where(declared > 0.0, declared, np.inf)


def velocity_of_servos(model: mujoco.MjModel, actuators: ArrayLike) -> FloatArray:
    """
    Return the highest velocities that velocity servos take, infinite for other actuators.

    :param actuators: their ids, of any shape
    :returns: at the joints [rad/s or m/s], of that shape
    """
    ids = np.asarray(actuators, dtype=int)
    limited = ((model.actuator_biasprm[ids, 1] == 0.0) & (model.actuator_biasprm[ids, 2] < 0.0)
               & (model.actuator_ctrllimited[ids] != 0))
    highest = np.abs(model.actuator_ctrlrange[ids]).min(axis=-1)
    return np.where(limited, highest / np.abs(model.actuator_gear[ids, 0]), np.inf)
