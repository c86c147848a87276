# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Streams of goals: when their messages were sent, where the goals are going, and between messages.

A stream is taken to be sent at even intervals, or at its stamps: a line through the arrivals, by
least squares with a fading memory. Where goals follow the arrivals better, because the timer of
the sender jitters, the times of sending lie between both. The goals are taken to be on a parabola,
whose memory is as long as their noise demands. What fixed the constants is in a table of
``docs/explanation/control.md``.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.law.compiling import compiled, inner
from manip_sim.control.law.records import SMOOTHING_S
from manip_sim.control.law.small_matrices import clip

#: So many messages back the line through the arrivals remembers.
MEMORY = 40.0
#: Shares of a rise and of a fall of jitter and noise that their measures follow with a message.
ATTACK, DECAY = 0.3, 0.03
#: On schedule is a message that is less than this share of the interval off the line.
ON_TIME = 0.05
#: So many messages in a row show that a stream is on schedule, sent more slowly, off its line, or
#: not stamped any more.
TRUSTED = 8.0
#: So many on schedule in a row show that changes of the velocity are those of the stream.
SCHEDULED = 32.0
#: Uncertainty of the number of messages by their times, at least [intervals].
UNSURE = 0.15
#: A goal that comes again in less than this share of the last interval is a copy.
COPY = 0.7
#: Share of the slack of ramps that is kept per message.
SLACK_KEPT = 0.93
#: Continuation of a stream after a message was due, unless set otherwise [intervals].
HOLD = 2.0
#: Velocity and acceleration of a stream may be so many times those before.
MARGIN = 1.5
#: Noise of the acceleration that is left, as a share of its limit; longest memory for that [s].
NOISE, LONGEST_S = 0.04, 0.1
#: Time constant of the tracked difference to the reference, in measures of jitter, at least.
SMOOTHING_JITTERS = 20.0


@inner
def alike(x: Any, y: Any, now: float) -> bool:
    """Return whether two coordinates have had the same messages, so that one clock is for both."""
    if (x.waiting_messages != y.waiting_messages or x.waiting_stamp != y.waiting_stamp
            or x.longest != y.longest or x.hold != y.hold):
        return False
    return bool(x.velocities == y.velocities and x.arrived == y.arrived and x.due == y.due
                and x.number == y.number and x.interval == y.interval and x.sent == y.sent
                and x.jitter == y.jitter and x.until == y.until
                or not (in_time(x, now) or in_time(y, now)))


@inner
def in_time(x: Any, now: float) -> bool:
    """Return whether a message may continue the stream now."""
    return bool(now - x.arrived <= x.longest
                or now <= x.until < math.inf and x.interval <= x.longest)


@inner
def goes_on(x: Any, now: float, messages: float, stamp: float, velocities: bool) -> bool:
    """Return whether messages continue a stream, and do not begin one."""
    if not in_time(x, now) or (x.velocities != 0.0) != velocities or x.number == 0.0:
        return False
    if (stamp > 0.0 or x.stamp > 0.0) and not stamp > x.stamp > 0.0:
        return False
    # Simulation time may have stood while the sender went on.
    sent = (stamp - x.stamp if stamp > 0.0 else messages) * x.scale
    return not (x.number > TRUSTED
                and x.due + sent - now > x.longest + 3.0 * x.jitter)


