# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What joints do near a singularity, where an end effector can hardly move in some direction."""

from __future__ import annotations

import math

import numpy as np

from manip_sim.algebra import dot, factorized, length, product, solved
from manip_sim.arrays import FloatArray

#: Below this singular value [m/rad and 1] the end effector can hardly move in a direction.
SINGULAR = 0.029
_INVERSE_ITERATIONS = 4
#: Singular values near a singularity, and those below which it is slowed down no further.
_NEAR, _SMALLEST = 0.06, 0.03


def bend(jacobian: FloatArray, step: FloatArray) -> FloatArray:
    """
    Return the joint accelerations that keep an end effector straight along a step, at most.

    They are those at velocities that make the step in a second, and grow with their square. As the
    direction in which the end effector can hardly move turns, all of the centripetal acceleration
    of the end effector may come to be along it; so an end effector slows down before it passes a
    singularity.

    :param jacobian: shape (6, n), the joints in their order from the base to the end effector
    :param step: displacements of the joints [rad], shape (n,)
    :returns: shape (n,)
    """
    return _bend(jacobian, step, *_hardest(jacobian))


def rate_without_bend(jacobian: FloatArray, step: FloatArray, acceleration_limit: FloatArray,
                      rate: float) -> float:
    """
    Return how fast to go along a step at most, so that :func:`bend` keeps to limits.

    :param acceleration_limit: of the joints [rad/s^2], shape (n,)
    :param rate: that is wanted, as a share of the step per second
    """
    direction, square = _hardest(jacobian)
    # No vector product below is longer than that of the lengths, and no joint needs more than
    # all of them would together.
    longest = (rate * float(np.add.reduce(np.abs(step))))**2 * (
        1.0 + 2.0 * length(jacobian.reshape(-1)[:3 * len(step)]))
    least = max(math.sqrt(square), _SMALLEST)
    if longest * math.sqrt(square) * _NEAR / least**3 < min(acceleration_limit.tolist()):
        return rate
    bent = np.maximum(_bend(jacobian, step, direction, square), 1e-12)
    return min(rate, math.sqrt(min((acceleration_limit / bent).tolist())))


def _bend(jacobian: FloatArray, step: FloatArray, direction: FloatArray, square: float
          ) -> FloatArray:
    linear, turns = jacobian[:3].T, step[:, None] * jacobian[3:].T
    # How each joint is turned by those before it, and with itself.
    here = np.cumsum(turns, axis=0)
    before = here - turns
    centripetal = length(np.concatenate([
        _vector_products(before + here, step[:, None] * linear).sum(axis=0),
        _vector_products(before, turns).sum(axis=0)]))
    # Far from a singularity it turns so slowly that this is rarely needed.
    least = max(math.sqrt(square), _SMALLEST)
    return np.asarray(np.abs(product(jacobian.T, direction)) * (
        centripetal * _NEAR / least**3))


def _vector_products(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return the vector products of rows, shape (n, 3), faster than numpy.cross."""
    return np.asarray(one[:, [1, 2, 0]] * other[:, [2, 0, 1]]
                      - one[:, [2, 0, 1]] * other[:, [1, 2, 0]])


def _hardest(jacobian: FloatArray) -> tuple[FloatArray, float]:
    """Return the direction of least motion, and the square of its singular value."""
    return _hard_direction(jacobian, np.full(6, 6.0**-0.5))


def _hard_direction(jacobian: FloatArray, direction: FloatArray) -> tuple[FloatArray, float]:
    """Return the same, of the directions that have a part in another one."""
    square = product(jacobian, jacobian.T)
    factor = factorized(square, 1e-12)
    for _ in range(_INVERSE_ITERATIONS):
        result = solved(factor, direction)
        direction = result / max(length(result), 1e-12)
    return direction, max(dot(direction, product(square, direction)), 0.0)


def is_singular(jacobian: FloatArray, task: FloatArray) -> bool:
    """Return whether a task is mostly in a direction in which the end effector can hardly move."""
    whole = length(task)
    if whole <= 1e-9:
        return False
    along = task / whole
    direction, square = _hard_direction(jacobian, along)
    return square < SINGULAR**2 and abs(dot(direction, along)) > 0.5
