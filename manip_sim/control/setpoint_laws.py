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

#: A setpoint that is slower and nearer to its goal than this has arrived [rad or m, and per s].
ARRIVED = 1e-10
#: Where the range ends is looked for this far ahead, beside the way of braking [s].
AHEAD_S = 0.1


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


def away_from_ends(low: FloatArray, high: FloatArray, velocity: FloatArray, limit: FloatArray
                   ) -> tuple[FloatArray, FloatArray]:
    """
    Return positions between which nothing that is not faster has to brake [rad or m].

    :param low: end of the range [rad or m], as is ``high``
    :param velocity: of that size at most [rad/s or m/s]
    :param limit: of the acceleration [rad/s^2 or m/s^2]
    """
    way = velocity**2 / limit + AHEAD_S * velocity
    return low + way, high - way


def outside(position: FloatArray, low: FloatArray, high: FloatArray) -> BoolArray:
    """Return which positions are not between two others [rad or m]."""
    return np.asarray((position < low) | (position > high))


def resting(stages: FloatArray, reference: FloatArray, goal_velocity: FloatArray,
            away: FloatArray, seeks: BoolArray) -> BoolArray:
    """
    Return which setpoints have arrived and rest.

    :param stages: what is caught up [rad/s or m/s], shape (3, ..., n)
    :param reference: velocity of references [rad/s or m/s], which comes to ``goal_velocity``
    :param away: from goals to setpoints [rad or m]
    :param seeks: which coordinates come to a goal
    """
    pace = np.maximum.reduce(np.abs([*stages, reference, goal_velocity]))
    return np.asarray(np.maximum(pace, np.where(seeks, np.abs(away), 0.0)) < ARRIVED)


def without_ended(until_s: FloatArray, now_s: float | FloatArray, goal_velocity: FloatArray,
                  slope: FloatArray, bound: FloatArray, limit: FloatArray
                  ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """
    Let the references of streams that have ended come to rest at the acceleration limit.

    :param until_s: until when streams last [s]
    :param now_s: simulation time [s]
    :param goal_velocity: of references [rad/s or m/s]
    :param slope: of these [rad/s^2 or m/s^2]; ``bound`` is that of all motion
    :param limit: of the acceleration [rad/s^2 or m/s^2]
    :returns: the first, third, fourth and fifth of these afterwards
    """
    ended = until_s <= now_s + 1e-9
    return (np.where(ended, np.inf, until_s), np.where(ended, 0.0, goal_velocity),
            np.where(ended, limit, slope), np.where(ended, limit, bound))
