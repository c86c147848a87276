# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The one place that converts between MuJoCo's quaternions (w, x, y, z) and ROS's (x, y, z, w)."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray

#: As w, x, y, z.
NO_TURN = (1.0, 0.0, 0.0, 0.0)


def wxyz_to_xyzw(quat_wxyz: ArrayLike) -> FloatArray:
    """Reorder a quaternion from MuJoCo's order to ROS's, shape (4,), a copy."""
    return np.asarray(quat_wxyz, dtype=float)[[1, 2, 3, 0]]


def xyzw_to_wxyz(quat_xyzw: ArrayLike) -> FloatArray:
    """Reorder a quaternion from ROS's order to MuJoCo's, shape (4,), a copy."""
    return np.asarray(quat_xyzw, dtype=float)[[3, 0, 1, 2]]


def quat_wxyz_from_rpy(rpy: ArrayLike) -> FloatArray:
    """
    Convert roll, pitch and yaw about fixed axes, as in REP 103, to a quaternion.

    :param rpy: roll, pitch, yaw [rad], shape (3,)
    :returns: w, x, y, z, shape (4,)
    """
    quat_wxyz = np.empty(4)
    mujoco.mju_euler2Quat(quat_wxyz, np.asarray(rpy, dtype=float), 'XYZ')
    return quat_wxyz


def relative_quat_wxyz(quat_parent: ArrayLike, quat_child: ArrayLike) -> FloatArray:
    """
    Return the rotation of a child frame in its parent's, given both in one frame.

    :param quat_parent: w, x, y, z, shape (4,)
    :param quat_child: w, x, y, z, shape (4,)
    :returns: w, x, y, z with unit norm and w >= 0, shape (4,)
    """
    inverse, relative = np.empty(4), np.empty(4)
    mujoco.mju_negQuat(inverse, np.asarray(quat_parent, dtype=float))
    mujoco.mju_mulQuat(relative, inverse, np.asarray(quat_child, dtype=float))
    mujoco.mju_normalize4(relative)
    return relative if relative[0] >= 0.0 else -relative
