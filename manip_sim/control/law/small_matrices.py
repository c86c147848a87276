# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Algebra of small matrices and vectors, in a fixed order, and a quadratic minimum in a box."""

from __future__ import annotations

import math

import numpy as np

from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.control.law.compiling import compiled, inner

#: Smaller squares on the diagonal of a Cholesky factor are taken for this.
_LEAST_PIVOT = 1e-18
#: Iterations of the minimum in a box at most, and gradients that count as zero there.
_ITERATIONS, _LEAST_PULL = 100, 1e-14
#: Sweeps of Jacobi rotations at most (six are enough for arms), and squares beside a diagonal that
#: count as zero, as a share of those on it.
_SWEEPS, _DIAGONAL = 20, 1e-24


@inner
def clip(value: float, low: float, high: float) -> float:
    """Return a number, or the bound that it is beyond."""
    return min(max(value, low), high)


@inner
def dot(one: FloatArray, other: FloatArray) -> float:
    """Return the scalar product of two vectors."""
    result = 0.0
    for i in range(len(one)):
        result += one[i] * other[i]
    return result


@inner
def norm(vector: FloatArray) -> float:
    """Return the length of a vector."""
    return math.sqrt(dot(vector, vector))


@inner
def norm3(vector: FloatArray, first: int) -> float:
    """Return the length of three components of a vector."""
    return math.sqrt(vector[first] * vector[first] + vector[first + 1] * vector[first + 1]
                     + vector[first + 2] * vector[first + 2])


@inner
def multiply(matrix: FloatArray, vector: FloatArray, result: FloatArray) -> None:
    """Write matrix x vector."""
    for i in range(len(result)):
        total = 0.0
        for j in range(len(vector)):
            total += matrix[i, j] * vector[j]
        result[i] = total


@inner
def multiply_matrices(one: FloatArray, other: FloatArray, result: FloatArray) -> None:
    """Write the product of two matrices."""
    for i in range(result.shape[0]):
        for j in range(result.shape[1]):
            total = 0.0
            for k in range(len(other)):
                total += one[i, k] * other[k, j]
            result[i, j] = total


@inner
def factorize(matrix: FloatArray, added: float, count: int, factor: FloatArray) -> None:
    """
    Write the lower Cholesky factor of a symmetric matrix, both of size (n, n), may be one array.

    :param added: to the diagonal of the matrix
    :param count: of the first rows and columns that are used
    """
    for i in range(count):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            if i == j:
                factor[i, i] = math.sqrt(max(total + added, _LEAST_PIVOT))
            else:
                factor[i, j] = total / factor[j, j]


@inner
def solve_lower(factor: FloatArray, vector: FloatArray, count: int, result: FloatArray) -> None:
    """Write the solution of a system with a lower triangular matrix; vectors may be one."""
    for i in range(count):
        total = vector[i]
        for k in range(i):
            total -= factor[i, k] * result[k]
        result[i] = total / factor[i, i]


@inner
def solve(factor: FloatArray, vector: FloatArray, count: int, result: FloatArray) -> None:
    """
    Write the solution of a system whose matrix has a Cholesky factor; vectors may be one.

    :param count: of the first rows and columns that are used
    """
    solve_lower(factor, vector, count, result)
    for i in range(count - 1, -1, -1):
        total = result[i]
        for k in range(i + 1, count):
            total -= factor[k, i] * result[k]
        result[i] = total / factor[i, i]


@compiled
def diagonalize(matrix: FloatArray, vectors: FloatArray) -> None:
    """
    Find the eigenvalues of a symmetric matrix by Jacobi rotations, which it has on its diagonal.

    :param matrix: shape (n, n), changed
    :param vectors: the eigenvectors in its columns, written, shape (n, n)
    """
    count = len(matrix)
    for i in range(count):
        for j in range(count):
            vectors[i, j] = 1.0 if i == j else 0.0
    for _ in range(_SWEEPS):
        aside = along = 0.0
        for i in range(count):
            along += matrix[i, i] * matrix[i, i]
            for j in range(i):
                aside += matrix[i, j] * matrix[i, j]
        if aside <= _DIAGONAL * along:
            return
        for i in range(1, count):
            for j in range(i):
                if matrix[i, j] != 0.0:
                    _rotate(matrix, vectors, i, j)


@inner
def _rotate(matrix: FloatArray, vectors: FloatArray, i: int, j: int) -> None:
    """Turn two axes so that a place of a symmetric matrix becomes zero."""
    half = (matrix[j, j] - matrix[i, i]) / (2.0 * matrix[i, j])
    tangent = 1.0 / (abs(half) + math.sqrt(half * half + 1.0))
    if half < 0.0:
        tangent = -tangent
    cos = 1.0 / math.sqrt(tangent * tangent + 1.0)
    sin = tangent * cos
    for k in range(len(matrix)):
        one, other = matrix[k, i], matrix[k, j]
        matrix[k, i], matrix[k, j] = cos * one - sin * other, sin * one + cos * other
        one, other = vectors[k, i], vectors[k, j]
        vectors[k, i], vectors[k, j] = cos * one - sin * other, sin * one + cos * other
    for k in range(len(matrix)):
        one, other = matrix[i, k], matrix[j, k]
        matrix[i, k], matrix[j, k] = cos * one - sin * other, sin * one + cos * other


