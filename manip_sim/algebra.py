# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Products of small matrices and vectors, and rotations, with the same bits on every processor.

NumPy's ``@``, ``dot`` and ``linalg`` leave products to a BLAS, whose sums differ with the
processor. This is the one place that converts rotations: MuJoCo's quaternions (w, x, y, z) to and
from ROS's (x, y, z, w), matrices, rotation vectors, and roll, pitch and yaw.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray

#: Places of x, y, z and w in a quaternion of MuJoCo.
XYZW = [1, 2, 3, 0]
#: As w, x, y, z.
NO_TURN = (1.0, 0.0, 0.0, 0.0)


def product(left: FloatArray, right: FloatArray) -> FloatArray:
    """
    Return the product of two matrices, or of a matrix and a vector.

    :param left: shape (m, k)
    :param right: shape (k, n) or (k,)
    :returns: shape (m, n) or (m,)
    """
    if right.ndim == 1:
        result = np.empty(len(left))
        mujoco.mju_mulMatVec(result, left, right)
    else:
        result = np.empty((len(left), right.shape[1]))
        mujoco.mju_mulMatMat(result, left, right)
    return result


def transposed_product(left: FloatArray, right: FloatArray) -> FloatArray:
    """
    Return the product of a transposed matrix and another one, or a vector.

    :param left: shape (k, m)
    :param right: shape (k, n) or (k,)
    :returns: shape (m, n) or (m,)
    """
    if right.ndim == 1:
        result = np.empty(left.shape[1])
        mujoco.mju_mulMatTVec(result, left, right)
    else:
        result = np.empty((left.shape[1], right.shape[1]))
        mujoco.mju_mulMatTMat(result, left, right)
    return result


def length(vector: FloatArray) -> float:
    """Return the Euclidean norm of a vector."""
    return float(mujoco.mju_norm(vector))


def wxyz_to_xyzw(quat_wxyz: ArrayLike) -> FloatArray:
    """Reorder a quaternion from MuJoCo's order to ROS's, shape (4,), a copy."""
    return np.asarray(quat_wxyz, dtype=float)[XYZW]


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


def matrix_of(quat_wxyz: ArrayLike) -> FloatArray:
    """Return the rotation matrix of a quaternion w, x, y, z of unit length, shape (3, 3)."""
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(quat_wxyz, dtype=float))
    return matrix.reshape(3, 3)


def rpy_of(rotation: FloatArray) -> FloatArray:
    """
    Return roll, pitch and yaw about fixed axes [rad], shape (3,).

    Pitch and roll are taken from the matrix after undoing the yaw, so that the three together are
    still exact where the pitch is 90 degrees, and roll and yaw are about one axis.

    :param rotation: matrix, shape (3, 3)
    """
    r = rotation
    yaw = math.atan2(r[1, 0], r[0, 0])
    c, s = math.cos(yaw), math.sin(yaw)
    pitch = math.atan2(-r[2, 0], c * r[0, 0] + s * r[1, 0])
    roll = math.atan2(s * r[0, 2] - c * r[1, 2], c * r[1, 1] - s * r[0, 1])
    return np.array([roll, pitch, yaw])


def rotation_vector(rotation: FloatArray) -> FloatArray:
    """Return the rotation vector of a rotation matrix [rad], shape (3,)."""
    quat_wxyz, vector = np.empty(4), np.empty(3)
    mujoco.mju_mat2Quat(quat_wxyz, np.ascontiguousarray(rotation).reshape(9))
    mujoco.mju_quat2Vel(vector, quat_wxyz, 1.0)
    return vector
