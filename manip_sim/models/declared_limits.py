# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Limits that MJCF has no attribute for and that a model keeps in ``user`` of its joints."""

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
