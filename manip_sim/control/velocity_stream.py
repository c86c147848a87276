# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""How velocities that come regularly are followed: each is reached when the next one is due."""

from __future__ import annotations

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.control.stream_estimation import RampEstimator


class VelocityStream:
    """
    The velocities of a stream, such as twists of an end effector or a base, all in one frame.

    The velocity ramps from message to message within one message interval, so that nothing jerks
    where control periods are shorter. The first one is reached within a control period.

    :param jump: acceleration that the stream itself has not [1/s^2], shape (n,)
    """

    def __init__(self, jump: FloatArray) -> None:
        self._jump = jump
        self._estimator = RampEstimator(len(jump))
        self._all = np.arange(len(jump))
        ((self._clock, _),) = self._estimator.clocks.of(self._all, 0.0)
        #: Velocity that is come to, how fast, until when, and how much of that is the stream's.
        self._velocity, self._slope, self._own = np.zeros((3, len(jump)))
        self._ramp_end_s = -np.inf

    def set(self, longest_s: float, hold_s: float) -> None:
        """
        Change what counts as a stream.

        :param longest_s: longest interval between messages [s]
        :param hold_s: how long a stream goes on after a message was due [s]; 0: two intervals
        """
        self._estimator.clocks.set(self._all, longest_s, hold_s)

    def take(self, velocity: FloatArray, present: FloatArray, now_s: float, period_s: float,
             messages: int = 1, sent_s: float = 0.0) -> None:
        """
        Take in the velocity of a message.

        :param velocity: [1/s], shape (n,)
        :param present: velocity now, which counts if the stream begins [1/s], shape (n,)
        :param now_s: simulation time [s]
        :param period_s: length of a control period [s]
        :param messages: how many messages came since the last call, of which this is the last
        :param sent_s: when it was sent, by any clock [s]; 0: unknown
        """
        clock = self._clock
        clock.notice_pause(now_s, sent_s, messages)
        streams = clock.continues(now_s)
        before = self.at(now_s) if streams else present
        _, self._own = self._estimator.take(
            clock, velocity, before, now_s, period_s, self._jump, messages, sent_s)
        duration_s = max(clock.interval_s, period_s) if streams else period_s
        self._velocity, self._slope = velocity, (velocity - before) / duration_s
        self._ramp_end_s = now_s + duration_s

    def at(self, now_s: float) -> FloatArray:
        """Return the velocity that is wanted [1/s], shape (n,)."""
        left_s = self._ramp_end_s - now_s
        return self._velocity - self._slope * left_s if left_s > 1e-9 else self._velocity

    def acceleration(self, now_s: float) -> FloatArray:
        """
        Return the acceleration of the stream itself [1/s^2], shape (n,).

        It is zero after a jump, and where messages are late.
        """
        ramps = now_s < self._ramp_end_s - 1e-9
        return np.clip(self._slope, -self._own, self._own) if ramps else np.zeros(len(self._own))
