# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Estimate how the goals of a stream move, whenever their messages arrive.

Nothing here knows of joints: a coordinate is any number that messages bring, such as the position
of a joint, or a component of a translation or of a rotation vector.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.control.message_clock import MessageClock
from manip_sim.control.message_clocks import MessageClocks

#: For how many intervals after a message was due the goals go on, unless set otherwise.
_HOLD_INTERVALS = 2.0
#: Uncertainty of a step of the goals, at least, as a share of it.
_GOAL_SPREAD = 0.05
#: Share of the acceleration by which it may change, and share of it learnt from a message.
_CURVE_SPREAD, _LEARNT = 0.3, 0.2
#: A velocity larger than this many times the last one is a jump.
_JUMP = 1.5
#: Messages are uneven whose jitter is more than this share of the interval.
_UNEVEN = 0.01
#: Goals may be off at random by so many standard deviations.
_OFF_GOALS = 4.0
#: How fast the power of what is off is learnt, and what it is of two differences in a row.
_POWER_LEARNT, _PRODUCT = 0.03, 15.0
#: Not more is off than the goals move in so many times the jitter of their messages.
_REACH = 1.5
#: Noise of the acceleration that is left, as a share of its limit.
_NOISE = 0.04
#: Goals are smooth again that need less than this share of an interval as memory, or no longer off
#: by their messages after so many of them on schedule.
_ROUGH, _FORGIVEN = 0.5, 1000
#: Smoothing takes the memory of a fit for a jitter of this share of it.
_LIKE_JITTER = 0.06
#: A first velocity may be what the acceleration limit allows in so long, at most [s].
_START_S = 0.02
#: How many lost messages one message shows at most; stamps may be 2e18 ns apart.
_MOST_LOST = 2**31


