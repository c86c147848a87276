# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Rotations as roll, pitch and yaw, and numbers as text, without loss of precision."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray

#: Smaller numbers are zeros with the rounding error of a product of two rotations.
_NOTHING = 1e-16


def matrix_of(quat_wxyz: ArrayLike) -> FloatArray:
    """Return the rotation matrix of a quaternion w, x, y, z of unit length, shape (3, 3)."""
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(quat_wxyz, dtype=float))
    return matrix.reshape(3, 3)


def rpy_of(rotation: FloatArray) -> FloatArray:
    """
    Return roll, pitch and yaw about fixed axes [rad], shape (3,).

    Pitch and roll are those of the matrix after undoing the yaw, so that the three together are
    still exact where the pitch is 90 degrees, and roll and yaw are about one axis.

    :param rotation: matrix, shape (3, 3)
    """
    r = rotation
    yaw = math.atan2(r[1, 0], r[0, 0])
    c, s = math.cos(yaw), math.sin(yaw)
    pitch = math.atan2(-r[2, 0], c * r[0, 0] + s * r[1, 0])
    roll = math.atan2(s * r[0, 2] - c * r[1, 2], c * r[1, 1] - s * r[0, 1])
    return np.array([roll, pitch, yaw])


def text_of(values: ArrayLike) -> str:
    """Return numbers as the shortest text of the same doubles; less than 1e-16 becomes 0."""
    if isinstance(values, float):
        return _shortest(float(values))
    return ' '.join(map(_shortest, np.asarray(values, dtype=float).reshape(-1).tolist()))


def _shortest(number: float) -> str:
    if abs(number) < _NOTHING:
        return '0'
    return str(int(number)) if number.is_integer() and abs(number) < 1e15 else repr(number)
