# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Setpoints: their motion in an interval, and what sets them in place of a stream.

The velocity of the *reference* ramps to that of the goals, which takes the setpoint along a stream
one and a half intervals late. What is then still missing of the way is *tracked*: by a
time-optimal profile, and after it two low-pass stages, which average and so never overshoot. The
way to a single goal is tracked as a whole. Last, the sum is limited.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.law.compiling import compiled, inner
from manip_sim.control.law.records import SMOOTHING_S
from manip_sim.control.law.small_matrices import clip
from manip_sim.control.law.streams import come_to, forget_stream, take_waiting, velocities_at
from manip_sim.physics.physics import WorldArrays

#: Least acceleration of a ramp [rad/s^2 or m/s^2].
_LEAST_SLOPE = 1e-9
#: A setpoint that is slower and nearer to its goal than this has arrived [rad or m, and per s].
ARRIVED = 1e-10


@compiled
def set_velocity(joints: Any, indices: IntArray, velocity: FloatArray) -> None:
    """
    Let setpoints come to velocities with their acceleration limits.

    :param joints: records, shape (n,)
    :param indices: of those that do, shape (k,)
    :param velocity: [rad/s or m/s], shape (k,)
    """
    for k in range(len(indices)):
        x = joints[indices[k]]
        come_to(x, velocity[k])
        forget_stream(x)


@compiled
def ramp_to(joints: Any, indices: IntArray, velocity: FloatArray, duration: float,
            limit: FloatArray) -> None:
    """
    Let setpoints come to velocities in a time, or later at a limit of the acceleration.

    :param joints: records, shape (n,)
    :param indices: of those that do, shape (k,)
    :param velocity: [rad/s or m/s], shape (k,)
    :param duration: the time [s]
    :param limit: above the limits of the joints, which count if it is empty [rad/s^2 or m/s^2]
    """
    for k in range(len(indices)):
        x = joints[indices[k]]
        most = x.limit
        if len(limit):
            most, x.bound = limit[k], max(limit[k], x.bound)
        come_to(x, velocity[k])
        forget_stream(x)
        x.slope = clip(abs(velocity[k] - x.velocity) / duration, _LEAST_SLOPE, most)


@compiled
def set_state(joints: Any, indices: IntArray, position: FloatArray, velocity: FloatArray) -> None:
    """
    Set setpoints, which come to rest from there; beyond an end of the range they stop at it.

    :param joints: records, shape (n,)
    :param indices: of those that are set, shape (k,)
    :param position: [rad or m], shape (k,)
    :param velocity: [rad/s or m/s], shape (k,)
    """
    for k in range(len(indices)):
        _place(joints[indices[k]], position[k], velocity[k], 0.0)


@inner
def follow(joints: Any, indices: IntArray, motion: FloatArray) -> None:
    """
    Set setpoints from another source; beyond the range they rest at its end.

    :param joints: records, shape (n,)
    :param indices: of those that are set, shape (k,)
    :param motion: their position, velocity and acceleration, shape (k, 3)
    """
    for k in range(len(indices)):
        x, position = joints[indices[k]], motion[k, 0]
        if x.low <= position <= x.high:
            _place(x, position, motion[k, 1], motion[k, 2])
        else:
            _place(x, position, 0.0, 0.0)


@inner
def _place(x: Any, position: float, velocity: float, acceleration: float) -> None:
    """Set a setpoint, which comes to rest from there."""
    x.position = clip(position, x.low, x.high)
    x.velocity = clip(velocity, 0.0 if position < x.low else -math.inf,
                      0.0 if position > x.high else math.inf)
    x.acceleration = acceleration
    come_to(x, 0.0)
    forget_stream(x)


@inner
def braking_velocity(distance: float, limit: float, duration: float) -> float:
    """Return the highest velocity in the next interval that still allows braking before a goal."""
    size, change = min(abs(distance), 1e6), limit * duration
    # The root of v^2 + 2 change v = 2 limit size, written so that it is exact for small sizes.
    return math.copysign(2.0 * limit * size / (
        change + math.sqrt(change * change + 2.0 * limit * size)), distance)


