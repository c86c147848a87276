# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Joint velocities that bring an end effector nearer to its target.

How fast to go along the displacements of inverse kinematics. Nothing here knows of commands.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np

from manip_sim.algebra import dot, length, product
from manip_sim.arrays import BoolArray, FloatArray
from manip_sim.control.cartesian.inverse_kinematics import displace, limit_rate
from manip_sim.control.motion_profiles import braking_velocity

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
#: The velocity of a pose that rests.
STILL = np.zeros(6)


@dataclass(frozen=True)
class JointState:
    """
    Setpoints and limits of the joints of an arm, all of shape (n,).

    :ivar position: where the present velocities bring the joints in the interval [rad]
    :ivar velocity: at present [rad/s]
    :ivar low: lowest position, may be infinite [rad]
    :ivar high: highest position [rad]
    :ivar velocity_limit: [rad/s]
    :ivar acceleration_limit: [rad/s^2]
    :ivar away: displacements to the posture that a redundant arm tends to [rad]
    """

    position: FloatArray
    velocity: FloatArray
    low: FloatArray
    high: FloatArray
    velocity_limit: FloatArray
    acceleration_limit: FloatArray
    away: FloatArray


@dataclass(frozen=True)
class Solution:
    """
    Joint velocities at the end of an interval.

    :ivar velocity: [rad/s], shape (n,)
    :ivar pace: of the motion for the task, as a share of the velocity limits
    :ivar progress: share of the wanted motion that the joints can make
    :ivar held: whether the range of a joint keeps it from doing more, shape (n,)
    :ivar singular: whether a motion is wanted in a direction in which the end effector can hardly
        move
    :ivar slowed: whether joint limits slow a twist down, or keep the end effector from going along
        with a pose that moves
    :ivar rests: whether the end effector is as near to a pose as it can come
    :ivar acceleration_limit: of the joints, if the motion needs more than their own
        [rad/s^2], shape (n,)
    """

    velocity: FloatArray
    pace: float
    progress: float
    held: BoolArray
    singular: bool
    slowed: bool = False
    rests: bool = False
    acceleration_limit: FloatArray | None = None


def approach(jacobian: FloatArray, error: FloatArray, joints: JointState, interval_s: float,
             linear_velocity: float, angular_velocity: float, before: FloatArray = STILL,
             twist: FloatArray = STILL, smooth: float = 0.0, rested: bool = False) -> Solution:
    """
    Return the velocities that bring the end effector to a pose and let it rest there.

    All joints arrive together: the end effector moves straight and turns about one axis, as fast
    as joint velocity and acceleration limits and those of the end effector allow.

    :param jacobian: of position and rotation of the end effector, shape (6, n)
    :param error: translation [m] and rotation vector [rad] to the pose, shape (6,), from where the
        present velocities bring the end effector in the interval
    :param interval_s: interval that the velocities are for [s]
    :param linear_velocity: limit for the end effector [m/s]
    :param angular_velocity: limit for the end effector [rad/s]
    :param before: velocity of the pose now [m/s, rad/s], shape (6,)
    :param twist: velocity of the pose at the end of the interval, with which the end effector
        shall go along [m/s, rad/s], shape (6,)
    :param smooth: share of the change between these two that the joints may follow beyond their
        acceleration limits
    :param rested: whether the end effector was as near as it can come before
    """
    along, relative, follows = np.zeros(len(joints.velocity)), joints, False
    if before is not STILL or twist is not STILL:
        along, own = (displace(
            jacobian, _HORIZON_S * motion, *_room(joints), np.zeros(len(along))).step / _HORIZON_S
            for motion in (twist, before))
        needed = np.abs(along - own) / interval_s
        limit = np.maximum(joints.acceleration_limit, _STREAM_ACCELERATION * smooth * needed)
        joints = replace(joints, acceleration_limit=limit)
        follows = bool((needed < limit).all())
        relative = replace(joints, velocity=joints.velocity - own,
                           acceleration_limit=limit - needed if follows else limit)
    part = min(1.0, _LARGEST_STEP / max(length(error[:3]), 1e-12),
               _LARGEST_TURN / max(length(error[3:]), 1e-12))
    found = displace(jacobian, part * error, *_room(joints), joints.away, rested)
    moved = product(jacobian, found.step)
    rate = min(_rate(found.step, relative, interval_s),
               max(linear_velocity - length(twist[:3]), 0.0) / max(length(moved[:3]), 1e-12),
               max(angular_velocity - length(twist[3:]), 0.0) / max(length(moved[3:]), 1e-12))
    rate = limit_rate(jacobian, found.step, joints.acceleration_limit, rate)
    velocity = along + rate * found.step
    pace = _pace(velocity, joints)
    velocity = _with_drift(velocity / max(1.0, pace), found.drift, joints)
    if found.rests and before is STILL and twist is STILL:
        possible = _slowed_evenly(joints, interval_s)
    elif follows:
        possible = along + _evenly(velocity - along, relative, interval_s)
    else:
        possible = _evenly(velocity, joints, interval_s)
    return Solution(possible, pace, _progress(moved, part * error), found.held, found.singular,
                    pace > 1.0 + 1e-6 or _pace(possible - velocity, joints) > _LESS, found.rests,
                    joints.acceleration_limit)


