# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Cartesian impedance: springs and dampers between an end effector and its reference.

The inertia of the arm stays as it is, unlike in :mod:`operational_space`, so a force moves the end
effector by force / stiffness. The damping matrix is that of Albu-Schaeffer et al. (2003),
"Cartesian impedance control of redundant robots": each mode of the springs and the inertia has
the damping ratio. All of it is computed in coordinates of the joints in which the inertia is the
unit matrix, y = L^T q with M = L L^T, so that it also holds for arms with fewer than six joints
and where an arm is singular.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.control.law.arm_records import Arm, Goal, Motion
from manip_sim.control.law.compiling import inner
from manip_sim.control.law.displacement import way_to_posture
from manip_sim.control.law.loads import find_inertia, Loads
from manip_sim.control.law.operational_space import find_error, find_jacobian
from manip_sim.control.law.small_matrices import (
    clip, diagonalize, dot, factorize, multiply, multiply_transposed, solve)
from manip_sim.physics.physics import WorldArrays

#: Greatest natural frequency of a mode, times the length of an interval: springs and dampers that
#: are sampled stay stable up to 0.8 at critical damping.
_FASTEST = 0.5
#: Damping of an axis at most, times the length of an interval and the mobility there.
_BRAKE = 0.25
#: Shares that are added to the diagonal of the mobility of the end effector: to tell motions of
#: the posture from its own, and to find the motion of the joints with its reference, which near a
#: singularity has to stay small.
_APART, _REGULAR = 1e-6, 1e-3


class Springs(NamedTuple):
    """
    Springs and dampers of an end effector.

    :ivar stiffness: along and about the axes [N/m, N m/rad], shape (6,)
    :ivar brakes: dampers along and about the axes [N s/m, N m s/rad], and velocities beyond which
        an end effector is braked there [m/s, rad/s], shape (2, 6)
    :ivar axes: of the springs in the world, shape (3, 3)
    :ivar damping_ratio: 1 is critical damping
    :ivar null_stiffness: towards the posture, where that leaves the end effector alone [N m/rad]
    :ivar push: force and torque that the end effector exerts beside, in the world [N, N m], (6,)
    """

    stiffness: FloatArray
    brakes: FloatArray
    axes: FloatArray
    damping_ratio: float
    null_stiffness: float
    push: FloatArray


@inner
def impede(world: WorldArrays, loads: Loads, arm: Arm, place: FloatArray, turned: FloatArray,
           reference: Goal, acceleration: FloatArray, postures: FloatArray, springs: Springs,
           duration: float, motion: Motion) -> None:
    """
    Write the efforts of the joints, within their limits.

    :param loads: payloads, whose weight is carried beside
    :param place: position of the end effector in the world [m], shape (3,)
    :param turned: its rotation in the world, shape (3, 3)
    :param reference: pose to which the springs pull, and its velocity
    :param acceleration: of the reference, in the world [m/s^2, rad/s^2], shape (6,)
    :param postures: positions that redundant arms are drawn to, of all joints [rad]
    :param duration: of the interval, in the middle of which the efforts are exact [s]
    """
    count = len(arm.joints)
    jacobian, velocity, away = np.empty((6, count)), np.empty(count), np.empty(count)
    root, carried = np.zeros((count, count)), np.empty((count, 6))
    find_jacobian(world.kinematics, arm, place, jacobian)
    find_error(place, turned, reference, motion.error)
    for i in range(count):
        joint = arm.joints[i]
        velocity[i] = world.velocities[joint.dof]
        position = world.kinematics.positions[joint.qpos] + velocity[i] * duration / 2.0
        away[i] = way_to_posture(postures[joint.joint] - position, joint.turn)
    find_inertia(world, loads, arm, root)
    factorize(root, 0.0, count, root)
    multiply(jacobian, velocity, motion.twist)
    column = np.empty(count)
    for k in range(6):
        _solve_lower(root, jacobian[k], column)
        for i in range(count):
            carried[i, k] = column[i]
    force, stiffness = np.zeros(count), np.zeros((count, count))
    _pull(carried, springs, motion, reference.along, duration, force, stiffness)
    mobility = np.empty((6, 6))
    if springs.null_stiffness > 0.0:
        _find_mobility(carried, _APART, mobility)
        _pull_to_posture(root, carried, mobility, springs.null_stiffness, away, force, stiffness)
    flow = np.empty(count)  # Velocity with respect to that of the reference.
    multiply_transposed(_lower(root), velocity, flow)
    _find_mobility(carried, _REGULAR, mobility)
    _go_along(carried, mobility, reference.along, -1.0, flow)
    _damp(stiffness, springs.damping_ratio, flow, duration, force)
    _go_along(carried, mobility, acceleration, 1.0, force)
    for i in range(count):
        for k in range(6):
            force[i] += carried[i, k] * springs.push[k]
    for i in range(count):
        joint = arm.joints[i]
        effort = (world.bias[joint.dof] - world.carried[joint.dof]
                  + joint.damping * velocity[i])
        for j in range(i + 1):
            effort += root[i, j] * force[j]
        motion.efforts[i] = clip(effort, joint.weakest, joint.strongest)


