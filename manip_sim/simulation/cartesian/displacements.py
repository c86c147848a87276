# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Joint displacements that bring a hand nearer to where it shall be, within the ranges of the joints.

A Gauss-Newton step (least squares with bounds on the joints) where all of the motion is possible.
What is not possible, beyond the reach or near a singularity, is treated as a constant force on the
hand: its stiffness, the second derivative of the kinematics, makes the step a Newton step towards
the place where the hand is nearest, so the joints come to rest there. Nothing here knows of time.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import mujoco
import numpy as np

from manip_sim.arrays import BoolArray, FloatArray
from manip_sim.algebra import (
    dot, factorized, length, product, solved, transposed_product, with_diagonal)
from manip_sim.simulation.profiles import within

#: What needs larger displacements of a joint is not possible here [rad].
_LARGEST = 1.0
#: Keeps the least squares regular; it is compensated, so the solution is exact.
_REGULAR = 1e-9
#: Weight of the posture beside that of the task, and in addition for each metre or radian of the
#: task that is not possible, so that an arm does not rest where it can hardly come back.
_POSTURE, _POSTURE_RATE = 1e-6, 0.005
#: Damping of what is not possible, at most and for each metre or radian of it [m^2].
_DAMPING, _DAMPING_RATE = 1.6e-3, 0.02
#: A part of the task smaller than this, as a share, counts as possible.
_NEGLIGIBLE = 1e-6
#: A hand rests if a step brings it nearer by less than this for each radian [m/rad], and until
#: one does by so many times as much: where it may rest does not change from step to step ...
_WORTH, _WORTH_AGAIN = 2e-3, 2.0
#: ... unless it is farthest there, as its distance bends down this much [m/rad^2], or the squared
#: distance bends up so much that the nearest place is near [m^2/rad^2].
_FARTHEST, _CLEAR = -0.05, 0.1
#: With less progress than this, as a share, the posture matters less.
_PROGRESS = 0.1
#: Iterations for the sign of a matrix, and what is added so that it is positive in any case.
_SIGN_ITERATIONS, _SIGN_ERROR = 10, 0.005
#: Below this singular value [m/rad and 1] the hand can hardly move in a direction.
_SINGULAR = 0.029
_INVERSE_ITERATIONS = 4
#: Singular values near a singularity, and those below which the hand does not slow down further.
_NEAR, _SMALLEST = 0.06, 0.03


class Displacement(NamedTuple):
    """
    Displacements of the joints of an arm.

    :ivar step: for the task [rad], shape (n,)
    :ivar drift: of a redundant arm towards its posture, which leaves the hand where it is [rad],
        shape (n,)
    :ivar held: whether the range of a joint keeps it from doing more, shape (n,)
    :ivar factor: Cholesky factor of the second derivative of what the step makes smaller, with the
        weight of the posture, shape (n, n)
    :ivar rests: whether the hand is as near as it can come, so that there is no step
    :ivar jacobian: of the hand, shape (6, n)
    :ivar task: wanted motion of the hand, shape (6,)
    :ivar easy: whether nothing singular can be wanted, as the step is small for it
    """

    step: FloatArray
    drift: FloatArray
    held: BoolArray
    factor: FloatArray
    rests: bool
    jacobian: FloatArray
    task: FloatArray
    easy: bool = False

    @property
    def singular(self) -> bool:
        """Whether a motion is wanted in a direction in which the hand can hardly move."""
        return not self.easy and _is_singular(self.jacobian, self.task)

    def slack(self, velocity: FloatArray) -> FloatArray:
        """Return the part of joint velocities that makes no difference to the task, shape (n,)."""
        return _POSTURE * solved(self.factor, velocity)


def displace(jacobian: FloatArray, task: FloatArray, low: FloatArray, high: FloatArray,
             away: FloatArray, rested: bool = False) -> Displacement:
    """
    Return the displacements for a task, and those in what it leaves free towards the posture.

    :param jacobian: of position and rotation of the hand, shape (6, n), the joints in their order
        from the base to the hand
    :param task: wanted translation [m] and rotation vector [rad], shape (6,)
    :param low: lowest displacements within the ranges of the joints [rad], shape (n,)
    :param high: highest displacements [rad], shape (n,)
    :param away: displacements to the posture [rad], shape (n,)
    :param rested: whether the hand rested before
    """
    square, pull = transposed_product(jacobian, jacobian), transposed_product(jacobian, task)
    whole, regular = length(task), factorized(square, _REGULAR)
    wanted = solved(regular, pull)
    displacement = _unbounded(jacobian, task, square, whole, pull, regular, wanted, low, high,
                              away)
    if displacement is not None:
        return displacement
    stiffness, weight = square, _POSTURE
    step = _minimum(with_diagonal(square, _REGULAR), pull, within(low, -_LARGEST, _LARGEST),
                    within(high, -_LARGEST, _LARGEST))
    missed = task - product(jacobian, step)
    size = length(missed)
    possible = size <= _NEGLIGIBLE * whole
    if not possible:
        bent = _curvature(jacobian, missed)
        stiffness = with_diagonal(square + _positive_part(bent),
                                  min(_DAMPING, _DAMPING_RATE * size))
        weight += _POSTURE_RATE * size
    step = _minimum(with_diagonal(stiffness, _REGULAR), pull + _REGULAR * step, low, high)
    held = ((step <= low) & (wanted < low)) | ((step >= high) & (wanted > high))
    drift, weighted, lowest, highest = (
        away, with_diagonal(stiffness, weight), low - step, high - step)
    for _ in range(2):  # The first one still moves the hand by a millionth.
        drift = _minimum(weighted, weight * drift, lowest, highest)
    rests = False
    if not possible:
        nearer, moved = dot(pull, step), length(step)
        drift = min(max(nearer / max(whole**2, 1e-18) / _PROGRESS, 0.0), 1.0)**2 * drift
        # The posture must not hold up the motion for the task: the arm would hardly move.
        drift = within(drift - min(dot(drift, step), 0.0) / max(moved**2, 1e-18) * step,
                       lowest, highest)
        second = dot(step, product(square + bent, step))
        again = _WORTH_AGAIN if rested else 1.0
        rests = nearer <= again * _WORTH * whole * moved and (
            again * _FARTHEST * whole * moved**2 <= second <= again * _CLEAR * moved**2)
        if rests:
            step, drift = np.zeros(len(step)), np.zeros(len(step))
    return Displacement(step, drift, held, factorized(stiffness, _POSTURE), rests, jacobian, task)


