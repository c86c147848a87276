# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Laws that setpoints move by within their limits, as functions of arrays without state.

Arrays are of shape (..., n): coordinates of one generator, or of several, such as one per world.
"""

from __future__ import annotations

import numpy as np

from manip_sim.arrays import BoolArray, FloatArray
from manip_sim.control.motion_profiles import (
    change_before_the_end, velocity_before_the_end, within)


def limited(wanted: FloatArray, begin: FloatArray, top: FloatArray, bound: FloatArray,
            duration_s: float, ranges: tuple[FloatArray, FloatArray] | None) -> FloatArray:
    """
    Return velocities at the end of an interval that keep to limits.

    :param wanted: there [rad/s or m/s]
    :param begin: at the beginning of the interval [rad/s or m/s]
    :param top: limit of the velocity [rad/s or m/s]
    :param bound: limit of the acceleration [rad/s^2 or m/s^2]
    :param duration_s: length of the interval [s]
    :param ranges: how far the ranges go on below and above the present position [rad or m]; None
        where no end is near
    """
    velocity, change = within(wanted, -top, top), bound * duration_s
    if ranges is not None:
        velocity = velocity_before_the_end(velocity, begin, *ranges, bound, duration_s)
        change = change_before_the_end(begin, *ranges, bound, duration_s)
    return within(velocity, begin - change, begin + change)


def divided(velocity: FloatArray, held: BoolArray, reference: FloatArray, caught_up: FloatArray,
            seeks: BoolArray) -> tuple[FloatArray, FloatArray]:
    """
    Return the velocities of references, and of what is caught up, that limits leave.

    :param velocity: the sum of both, within limits [rad/s or m/s]
    :param held: where this is not the sum of what was wanted
    :param reference: wanted [rad/s or m/s], and so ``caught_up``
    :param seeks: which coordinates come to a goal, and so catch up less; others miss no way
    """
    return (np.where(held & ~seeks, velocity, reference),
            np.where(held & seeks, velocity - reference, caught_up))
