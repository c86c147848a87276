# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Motion within limits: functions of arrays without state."""

from __future__ import annotations

import numpy as np

from manip_sim.arrays import FloatArray


def braking_velocity(distance: FloatArray, limit: FloatArray, interval_s: float) -> FloatArray:
    """
    Return the highest velocity in the next interval that still allows braking before the goal.

    The distance left after the interval is that of a constant deceleration, v^2 / (2 a), so the
    intervals that follow may be of any length.

    :param distance: to the goal, with sign [rad or m], shape (n,)
    :param limit: of the acceleration [rad/s^2 or m/s^2], shape (n,)
    :param interval_s: [s]
    """
    size, change = np.minimum(np.abs(distance), 1e6), limit * interval_s
    # The root of v^2 + 2 change v = 2 limit size, written so that it is exact for small sizes.
    return np.asarray(np.sign(distance) * 2.0 * limit * size / (
        change + np.sqrt(change**2 + 2.0 * limit * size)))


def evenly_braked(velocity: FloatArray, position: FloatArray, low: FloatArray, high: FloatArray,
                  limit: FloatArray, shortest_s: float) -> FloatArray:
    """
    Return decelerations with which velocities end together, and before their ranges do.

    :param velocity: now [rad/s or m/s], shape (n,)
    :param position: now [rad or m], shape (n,); ``low`` and ``high`` end its range
    :param limit: of the deceleration, unless a range ends before [rad/s^2 or m/s^2], shape (n,)
    :param shortest_s: the least time that it takes [s]
    :returns: above 0 [rad/s^2 or m/s^2], shape (n,)
    """
    size, ahead = np.abs(velocity), np.where(velocity > 0.0, high - position, position - low)
    shortest_s = max(shortest_s, 1e-9)
    needed = np.minimum(size**2 / (2.0 * np.maximum(ahead, 1e-6)), size / shortest_s)
    longest_s = (size / np.maximum(limit, needed)).max(initial=0.0)
    return np.asarray(np.maximum(np.maximum(size / max(longest_s, shortest_s), needed), 1e-9))