def _unbounded(jacobian: FloatArray, task: FloatArray, square: FloatArray, whole: float,
               pull: FloatArray, regular: FloatArray, wanted: FloatArray, low: FloatArray,
               high: FloatArray, away: FloatArray) -> Displacement | None:
    """
    Return the displacements where all of a task is possible and no bound is met, else None.

    That is what :func:`displace` finds then too, in a tenth of the time.

    :param square: of the Jacobian, ``regular`` its factor
    :param whole: length of the task, ``pull`` and ``wanted`` it and its solution in joints
    """
    far = length(wanted)
    if not (far <= _LARGEST
            and length(task - product(jacobian, wanted)) <= _NEGLIGIBLE * whole):
        return None
    step = solved(regular, pull + _REGULAR * wanted)
    factor = factorized(square, _POSTURE)
    first = _POSTURE * solved(factor, away)
    drift = _POSTURE * solved(factor, first)
    ends = np.concatenate((step, step + first, step + drift)).reshape(3, -1)
    if np.count_nonzero((ends < low) | (ends > high)):
        return None
    # Half of the task in a direction in which the hand can hardly move would need more than that.
    return Displacement(step, drift, np.zeros(len(low), dtype=bool), factor, False, jacobian, task,
                        easy=far * _SINGULAR <= 0.4 * whole)


def _minimum(matrix: FloatArray, vector: FloatArray, low: FloatArray, high: FloatArray
             ) -> FloatArray:
    """Return where x matrix x / 2 - vector x is smallest within bounds."""
    count = len(vector)
    result = np.zeros(count)
    mujoco.mju_boxQP(result, np.empty((count, count + 7)), None, matrix, -vector, low, high)
    return result


def _curvature(jacobian: FloatArray, force: FloatArray) -> FloatArray:
    """
    Return minus the second derivative of the pose along a force, shape (n, n).

    A turn of one joint turns the axis of each joint beyond it, and the lever from there.
    """
    linear, angular = jacobian[:3].T, jacobian[3:].T
    levers = np.triu(product(product(angular, _cross(force[:3])), linear.T))
    axes = np.triu(product(product(angular, _cross(force[3:])), angular.T), 1) / 2.0
    upper = levers + axes
    return upper + np.triu(upper, 1).T


def _cross(vector: FloatArray) -> FloatArray:
    """Return the matrix of the cross product from the left with a vector, shape (3, 3)."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _positive_part(matrix: FloatArray) -> FloatArray:
    """Return a symmetric matrix without its negative eigenvalues, and a little more."""
    scale = length(matrix.ravel()) + 1e-30
    # Newton and Schulz: the sign of the matrix, whose product with the matrix is its magnitude.
    sign = matrix / scale
    for _ in range(_SIGN_ITERATIONS):
        sign = 1.5 * sign - 0.5 * product(sign, product(sign, sign))
    magnitude = product(sign, matrix)
    magnitude = (magnitude + magnitude.T) / 2.0
    return np.asarray((matrix + magnitude) / 2.0 + _SIGN_ERROR * scale * np.eye(len(matrix)))


def bend(jacobian: FloatArray, step: FloatArray) -> FloatArray:
    """
    Return the joint accelerations that keep a hand straight along a step, at most, shape (n,).

    They are those at velocities that make the step in a second, and grow with their square. As the
    direction in which the hand can hardly move turns, all of the centripetal acceleration of the
    hand may come to be along it; so a hand slows down before it passes a singularity.

    :param jacobian: shape (6, n), the joints in their order from the base to the hand
    :param step: displacements of the joints [rad], shape (n,)
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
    """Return the direction in which a hand moves least, and the square of its singular value."""
    return _hard_direction(jacobian, np.full(6, 6.0**-0.5))


def _hard_direction(jacobian: FloatArray, direction: FloatArray) -> tuple[FloatArray, float]:
    """Return the same, of the directions that have a part in another one."""
    square = product(jacobian, jacobian.T)
    factor = factorized(square, 1e-12)
    for _ in range(_INVERSE_ITERATIONS):
        result = solved(factor, direction)
        direction = result / max(length(result), 1e-12)
    return direction, max(dot(direction, product(square, direction)), 0.0)


def _is_singular(jacobian: FloatArray, task: FloatArray) -> bool:
    """Return whether most of a task is in a direction in which the hand can hardly move."""
    whole = length(task)
    if whole <= 1e-9:
        return False
    along = task / whole
    direction, square = _hard_direction(jacobian, along)
    return square < _SINGULAR**2 and abs(dot(direction, along)) > 0.5
