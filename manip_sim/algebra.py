# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Products of small matrices and vectors, with the same bits on every processor.

NumPy's ``@``, ``dot`` and ``linalg`` leave them to a BLAS, whose sums differ with the processor.
"""

from __future__ import annotations

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray


def product(one: FloatArray, other: FloatArray) -> FloatArray:
    """
    Return the product of two matrices, or of a matrix and a vector.

    :param one: shape (m, k)
    :param other: shape (k, n) or (k,)
    :returns: shape (m, n) or (m,)
    """
    if other.ndim == 1:
        result = np.empty(len(one))
        mujoco.mju_mulMatVec(result, one, other)
    else:
        result = np.empty((len(one), other.shape[1]))
        mujoco.mju_mulMatMat(result, one, other)
    return result


def transposed_product(one: FloatArray, other: FloatArray) -> FloatArray:
    """
    Return the product of a transposed matrix and another one, or a vector.

    :param one: shape (k, m)
    :param other: shape (k, n) or (k,)
    :returns: shape (m, n) or (m,)
    """
    if other.ndim == 1:
        result = np.empty(one.shape[1])
        mujoco.mju_mulMatTVec(result, one, other)
    else:
        result = np.empty((one.shape[1], other.shape[1]))
        mujoco.mju_mulMatTMat(result, one, other)
    return result


def length(vector: FloatArray) -> float:
    """Return the Euclidean norm of a vector."""
    return float(mujoco.mju_norm(vector))
