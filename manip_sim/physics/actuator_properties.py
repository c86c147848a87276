# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Properties of the actuators of joints in a model: kinds, gains, limits."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.errors import ModelError
from manip_sim.models.couplings import declared_velocity, velocity_of_servos
from manip_sim.models.setpoint_activation import position_servos

#: Lag of a position servo whose gains are derived [s]: damping over stiffness.
_LAG_S = 0.013
#: Velocity limit of a joint that declares none [rad/s or m/s].
_DEFAULT_VELOCITY = np.pi


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
