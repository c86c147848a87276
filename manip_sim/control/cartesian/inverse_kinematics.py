# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Inverse kinematics of an arm, computed by the compiled law.

The law is imported when it is first called, as that imports numba.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from manip_sim.arrays import BoolArray, FloatArray


class Displacement(NamedTuple):
    """
    Displacements of the joints of an arm.

    :ivar step: for the task [rad], shape (n,)
    :ivar drift: of a redundant arm towards its posture, which leaves the end effector where it is
        [rad], shape (n,)
    :ivar held: whether the range of a joint keeps it from doing more, shape (n,)
    :ivar rests: whether the end effector is as near as it can come, so that there is no step
    :ivar singular: whether a motion is wanted in a direction in which it can hardly move
    """

    step: FloatArray
    drift: FloatArray
    held: BoolArray
    rests: bool
    singular: bool


def way_to_posture(posture: FloatArray, position: FloatArray, turn: FloatArray) -> FloatArray:
    """
    Return displacements to a posture [rad], shape (n,).

    :param posture: positions of joints [rad], shape (n,)
    :param position: where they are [rad], shape (n,)
    :param turn: 2 pi where whole turns make no difference, 0 elsewhere, shape (n,)
    """
    away = posture - position
    return away - turn * np.rint(away / (2.0 * np.pi))


def displace(jacobian: FloatArray, task: FloatArray, low: FloatArray, high: FloatArray,
             away: FloatArray, rested: bool = False) -> Displacement:
    """
    Return the displacements for a task, and those in what it leaves free towards the posture.

    :param jacobian: of position and rotation of the end effector, shape (6, n), the joints in
        their order from the base to the end effector
    :param task: wanted translation [m] and rotation vector [rad], shape (6,)
    :param low: lowest displacements within the ranges of the joints [rad], shape (n,)
    :param high: highest displacements [rad], shape (n,)
    :param away: displacements to the posture [rad], shape (n,)
    :param rested: whether the end effector rested before
    """
    from manip_sim.control.law import displacement as law
    count = len(away)
    step, drift, held = np.empty(count), np.empty(count), np.empty(count, np.bool_)
    rests, singular = law.displace(
        jacobian, task, low, high, away, rested, step, drift, held, np.empty((count, count)))
    return Displacement(step, drift, held, rests, singular)


def limit_rate(jacobian: FloatArray, step: FloatArray, acceleration_limit: FloatArray, rate: float
               ) -> float:
    """
    Return how fast to go along a step at most, so that an end effector can keep straight.

    :param jacobian: shape (6, n), the joints in their order from the base to the end effector
    :param step: displacements of the joints [rad], shape (n,)
    :param acceleration_limit: of the joints [rad/s^2], shape (n,)
    :param rate: that is wanted, as a share of the step per second
    """
    from manip_sim.control.law import singular_directions as law
    return law.limit_rate(jacobian, step, acceleration_limit, rate)