@inner
def sent_since(joints: Any, members: IntArray, now: float, messages: float,
               velocities: bool) -> float:
    """Return how many messages were sent, by the time and by how far the goals went."""
    x = joints[members[0]]
    if x.share > 0.75:
        # The timer of the sender jitters.
        return float(max(math.floor((now - x.arrived) / x.interval + 0.1), messages))
    by_time, spread = (now - x.due) / x.interval, x.jitter / x.interval
    # A message may be as late as it likes, but it does not come before it is sent.
    most = math.floor(by_time + 0.5 + min(2.0 * spread, 1.0))
    if most <= messages:
        return messages
    sure = 1.0 / ((spread + UNSURE) * (spread + UNSURE))
    mean = by_time * sure
    if not velocities:
        for i in members:
            x = joints[i]
            expected = (x.pace + x.bend * x.interval / 2.0) * x.interval
            off = (0.05 * abs(expected) + 0.3 * abs(x.bend) * x.interval * x.interval
                   + 4.0 * math.sqrt(x.noise))
            step = x.waiting_goal - x.goal
            if (0.5 * expected * expected < step * expected
                    < (by_time + 1.0 + 3.0 * spread) * expected * expected < math.inf):
                weight = (expected / max(off, 1e-12)) * (expected / max(off, 1e-12))
                sure += weight
                mean += weight * (step / expected)
    if not mean < math.inf:
        mean, sure = by_time, 1.0
    return float(max(min(math.floor(mean / sure + 0.5), most), messages))


@inner
def compare(joints: Any, members: IntArray, line: float, since: float) -> tuple[float, float]:
    """Return squares of errors of goals predicted from three before, by the line and arrivals."""
    x = joints[members[0]]
    bend = (line + x.line_1) / (x.line_1 + x.line_2)
    line_last, line_first = line / x.line_1 * (1.0 + bend), line / x.line_2 * bend
    bend = (since + x.arrival_1) / (x.arrival_1 + x.arrival_2)
    last, first = since / x.arrival_1 * (1.0 + bend), since / x.arrival_2 * bend
    by_line = by_arrival = 0.0
    for i in members:
        x = joints[i]
        step = x.waiting_goal - x.goal
        miss = step - line_last * x.step_1 + line_first * x.step_2
        by_line += miss * miss
        miss = step - last * x.step_1 + first * x.step_2
        by_arrival += miss * miss + 1e-4 * step * step
    return by_line, by_arrival


