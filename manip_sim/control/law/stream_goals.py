# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Motion of the goals of a stream: a parabola whose memory is as long as their noise demands."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from manip_sim.control.law.compiling import compiled, inner
from manip_sim.control.law.joint_records import SMOOTHING_S
from manip_sim.control.law.setpoint_changes import come_to
from manip_sim.control.law.small_matrices import clip
from manip_sim.control.law.stream_timing import (
    DECAY, is_copy, next_members, SCHEDULED, take_time, TRUSTED)

#: Velocity and acceleration of a stream may be so many times those before.
MARGIN = 1.5
#: Noise of the acceleration that is left, as a share of its limit; longest memory for that [s].
NOISE, LONGEST_S = 0.04, 0.1
#: Time constant of the tracked difference to the reference, in measures of jitter, at least.
SMOOTHING_JITTERS = 20.0


@inner
def fit_goal(x: Any, live: bool) -> float:
    """
    Take in a goal that has come.

    :param live: whether it continues a stream
    :returns: velocity of the goals half an interval before the last one
    """
    goal, period = x.waiting_goal, x.waiting_period
    interval, between = max(x.interval, period), (x.elapsed + x.elapsed_before) / 2.0
    step = goal - x.goal if live else 0.0
    velocity = step / x.elapsed
    if not live:
        x.noise = x.curve = x.third = x.product = x.change = x.last = x.step_1 = 0.0
    slack = (2.0 * max(period, min(interval, SMOOTHING_S)) * x.limit + MARGIN * abs(x.change)
             + 4.0 * math.sqrt(x.noise) / x.elapsed)
    smooth = (live and min(0.0, MARGIN * x.last) - slack <= velocity
              <= max(0.0, MARGIN * x.last) + slack)
    if smooth:
        x.change = velocity - x.last
        third = (x.change - x.curve * between) * x.elapsed
        product = -third * x.third / 7.0
        # Of random errors e, the smaller of two such products in a row is e^2 on average; at a
        # corner of a smooth course, one of them is zero or less. It falls no faster than by 9 %.
        x.noise += DECAY * (max(min(product, x.product), -2.0 * x.noise) - x.noise)
        x.curve, x.third, x.product = x.change / between, third, product
        # It grows no faster than goals come that it is to remember.
        x.memory = min(math.sqrt(3.0 * math.sqrt(x.noise) / (NOISE * x.limit)), LONGEST_S,
                       x.memory + x.elapsed)
        if x.memory < 0.5 * x.elapsed:
            x.level, x.bend = goal, x.curve
            x.pace = velocity + x.bend * x.elapsed / 2.0
        else:
            # The fading-memory filter of second order (N. Morrison).
            share = x.elapsed / x.memory
            kept = 1.0 / (1.0 + share + share * share / 2.0)
            new = 1.0 - kept
            x.pace += x.bend * x.elapsed
            x.level += (x.pace - x.bend * x.elapsed / 2.0) * x.elapsed
            miss = goal - x.level
            x.level += (1.0 - kept * kept * kept) * miss
            x.pace += 1.5 * new * new * (1.0 + kept) * miss / x.elapsed
            x.bend += new * new * new * miss / (x.elapsed * x.elapsed)
        x.steady += 1.0
    else:
        # A jump does not continue the stream, nor does it end it.
        x.level, x.pace, x.bend = goal, (x.rate_goal if live else 0.0), 0.0
        x.change = x.curve = x.third = x.product = x.steady = 0.0
    alternates = (step == 0.0) != (x.step_1 == 0.0)
    x.alternating = x.alternating + 1.0 if alternates else 0.0
    x.step_2, x.step_1 = (x.step_1 if live else step), step
    x.goal, x.last = goal, velocity
    return float(x.pace - x.bend * interval / 2.0)


@inner
def own_acceleration(x: Any, velocity: float, known: float) -> float:
    """
    Return the signed acceleration of a stream to a velocity, zero unless it is on schedule.

    :param known: so many messages in a row show that
    """
    for goal in (x.goal, x.goal - x.step_1, x.goal - x.step_1 - x.step_2):
        # That of goals that are clamped to the range is none.
        if not x.low + 1e-9 < goal < x.high - 1e-9:
            return 0.0
    if x.even <= known or x.steady <= TRUSTED or x.memory >= 0.5 * x.elapsed:
        return 0.0
    return float((velocity - x.rate_goal) * 2.0 / (x.elapsed + x.elapsed_before))


