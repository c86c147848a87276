# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Joint motions near a singularity, where an end effector can hardly move in some direction."""

from __future__ import annotations

import math

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.control.law.compiling import compiled, inner
from manip_sim.control.law.small_matrices import (
    dot, factorize, multiply, multiply_transposed, norm, solve)

#: Below this singular value [m/rad and 1] the end effector can hardly move in a direction.
SINGULAR = 0.029
_INVERSE_ITERATIONS = 4
#: Components of a direction that has a part in all directions.
_EVEN = 6.0**-0.5
#: Singular values near a singularity, and those below which it is slowed down no further.
_NEAR, _SMALLEST = 0.06, 0.03


@inner
def is_singular(jacobian: FloatArray, task: FloatArray) -> bool:
    """Return whether a task is mostly in a direction in which the end effector can hardly move."""
    whole = norm(task)
    if whole <= 1e-9:
        return False
    direction = np.empty(6)
    for i in range(6):
        direction[i] = task[i] / whole
    return (_find_hard_direction(jacobian, direction) < SINGULAR * SINGULAR
            and abs(dot(direction, task)) > 0.5 * whole)


@compiled
def find_bend(jacobian: FloatArray, step: FloatArray, result: FloatArray) -> None:
    """
    Write the joint accelerations that keep an end effector straight along a step, at most.

    They are those at velocities that make the step in a second, and grow with their square. As the
    direction in which the end effector can hardly move turns, all of the centripetal acceleration
    of the end effector may come to be along it; so an end effector slows down before it passes a
    singularity.

    :param jacobian: shape (6, n), the joints in their order from the base to the end effector
    :param step: displacements of the joints [rad], shape (n,)
    :param result: shape (n,), written
    """
    direction, turned, centripetal = np.empty(6), np.empty(3), np.empty(6)
    for i in range(6):
        direction[i], centripetal[i], turned[i % 3] = _EVEN, 0.0, 0.0
    square = _find_hard_direction(jacobian, direction)
    # Rotation of each joint by those before it, and with itself: twice its mean.
    for j in range(len(step)):
        for k in range(3):
            one, two = (k + 1) % 3, (k + 2) % 3
            own_one, own_two = step[j] * jacobian[3 + one, j], step[j] * jacobian[3 + two, j]
            centripetal[k] += step[j] * (
                (2.0 * turned[one] + own_one) * jacobian[two, j]
                - (2.0 * turned[two] + own_two) * jacobian[one, j])
            centripetal[3 + k] += turned[one] * own_two - turned[two] * own_one
        for k in range(3):
            turned[k] += step[j] * jacobian[3 + k, j]
    # Far from a singularity it turns so slowly that this is rarely needed.
    least = max(math.sqrt(square), _SMALLEST)
    multiply_transposed(jacobian, direction, result)
    for j in range(len(step)):
        result[j] = abs(result[j]) * norm(centripetal) * _NEAR / (least * least * least)


@compiled
def limit_rate(jacobian: FloatArray, step: FloatArray, acceleration_limit: FloatArray,
               rate: float) -> float:
    """
    Return how fast to go along a step at most, so that :func:`find_bend` keeps to limits.

    :param acceleration_limit: of the joints [rad/s^2], shape (n,)
    :param rate: that is wanted, as a share of the step per second
    """
    bend = np.empty(len(step))
    find_bend(jacobian, step, bend)
    for j in range(len(step)):
        rate = min(rate, math.sqrt(acceleration_limit[j] / max(bend[j], 1e-12)))
    return rate


@inner
def _find_hard_direction(jacobian: FloatArray, direction: FloatArray) -> float:
    """
    Find the direction of least motion, of those that have a part in another one.

    :param direction: the other one, changed, shape (6,)
    :returns: the square of its singular value
    """
    square, factor = np.empty((6, 6)), np.empty((6, 6))
    for i in range(6):
        for j in range(i + 1):
            total = 0.0
            for k in range(jacobian.shape[1]):
                total += jacobian[i, k] * jacobian[j, k]
            square[i, j] = square[j, i] = total
    factorize(square, 1e-12, len(square), factor)
    for _ in range(_INVERSE_ITERATIONS):
        solve(factor, direction, len(square), direction)
        size = max(norm(direction), 1e-12)
        for i in range(6):
            direction[i] /= size
    moved = np.empty(6)
    multiply(square, direction, moved)
    return max(dot(direction, moved), 0.0)
