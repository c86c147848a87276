# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Efforts of an end effector: operational space control and Cartesian impedance.

With *operational space control* it behaves like a mass on a spring and damper. As Khatib (1987) it
accelerates as these say, whatever the inertia of the arm; here by joint accelerations rather than
by a force at the end effector, which is the same for the end effector and well behaved where the
arm is singular. What leaves the end effector where it is goes to a posture.

With *Cartesian impedance* the inertia of the arm stays as it is, so a force moves the end effector
by force / stiffness from its reference. The damping matrix is that of Albu-Schaeffer et al.
(2003), "Cartesian impedance control of redundant robots": each mode of the springs and the inertia
has the damping ratio. All of it is computed in coordinates of the joints in which the inertia is
the unit matrix, y = L^T q with M = L L^T, so that it also holds for arms with fewer than six
joints and where an arm is singular.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from manip_sim.arrays import BoolArray, FloatArray
from manip_sim.control.law.compiling import compiled, inner
from manip_sim.control.law.inverse_kinematics import displace, project_free, way_to_posture
from manip_sim.control.law.loads import find_inertia, Loads, velocity_at
from manip_sim.control.law.records import Arm, Goal, Motion, Spring
from manip_sim.control.law.small_matrices import (
    clip, diagonalize, dot, factorize, multiply, multiply_matrices, norm3, rotation_vector, solve,
    solve_lower)
from manip_sim.physics.physics import Kinematics, WorldArrays

#: Stiffness towards the posture in the null space [1/s^2], critically damped; that of robosuite.
_POSTURE = 10.0
_POSTURE_DAMPING = 2.0 * math.sqrt(_POSTURE)
#: Displacements are sought for a longer motion than this no more [m], [rad].
_LARGEST_STEP, _LARGEST_TURN = 0.1, 0.5
#: Greatest natural frequency of a mode, times the length of an interval: springs and dampers that
#: are sampled stay stable up to 0.8 at critical damping.
_FASTEST = 0.5
#: Damping of an axis at most, times the length of an interval and the mobility there.
_BRAKE = 0.25
#: Shares that are added to the diagonal of the mobility of the end effector: to tell motions of
#: the posture from its own, and to find the motion of the joints with its reference, which near a
#: singularity has to stay small.
_APART, _REGULAR = 1e-6, 1e-3


@compiled
def exert(world: WorldArrays, loads: Loads, arm: Arm, place: FloatArray, turned: FloatArray,
          goal: Goal, postures: FloatArray, spring: Spring, rested: bool, motion: Motion
          ) -> tuple[bool, bool, bool]:
    """
    Write the efforts that move an end effector to its goal, within the limits of the joints.

    :param loads: payloads, whose weight is carried beside
    :param place: position of the end effector in the world [m], shape (3,)
    :param turned: its rotation in the world, shape (3, 3)
    :param postures: positions that redundant arms are drawn to, of all joints [rad]
    :param rested: whether the end effector was as near as it can come before
    :returns: whether it is as near as it can come, whether a motion is wanted in a direction in
        which it can hardly move, and whether velocity limits of joints slow it down
    """
    count = len(arm.joints)
    jacobian, velocity, accelerations = np.empty((6, count)), np.empty(count), np.empty(count)
    low, high, away, most = np.empty(count), np.empty(count), np.empty(count), np.empty(count)
    find_jacobian(world.kinematics, arm, place, jacobian)
    find_error(place, turned, goal, motion.error)
    for i in range(count):
        joint = arm.joints[i]
        velocity[i], most[i] = world.velocities[joint.dof], joint.velocity_limit
        position = world.kinematics.positions[joint.qpos]
        low[i], high[i] = joint.low - position, joint.high - position
        away[i] = way_to_posture(postures[joint.joint] - position, joint.turn)
    multiply(jacobian, velocity, motion.twist)
    flags = accelerate(jacobian, motion.error, goal.along, spring, most, low, high, away,
                       velocity, rested, motion.held, accelerations)
    inertia = np.empty((count, count))
    find_inertia(world, loads, arm, inertia)
    for i in range(count):
        joint = arm.joints[i]
        # Gravity that is compensated needs no effort here.
        effort = (world.bias[joint.dof] - world.carried[joint.dof]
                  + joint.damping * velocity[i])
        for j in range(count):
            effort += inertia[i, j] * accelerations[j]
        motion.efforts[i] = clip(effort, joint.weakest, joint.strongest)
    return flags


