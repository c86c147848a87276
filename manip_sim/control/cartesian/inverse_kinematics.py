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

from collections.abc import Callable, Iterable, Sequence
import functools
from typing import NamedTuple

import mujoco
from mujoco import (
    mju_cholFactor, mju_cholSolve, mju_mulMatMat, mju_mulMatTMat, mju_mulMatTVec, mju_mulMatVec,
    mju_norm)
import numpy as np

from manip_sim.algebra import (
    dot, factorized, LEAST_PIVOT, length, product, transposed_product, with_diagonal)
from manip_sim.arrays import BoolArray, FloatArray
from manip_sim.control.cartesian.singularities import is_singular, SINGULAR
from manip_sim.control.motion_profiles import within

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
#: An end effector rests if a step brings it nearer by less than this for each radian [m/rad], and
#: until one does by so many times as much: where it may rest does not change from step to step ...
_WORTH, _WORTH_AGAIN = 2e-3, 2.0
#: ... unless it is farthest there, as its distance bends down this much [m/rad^2], or the squared
#: distance bends up so much that the nearest place is near [m^2/rad^2].
_FARTHEST, _CLEAR = -0.05, 0.1
#: With less progress than this, as a share, the posture matters less.
_PROGRESS = 0.1
#: Iterations for the sign of a matrix, and what is added so that it is positive in any case.
_SIGN_ITERATIONS, _SIGN_ERROR = 10, 0.005