@inner
def end_stream(x: Any) -> None:
    """Let a reference without messages come to rest, and the setpoint go to the last goal."""
    x.until, x.rate_goal, x.slope, x.bound = math.inf, 0.0, x.limit, x.limit
    x.target, x.smoothing = x.goal, SMOOTHING_S


@inner
def missing_way(x: Any, now: float) -> float:
    """Return how far the setpoint will be behind its target if only the reference ramps."""
    if x.brakes != 0.0 and x.rate == 0.0:
        x.brakes = 0.0
    if x.seeks == 0.0 or x.brakes != 0.0:
        return 0.0
    late = now - x.sent - 1.5 * max(x.interval, x.waiting_period) if x.until < math.inf else 0.0
    change = x.rate_goal - x.rate
    return float(x.target + x.rate_goal * late - x.position
                 + change * abs(change) / (2.0 * x.slope) - x.smoothing * (x.first + x.second))


@inner
def track(x: Any, missing: float, duration: float) -> None:
    """Let the tracked difference to the reference shrink."""
    change = x.limit * duration
    raw = clip(braking_velocity(missing, x.limit, duration), x.raw - change, x.raw + change)
    raw = clip(raw, -x.top - x.rate_goal, x.top - x.rate_goal)
    share = duration / (x.smoothing + duration / 2.0)
    first = x.first + share * (raw - x.first)
    second = x.second + share * ((x.first + first) / 2.0 - x.second)
    if max(abs(missing), abs(raw), abs(first), abs(second)) < ARRIVED:
        raw = first = second = 0.0
    x.raw, x.first, x.second = raw, first, second


@inner
def limited(x: Any, velocity: float, duration: float) -> float:
    """Return a velocity at the end of an interval that keeps to limits, and ends in the range."""
    if x.seeks != 0.0:
        velocity = clip(velocity, -x.top, x.top)
    half, begin, change = x.bound * duration / 2.0, x.velocity, x.bound * duration
    above, below = min(x.high - x.position, 1e6), min(x.position - x.low, 1e6)
    highest = math.sqrt(half * half + 2.0 * x.bound * max(
        above - begin * duration / 2.0, 0.0)) - half
    lowest = math.sqrt(half * half + 2.0 * x.bound * max(
        below + begin * duration / 2.0, 0.0)) - half
    velocity = clip(velocity, -lowest, highest)
    # Too late for that, it slows down evenly up to the end.
    needed = begin * begin / (2.0 * max(above if begin > 0.0 else below, 1e-9))
    if needed > 1.01 * x.bound:
        change = max(change, min(needed * duration, abs(begin)))
    return clip(velocity, begin - change, begin + change)


@inner
def move(x: Any, now: float, duration: float) -> None:
    """Move a setpoint in an interval."""
    if x.until <= now + 1e-9:
        end_stream(x)
    begin, tracked, missing = x.velocity, x.second, missing_way(x, now)
    most = x.slope * duration
    # Near its goal this is the difference itself: the rest of a quotient is never zero.
    change = clip(x.rate_goal - x.rate, -most, most)
    rate = x.rate + change
    travel = rate * duration - change / 2.0 * (abs(change) / x.slope)
    tracks = (abs(missing) >= ARRIVED or x.raw != 0.0 or x.first != 0.0 or x.second != 0.0)
    if tracks:
        track(x, missing, duration)
    velocity = limited(x, rate + x.second, duration)
    if velocity != rate + x.second:
        tracks = True
        if x.seeks != 0.0:
            # The part that the limits take away is not tracked at once.
            x.second = velocity - rate
        else:
            rate = velocity
        travel = (begin + velocity) / 2.0 * duration
    elif tracked != 0.0 or x.second != 0.0:
        travel = (begin + velocity) / 2.0 * duration
    x.rate, x.velocity, x.acceleration = rate, velocity, (velocity - begin) / duration
    x.position = clip(x.position + travel, x.low, x.high)
    if velocity == 0.0 and x.rate_goal == 0.0:
        rest(x)


@inner
def rest(x: Any) -> None:
    """Let a setpoint rest that has arrived."""
    away = abs(x.goal - x.position) if x.seeks != 0.0 else 0.0
    if max(abs(x.raw), abs(x.first), abs(x.second), abs(x.rate), away) < ARRIVED:
        if x.seeks != 0.0:
            x.position = x.goal
        x.raw = x.first = x.second = x.acceleration = x.rate = x.moves = x.held = 0.0
        x.slide = 0.0
        x.bound = x.limit