@inner
def take_time(joints: Any, members: IntArray, now: float, velocities: bool) -> bool:
    """
    Take in when messages came.

    :param members: of the coordinates that they bring, which are :func:`alike`
    :param now: simulation time [s]
    :param velocities: whether they bring velocities, and not positions
    :returns: whether they continue a stream
    """
    x = joints[members[0]]
    period, stamp, messages = x.waiting_period, x.waiting_stamp, x.waiting_messages
    guessed = 0.0
    if stamp == 0.0 and x.stamp > 0.0 and x.number > 2.0 and x.guessed < TRUSTED:
        stamp, guessed = x.stamp + messages * x.interval / x.scale, x.guessed + 1.0
    live = goes_on(x, now, messages, stamp, velocities)
    since = max(now - x.arrived, 1e-9) if live else period
    number = x.number + 1.0 if live else 1.0
    known, stamped, late = number > 2.0, live and stamp > 0.0, now - x.due
    unit = messages
    if stamped:
        unit = stamp - x.stamp
    elif known:
        unit = sent_since(joints, members, now, messages, velocities)
    scale = x.scale if known else since / unit
    if not live:
        stamp, guessed = x.waiting_stamp, 0.0
    if stamped and not known and 0.5 < scale < 2.0:
        # Most senders have the clock of the simulation, to within the jitter of two messages.
        scale, number = 1.0, 20.0
    line = unit * scale
    off = late - line if known else 0.0
    interval = x.interval if known else line / messages
    jitter = x.jitter if known else 0.0
    # The line.
    memory = min(number, MEMORY)
    most = max(3.0 * jitter, 0.25 * interval) if number > 4.0 else math.inf
    pull = clip(off, -most, most)
    due = x.due + line + 2.0 * (2.0 * memory - 1.0) / (memory * (memory + 1.0)) * pull
    if not known:
        due = now
    scale = max(scale + 6.0 / (memory * (memory + 1.0)) * pull / unit, 0.2 * scale)
    if not stamped:
        interval = scale
    elif known:
        interval += 0.1 * (line / max(math.floor(line / interval + 0.5), 1.0) - interval)
    size = abs(off)
    rise = min(size, interval) - jitter
    jitter += (ATTACK if rise > 0.0 else DECAY) * rise
    # Off the line for long: the sender has another phase, or another rate.
    far = 0.0
    if size > 0.5 * max(interval, period) and size > abs(x.off) - 0.25 * interval:
        far = math.copysign(1.0, off)
    astray = x.astray + far if live and far * x.astray > 0.0 else far
    if abs(astray) >= TRUSTED:
        due, number, astray = now, 6.0, 0.0
    lost = unit - messages if live and not stamped else 0.0
    skipped = x.skipped + 1.0 if lost > 0.0 and x.number > 0.0 else 0.0
    skipped_lost = x.skipped_lost + lost if skipped > 1.0 else lost
    if skipped >= TRUSTED:
        # None was lost: the sender is slower.
        scale = interval = scale * unit / messages
        lost, skipped, skipped_lost = lost - skipped_lost, 0.0, 0.0
    # The share of the arrivals.
    share = by_line = by_arrival = 0.0
    if live and not stamped and not velocities:
        by_line, by_arrival = x.line_error, x.arrival_error
        if number > TRUSTED and (
                abs(line - since) > 1e-6 * line or abs(x.line_1 - x.arrival_1) > 1e-6 * line
                or abs(x.line_2 - x.arrival_2) > 1e-6 * line):
            new_line, new_arrival = compare(joints, members, line, since)
            by_line = (1.0 - DECAY) * by_line + new_line
            by_arrival = (1.0 - DECAY) * by_arrival + new_arrival
        if by_line > 0.0:
            share = by_line / (by_line + by_arrival)
        if not 0.1 < share <= 1.0:
            share = 0.0
    sent = due + share * (now - due)
    elapsed = max(sent - x.sent, 0.1 * since) if share > 0.0 else line if live else period
    slack = (1.0 - share) * max(SLACK_KEPT * x.slack if live else 0.0, min(
        size + max(line - max(interval, period), 0.0), 2.0 * interval))
    even = (live and max(size, jitter) < ON_TIME * interval
            and abs(line - messages * interval) < ON_TIME * interval)
    lasts = max(interval, period)
    until = max(now, sent) + lasts + (x.hold if x.hold > 0.0 else HOLD * lasts) + (
        3.0 * (1.0 - share) * jitter)
    for i in members:
        x = joints[i]
        x.velocities = 1.0 if velocities else 0.0
        x.line_2, x.arrival_2 = (x.line_1, x.arrival_1) if live else (line, since)
        x.line_1, x.arrival_1 = line, since
        x.elapsed_before, x.elapsed = x.elapsed if live else period, elapsed
        x.arrived, x.stamp, x.number, x.due, x.scale, x.interval = (
            now, stamp, number, due, scale, interval)
        x.jitter, x.off, x.astray, x.skipped, x.skipped_lost = (
            jitter, off, astray, skipped, skipped_lost)
        x.guessed, x.even = guessed, x.even + 1.0 if even else 0.0
        x.share, x.line_error, x.arrival_error, x.sent, x.slack, x.until = (
            share, by_line, by_arrival, sent, slack, until)
        x.lost += min(lost, 2.0**31)
    return live


@inner
def is_copy(joints: Any, members: IntArray, now: float) -> bool:
    """Return whether messages that wait are copies of the last ones, by their goals and times."""
    x = joints[members[0]]
    if x.waiting_messages > 0.0:
        return False
    for i in members:
        # Where periods of control hide when they came, goals show that each one is copied.
        if joints[i].alternating >= TRUSTED and joints[i].step_1 != 0.0:
            return True
    return bool(now - x.arrived < COPY * x.arrival_1
                or x.waiting_stamp > 0.0 and x.waiting_stamp == x.stamp)


