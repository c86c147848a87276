# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Joint velocities that bring an end effector nearer to a pose, or move it with a twist."""

from __future__ import annotations

import math

import numpy as np

from manip_sim.arrays import BoolArray, FloatArray
from manip_sim.control.law.arm_records import ArmMotion, Velocities
from manip_sim.control.law.compiling import compiled, inner
from manip_sim.control.law.displacement import displace, way_to_posture
from manip_sim.control.law.setpoint_motion import braking_velocity
from manip_sim.control.law.singular_directions import limit_rate
from manip_sim.control.law.small_matrices import clip, dot, multiply, norm3

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
