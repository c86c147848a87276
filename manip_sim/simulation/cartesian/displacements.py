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

from dataclasses import dataclass

import mujoco
import numpy as np

from manip_sim.arrays import BoolArray, FloatArray
from manip_sim.algebra import dot, length, product

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
#: A step is not worth making if it improves the pose by less than this share of the squared error,
#: a larger one for errors that are smaller than this [m, rad] ...
_WORTH, _WORTH_SIZE = 3e-5, 0.1
#: ... unless the squared error grows at least this much with the square of the step [m^2/rad^2].
_CLEAR = 0.1
#: With less progress than this, as a share, the posture matters less.
_PROGRESS = 0.1
#: Iterations for the sign of a matrix, and what is added so that it is positive in any case.
_SIGN_ITERATIONS, _SIGN_ERROR = 10, 0.005
#: Below this singular value [m/rad and 1] the hand can hardly move in a direction.
_SINGULAR = 0.029
_INVERSE_ITERATIONS = 4


@dataclass(frozen=True)
class Displacement:
    """
    Displacements of the joints of an arm.

    :ivar step: for the task [rad], shape (n,)
    :ivar drift: of a redundant arm towards its posture, which leaves the hand where it is [rad],
        shape (n,)
    :ivar held: whether the range of a joint keeps it from doing more, shape (n,)
    :ivar singular: whether a motion is wanted in a direction in which the hand can hardly move
    :ivar stiffness: second derivative of what the step makes smaller, shape (n, n)
    """

    step: FloatArray
    drift: FloatArray
    held: BoolArray
    singular: bool
    stiffness: FloatArray

    def slack(self, velocity: FloatArray) -> FloatArray:
        """Return the part of joint velocities that makes no difference to the task, shape (n,)."""
        weighted = self.stiffness + _POSTURE * np.eye(len(velocity))
        return _POSTURE * _solve(weighted, velocity)


def displace(jacobian: FloatArray, task: FloatArray, low: FloatArray, high: FloatArray,
             away: FloatArray) -> Displacement:
    """
    Return the displacements for a task, and those in what it leaves free towards the posture.

    :param jacobian: of position and rotation of the hand, shape (6, n), the joints in their order
        from the base to the hand
    :param task: wanted translation [m] and rotation vector [rad], shape (6,)
    :param low: lowest displacements within the ranges of the joints [rad], shape (n,)
    :param high: highest displacements [rad], shape (n,)
    :param away: displacements to the posture [rad], shape (n,)
    """
    unit, whole = np.eye(len(low)), length(task)
    square, pull = product(jacobian.T, jacobian), product(jacobian.T, task)
    stiffness, weight = square, _POSTURE
    wanted = _solve(square + _REGULAR * unit, pull)
    step = _minimum(square + _REGULAR * unit, pull, np.clip(low, -_LARGEST, _LARGEST),
                    np.clip(high, -_LARGEST, _LARGEST))
    missed = task - product(jacobian, step)
    size = length(missed)
    possible = size <= _NEGLIGIBLE * whole
    if not possible:
        bent = _curvature(jacobian, missed)
        stiffness = square + _positive_part(bent) + min(_DAMPING, _DAMPING_RATE * size) * unit
        weight += _POSTURE_RATE * size
    step = _minimum(stiffness + _REGULAR * unit, pull + _REGULAR * step, low, high)
    held = ((step <= low) & (wanted < low)) | ((step >= high) & (wanted > high))
    drift = away
    for _ in range(2):  # The first one still moves the hand by a millionth.
        drift = _minimum(stiffness + weight * unit, weight * drift, low - step, high - step)
    if not possible:
        gain = dot(pull, step) / whole**2
        drift = min(max(gain / _PROGRESS, 0.0), 1.0)**2 * drift
        share = _worth(gain, whole, dot(step, step), dot(step, product(square + bent, step)))
        step, drift = share * step, share * drift
    return Displacement(step, drift, held, _is_singular(jacobian, task), stiffness)


def _worth(gain: float, size: float, moved: float, second: float) -> float:
    """
    Return 1 for a step that is worth making, 0 for one that is not, and between the two.

    :param gain: what it improves, as a share of the squared size of the task
    :param size: of the task [m, rad]
    :param moved: squared length of the step [rad^2]
    :param second: second derivative of the squared error along the step
    """
    # The way down from a place where the hand is farthest begins flat.
    if not 0.0 <= second < 2.0 * _CLEAR * moved:
        return 1.0
    worth = max(gain / (_WORTH * (1.0 + _WORTH_SIZE / size)), second / (_CLEAR * moved))
    return min(max(4.0 * (worth - 1.0), 0.0), 1.0)


def _solve(matrix: FloatArray, vector: FloatArray) -> FloatArray:
    """Return the solution of a system of equations with a positive matrix."""
    factor, result = matrix.copy(), np.empty(len(vector))
    mujoco.mju_cholFactor(factor, 1e-18)
    mujoco.mju_cholSolve(result, factor, vector)
    return result


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


def _is_singular(jacobian: FloatArray, task: FloatArray) -> bool:
    """Return whether most of a task is in a direction in which the hand can hardly move."""
    square = product(jacobian, jacobian.T)
    factor, direction = square + 1e-12 * np.eye(6), task / max(length(task), 1e-12)
    along = direction
    mujoco.mju_cholFactor(factor, 1e-18)
    for _ in range(_INVERSE_ITERATIONS):
        result = np.empty(6)
        mujoco.mju_cholSolve(result, factor, direction)
        direction = result / max(length(result), 1e-12)
    hardly = dot(direction, product(square, direction)) < _SINGULAR**2
    return hardly and abs(dot(direction, along)) > 0.5 and length(task) > 1e-9
