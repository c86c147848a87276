# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Estimate the velocity of goals that come as a stream, even if their messages jitter."""

from __future__ import annotations

import numpy as np

from manip_sim.arrays import BoolArray, FloatArray, IntArray

#: Messages no farther apart than this are a stream, whose velocity can be estimated [s].
STREAM_INTERVAL_S = 0.105
#: Share of the average velocity, and of the measure of jitter, kept from message to message.
_KEPT, _KEPT_JITTER = 0.7, 0.95
#: Second difference of the velocity, where its sign alternates from message to message, over the
#: velocity: below the first a stream is smooth, above the second it jitters fully. If one message
#: in fourteen comes a period late, it is 0.07.
_SMOOTH, _JITTERS = 0.04, 0.08
#: Share of a rise that the measure of jitter follows with each message.
_ATTACK = 0.3
#: A step larger than this many times the last one is a jump.
_JUMP = 1.5
#: A velocity below this share of the average is a stop and not jitter.
_STOPS = 0.2
#: The longest recent interval counts up to this many mean intervals.
_PATIENCE = 2.1


class StreamEstimator:
    """
    An estimator of the velocity of goals from the messages that bring them.

    Messages in step with the control periods give it exactly. Others, such as 90 messages a second
    in 100 periods, bring sometimes one step, sometimes two, or come a period late; they are
    averaged, at the price of some delay.

    :param count: number of joints
    :ivar velocity: of the goals [rad/s or m/s], shape (n,)
    :ivar interval_s: for how long it holds after a message [s], shape (n,)
    :ivar jitter: how much messages jitter, from 0 to 1, shape (n,)
    """

    def __init__(self, count: int) -> None:
        def zeros() -> FloatArray:
            return np.zeros(count)

        self.velocity, self.interval_s, self.jitter = zeros(), zeros(), zeros()
        self._goal, self._last_s = zeros(), np.full(count, -np.inf)
        self._step, self._messages = zeros(), zeros()
        #: How much the velocity changed with the last message, zero if that was a jump.
        self._change = zeros()
        #: Velocity of the last message and of that before.
        self._history = np.zeros((2, count))
        self._mean_step, self._mean_s = zeros(), zeros()
        self._mean_speed, self._second_difference, self._worst_turn = zeros(), zeros(), zeros()

    def forget(self, indices: IntArray) -> None:
        """Let the next goals be the first of a stream."""
        self._last_s[indices] = -np.inf

    def streams(self, indices: IntArray, now_s: float) -> BoolArray:
        """Tell which goals would continue a stream if they came now."""
        return np.asarray(now_s - self._last_s[indices] <= STREAM_INTERVAL_S)

    def take(self, indices: IntArray, goal: FloatArray, now_s: float, period_s: float,
             acceleration_limit: FloatArray) -> IntArray:
        """
        Take in the goals of a message.

        :param goal: [rad or m], shape of ``indices``
        :param now_s: simulation time [s]
        :param period_s: length of a control period [s]
        :param acceleration_limit: of a jump [rad/s^2 or m/s^2], shape of ``indices``
        :returns: the indices whose velocity is new
        """
        fresh = self._last_s[indices] != now_s
        # Of two goals at one instant the newer counts; they give no velocity.
        self._goal[indices[~fresh]] = goal[~fresh]
        indices, goal, limit = indices[fresh], goal[fresh], acceleration_limit[fresh]
        since_s = now_s - self._last_s[indices]
        streams = self.streams(indices, now_s)
        elapsed_s = np.where(streams, since_s, period_s)
        step = np.where(streams, goal - self._goal[indices], 0.0)
        before = self._step[indices]
        # A smooth stream accelerates about as it did before, even where its velocity changes sign.
        slack = elapsed_s * (2.0 * limit * period_s + _JUMP * self._change[indices])

        def usual(factor: FloatArray | float) -> FloatArray:
            return np.asarray(np.minimum(
                np.maximum(step, np.minimum(0.0, factor * before) - slack),
                np.maximum(0.0, factor * before) + slack))

        # A jump does not continue the stream, two messages in a period do not double its velocity.
        kept = np.where(streams, self.velocity[indices] * elapsed_s, 0.0)
        jump = _JUMP + 0.5 * self.jitter[indices]
        smooth = usual(jump) == step
        expected = np.where(smooth, step, kept)
        self._change[indices] = np.where(
            streams & smooth, np.abs(step - before) / elapsed_s, 0.0)
        self._goal[indices], self._step[indices], self._last_s[indices] = goal, step, now_s
        self._measure_jitter(indices, usual(2.0) / elapsed_s, streams)
        self._average(indices, expected, elapsed_s, streams)
        return indices

    def _measure_jitter(self, indices: IntArray, velocity: FloatArray, streams: BoolArray) -> None:
        older, oldest = self._history[:, indices]
        self._messages[indices] = np.where(streams, self._messages[indices] + 1.0, 0.0)
        # The start of a stream is not jitter.
        second = np.where(self._messages[indices] > 3.0, velocity - 2.0 * older + oldest, 0.0)
        before = self._second_difference[indices]
        turn = np.where(second * before < 0.0, np.minimum(np.abs(second), np.abs(before)), 0.0)
        self._history[:, indices], self._second_difference[indices] = (velocity, older), second
        kept = np.where(streams, _KEPT_JITTER, 0.0)
        mean = kept * self._mean_speed[indices] + (1.0 - kept) * np.abs(velocity)
        self._mean_speed[indices] = mean
        worst = self._worst_turn[indices]
        self._worst_turn[indices] = np.maximum(kept * worst, worst + _ATTACK * (turn - worst))
        ratio = self._worst_turn[indices] / np.maximum(mean, 1e-12)
        self.jitter[indices] = np.clip((ratio - _SMOOTH) / (_JITTERS - _SMOOTH), 0.0, 1.0)

    def _average(self, indices: IntArray, step: FloatArray, elapsed_s: FloatArray,
                 streams: BoolArray) -> None:
        velocity = step / elapsed_s
        before = self._mean_step[indices] / np.maximum(self._mean_s[indices], 1e-12)
        stops = velocity * np.sign(before) < _STOPS * np.abs(before)
        kept = np.where(streams & ~stops, _KEPT, 0.0)
        for mean, value in ((self._mean_step, step), (self._mean_s, elapsed_s)):
            mean[indices] = kept * mean[indices] + (1.0 - kept) * value
        average = self._mean_step[indices] / self._mean_s[indices]
        self.velocity[indices] = velocity + self.jitter[indices] * (average - velocity)
        # If messages jitter, the stream would stall without the longest recent interval.
        late_s = np.minimum(0.99 * self.interval_s[indices], _PATIENCE * self._mean_s[indices])
        self.interval_s[indices] = np.maximum(elapsed_s, np.where(streams, late_s, 0.0))