@inner
def _solve_lower(root: FloatArray, vector: FloatArray, result: FloatArray) -> None:
    """Write the solution of a system with a lower triangular matrix."""
    for i in range(len(result)):
        total = vector[i]
        for k in range(i):
            total -= root[i, k] * result[k]
        result[i] = total / root[i, i]


@inner
def _lower(root: FloatArray) -> FloatArray:
    """Return the lower triangle of a matrix."""
    result = np.zeros(root.shape)
    for i in range(len(root)):
        for j in range(i + 1):
            result[i, j] = root[i, j]
    return result


@inner
def _pull(carried: FloatArray, springs: Springs, motion: Motion, along: FloatArray,
          duration: float, force: FloatArray, stiffness: FloatArray) -> None:
    """
    Add the springs and brakes of the end effector, all in coordinates of unit inertia.

    :param carried: transposed Jacobian of the end effector, shape (n, 6)
    :param along: velocity of the reference in the world [m/s, rad/s], shape (6,)
    """
    count, row = len(force), np.empty(len(force))
    for half in range(2):
        for i in range(3):
            k, error, speed = springs.stiffness[3 * half + i], 0.0, 0.0
            for j in range(3):
                axis, n = springs.axes[j, i], 3 * half + j
                speed += axis * (motion.twist[n] - along[n])
                error += axis * motion.error[n]
            for m in range(count):
                row[m] = 0.0
                for j in range(3):
                    row[m] += springs.axes[j, i] * carried[m, 3 * half + j]
            limit, most = springs.brakes[1, 3 * half + i], _BRAKE / duration / dot(row, row)
            pull = (k * (error - speed * duration / 2.0)
                    - min(springs.brakes[0, 3 * half + i], most) * speed)
            if abs(speed) > limit:
                pull -= most * (speed - clip(speed, -limit, limit))
            for m in range(count):
                force[m] += pull * row[m]
                for n in range(count):
                    stiffness[m, n] += k * row[m] * row[n]


@inner
def _find_mobility(carried: FloatArray, added: float, factor: FloatArray) -> None:
    """
    Write the Cholesky factor of the mobility of the end effector, its inverse inertia.

    :param added: to the diagonal, as a share of it
    """
    for i in range(6):
        for j in range(i + 1):
            total = 0.0
            for k in range(len(carried)):
                total += carried[k, i] * carried[k, j]
            factor[i, j] = factor[j, i] = total
        factor[i, i] *= 1.0 + added
    factorize(factor, 0.0, 6, factor)


@inner
def _go_along(carried: FloatArray, mobility: FloatArray, twist: FloatArray, scale: float,
              flow: FloatArray) -> None:
    """Add the motion of the joints that moves the end effector in a way."""
    if not twist.any():
        return
    inverse = np.empty(6)
    solve(mobility, twist, 6, inverse)
    for i in range(len(flow)):
        for k in range(6):
            flow[i] += scale * carried[i, k] * inverse[k]


@inner
def _pull_to_posture(root: FloatArray, carried: FloatArray, mobility: FloatArray, stiffness: float,
                     away: FloatArray, force: FloatArray, total: FloatArray) -> None:
    """Add the springs to the posture in what makes no difference to the end effector."""
    count = len(force)
    free, column, shares = np.empty((count, count)), np.empty(count), np.empty(6)
    for j in range(count):
        for i in range(count):
            column[i] = 1.0 if i == j else 0.0
        _solve_lower(root, column, column)
        multiply_transposed(carried, column, shares)
        solve(mobility, shares, 6, shares)
        for i in range(count):
            free[i, j] = column[i]
            for k in range(6):
                free[i, j] -= carried[i, k] * shares[k]
    for i in range(count):
        for j in range(count):
            force[i] += stiffness * free[i, j] * away[j]
            for k in range(count):
                total[i, j] += stiffness * free[i, k] * free[j, k]


@inner
def _damp(stiffness: FloatArray, ratio: float, flow: FloatArray, duration: float,
          force: FloatArray) -> None:
    """Soften modes that are too fast for the interval, and add the forces of the dampers."""
    count = len(force)
    modes, pulls = np.empty((count, count)), np.zeros(count)
    diagonalize(stiffness, modes)
    fastest = _FASTEST / duration / max(ratio, 1.0)
    for k in range(count):
        rate = math.sqrt(max(stiffness[k, k], 0.0))
        share = min(1.0, fastest / rate) if rate > 0.0 else 1.0
        pull = speed = 0.0
        for i in range(count):
            pull += modes[i, k] * force[i]
            speed += modes[i, k] * flow[i]
        pulls[k] = share * share * pull - 2.0 * ratio * share * rate * speed
    multiply(modes, pulls, force)
