# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""How hard joints may accelerate after a jump of the goal: as declared, or as inertia allows."""

from __future__ import annotations

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray, IntArray

#: Share of the torque beyond weight and damping that a jump of the goal may use.
_TORQUE_SHARE = 0.6
#: Shortest time in which a step reaches the velocity limit, of joints or of an end effector [s].
SPEED_UP_S = 0.1
#: Number of poses in which the inertia is computed, and the share of them that may be heavier.
_POSES = 64
_QUANTILE = 0.15


def acceleration_limits(model: mujoco.MjModel, data: mujoco.MjData, joint_ids: IntArray,
                        torque: FloatArray, drag: FloatArray, velocity_limit: FloatArray,
                        position_clamp: FloatArray) -> FloatArray:
    """
    Return the acceleration limits of joints: declared in the model, or derived.

    :param data: at the start; joints that are not named keep their positions
    :param joint_ids: of the joints, shape (n,)
    :param torque: greatest effort of each joint [N m or N], shape (n,)
    :param drag: effort that its own damping takes up at speed [N m or N], shape (n,)
    :param velocity_limit: [rad/s or m/s], shape (n,)
    :param position_clamp: lowest and highest position [rad or m], shape (n, 2)
    :returns: [rad/s^2 or m/s^2], shape (n,)
    """
    if model.nuser_jnt > 1:
        declared = model.jnt_user[joint_ids, 1]
    else:
        declared = np.zeros(len(joint_ids))
    if (declared > 0.0).all():
        return np.array(declared)
    qpos, dofs, kind = (field[joint_ids] for field in (
        model.jnt_qposadr, model.jnt_dofadr, model.jnt_type))
    carries = model.jnt_actgravcomp[joint_ids]
    random = np.random.default_rng(0)
    scratch = mujoco.MjData(model)
    low, high = np.clip(position_clamp, -np.pi, np.pi).T
    possible = []
    for pose in range(_POSES):
        scratch.qpos[:] = data.qpos
        if pose:
            scratch.qpos[qpos] = random.uniform(low, high)
        _compute_inertia_and_weight(model, scratch)
        # All joints of a kind may accelerate at once.
        coupled = (_inertia(model, scratch, dofs) * (kind[:, None] == kind)).sum(axis=1)
        weight = np.abs(scratch.qfrc_gravcomp[dofs]) * carries
        possible.append(np.maximum(torque - weight - drag, 0.2 * torque) / coupled)
    usual = np.quantile(possible, _QUANTILE, axis=0)
    derived = np.minimum(_TORQUE_SHARE * usual, velocity_limit / SPEED_UP_S)
    return np.asarray(np.where(declared > 0.0, declared, derived))


def _inertia(model: mujoco.MjModel, data: mujoco.MjData, dofs: IntArray) -> FloatArray:
    """Return the magnitudes of the joints' block of the inertia matrix, shape (n, n)."""
    inertia = np.zeros((model.nv, model.nv))
    rows, columns = np.repeat(np.arange(model.nv), model.M_rownnz), model.M_colind
    inertia[rows, columns] = inertia[columns, rows] = np.abs(data.M)
    return inertia[np.ix_(dofs, dofs)]


def _compute_inertia_and_weight(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Compute of ``mj_forward`` only the inertia matrix and ``qfrc_gravcomp``."""
    for compute in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_tendon, mujoco.mj_makeM,
                    mujoco.mj_passive):
        compute(model, data)