@inner
def allowed_acceleration(x: Any, own: float, stops: bool) -> float:
    """
    Return the acceleration that a setpoint may have to follow a stream.

    Accelerations of messages off schedule alternate in sign, those of a stream last.

    :param own: signed acceleration of the stream; ``x.own`` is that before
    :param stops: whether the goals come to rest, which a setpoint does without going past them
    """
    if stops:
        return float(max(x.limit, MARGIN * max(abs(own), abs(x.own))))
    return float(max(x.limit, MARGIN * min(abs(own), abs(x.own)) if own * x.own > 0.0 else 0.0))


@inner
def follow_goal(x: Any, live: bool, now: float) -> None:
    """Let the reference come to the velocity of goals of which another one has come."""
    if not live:
        # The reference of a setpoint without a stream becomes a way to its goal.
        x.raw, x.first, x.second = x.raw + x.rate, x.first + x.rate, x.second + x.rate
        x.rate = x.rate_goal = x.own = 0.0
    wanted = fit_goal(x, live)
    velocity = clip(wanted, -x.top, x.top)
    if velocity != wanted:
        x.limited += 1.0
    own = own_acceleration(x, velocity, SCHEDULED)
    x.bound, x.own = allowed_acceleration(x, own, x.step_1 == 0.0), own
    interval = max(x.interval, x.waiting_period)
    left = clip(x.sent + interval - now, 0.5 * interval, 1.5 * interval) + x.slack
    x.slope = min(max(abs(velocity - x.rate) / left, 1e-9), x.bound)
    x.target, x.rate_goal, x.seeks, x.brakes, x.moves = x.level, velocity, 1.0, 0.0, 1.0
    x.smoothing = SMOOTHING_S if velocity == 0.0 else max(
        interval, SMOOTHING_JITTERS * (1.0 - x.share) * x.jitter, SMOOTHING_S)


@inner
def take_velocity(x: Any, live: bool, known: float) -> float:
    """
    Take in a velocity that has come; return the signed acceleration of its stream.

    :param known: so many messages in a row show that it is on schedule
    """
    velocity = x.waiting_goal
    change = velocity - x.goal if live else 0.0
    # As for positions, a change may be twice the last one plus what the limit allows.
    on_time = live and x.even > known and (
        abs(change) <= 2.0 * (abs(x.change) + x.limit * x.elapsed))
    x.goal, x.change = velocity, change
    return float(change / x.elapsed if on_time else 0.0)


@inner
def follow_velocity(x: Any, live: bool) -> None:
    """Let the reference come to a velocity of which another one has come."""
    own = take_velocity(x, live, SCHEDULED)
    come_to(x, x.goal)
    x.bound, x.own = allowed_acceleration(x, own, False), own
    interval = x.interval if live else x.waiting_period
    x.slope = min(max(abs(x.goal - x.velocity) / interval, 1e-9), x.bound)


@inner
def take_waiting(joints: Any, now: float) -> None:
    """Take in the goals that came at this instant."""
    members = np.empty(len(joints), np.int64)
    for i in range(len(joints)):
        kind = joints[i].waiting
        if kind == 0.0:
            continue
        count = next_members(joints, i, now, members)
        if is_copy(joints, members[:count], now):
            continue
        for k in range(count):
            joints[members[k]].waiting_messages = max(joints[members[k]].waiting_messages, 1.0)
        live = take_time(joints, members[:count], now, kind == 2.0)
        for k in range(count):
            if kind == 2.0:
                follow_velocity(joints[members[k]], live)
            else:
                follow_goal(joints[members[k]], live, now)


@compiled
def take_alone(joints: Any, now: float) -> int:
    """
    Take in what one message has brought for all coordinates, without setpoints that follow.

    The velocity of goals is ``rate_goal`` then, and ``own`` is their own acceleration.

    :returns: 0 for a copy, which changes nothing; 1 for the first message of a stream; or else 2
    """
    members = np.arange(len(joints))
    velocities = joints[0].waiting == 2.0
    for i in members:
        joints[i].waiting = 0.0
    if is_copy(joints, members, now):
        return 0
    for i in members:
        joints[i].waiting_messages = max(joints[i].waiting_messages, 1.0)
    live = take_time(joints, members, now, velocities)
    for i in members:
        x = joints[i]
        if velocities:
            x.own = take_velocity(x, live, TRUSTED)
        else:
            velocity = fit_goal(x, live)
            x.own = own_acceleration(x, velocity, TRUSTED)
            x.rate_goal = velocity
    return 2 if live else 1
