# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Inverse kinematics: joint displacements, within their ranges, that bring an end effector nearer.

A Gauss-Newton step (least squares with bounds on the joints) where all of the motion is possible.
What is not possible, beyond the reach or near a singularity, is treated as a constant force on the
end effector: its stiffness, the second derivative of the kinematics, makes the step a Newton step
towards the place where the end effector is nearest, so the joints come to rest there. Nothing here
knows of time.
"""

from __future__ import annotations

import math

import numpy as np

from manip_sim.arrays import BoolArray, FloatArray
from manip_sim.control.law.compiling import compiled, inlined, inner
from manip_sim.control.law.singular_directions import is_singular, SINGULAR
from manip_sim.control.law.small_matrices import (
    clip, dot, factorize, minimize_in_box, multiply, multiply_matrices, multiply_transposed, norm,
    solve)

#: Tasks that need larger displacements of a joint are not possible here [rad].
_LARGEST = 1.0
#: Keeps the least squares regular; it is compensated, so the solution is exact.
_REGULAR = 1e-9
#: Weight of the posture beside that of the task, and in addition for each metre or radian of the
#: task that is not possible, so that an arm does not rest where it can hardly come back.
POSTURE, _POSTURE_RATE = 1e-6, 0.005
#: Damping of the impossible part of a task, at most and for each metre or radian of it [m^2].
_DAMPING, _DAMPING_RATE = 1.6e-3, 0.02
#: A part of the task smaller than this, as a share, counts as possible.
_NEGLIGIBLE = 1e-6
#: An end effector rests if a step brings it nearer by less than this for each radian [m/rad], and
#: until one does by so many times as much: where it may rest does not change from step to step ...
_WORTH, _WORTH_AGAIN = 2e-3, 2.0
#: ... unless it is farthest there, as its distance bends down this much [m/rad^2], or the squared
#: distance bends up so much that the nearest place is near [m^2/rad^2].
_FARTHEST, _CLEAR = -0.05, 0.1
#: With less progress than this, as a share, the posture matters less.
_PROGRESS = 0.1
#: Iterations for the sign of a matrix, and an addition that makes it positive in any case.
_SIGN_ITERATIONS, _SIGN_ERROR = 10, 0.005


@compiled
def displace(jacobian: FloatArray, task: FloatArray, low: FloatArray, high: FloatArray,
             away: FloatArray, rested: bool, step: FloatArray, drift: FloatArray,
             held: BoolArray, factor: FloatArray) -> tuple[bool, bool]:
    """
    Write the displacements for a task, and those in what it leaves free towards the posture.

    :param jacobian: of position and rotation of the end effector, shape (6, n), the joints in
        their order from the base to the end effector
    :param task: wanted translation [m] and rotation vector [rad], shape (6,)
    :param low: lowest displacements within the ranges of the joints [rad], shape (n,)
    :param high: highest displacements [rad], shape (n,)
    :param away: displacements to the posture [rad], shape (n,)
    :param rested: whether the end effector rested before
    :param step: for the task [rad], shape (n,), written
    :param drift: towards the posture, which leaves the end effector where it is [rad], shape (n,),
        written
    :param held: whether the range of a joint keeps it from doing more, shape (n,), written
    :param factor: Cholesky factor of the second derivative of what the step makes smaller, with
        the weight of the posture, shape (n, n), written
    :returns: whether the end effector is as near as it can come, so that there is no step, and
        whether a motion is wanted in a direction in which it can hardly move
    """
    count = len(step)
    square, pull, wanted = np.empty((count, count)), np.empty(count), np.empty(count)
    for i in range(count):
        held[i] = False
        for j in range(i + 1):
            total = 0.0
            for k in range(6):
                total += jacobian[k, i] * jacobian[k, j]
            square[i, j] = square[j, i] = total
    multiply_transposed(jacobian, task, pull)
    factorize(square, POSTURE, count, factor)
    if _find_unbounded(jacobian, task, low, high, away, square, pull, factor, wanted, step, drift):
        # Half of the task in a direction of hardly any motion would need more.
        if norm(wanted) * SINGULAR <= 0.4 * norm(task):
            return False, False
        return False, is_singular(jacobian, task)
    rests = _find_bounded(jacobian, task, low, high, away, rested, square, pull, wanted, step,
                          drift, held, factor)
    return rests, is_singular(jacobian, task)


@inner
def way_to_posture(way: float, turn: float) -> float:
    """
    Return a displacement to a posture without whole turns, where these make no difference [rad].

    :param turn: 2 pi where they make none, or 0
    """
    return way - turn * math.floor(way / (2.0 * math.pi) + 0.5)


@inner
def project_free(factor: FloatArray, velocity: FloatArray, result: FloatArray) -> None:
    """Write the part of joint velocities, or displacements, that makes no difference to a task."""
    solve(factor, velocity, len(result), result)
    for i in range(len(result)):
        result[i] *= POSTURE


@inner
def _find_unbounded(jacobian: FloatArray, task: FloatArray, low: FloatArray, high: FloatArray,
                    away: FloatArray, square: FloatArray, pull: FloatArray, factor: FloatArray,
                    wanted: FloatArray, step: FloatArray, drift: FloatArray) -> bool:
    """
    Write the displacements as if all of the task were possible and no bound were met.

    Where that is so, :func:`_find_bounded` would find the same in ten times the time.

    :param square: of the Jacobian, ``pull`` the task in joints
    :param wanted: solution of the regularized problem, written
    :returns: whether it is so
    """
    count = len(step)
    regular, first, missed = np.empty((count, count)), np.empty(count), np.empty(6)
    factorize(square, _REGULAR, count, regular)
    solve(regular, pull, count, wanted)
    multiply(jacobian, wanted, missed)
    for i in range(6):
        missed[i] = task[i] - missed[i]
    for i in range(count):
        first[i] = pull[i] + _REGULAR * wanted[i]
    solve(regular, first, count, step)
    project_free(factor, away, first)
    project_free(factor, first, drift)
    for i in range(count):
        least, most = min(0.0, first[i], drift[i]), max(0.0, first[i], drift[i])
        if not (low[i] <= step[i] + least and step[i] + most <= high[i]):
            return False
    return norm(wanted) <= _LARGEST and norm(missed) <= _NEGLIGIBLE * norm(task)


@inlined
def _find_bounded(jacobian: FloatArray, task: FloatArray, low: FloatArray, high: FloatArray,
                  away: FloatArray, rested: bool, square: FloatArray, pull: FloatArray,
                  wanted: FloatArray, step: FloatArray, drift: FloatArray, held: BoolArray,
                  factor: FloatArray) -> bool:
    """
    Write the displacements where something keeps the joints from the task.

    :returns: whether the end effector is as near as it can come
    """
    count, whole, weight = len(step), norm(task), POSTURE
    lowest, highest, vector, missed = (
        np.empty(count), np.empty(count), np.empty(count), np.empty(6))
    for i in range(count):
        lowest[i] = clip(low[i], -_LARGEST, _LARGEST)
        highest[i] = clip(high[i], -_LARGEST, _LARGEST)
    minimize_in_box(square, _REGULAR, pull, lowest, highest, step)
    multiply(jacobian, step, missed)
    for i in range(6):
        missed[i] = task[i] - missed[i]
    size = norm(missed)
    possible = size <= _NEGLIGIBLE * whole
    stiffness, bent = np.empty((count, count)), np.empty((count, count))
    for i in range(count):
        for j in range(count):
            stiffness[i, j] = bent[i, j] = square[i, j]
    if not possible:
        curvature = np.empty((count, count))
        _find_curvature(jacobian, missed, curvature)
        for i in range(count):
            for j in range(count):
                bent[i, j] += curvature[i, j]
        _add_positive_part(curvature, stiffness)
        damping = min(_DAMPING, _DAMPING_RATE * size)
        for i in range(count):
            stiffness[i, i] += damping
        weight += _POSTURE_RATE * size
    for i in range(count):
        vector[i] = pull[i] + _REGULAR * step[i]
    minimize_in_box(stiffness, _REGULAR, vector, low, high, step)
    for i in range(count):
        held[i] = (step[i] <= low[i] and wanted[i] < low[i]
                   or step[i] >= high[i] and wanted[i] > high[i])
        lowest[i], highest[i], drift[i] = low[i] - step[i], high[i] - step[i], away[i]
    for _ in range(2):  # The first one still moves the end effector by a millionth.
        for i in range(count):
            vector[i] = weight * drift[i]
        minimize_in_box(stiffness, weight, vector, lowest, highest, drift)
    factorize(stiffness, POSTURE, count, factor)
    return not possible and _limit_drift(
        pull, whole, bent, lowest, highest, rested, step, drift)


@inner
def _limit_drift(pull: FloatArray, whole: float, bent: FloatArray, lowest: FloatArray,
                 highest: FloatArray, rested: bool, step: FloatArray, drift: FloatArray) -> bool:
    """
    Limit the way to the posture where not all of a task is possible.

    :param whole: length of the task
    :param bent: second derivative of the squared distance, shape (n, n)
    :returns: whether the end effector is as near as it can come; there is no step then
    """
    count = len(step)
    nearer, moved = dot(pull, step), norm(step)
    share = clip(nearer / max(whole * whole, 1e-18) / _PROGRESS, 0.0, 1.0)
    for i in range(count):
        drift[i] *= share * share
    # The posture must not hold up the motion for the task: the arm would hardly move.
    back = min(dot(drift, step), 0.0) / max(moved * moved, 1e-18)
    bend = np.empty(count)
    multiply(bent, step, bend)
    second = dot(step, bend)
    for i in range(count):
        drift[i] = clip(drift[i] - back * step[i], lowest[i], highest[i])
    again = _WORTH_AGAIN if rested else 1.0
    if nearer <= again * _WORTH * whole * moved and (
            again * _FARTHEST * whole * moved * moved <= second <= again * _CLEAR * moved * moved):
        for i in range(count):
            step[i] = drift[i] = 0.0
        return True
    return False


@inner
def _find_curvature(jacobian: FloatArray, force: FloatArray, result: FloatArray) -> None:
    """
    Write minus the second derivative of the pose along a force, shape (n, n).

    A turn of one joint turns the axis of each joint beyond it, and the lever from there.
    """
    for i in range(result.shape[0]):
        for j in range(i, result.shape[1]):
            lever = axis = 0.0
            for k in range(3):
                # Vector product of the axis of the joint before with force and torque.
                one, two = (k + 1) % 3, (k + 2) % 3
                lever += jacobian[k, j] * (
                    jacobian[3 + one, i] * force[two] - jacobian[3 + two, i] * force[one])
                axis += jacobian[3 + k, j] * (
                    jacobian[3 + one, i] * force[3 + two] - jacobian[3 + two, i] * force[3 + one])
            result[i, j] = result[j, i] = lever + (axis / 2.0 if i < j else 0.0)


@inner
def _add_positive_part(matrix: FloatArray, result: FloatArray) -> None:
    """Add a symmetric matrix without its negative eigenvalues, and a little more."""
    count = len(matrix)
    scale = 0.0
    sign, square, cube = (
        np.empty((count, count)), np.empty((count, count)), np.empty((count, count)))
    for i in range(count):
        for j in range(count):
            scale += matrix[i, j] * matrix[i, j]
    scale = math.sqrt(scale) + 1e-30
    for i in range(count):
        for j in range(count):
            sign[i, j] = matrix[i, j] / scale
    # Newton and Schulz: the sign of the matrix, whose product with the matrix is its magnitude.
    for _ in range(_SIGN_ITERATIONS):
        multiply_matrices(sign, sign, square)
        multiply_matrices(sign, square, cube)
        for i in range(count):
            for j in range(count):
                sign[i, j] = 1.5 * sign[i, j] - 0.5 * cube[i, j]
    multiply_matrices(sign, matrix, square)
    for i in range(count):
        for j in range(count):
            magnitude = (square[i, j] + square[j, i]) / 2.0
            result[i, j] += (matrix[i, j] + magnitude) / 2.0
        result[i, i] += _SIGN_ERROR * scale