def follow_twist(jacobian: FloatArray, twist: FloatArray, joints: JointState, interval_s: float
                 ) -> Solution:
    """
    Return the velocities that move the end effector with a twist, or slower where joints limit it.

    A joint that comes near the end of its range brakes before, and the others do what they can.

    :param jacobian: of position and rotation of the end effector, shape (6, n)
    :param twist: linear [m/s] and angular [rad/s], shape (6,)
    :param interval_s: interval that the velocities are for [s]
    """
    low, high = _room(joints)
    slowest, fastest = (_HORIZON_S * braking_velocity(
        end, _BRAKING * joints.acceleration_limit, interval_s) for end in (low, high))
    found = displace(jacobian, _HORIZON_S * twist, np.maximum(low, slowest),
                     np.minimum(high, fastest), joints.away)
    velocity = found.step / _HORIZON_S
    pace = _pace(velocity, joints)
    velocity = _with_drift(velocity / max(1.0, pace), found.drift, joints)
    return Solution(_evenly(velocity, joints, interval_s), pace,
                    _progress(product(jacobian, found.step), _HORIZON_S * twist), found.held,
                    found.singular,
                    slowed=pace > 1.0 + 1e-6)


def _pace(velocity: FloatArray, joints: JointState) -> float:
    """Return the largest velocity as a share of its limit."""
    return float(max((np.abs(velocity) / joints.velocity_limit).tolist()))


def _progress(made: FloatArray, wanted: FloatArray) -> float:
    return dot(made, wanted) / max(dot(wanted, wanted), 1e-18)


def stop(joints: JointState, interval_s: float) -> FloatArray:
    """Return the velocities that bring each joint to rest soonest [rad/s], shape (n,)."""
    return _reached(np.zeros(len(joints.velocity)), joints, interval_s)


def _room(joints: JointState) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and the highest displacements within the ranges of the joints."""
    return joints.low - joints.position, joints.high - joints.position


def _rate(step: FloatArray, joints: JointState, interval_s: float) -> float:
    """
    Return how fast to go along a displacement, as a share of it per second.

    The displacement begins where the present velocities bring the joints in the interval.
    """
    size = np.maximum(np.abs(step), 1e-12)
    present = dot(joints.velocity, step) / dot(size, size)
    # Braking from v at the end of the interval takes v^2 / (2 a), and until then the mean of the
    # two velocities counts; together they make the whole displacement from the present.
    whole = 1.0 + present * interval_s
    possible = float(min((joints.acceleration_limit / size).tolist()))
    limit = _BRAKING * possible
    change = limit * interval_s / 2.0
    root = change**2 + 2.0 * limit * (whole - present * interval_s / 2.0)
    braking = math.sqrt(max(root, 0.0)) - change
    # All joints gain speed evenly, so that the path is straight from the beginning.
    return min(max(braking, 0.0), max(present, 0.0) + possible * interval_s,
               max(whole, 0.0) * min(_APPROACH / interval_s, _MAX_RATE),
               float(min((joints.velocity_limit / size).tolist())))


def _with_drift(velocity: FloatArray, drift: FloatArray, joints: JointState) -> FloatArray:
    """Add the motion towards the posture for which the velocity limits leave room."""
    moving = min(_pace(velocity, joints) / _MOVING_PACE, 1.0)
    wanted = (_POSTURE_RATE + moving * (_POSTURE_RATE_MOVING - _POSTURE_RATE)) * drift
    room = joints.velocity_limit - np.abs(velocity)
    share = float(min((room / np.maximum(np.abs(wanted), 1e-12)).tolist()))
    return velocity + min(max(share, 0.0), 1.0) * wanted


def _evenly(velocity: FloatArray, joints: JointState, interval_s: float) -> FloatArray:
    """
    Limit changes of velocity, if possible by one factor for all joints, so that the way is kept.

    Otherwise joints that speed up share one factor for the change, and others are clamped.
    """
    lowest, highest = 0.0, math.inf
    for new, old, limit in zip(velocity.tolist(), joints.velocity.tolist(),
                               joints.acceleration_limit.tolist()):
        change = limit * interval_s
        if abs(new) > 1e-9:
            middle, width = old / new, change / abs(new)
            lowest, highest = max(lowest, middle - width), min(highest, middle + width)
        elif abs(old) > change:
            highest = -math.inf
    if lowest <= highest:
        return np.asarray(min(max(1.0, lowest), highest) * velocity)
    change = joints.acceleration_limit * interval_s
    gains = np.abs(velocity) > np.abs(joints.velocity)
    changes = np.abs(velocity - joints.velocity)[gains]
    share = float((change[gains] / np.maximum(changes, 1e-12)).min(initial=1.0))
    return np.where(gains, joints.velocity + share * (velocity - joints.velocity),
                    _reached(velocity, joints, interval_s))


def _slowed_evenly(joints: JointState, interval_s: float) -> FloatArray:
    """Return the velocities after braking by one factor for all joints, so the way is kept."""
    size = np.maximum(np.abs(joints.velocity), 1e-12)
    share = interval_s * float(min((joints.acceleration_limit / size).tolist()))
    return np.asarray(max(1.0 - share, 0.0) * joints.velocity)


def _reached(velocity: FloatArray, joints: JointState, interval_s: float) -> FloatArray:
    """Return the nearest velocity that the acceleration limits allow in an interval."""
    change = joints.acceleration_limit * interval_s
    return np.asarray(np.clip(velocity, joints.velocity - change, joints.velocity + change))