@compiled
def minimize_in_box(matrix: FloatArray, added: float, vector: FloatArray, low: FloatArray,
                    high: FloatArray, place: FloatArray) -> None:
    """
    Write where x (matrix + added 1) x / 2 - vector x is smallest within bounds.

    An active set: a step to the minimum in the free coordinates ends at the first bound that it
    meets, which is held; at the minimum the bound is released that the gradient pulls away from
    most.

    :param matrix: symmetric, without negative eigenvalues, shape (n, n)
    :param added: to its diagonal, above 0
    :param low: lowest coordinates, shape (n,)
    :param high: highest coordinates, shape (n,)
    :param place: written, shape (n,)
    """
    count, number, full = len(vector), 0, False
    free, held, gradient = (
        np.empty(count, np.int64), np.zeros(count, np.bool_), np.empty(count))
    factor, search = np.empty((count, count)), np.empty(count)
    for i in range(count):
        place[i] = clip(0.0, low[i], high[i])
    for _ in range(_ITERATIONS):
        multiply(matrix, place, gradient)
        for i in range(count):
            gradient[i] += added * place[i] - vector[i]
        if not full:
            number = 0
            for i in range(count):
                if not held[i]:
                    free[number] = i
                    for j in range(number + 1):
                        factor[number, j] = matrix[i, free[j]]
                    number += 1
            factorize(factor, added, number, factor)
        for i in range(number):
            search[i] = -gradient[free[i]]
        solve(factor, search, number, search)
        met = _step_in_box(free, number, search, low, high, place)
        if met >= 0:
            held[met], full = True, False
        elif not full:
            full = True  # A second step corrects the rounding of the first one.
        else:
            released = _most_pulled(held, gradient, low, high, place)
            if released < 0:
                return
            held[released], full = False, False


@inner
def _step_in_box(free: IntArray, number: int, search: FloatArray, low: FloatArray,
                 high: FloatArray, place: FloatArray) -> int:
    """Make a step, or as much of it as bounds allow; return the coordinate at its bound, or -1."""
    share, met = 1.0, -1
    for i in range(number):
        j = free[i]
        room = (high[j] if search[i] > 0.0 else low[j]) - place[j]
        if abs(room) < share * abs(search[i]):
            share, met = room / search[i], j
    for i in range(number):
        j = free[i]
        place[j] = clip(place[j] + share * search[i], low[j], high[j])
        if j == met:
            place[j] = high[j] if search[i] > 0.0 else low[j]
    return met


@inner
def _most_pulled(held: BoolArray, gradient: FloatArray, low: FloatArray, high: FloatArray,
                 place: FloatArray) -> int:
    """Return the held coordinate that would most decrease the function inwards, or -1."""
    result, most = -1, _LEAST_PULL
    for i in range(len(place)):
        pull = -gradient[i] if place[i] <= low[i] else gradient[i]
        if held[i] and low[i] < high[i] and pull > most:
            result, most = i, pull
    return result


@inner
def rotation_matrix(vector: FloatArray, first: int, scale: float, matrix: FloatArray) -> None:
    """
    Write the rotation matrix of a rotation vector.

    :param vector: whose three components from ``first`` on are it over ``scale`` [rad]
    :param matrix: shape (3, 3)
    """
    angle = scale * norm3(vector, first)
    share = scale * math.sin(angle / 2.0) / angle if angle > 0.0 else 0.0
    w, x = math.cos(angle / 2.0), share * vector[first]
    y, z = share * vector[first + 1], share * vector[first + 2]
    matrix[0, 0], matrix[0, 1], matrix[0, 2] = (
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y))
    matrix[1, 0], matrix[1, 1], matrix[1, 2] = (
        2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x))
    matrix[2, 0], matrix[2, 1], matrix[2, 2] = (
        2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y))


@compiled
def rotation_vector(rotation: FloatArray, error: FloatArray) -> None:
    """
    Write the rotation vector of a rotation matrix [rad], not longer than pi.

    :param rotation: shape (3, 3)
    :param error: whose last three components are written, shape (6,)
    """
    result = np.empty(3)
    trace = rotation[0, 0] + rotation[1, 1] + rotation[2, 2]
    result[0] = rotation[2, 1] - rotation[1, 2]
    result[1] = rotation[0, 2] - rotation[2, 0]
    result[2] = rotation[1, 0] - rotation[0, 1]
    if trace > 0.0:
        # Quaternion (w, x, y, z) times 2 s: s^2, and the differences above.
        real = trace + 1.0
    else:
        k = 0
        for i in range(1, 3):
            if rotation[i, i] > rotation[k, k]:
                k = i
        real = result[k]
        for i in range(3):
            result[i] = rotation[i, k] + rotation[k, i]
        result[k] = 1.0 + 2.0 * rotation[k, k] - trace
        if real < 0.0:
            real = -real
            for i in range(3):
                result[i] = -result[i]
    size = norm(result)
    share = 2.0 * math.atan2(size, real) / size if size > 0.0 else 0.0
    for i in range(3):
        error[3 + i] = share * result[i]