class StreamEstimator:
    """
    An estimator of where the goals of streams are, and how fast, between their messages.

    Its coordinates are numbers of any kind that change smoothly: six of them are a pose, as
    translation and rotation vector. On schedule the velocity is exactly that from message to
    message; what jitters or is lost does not change it.

    :param count: number of coordinates
    :ivar clocks: of their messages
    :ivar goal: of the last message, shape (n,)
    :ivar velocity: of the goals [1/s], shape (n,)
    :ivar acceleration: of the goals, zero unless their messages are on schedule [1/s^2], shape
        (n,)
    :ivar interval_s: from message to message, or from one control period to the next if messages
        come faster [s], shape (n,)
    :ivar sent_s: when the last message was sent [s], shape (n,)
    :ivar jitter_s: how far arrivals are off the times of sending [s], shape (n,)
    :ivar lost: how many messages seem to have been lost, shape (n,)
    """

    #: Only counted.
    not_in_digest = ('lost',)

    def __init__(self, count: int) -> None:
        self.clocks = MessageClocks(count)
        (self.goal, self.velocity, self.acceleration, self.interval_s, self.sent_s,
         self.jitter_s) = np.zeros((6, count))
        self.lost = np.zeros(count, dtype=np.int64)
        #: Velocity of the last step, and how much it changed with it, zero if that was a jump.
        self._last, self._change = np.zeros((2, count))
        #: The last step, and the one before, of one stream.
        self._steps = np.zeros((2, count))
        #: How fast the velocity changes on average, with and without its sign.
        self._curves = np.zeros((2, count))
        #: Of streams off schedule: value, velocity and acceleration of a parabola that follows
        #: the goals; the acceleration by the last two steps; by how much the last goal missed
        #: those of the three before, the power of what misses at random, and whether it has begun.
        self._fit = np.zeros((7, count))

    @property
    def usual_acceleration(self) -> FloatArray:
        """Size of the acceleration, an exponential mean over messages, shape (n,)."""
        return np.asarray(self._curves[1])

    def last_goals(self, at: slice | IntArray) -> FloatArray:
        """Return the goals of the last three messages of a stream, shape (3, n)."""
        last, before = self._steps[:, at]
        return np.array([self.goal[at], self.goal[at] - last, self.goal[at] - last - before])

    def begun_anew(self) -> StreamEstimator:
        """Return an estimator of no stream yet; settings and counts are those of this one."""
        estimator = StreamEstimator(len(self.lost))
        estimator.clocks, estimator.lost = self.clocks.begun_anew(), self.lost
        return estimator

    def forget(self, indices: IntArray) -> None:
        """Let the next goals be the first of a stream."""
        self.clocks.forget(indices)

    def take(self, clock: MessageClock, goal: FloatArray, now_s: float, period_s: float,
             acceleration_limit: FloatArray, messages: int = 1, stamp_s: float = 0.0) -> None:
        """
        Take in the goals of the messages that came at an instant; the last one counts.

        :param clock: one of :attr:`clocks`, of the coordinates that the messages bring
        :param goal: of these coordinates
        :param now_s: simulation time, after that of the last call for these coordinates [s]
        :param period_s: length of a control period [s]
        :param acceleration_limit: of a jump [1/s^2], shape of ``goal``
        :param messages: how many came at this instant
        :param stamp_s: when the last of them was sent, by any clock [s]; 0: unknown
        """
        at, streams = clock.where, clock.continues(now_s)
        before, before_s = self._last[at], clock.elapsed_s
        step = goal - self.goal[at] if streams else np.zeros(len(goal))

        def by_goal(interval_s: float, most: float) -> tuple[float, float]:
            curve, roughness = self._curves[:, at]
            expected = (before + curve * interval_s) * interval_s
            spread = (_GOAL_SPREAD * np.abs(expected)
                      + _CURVE_SPREAD * roughness * interval_s**2
                      + _OFF_GOALS * self._off(at))
            moved = step / np.where(expected == 0.0, np.inf, expected)
            weight = np.where((moved > 0.5) & (moved < most),
                              (expected / np.maximum(spread, 1e-12))**2, 0.0)
            return float((weight * moved).sum()), float(weight.sum())

        def errors(factors: FloatArray) -> FloatArray:
            last, first = self._steps[:, at]
            by_both = step - factors[:, :1] * last - factors[:, 1:] * first
            return np.asarray((np.concatenate([by_both, step[None]])**2).sum(axis=1))

        lost = clock.take(now_s, period_s, stamp_s, messages, by_goal, errors)
        if lost:
            self.lost[at] += min(lost, _MOST_LOST)
        self._steps[1, at], self._steps[0, at] = self._steps[0, at], step
        elapsed_s, interval_s = clock.elapsed_s, max(clock.interval_s, period_s)
        velocity = step / elapsed_s
        change = velocity - before
        size = np.abs(change)
        # A smooth stream accelerates about as it did before, even where its velocity changes sign.
        smooth: BoolArray | bool = streams
        slack = (2.0 * max(period_s, min(interval_s, _START_S)) * acceleration_limit
                 + _JUMP * self._change[at]
                 + _OFF_GOALS * self._off(at) / elapsed_s)
        if not streams or np.count_nonzero(size > slack):
            smooth = streams & (velocity >= np.minimum(0.0, _JUMP * before) - slack) & (
                velocity <= np.maximum(0.0, _JUMP * before) + slack)
            # A jump does not continue the stream, nor does it end it.
            kept = self.velocity[at] if streams else 0.0
            self.velocity[at] = np.where(smooth, velocity, kept)
            size, change = np.where(smooth, size, 0.0), np.where(smooth, change, 0.0)
        else:
            self.velocity[at] = velocity
        self.jitter_s[at] = clock.jitter_s
        clock.fitted = clock.number > 3 and self._is_off(clock, interval_s, acceleration_limit)
        if clock.fitted:
            clock.on_time = False
            self._smooth(clock, goal, velocity, change, smooth, before_s, interval_s, period_s,
                         acceleration_limit)
        else:
            self._fit[6, at] = 0.0
        self._change[at] = size
        self.acceleration[at] = size * 2.0 / (elapsed_s + before_s) if clock.on_time else 0.0
        curves = self._curves[:, at]
        curves += _LEARNT * (np.array((change, size)) / elapsed_s - curves)
        self._curves[:, at] = curves
        self.goal[at], self._last[at] = goal, velocity
        self.interval_s[at], self.sent_s[at] = interval_s, clock.sent_s
        clock.until_s = (max(now_s, clock.sent_s) + interval_s
                         + (clock.hold_s if clock.hold_s > 0.0 else _HOLD_INTERVALS * interval_s)
                         + 3.0 * clock.jitter_s)

    def _is_off(self, clock: MessageClock, interval_s: float, acceleration_limit: FloatArray
                ) -> bool:
        """Return whether a stream is off schedule: by its messages, or by its goals since."""
        if clock.on_time:
            # Where arrivals are seen once a period, they look even though the timer is not.
            memory_s = self._memory_s(self._off(clock.where), acceleration_limit)
            return (clock.fitted and clock.even < _FORGIVEN
                    and bool((memory_s > _ROUGH * interval_s).any()))
        return clock.fitted or clock.relapsed or clock.spread_s > _UNEVEN * interval_s

    @staticmethod
    def _memory_s(off: FloatArray, acceleration_limit: FloatArray) -> FloatArray:
        """Return the memory of a fit to goals that are so far off at random [s]."""
        return np.asarray(np.sqrt(3.0 * off / (_NOISE * acceleration_limit)))

    def _off(self, at: slice | IntArray) -> FloatArray:
        """Return how far goals come off a smooth course at random, standard deviations."""
        return np.asarray(np.sqrt(np.maximum(self._fit[5, at], 0.0)))

    def _smooth(self, clock: MessageClock, goal: FloatArray, velocity: FloatArray,
                change: FloatArray, smooth: BoolArray | bool, before_s: float, interval_s: float,
                period_s: float, acceleration_limit: FloatArray) -> None:
        """
        Let the velocity be that of a parabola through goals whose times of sending are uncertain.

        Its memory fades in time (the second-order fading-memory filter of N. Morrison), the more
        slowly the more goals are off at random: without that it passes through the last three.
        """
        at, elapsed_s = clock.where, clock.elapsed_s
        between_s = (elapsed_s + before_s) / 2.0
        level, pace, bend, last_bend, last_off, power, begun = self._fit[:, at]
        if not begun.all():
            level, pace, last_bend = self.goal[at], self._last[at], change / between_s
            bend, last_off, power = np.zeros((3, len(goal)))
        off = (change - last_bend * between_s) * elapsed_s
        # Of random errors e, two such differences in a row have a product of -15 e^2 on average;
        # a smooth course adds the square of its third difference, of the other sign.
        power = power + _POWER_LEARNT * (-off * last_off / _PRODUCT - power)
        self._fit[3:, at] = change / between_s, off, power, np.ones(len(goal))
        speed = np.maximum(np.abs(velocity), np.abs(self._last[at]))
        spread = np.minimum(self._off(at), _REACH * speed * (clock.spread_s + period_s / 4.0))
        memory_s = self._memory_s(spread, acceleration_limit)
        kept = np.exp(-elapsed_s / np.maximum(memory_s, 1e-9))
        new = 1.0 - kept
        pace = pace + bend * elapsed_s
        level = level + (pace - bend * elapsed_s / 2.0) * elapsed_s
        missed = goal - level
        level = level + (1.0 - kept**3) * missed
        pace = pace + 1.5 * new**2 * (1.0 + kept) * missed / elapsed_s
        bend = bend + new**3 * missed / elapsed_s**2
        self._fit[:3, at] = (np.where(smooth, level, goal), np.where(smooth, pace, velocity),
                             np.where(smooth, bend, 0.0))
        # As on schedule, it is the velocity half an interval before the last goal.
        self.velocity[at] = np.where(smooth, pace - bend * interval_s / 2.0, self.velocity[at])
        self.jitter_s[at] = np.maximum(clock.jitter_s, _LIKE_JITTER * memory_s)