@compiled
def accelerate(jacobian: FloatArray, error: FloatArray, along: FloatArray, spring: Spring,
               velocity_limit: FloatArray, low: FloatArray, high: FloatArray, away: FloatArray,
               velocity: FloatArray, rested: bool, held: BoolArray, accelerations: FloatArray
               ) -> tuple[bool, bool, bool]:
    """
    Write the accelerations of the joints [rad/s^2], shape (n,).

    Those of the end effector are damping times its velocity error, in all six directions. The
    velocity is that at which spring and damper are in balance, limited to those of the settings
    and of the joints, and to what the arm can do near a singularity and near the ends of ranges.

    :param jacobian: of position and rotation of the end effector, shape (6, n)
    :param error: translation [m] and rotation vector [rad] to the goal, shape (6,)
    :param low: lowest displacements within the ranges of the joints [rad], shape (n,)
    :param high: highest displacements [rad], shape (n,)
    :param away: displacements to the posture [rad], shape (n,)
    :param velocity: of the joints [rad/s], shape (n,)
    :returns: as of :func:`exert`
    """
    count = len(velocity)
    task, step, drift, slack = np.empty(6), np.empty(count), np.empty(count), np.empty(count)
    factor = np.empty((count, count))
    duration_s = _find_task(error, along, spring, task)
    rests, singular = displace(
        jacobian, task, low, high, away, rested, step, drift, held, factor)
    excess = 0.0
    for i in range(count):
        excess = max(excess, abs(step[i]) / duration_s / velocity_limit[i])
    project_free(factor, velocity, slack)
    for i in range(count):
        wanted = step[i] / duration_s / max(excess, 1.0)
        accelerations[i] = spring.damping * (wanted - velocity[i] + slack[i]) + (
            _POSTURE * drift[i] - _POSTURE_DAMPING * slack[i])
    return rests, singular, excess > 1.0 + 1e-6


@inner
def _find_task(error: FloatArray, along: FloatArray, spring: Spring, task: FloatArray) -> float:
    """
    Write the motion at which spring and damper are in balance.

    :returns: in how long it is made [s]
    """
    rate = spring.stiffness / spring.damping
    duration_s = 1.0 / rate
    way, turn = rate * norm3(error, 0), rate * norm3(error, 3)
    slower = min(1.0, spring.linear_velocity / max(way, 1e-12))
    calmer = min(1.0, spring.angular_velocity / max(turn, 1e-12))
    for i in range(3):
        task[i] = slower * rate * error[i] + along[i]
        task[3 + i] = calmer * rate * error[3 + i] + along[3 + i]
    duration_s = min(duration_s, _LARGEST_STEP / max(norm3(task, 0), 1e-12),
                     _LARGEST_TURN / max(norm3(task, 3), 1e-12))
    for i in range(6):
        task[i] *= duration_s
    return duration_s


@inner
def find_jacobian(kinematics: Kinematics, arm: Arm, place: FloatArray, jacobian: FloatArray
                  ) -> None:
    """Write the Jacobian of position and rotation of the end effector, shape (6, n)."""
    center = kinematics.centers[arm.root]
    for i in range(len(arm.joints)):
        joint = arm.joints[i]
        motion = kinematics.motions[joint.dof]
        for k in range(3):
            linear = velocity_at(place, motion, center, k)
            jacobian[k, i] = linear if joint.moves else 0.0
            jacobian[3 + k, i] = motion[k] if joint.moves else 0.0


@inner
def find_error(place: FloatArray, turned: FloatArray, goal: Goal, error: FloatArray) -> None:
    """Write translation [m] and rotation vector [rad] from an end effector to its goal, (6,)."""
    turn, wanted = np.empty((3, 3)), np.empty((3, 3))
    multiply_matrices(goal.axes, goal.rotation, wanted)
    for i in range(3):
        error[i] = goal.origin[i] - place[i]
        for j in range(3):
            error[i] += goal.axes[i, j] * goal.position[j]
            turn[i, j] = (wanted[i, 0] * turned[j, 0] + wanted[i, 1] * turned[j, 1]
                          + wanted[i, 2] * turned[j, 2])
    rotation_vector(turn, error)


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

    Where these limit the force, all of it is less, and its direction stays: if single joints gave
    less than their part, an arm that presses on a floor could swing for ever.

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
        solve_lower(root, jacobian[k], count, column)
        for i in range(count):
            carried[i, k] = column[i]
    force, stiffness = np.zeros(count), np.zeros((count, count))
    _pull(carried, springs, motion, reference.along, duration, force, stiffness)
    mobility = np.empty((6, 6))
    if springs.null_stiffness > 0.0:
        _find_mobility(carried, _APART, mobility)
        _pull_to_posture(root, carried, mobility, springs.null_stiffness, away, force, stiffness)
    flow = np.zeros(count)  # Velocity with respect to that of the reference.
    for i in range(count):
        for j in range(i, count):
            flow[i] += root[j, i] * velocity[j]
    _find_mobility(carried, _REGULAR, mobility)
    _go_along(carried, mobility, reference.along, -1.0, flow)
    _damp(stiffness, springs.damping_ratio, flow, duration, force)
    _go_along(carried, mobility, acceleration, 1.0, force)
    for i in range(count):
        for k in range(6):
            force[i] += carried[i, k] * springs.push[k]
    share, held = 1.0, np.empty(count)
    for i in range(count):
        joint = arm.joints[i]
        held[i] = effort = (world.bias[joint.dof] - world.carried[joint.dof]
                            + joint.damping * velocity[i])
        for j in range(i + 1):
            effort += root[i, j] * force[j]
        motion.efforts[i] = effort
        excess, pull = effort - clip(effort, joint.weakest, joint.strongest), effort - held[i]
        if excess * pull > 0.0:
            share = min(share, max(0.0, 1.0 - excess / pull))
    for i in range(count):
        joint = arm.joints[i]
        effort = motion.efforts[i] - (1.0 - share) * (motion.efforts[i] - held[i])
        motion.efforts[i] = clip(effort, joint.weakest, joint.strongest)


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
        solve_lower(root, column, count, column)
        multiply(carried.T, column, shares)
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