@inner
def next_members(joints: Any, begin: int, now: float, members: IntArray) -> int:
    """
    Find coordinates that one message has brought, and which have had the same ones before.

    :param begin: the first coordinate, for which one waits
    :param members: is filled with them
    :returns: how many there are
    """
    count = 0
    for i in range(begin, len(joints)):
        if joints[i].waiting == joints[begin].waiting and alike(joints[begin], joints[i], now):
            members[count] = i
            count += 1
    for k in range(count):
        joints[members[k]].waiting = 0.0
    return count


@compiled
def wait(joints: Any, indices: IntArray, goals: Any, period: float, messages: float,
         stamp: float, velocities: bool) -> None:
    """
    Let goals that have come wait for the next interval, in place of those that wait already.

    :param indices: of the coordinates
    :param goals: shape of ``indices``
    :param period: of control [s]
    :param messages: how many have come
    :param stamp: when the last one was sent, by any clock [s]; 0: unknown
    :param velocities: whether they bring velocities, and not positions
    """
    kind = 2.0 if velocities else 1.0
    copied, moved = True, False
    for k in range(len(indices)):
        x = joints[indices[k]]
        waits = x.waiting == kind
        known = x.number > 0.0 and (x.velocities != 0.0) == velocities
        copied = copied and (waits or known) and (
            goals[k] == (x.waiting_goal if waits else x.goal))
        moved = moved or waits or (x.change if velocities else x.step_1) != 0.0
    for k in range(len(indices)):
        x = joints[indices[k]]
        before = x.waiting_messages if x.waiting == kind else 0.0
        x.waiting_messages = before + (0.0 if copied and moved else messages)
        x.waiting, x.waiting_goal, x.waiting_stamp, x.waiting_period = (
            kind, goals[k], stamp, period)
        x.moves = 1.0


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
def come_to(x: Any, velocity: float) -> None:
    """Let the reference come to a velocity with the acceleration limit, and seek no goal."""
    x.rate, x.rate_goal, x.slope, x.until = x.velocity, velocity, x.limit, math.inf
    x.raw = x.first = x.second = x.seeks = x.brakes = x.waiting = 0.0
    x.moves = 1.0


@inner
def follow_velocity(x: Any, live: bool) -> None:
    """Let the reference come to a velocity of which another one has come."""
    own = take_velocity(x, live, SCHEDULED)
    come_to(x, x.goal)
    x.bound, x.own = allowed_acceleration(x, own, False), own
    interval = x.interval if live else x.waiting_period
    x.slope = min(max(abs(x.goal - x.velocity) / interval, 1e-9), x.bound)


@inner
def forget_stream(x: Any) -> None:
    """Let the next message begin a stream."""
    x.number, x.arrived, x.smoothing, x.held = 0.0, -math.inf, SMOOTHING_S, 0.0


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


@compiled
def velocities_at(motion: Any, now: float) -> FloatArray:
    """
    Return the velocities at a time, shape (n,).

    :param motion: records of ``MOTION``, shape (n,)
    :param now: simulation time [s]
    """
    velocity = np.empty(len(motion))
    for i in range(len(motion)):
        x = motion[i]
        left = x.reached - now
        velocity[i] = x.velocity - x.slope * left if left > 1e-9 else x.velocity
    return velocity


@inner
def own_accelerations_at(motion: Any, now: float) -> FloatArray:
    """
    Return the accelerations of the stream itself, shape (n,).

    :param motion: records of ``MOTION``, shape (n,)
    :param now: simulation time [s]
    """
    acceleration = np.zeros(len(motion))
    for i in range(len(motion)):
        x = motion[i]
        if now < x.reached - 1e-9:
            acceleration[i] = clip(x.slope, -x.own, x.own)
    return acceleration


@inner
def positions_at(motion: Any, now: float) -> FloatArray:
    """
    Return the positions at a time, shape (n,).

    :param motion: records of ``MOTION``, shape (n,)
    :param now: simulation time [s]
    """
    position = np.empty(len(motion))
    for i in range(len(motion)):
        x = motion[i]
        left = max(x.reached - now, 0.0)
        position[i] = x.position + x.velocity * (now - x.due) + x.slope * left * left / 2.0
    return position
