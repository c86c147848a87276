# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Motion of a setpoint in an interval: a reference, a tracked difference to it, and the limits.

The velocity of the *reference* ramps to that of the goals, which takes the setpoint along a stream
one and a half intervals late. What is then still missing of the way is *tracked*: by a
time-optimal profile, and after it two low-pass stages, which average and so never overshoot. The
way to a single goal is tracked as a whole. Last, the sum is limited.
"""

from __future__ import annotations

import math
from typing import Any

from manip_sim.arrays import IntArray
from manip_sim.control.law.compiling import compiled, inner
from manip_sim.control.law.joint_records import SMOOTHING_S
from manip_sim.control.law.small_matrices import clip
from manip_sim.control.law.stream_goals import take_waiting

#: A setpoint that is slower and nearer to its goal than this has arrived [rad or m, and per s].
ARRIVED = 1e-10


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