class Displacement(NamedTuple):
    """
    Displacements of the joints of an arm.

    :ivar step: for the task [rad], shape (n,)
    :ivar drift: of a redundant arm towards its posture, which leaves the end effector where it is
        [rad], shape (n,)
    :ivar held: whether the range of a joint keeps it from doing more, shape (n,)
    :ivar factor: Cholesky factor of the second derivative of what the step makes smaller, with the
        weight of the posture, shape (n, n)
    :ivar rests: whether the end effector is as near as it can come, so that there is no step
    :ivar jacobian: of the end effector, shape (6, n)
    :ivar task: wanted motion of the end effector, shape (6,)
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
        """Whether a motion is wanted in a direction in which the end effector can hardly move."""
        return not self.easy and is_singular(self.jacobian, self.task)


class Displacements:
    """
    Displacements of the joints of one arm, or of several of as many joints, each a row.

    For several, fewer calls are needed than one by one, with the same bits. For one arm, arrays
    have no axis of rows.

    :param jacobians: of position and rotation of the end effectors, shape (rows, 6, n), the joints
        in their order from the base to the end effector
    :param tasks: wanted translations [m] and rotation vectors [rad], shape (rows, 6)
    :param low: lowest displacements within the ranges of the joints [rad], shape (rows, n)
    :param high: highest displacements [rad], shape (rows, n)
    :param away: displacements to the postures [rad], shape (rows, n)
    :param rested: whether each end effector rested before
    :ivar step: as of :class:`Displacement`, shape (rows, n); ``drift`` too
    :ivar rests: of each end effector
    """

    def __init__(self, jacobians: FloatArray, tasks: FloatArray, low: FloatArray,
                 high: FloatArray, away: FloatArray, rested: Sequence[bool]) -> None:
        self._one, self._jacobians, self._tasks = tasks.ndim == 1, jacobians, tasks
        self._rows: Callable[..., Iterable[tuple[FloatArray, ...]]] = _only if self._one else zip
        self.rests = [False] * len(rested)
        #: The displacements where not all of a task is possible, or a bound is met.
        self._bounded: dict[int, Displacement] = {}
        squares, pulls, wanted, outside = self._unbounded(low, high, away)
        if not outside:
            return
        for row, (jacobian, task, square, pull, sought, lowest, highest, posture, *results) in (
                enumerate(self._rows(jacobians, tasks, squares, pulls, wanted, low, high, away,
                                     self.step, self.drift, self._factors))):
            if row in outside:
                one = self._bounded[row] = _bounded(
                    jacobian, task, square, self._whole[row], pull, sought, lowest, highest,
                    posture, rested[row])
                for result, found in zip(results, (one.step, one.drift, one.factor)):
                    result[:] = found
                self.rests[row] = one.rests

    def _unbounded(self, low: FloatArray, high: FloatArray, away: FloatArray
                   ) -> tuple[FloatArray, FloatArray, FloatArray, list[int]]:
        """
        Find the displacements as if all of the tasks were possible and no bound were met.

        Where that is so, they are those of :func:`_bounded`, found in a tenth of the time.

        :returns: squares of the Jacobians, the tasks and their solutions in joints, and the rows
            where it is not so
        """
        shape, tasks = away.shape, self._tasks
        squares, pulls, wanted = np.empty((*shape, shape[-1])), np.empty(shape), np.empty(shape)
        for square, pull, jacobian, task in self._rows(squares, pulls, self._jacobians, tasks):
            mju_mulMatTMat(square, jacobian, jacobian)
            mju_mulMatTVec(pull, jacobian, task)
        regular_diagonal, posture_diagonal = _diagonals(shape[-1])
        regulars, factors = squares + regular_diagonal, squares + posture_diagonal
        made, step, first, drift = (
            np.empty(tasks.shape), np.empty(shape), np.empty(shape), np.empty(shape))
        self._far, self._whole = [], []
        for regular, factor, sought, pull, jacobian, task, moved in self._rows(
                regulars, factors, wanted, pulls, self._jacobians, tasks, made):
            mju_cholFactor(regular, LEAST_PIVOT)
            mju_cholFactor(factor, LEAST_PIVOT)
            mju_cholSolve(sought, regular, pull)
            mju_mulMatVec(moved, jacobian, sought)
            self._far.append(mju_norm(sought))
            self._whole.append(mju_norm(task))
        missed = tasks - made
        exact = _REGULAR * wanted
        exact += pulls
        missing = []
        for regular, factor, pull, way, free, posture, error in self._rows(
                regulars, factors, exact, step, first, away, missed):
            mju_cholSolve(way, regular, pull)
            mju_cholSolve(free, factor, posture)
            missing.append(mju_norm(error))
        first *= _POSTURE
        for factor, vector, free in self._rows(factors, first, drift):
            mju_cholSolve(free, factor, vector)
        drift *= _POSTURE
        self.step, self.drift, self._factors = step, drift, factors
        ends = np.empty((3, *shape))
        ends[:] = step
        ends[1] += first
        ends[2] += drift
        over = (ends < low) | (ends > high)
        outside = [
            row for row, (far, whole, error) in enumerate(zip(self._far, self._whole, missing))
            if not (far <= _LARGEST and error <= _NEGLIGIBLE * whole)]
        if np.count_nonzero(over):
            met = np.flatnonzero(over.any(axis=(0, -1)))
            outside = sorted({*outside, *met.tolist()})
        return squares, pulls, wanted, outside

    def slack(self, velocity: FloatArray) -> FloatArray:
        """
        Return the part of joint velocities that makes no difference to the tasks.

        :param velocity: shape (rows, n); the result too
        """
        result = np.empty(velocity.shape)
        for free, factor, own in self._rows(result, self._factors, velocity):
            mju_cholSolve(free, factor, own)
        result *= _POSTURE
        return result

    def row(self, row: int = 0) -> Displacement:
        """Return the displacements of one arm."""
        if row in self._bounded:
            return self._bounded[row]
        step, drift, factor, jacobian, task = [
            of if self._one else of[row]
            for of in (self.step, self.drift, self._factors, self._jacobians, self._tasks)]
        # Half of the task in a direction of hardly any motion would need more.
        return Displacement(
            step, drift, np.zeros(len(step), dtype=bool), factor, False, jacobian, task,
            easy=self._far[row] * SINGULAR <= 0.4 * self._whole[row])


def _only(*arrays: FloatArray) -> tuple[tuple[FloatArray, ...]]:
    """Return the arrays of one arm as those of its only row."""
    return arrays,


@functools.cache
def _diagonals(size: int) -> tuple[FloatArray, FloatArray]:
    """Return what is added to matrices so that they are regular, and for the posture, (n, n)."""
    return _REGULAR * np.eye(size), _POSTURE * np.eye(size)


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
    return Displacements(jacobian, task, low, high, away, [rested]).row()


def _bounded(jacobian: FloatArray, task: FloatArray, square: FloatArray, whole: float,
             pull: FloatArray, wanted: FloatArray, low: FloatArray, high: FloatArray,
             away: FloatArray, rested: bool) -> Displacement:
    """
    Return the displacements for a task where something keeps the joints from it.

    :param square: of the Jacobian
    :param whole: length of the task, ``pull`` and ``wanted`` it and its solution in joints
    """
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
    for _ in range(2):  # The first one still moves the end effector by a millionth.
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
    linear, angular = jacobian[:3], jacobian[3:]
    from_own, beyond = _upper(jacobian.shape[1])
    upper = from_own * product(transposed_product(angular, _cross(force[:3])), linear)
    axes = beyond * product(transposed_product(angular, _cross(force[3:])), angular)
    axes /= 2.0
    upper += axes
    return np.asarray(upper + (beyond * upper).T)


@functools.cache
def _upper(size: int) -> tuple[FloatArray, FloatArray]:
    """Return ones on and above the diagonal, and above it alone, of shape (n, n)."""
    ones = np.ones((size, size))
    return np.triu(ones), np.triu(ones, 1)


def _cross(vector: FloatArray) -> FloatArray:
    """Return the matrix of the cross product from the left with a vector, shape (3, 3)."""
    x, y, z = vector.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _positive_part(matrix: FloatArray) -> FloatArray:
    """Return a symmetric matrix without its negative eigenvalues, and a little more."""
    scale = length(matrix.ravel()) + 1e-30
    # Newton and Schulz: the sign of the matrix, whose product with the matrix is its magnitude.
    sign = matrix / scale
    square, cube = np.empty((2, *matrix.shape))
    for _ in range(_SIGN_ITERATIONS):
        mju_mulMatMat(square, sign, sign)
        mju_mulMatMat(cube, sign, square)
        cube *= 0.5
        sign *= 1.5
        sign -= cube
    magnitude = product(sign, matrix)
    magnitude = (magnitude + magnitude.T) / 2.0
    return np.asarray((matrix + magnitude) / 2.0 + _SIGN_ERROR * scale * np.eye(len(matrix)))