class RampEstimator:
    """
    An estimator of the acceleration that lets a stream of velocities pass, but not a jump.

    :param count: number of coordinates
    :ivar clocks: of their messages
    :ivar lost: how many messages seem to have been lost, shape (n,)
    """

    #: Only counted.
    not_in_digest = ('lost',)

    def __init__(self, count: int) -> None:
        self.clocks = MessageClocks(count)
        self.lost = np.zeros(count, dtype=np.int64)
        self._velocity, self._change = np.zeros((2, count))
        self._taken_s = np.full(count, -np.inf)

    def begun_anew(self) -> RampEstimator:
        """Return an estimator of no stream yet; settings and counts are those of this one."""
        estimator = RampEstimator(len(self.lost))
        estimator.clocks, estimator.lost = self.clocks.begun_anew(), self.lost
        return estimator

    def forget(self, indices: IntArray) -> None:
        """Let the next velocities be the first of a stream."""
        self.clocks.forget(indices)

    def take(self, clock: MessageClock, velocity: FloatArray, present: FloatArray, now_s: float,
             period_s: float, acceleration_limit: FloatArray, messages: int = 1,
             stamp_s: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """
        Return the acceleration to use for the velocities of a message, and the stream's own.

        :param clock: one of :attr:`clocks`, of the coordinates that the message brings
        :param velocity: wanted [1/s], of these coordinates
        :param present: present velocity [1/s], shape of ``velocity``
        :param now_s: simulation time [s]
        :param period_s: length of a control period [s]
        :param acceleration_limit: of a jump [1/s^2], shape of ``velocity``
        :param messages: how many came at this instant
        :param stamp_s: when the last of them was sent, by any clock [s]; 0: unknown
        :returns: both of the shape of ``velocity`` [1/s^2]
        """
        at, streams = clock.where, clock.continues(now_s)
        # Of two messages at one instant the newer counts, and the schedule knows of one.
        new = not (self._taken_s[at] == now_s).any()
        if new:
            self.lost[at] += clock.take(now_s, period_s, stamp_s, messages)
            self._taken_s[at] = now_s
        change = np.abs(velocity - self._velocity[at]) if streams else np.zeros(len(velocity))
        own = np.zeros(len(velocity))
        if new and streams and clock.on_time:
            # As for positions, a change may be twice the last one plus what the limit allows.
            smooth = change <= 2.0 * (self._change[at] + acceleration_limit * clock.elapsed_s)
            # Velocities hold for an interval each, so a change comes with the last one.
            own = np.where(smooth, change / clock.elapsed_s, 0.0)
        self._velocity[at], self._change[at] = velocity, change
        interval_s = clock.interval_s if streams else period_s
        return np.abs(velocity - present) / interval_s, own


@dataclass(frozen=True)
class WaitingGoal:
    """
    The goal of messages that came at one instant, of which the last one counts.

    :ivar indices: of the coordinates that they bring
    :ivar goal: shape of ``indices``
    :ivar messages: how many came
    :ivar stamp_s: when the last one was sent, by any clock [s]; 0: unknown
    :ivar period_s: length of a control period [s]
    """

    indices: IntArray
    goal: FloatArray
    messages: int
    stamp_s: float
    period_s: float


class WaitingGoals:
    """
    The goals that came at the present instant, at most one for each coordinate.

    :param count: number of coordinates
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._goals: list[WaitingGoal] = []

    def __bool__(self) -> bool:
        return bool(self._goals)

    def brings(self, indices: IntArray) -> bool:
        """Return whether there is a goal for any of some coordinates."""
        return any([np.isin(waiting.indices, indices).any() for waiting in self._goals])

    def take_all(self) -> list[WaitingGoal]:
        """Return all goals, which wait no longer."""
        goals, self._goals = self._goals, []
        return goals

    def add(self, new: WaitingGoal) -> None:
        """Let a goal wait instead of those that its coordinates had; a copy is no new message."""
        if not self._goals:
            self._goals.append(new)
            return
        before, counts = self.withdraw(new.indices)
        counts += 0 if (before == new.goal).all() else new.messages
        for count in sorted(set(counts.tolist())):
            chosen = counts == count
            self._goals.append(replace(new, indices=new.indices[chosen], goal=new.goal[chosen],
                                       messages=count))

    def withdraw(self, indices: IntArray) -> tuple[FloatArray, IntArray]:
        """Let goals wait no longer; return them, NaN where there is none, and how many came."""
        goal, messages = np.full(self._count, np.nan), np.zeros(self._count, dtype=np.int64)
        kept = []
        for waiting in self._goals:
            goal[waiting.indices], messages[waiting.indices] = waiting.goal, waiting.messages
            left = ~np.isin(waiting.indices, indices)
            if left.any():
                kept.append(replace(waiting, indices=waiting.indices[left],
                                    goal=waiting.goal[left]))
        self._goals = kept
        return goal[indices], messages[indices]
