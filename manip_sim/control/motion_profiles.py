# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Laws of motion within limits, as functions of arrays without state, of any common shape."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from manip_sim.arrays import FloatArray

#: A range that goes on no farther ends here [rad or m].
_NO_WAY = 1e-9
#: Multiple of the limit from which on braking is too late for it; less may be rounding.
_LATE = 1.01


def within(values: FloatArray, low: FloatArray | float, high: FloatArray | float) -> FloatArray:
    """Return values clipped to a range; np.clip takes several times as long for few of them."""
    return np.asarray(np.minimum(np.maximum(values, low), high))


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


def ramp(begin: FloatArray, goal: FloatArray, slope: FloatArray, interval_s: float | FloatArray
         ) -> tuple[FloatArray, FloatArray]:
    """
    Let velocities come to others at constant accelerations.

    :param begin: velocity at the beginning of an interval [rad/s or m/s], shape (n,)
    :param goal: that it comes to, and stays [rad/s or m/s], shape (n,)
    :param slope: size of the acceleration, above 0 [rad/s^2 or m/s^2], shape (n,)
    :param interval_s: [s]
    :returns: velocity at the end of the interval, and the way in it, each of shape (n,)
    """
    most = slope * interval_s
    # Near the goal this is the difference itself: what is left of a quotient would never be zero.
    change = within(goal - begin, -most, most)
    end = begin + change
    return end, np.asarray(end * interval_s - change / 2.0 * (np.abs(change) / slope))


class Plan(NamedTuple):
    """
    Where coordinates are at the ends of several intervals, and how they move.

    :ivar durations_s: of the intervals [s], shape (k, 1 ...)
    :ivar positions: [rad or m], shape (k, ..., n); velocities and accelerations have the same
    :ivar velocities: [rad/s or m/s]
    :ivar accelerations: means over the intervals [rad/s^2 or m/s^2]
    """

    durations_s: FloatArray
    positions: FloatArray
    velocities: FloatArray
    accelerations: FloatArray


def plan_ramps(position: FloatArray, begin: FloatArray, goal: FloatArray, slope: FloatArray,
               ends_s: FloatArray) -> Plan:
    """
    Plan how velocities come to others at constant accelerations, in several intervals.

    :param position: at the beginning [rad or m], shape (..., n)
    :param begin: velocity there; ``goal`` and ``slope`` as for :func:`ramp`, shape (..., n)
    :param ends_s: of the intervals, since the beginning [s], shape (k, 1 ...)
    """
    velocities, ways = ramp(begin, goal, slope, ends_s)
    accelerations, durations_s = velocities.copy(), ends_s.copy()
    accelerations[0] -= begin
    accelerations[1:] -= velocities[:-1]
    durations_s[1:] -= ends_s[:-1]
    accelerations /= durations_s
    return Plan(durations_s, position + ways, velocities, accelerations)


def way_of_ramp(begin: FloatArray, goal: FloatArray, slope: FloatArray) -> FloatArray:
    """Return how much farther a velocity that ramps goes than if it were at its goal."""
    change = goal - begin
    return np.asarray(-change * np.abs(change) / (2.0 * slope))


def low_pass(before: FloatArray, present: FloatArray, smoothing_s: FloatArray, interval_s: float
             ) -> FloatArray:
    """
    Smooth velocities by first-order stages, each of which averages what goes into it.

    :param before: velocities before an interval: the input, and after each stage, shape
        (k, ..., n)
    :param present: the input after the interval, shape (..., n)
    :param smoothing_s: time constant of each stage [s], shape (n,)
    :param interval_s: [s]
    :returns: velocities after the interval, shape (k, ..., n); the first input counts in full
    """
    share = interval_s / (smoothing_s + interval_s / 2.0)
    after = np.empty_like(before)
    after[0] = mean = present
    for stage in range(1, len(before)):
        after[stage] = before[stage] + share * (mean - before[stage])
        mean = (before[stage] + after[stage]) / 2.0
    return after


def velocity_before_the_end(velocity: FloatArray, begin: FloatArray, below: FloatArray,
                            above: FloatArray, limit: FloatArray, interval_s: float
                            ) -> FloatArray:
    """
    Return velocities, at the end of an interval, that allow braking before the range ends.

    :param velocity: wanted there [rad/s or m/s], shape (n,)
    :param begin: velocity at the beginning of the interval [rad/s or m/s], shape (n,)
    :param below: how far the range goes on below the present position [rad or m], shape (n,)
    :param above: how far it goes on above it [rad or m], shape (n,)
    :param limit: of the acceleration [rad/s^2 or m/s^2], shape (n,)
    :param interval_s: [s]
    """
    change = limit * interval_s / 2.0
    highest, lowest = [
        np.sqrt(np.maximum(change**2 + 2.0 * limit * np.maximum(
            np.minimum(distance, 1e6) - towards * interval_s / 2.0, 0.0), 0.0)) - change
        for distance, towards in ((above, begin), (below, -begin))]
    return within(velocity, -lowest, highest)


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


def change_before_the_end(begin: FloatArray, below: FloatArray, above: FloatArray,
                          limit: FloatArray, interval_s: float) -> FloatArray:
    """
    Return how much velocities may change in an interval.

    That is what the limit allows, except where the range would end before they are at rest: there
    they slow down evenly up to its end.

    :param begin: velocity at the beginning of the interval [rad/s or m/s], shape (n,)
    :param below: how far the range goes on below the present position [rad or m], shape (n,)
    :param above: how far it goes on above it [rad or m], shape (n,)
    :param limit: of the acceleration [rad/s^2 or m/s^2], shape (n,)
    :param interval_s: [s]
    """
    change, size = limit * interval_s, np.abs(begin)
    ahead = np.where(begin > 0.0, above, below)
    needed = size**2 / (2.0 * np.maximum(ahead, _NO_WAY))
    late = needed > _LATE * limit
    if not np.count_nonzero(late):
        return change
    return np.where(late, np.maximum(change, np.minimum(needed * interval_s, size)), change)
