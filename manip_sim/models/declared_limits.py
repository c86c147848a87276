# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Velocity limits of joints: MJCF has no attribute for them."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray


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