@compiled
def advance(joints: Any, counts: IntArray, now: float, duration: float) -> bool:
    """
    Take in goals that wait, and move the setpoints of a robot in an interval.

    :param joints: records, shape (n,)
    :param counts: of goals beyond the velocity limit and of lost messages, shape (2, n), added to
    :param now: simulation time [s]
    :param duration: of the interval [s]
    :returns: whether any of them moves on
    """
    take_waiting(joints, now)
    moves = False
    for i in range(len(joints)):
        x = joints[i]
        counts[0, i] += int(x.limited)
        counts[1, i] += int(x.lost)
        x.limited = x.lost = 0.0
        if x.moves != 0.0:
            move(x, now, duration)
        else:
            x.velocity = x.acceleration = 0.0
        moves = moves or x.moves != 0.0
    return moves


@inner
def drive_base(world: WorldArrays, servos: Any, setpoints: Any, base: IntArray, owned: IntArray,
               twist: Any, now: float, duration: float) -> None:
    """
    Set velocities of the setpoints that a twist owns.

    The twist is limited in the frame of the base: limits of single joints would let it slide
    sideways.

    :param servos: records of the robot, shape (n,)
    :param setpoints: records of the robot, shape (n,), changed
    :param base: the joints x, y and yaw of the base, shape (3,)
    :param owned: which of these three the twist owns, shape (k,)
    :param twist: along x and y [m/s] and about z [rad/s], records of ``MOTION``, shape (3,)
    :param now: simulation time at the beginning of the interval [s]
    :param duration: of the interval [s]
    """
    yaw, wanted = (
        world.kinematics.positions[servos[base[2]].qpos], velocities_at(twist, now + duration))
    velocity, limit = np.empty(3), np.empty(3)
    if len(owned) == 3:
        before, present = np.empty(3), np.empty(3)
        for i in range(3):
            before[i], limit[i] = setpoints[base[i]].velocity, setpoints[base[i]].limit
        _turn(before, -yaw, present)
        ahead = _come_nearer(present, wanted, limit, duration)
        _turn(ahead, yaw + (present[2] + ahead[2]) / 2.0 * duration, velocity)
        for i in range(3):
            limit[i] = max(limit[i], abs(velocity[i] - before[i]) / duration)
    else:
        _turn(wanted, yaw, velocity)
        for i in range(3):
            limit[i] = setpoints[base[i]].limit
    indices = np.empty(len(owned), np.int64)
    speeds, most = np.empty(len(owned)), np.empty(len(owned))
    for i in range(len(owned)):
        indices[i], speeds[i], most[i] = base[owned[i]], velocity[owned[i]], limit[owned[i]]
    ramp_to(setpoints, indices, speeds, duration, most)


@inner
def _turn(twist: FloatArray, yaw: float, turned: FloatArray) -> None:
    """Write a twist along x and y and about z in a frame that is turned by minus ``yaw``."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    turned[0] = cos * twist[0] - sin * twist[1]
    turned[1] = sin * twist[0] + cos * twist[1]
    turned[2] = twist[2]


@inner
def _come_nearer(present: FloatArray, wanted: FloatArray, limit: FloatArray, duration: float
                 ) -> FloatArray:
    """
    Return the twist after an interval, on the straight line from the present to the wanted one.

    With the acceleration of turning, that of the slide joints stays within their limit, or within
    twice the acceleration of turning if that is more.
    """
    linear = min(limit[0], limit[1])
    turning = math.sqrt(
        present[0] * present[0] + present[1] * present[1]) * abs(present[2])
    higher = max(linear, 2.0 * turning)
    most = min(linear, math.sqrt(higher * higher - turning * turning)) * duration
    twist = np.empty(3)
    along, aside = wanted[0] - present[0], wanted[1] - present[1]
    distance = math.sqrt(along * along + aside * aside)
    share = most / distance if distance > most else 1.0
    twist[0], twist[1] = present[0] + share * along, present[1] + share * aside
    turn = limit[2] * duration
    twist[2] = present[2] + clip(wanted[2] - present[2], -turn, turn)
    return twist