class RampEstimator:
    """
    An estimator of the acceleration that lets a stream of velocities pass, but not a jump.

    :param count: number of joints
    """

    def __init__(self, count: int) -> None:
        self._velocity, self._change = np.zeros(count), np.zeros(count)
        self._last_s = np.full(count, -np.inf)

    def forget(self, indices: IntArray) -> None:
        """Let the next velocities be the first of a stream."""
        self._last_s[indices] = -np.inf

    def take(self, indices: IntArray, velocity: FloatArray, present: FloatArray, now_s: float,
             period_s: float, acceleration_limit: FloatArray) -> FloatArray:
        """
        Return the acceleration to use for the velocities of a message, shape of ``indices``.

        :param velocity: wanted [rad/s or m/s], shape of ``indices``
        :param present: present velocity [rad/s or m/s], shape of ``indices``
        :param now_s: simulation time [s]
        :param period_s: length of a control period [s]
        :param acceleration_limit: of a jump [rad/s^2 or m/s^2], shape of ``indices``
        """
        since_s = now_s - self._last_s[indices]
        streams = (since_s > 0.0) & (since_s <= STREAM_INTERVAL_S)
        elapsed_s = np.where(streams, since_s, period_s)
        change = np.where(streams, np.abs(velocity - self._velocity[indices]), 0.0)
        # As for positions, a change may be twice the last one plus what the limit allows.
        most = np.where(streams, 2.0 * self._change[indices], 0.0) / elapsed_s + acceleration_limit
        self._velocity[indices], self._change[indices] = velocity, change
        self._last_s[indices] = now_s
        wanted = np.abs(velocity - present) / elapsed_s
        return np.asarray(np.clip(wanted, acceleration_limit, most))
