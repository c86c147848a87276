# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Inverse kinematics: joint displacements and velocities that bring an end effector nearer.

Displacements are a Gauss-Newton step (least squares with bounds on the joints) where all of the
motion is possible. What is not possible, beyond the reach or near a singularity, is treated as a
constant force on the end effector: its stiffness, the second derivative of the kinematics, makes
the step a Newton step towards the place where the end effector is nearest, so the joints come to
rest there. Velocities follow a displacement, or a twist, within the limits of the joints, and slow
down near a singularity.
"""

from __future__ import annotations

import math

import numpy as np

from manip_sim.arrays import BoolArray, FloatArray
from manip_sim.control.law.compiling import compiled, inlined, inner
from manip_sim.control.law.records import ArmMotion, Velocities
from manip_sim.control.law.setpoint_motion import braking_velocity
from manip_sim.control.law.small_matrices import (
    clip, dot, factorize, minimize_in_box, multiply, multiply_matrices, norm, norm3, solve)

#: Tasks that need larger displacements of a joint are not possible here [rad].
_LARGEST = 1.0
#: Keeps the least squares regular; it is compensated, so the solution is exact.
_REGULAR = 1e-9
#: Weight of the posture beside that of the task, and in addition for each metre or radian of the
#: task that is not possible, so that an arm does not rest where it can hardly come back.
POSTURE, _POSTURE_PULL = 1e-6, 0.005
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
#: Below this singular value [m/rad and 1] the end effector can hardly move in a direction.
SINGULAR = 0.029
_INVERSE_ITERATIONS = 4
#: Components of a direction that has a part in all directions.
_EVEN = 6.0**-0.5
#: Singular values near a singularity, and those below which it is slowed down no further.
_NEAR, _SMALLEST = 0.06, 0.03
#: A larger error is shortened to this, and braking begins as if that were all [m], [rad].
_LARGEST_STEP, _LARGEST_TURN = 0.1, 0.5
#: Share of the acceleration limits that braking may use: the path is not straight in joint space.
_BRAKING = 0.5
#: Final rate of the approach, times the interval: critical damping of x[n+1] = x[n] - T
#: (v[n] + v[n+1]) / 2 with v[n+1] = k x[n] is at k T = 6 - 4 sqrt(2).
_APPROACH = 6.0 - 4.0 * math.sqrt(2.0)
_MAX_RATE = 40.0
#: Rate at which a redundant arm goes towards its posture [1/s], when the end effector rests and
#: while it moves faster than this share of the velocity limits, so that its way is straight.
_POSTURE_RATE, _POSTURE_RATE_MOVING, _MOVING_PACE = 3.0, 1.0, 0.1
#: A twist is slowed down so that no joint comes to its limit sooner than this [s].
_HORIZON_S = 0.1
#: Joints may accelerate this many times as much as a pose that moves needs, where that is more
#: than their limits.
_STREAM_ACCELERATION = 2.0
#: Less than this share of the velocity limits makes no difference.
_LESS = 0.01


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
    multiply(jacobian.T, task, pull)
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
        weight += _POSTURE_PULL * size
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
    multiply(jacobian.T, direction, result)
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


@compiled
def approach(jacobian: FloatArray, error: FloatArray, arm: ArmMotion, interval: float,
             linear_velocity: float, angular_velocity: float, before: FloatArray,
             twist: FloatArray, goes: bool, smooth: float, rested: bool, result: Velocities
             ) -> tuple[float, float, bool, bool, bool]:
    """
    Write the velocities that bring the end effector to a pose and let it rest there.

    All joints arrive together: the end effector moves straight and turns about one axis, as fast
    as joint velocity and acceleration limits and those of the end effector allow.

    :param jacobian: of position and rotation of the end effector, shape (6, n)
    :param error: translation [m] and rotation vector [rad] to the pose, shape (6,), from where the
        present velocities bring the end effector in the interval
    :param interval: that the velocities are for [s]
    :param linear_velocity: limit for the end effector [m/s]
    :param angular_velocity: limit for the end effector [rad/s]
    :param before: velocity of the pose now [m/s, rad/s], shape (6,)
    :param twist: velocity of the pose at the end of the interval, with which the end effector
        shall go along [m/s, rad/s], shape (6,)
    :param goes: whether the pose moves; otherwise the last two are zero
    :param smooth: share of the change between these two that the joints may follow beyond their
        acceleration limits
    :param rested: whether the end effector was as near as it can come before
    :returns: the pace of the motion as a share of the velocity limits, which share of the wanted
        motion the joints can make, whether a motion is wanted in a direction in which the end
        effector can hardly move, whether joint limits keep it from going along, and whether it is
        as near as it can come
    """
    count, follows = len(arm.position), goes
    low, high, away = np.empty(count), np.empty(count), np.empty(count)
    step, drift, factor = np.empty(count), np.empty(count), np.empty((count, count))
    along, own, spare = np.zeros(count), np.zeros(count), np.empty(count)
    task, moved, wanted = np.empty(6), np.empty(6), np.empty(count)
    _find_room(arm, low, high, away)
    limit, velocity = result.acceleration_limit, result.velocity
    for i in range(count):
        limit[i] = spare[i] = arm.acceleration_limit[i]
    if goes:
        _go_along(jacobian, twist, low, high, not goes, result.held, factor, along)
        _go_along(jacobian, before, low, high, not goes, result.held, factor, own)
        for i in range(count):
            needed = abs(along[i] - own[i]) / interval
            limit[i] = max(limit[i], _STREAM_ACCELERATION * smooth * needed)
            spare[i] = limit[i] - needed
            follows = follows and needed < limit[i]
        for i in range(count):
            spare[i] = spare[i] if follows else limit[i]
            own[i] = arm.velocity[i] - own[i]
    else:
        for i in range(count):
            own[i] = arm.velocity[i]
    part = min(1.0, _LARGEST_STEP / max(norm3(error, 0), 1e-12),
               _LARGEST_TURN / max(norm3(error, 3), 1e-12))
    for i in range(6):
        task[i] = part * error[i]
    rests, singular = displace(jacobian, task, low, high, away, rested, step, drift, result.held,
                               factor)
    multiply(jacobian, step, moved)
    rate = min(_find_rate(step, own, spare, arm.velocity_limit, interval),
               max(linear_velocity - norm3(twist, 0), 0.0) / max(norm3(moved, 0), 1e-12),
               max(angular_velocity - norm3(twist, 3), 0.0) / max(norm3(moved, 3), 1e-12))
    rate = limit_rate(jacobian, step, limit, rate)
    for i in range(count):
        wanted[i] = along[i] + rate * step[i]
    pace = _slow_down(wanted, drift, arm.velocity_limit)
    if rests and not goes:
        _brake_evenly(arm, interval, velocity)
    elif follows:
        for i in range(count):
            away[i] = wanted[i] - along[i]
        _change_evenly(away, own, spare, interval, velocity)
        for i in range(count):
            velocity[i] += along[i]
    else:
        _change_evenly(wanted, arm.velocity, limit, interval, velocity)
    missed = 0.0
    for i in range(count):
        missed = max(missed, abs(velocity[i] - wanted[i]) / arm.velocity_limit[i])
    return (pace, dot(moved, task) / max(dot(task, task), 1e-18), singular,
            pace > 1.0 + 1e-6 or missed > _LESS, rests)


@compiled
def follow_twist(jacobian: FloatArray, twist: FloatArray, arm: ArmMotion, interval: float,
                 rested: bool, result: Velocities) -> tuple[float, float, bool, bool, bool]:
    """
    Write the velocities that move the end effector with a twist, or slower where joints limit it.

    A joint that comes near the end of its range brakes before, and the others do what they can.

    :param jacobian: of position and rotation of the end effector, shape (6, n)
    :param twist: linear [m/s] and angular [rad/s], shape (6,)
    :param interval: that the velocities are for [s]
    :param rested: whether the end effector was as near as it can come before
    :returns: as of :func:`approach`
    """
    count = len(arm.position)
    low, high, away = np.empty(count), np.empty(count), np.empty(count)
    step, drift, factor = np.empty(count), np.empty(count), np.empty((count, count))
    task, moved = np.empty(6), np.empty(6)
    _find_room(arm, low, high, away)
    for i in range(count):
        limit = result.acceleration_limit[i] = arm.acceleration_limit[i]
        low[i] = max(low[i], _HORIZON_S * braking_velocity(low[i], _BRAKING * limit, interval))
        high[i] = min(high[i], _HORIZON_S * braking_velocity(high[i], _BRAKING * limit, interval))
    for i in range(6):
        task[i] = _HORIZON_S * twist[i]
    rests, singular = displace(jacobian, task, low, high, away, rested, step, drift, result.held,
                               factor)
    multiply(jacobian, step, moved)
    progress = dot(moved, task) / max(dot(task, task), 1e-18)
    for i in range(count):
        step[i] /= _HORIZON_S
    pace = _slow_down(step, drift, arm.velocity_limit)
    _change_evenly(step, arm.velocity, arm.acceleration_limit, interval, result.velocity)
    return pace, progress, singular, pace > 1.0 + 1e-6, rests


@inner
def _find_room(arm: ArmMotion, low: FloatArray, high: FloatArray, away: FloatArray) -> None:
    """Write lowest and highest displacements within the ranges, and those to the posture."""
    for i in range(len(low)):
        low[i], high[i] = arm.low[i] - arm.position[i], arm.high[i] - arm.position[i]
        away[i] = way_to_posture(arm.posture[i] - arm.position[i], arm.turn[i])


@inner
def _go_along(jacobian: FloatArray, twist: FloatArray, low: FloatArray, high: FloatArray,
              rested: bool, held: BoolArray, factor: FloatArray, velocity: FloatArray) -> None:
    """Write the velocities with which an end effector goes along with a pose [rad/s]."""
    task, zero, drift = np.empty(6), np.zeros(len(low)), np.empty(len(low))
    for i in range(6):
        task[i] = _HORIZON_S * twist[i]
    displace(jacobian, task, low, high, zero, rested, velocity, drift, held, factor)
    for i in range(len(low)):
        velocity[i] /= _HORIZON_S


@inner
def _find_rate(step: FloatArray, velocity: FloatArray, limit: FloatArray,
               velocity_limit: FloatArray, interval: float) -> float:
    """
    Return how fast to go along a displacement, as a share of it per second.

    The displacement begins where the present velocities bring the joints in the interval.

    :param velocity: at present [rad/s], shape (n,)
    :param limit: of the acceleration [rad/s^2], shape (n,)
    """
    square, possible, fastest = 0.0, math.inf, math.inf
    for i in range(len(step)):
        size = max(abs(step[i]), 1e-12)
        square += size * size
        possible, fastest = min(possible, limit[i] / size), min(fastest, velocity_limit[i] / size)
    present = dot(velocity, step) / square
    # Braking from v at the end of the interval takes v^2 / (2 a), and until then the mean of the
    # two velocities counts; together they make the whole displacement from the present.
    whole = 1.0 + present * interval
    braking = _BRAKING * possible
    change = braking * interval / 2.0
    root = change * change + 2.0 * braking * (whole - present * interval / 2.0)
    slowing = math.sqrt(max(root, 0.0)) - change
    # All joints gain speed evenly, so that the path is straight from the beginning.
    return min(max(slowing, 0.0), max(present, 0.0) + possible * interval,
               max(whole, 0.0) * min(_APPROACH / interval, _MAX_RATE), fastest)


@inner
def _slow_down(velocity: FloatArray, drift: FloatArray, limit: FloatArray) -> float:
    """
    Slow velocities down to their limits; add the motion to the posture for which there is room.

    :returns: the largest velocity before, as a share of its limit
    """
    pace = 0.0
    for i in range(len(velocity)):
        pace = max(pace, abs(velocity[i]) / limit[i])
    moving = min(pace / max(1.0, pace) / _MOVING_PACE, 1.0)
    rate, share = _POSTURE_RATE + moving * (_POSTURE_RATE_MOVING - _POSTURE_RATE), 1.0
    for i in range(len(velocity)):
        velocity[i] /= max(1.0, pace)
        share = min(share, (limit[i] - abs(velocity[i])) / max(abs(rate * drift[i]), 1e-12))
    for i in range(len(velocity)):
        velocity[i] += max(share, 0.0) * rate * drift[i]
    return pace


@inner
def _change_evenly(velocity: FloatArray, before: FloatArray, limit: FloatArray, interval: float,
                   result: FloatArray) -> None:
    """
    Limit changes of velocity, if possible by one factor for all joints, so that the way is kept.

    Otherwise joints that speed up share one factor for the change, and others are clamped.
    """
    lowest, highest, share = 0.0, math.inf, 1.0
    for i in range(len(velocity)):
        new, change = velocity[i], limit[i] * interval
        if abs(new) > 1e-9:
            middle, width = before[i] / new, change / abs(new)
            lowest, highest = max(lowest, middle - width), min(highest, middle + width)
        elif abs(before[i]) > change:
            highest = -math.inf
        if abs(new) > abs(before[i]):
            share = min(share, change / max(abs(new - before[i]), 1e-12))
    for i in range(len(velocity)):
        new, change = velocity[i], limit[i] * interval
        if lowest <= highest:
            result[i] = clip(1.0, lowest, highest) * new
        elif abs(new) > abs(before[i]):
            result[i] = before[i] + share * (new - before[i])
        else:
            result[i] = clip(new, before[i] - change, before[i] + change)


@inner
def _brake_evenly(arm: ArmMotion, interval: float, velocity: FloatArray) -> None:
    """Write the velocities after braking by one factor for all joints, so the way is kept."""
    share = math.inf
    for i in range(len(velocity)):
        share = min(share, arm.acceleration_limit[i] / max(abs(arm.velocity[i]), 1e-12))
    for i in range(len(velocity)):
        velocity[i] = max(1.0 - interval * share, 0.0) * arm.velocity[i]
