# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What servos need to follow a motion, as functions of arrays without state."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from manip_sim.arrays import FloatArray


def place_after(position: FloatArray, velocity: FloatArray, limit: FloatArray, duration_s: float
                ) -> FloatArray:
    """
    Return where joints are to be looked for: those faster than their limit go farther.

    :param position: [rad or m], shape (..., n)
    :param velocity: [rad/s or m/s], shape (..., n)
    :param limit: of the velocity [rad/s or m/s], shape (n,)
    :param duration_s: how far ahead [s]
    :returns: [rad or m], shape (..., n), ``position`` itself if none is too fast
    """
    if np.count_nonzero(np.abs(velocity) > limit):
        position = position + duration_s * (velocity - np.clip(velocity, -limit, limit))
    return np.asarray(position)


def activations(position: FloatArray, velocity: FloatArray, forces: Sequence[FloatArray],
                drag: FloatArray, stiffness: FloatArray) -> FloatArray:
    """
    Return the positions of servos that exert what a motion needs.

    :param position: of the motion [rad or m], shape (..., n)
    :param velocity: [rad/s or m/s], shape (..., n)
    :param forces: that it needs besides drag [N m or N], each of a shape that fits (..., n)
    :param drag: damping of servos and joints [N m s/rad or N s/m], shape (..., n)
    :param stiffness: of the servos [N m/rad or N/m], shape (..., n)
    """
    force = drag * velocity
    for other in forces:
        force += other
    force /= stiffness
    force += position
    return np.asarray(force)
