# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""How a hand follows twists that come regularly: each is reached when the next one is due."""

from __future__ import annotations

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.simulation.streams import RampEstimator

_ALL = np.arange(6)
#: A twist that needs more than the velocity limits in this time is a jump [s].
_SPEED_UP_S = 0.1


class TwistStream:
    """
    The twists of a stream, all in the same frame.

    The velocity ramps from twist to twist within one message interval, so that the hand does not
    jerk where control periods are shorter. The first twist is reached within a control period.
    """

    def __init__(self) -> None:
        self._estimator = RampEstimator(6)
        ((self._clock, _),) = self._estimator.clocks.of(_ALL, 0.0)
        #: Velocity that the hand comes to, how fast, and until when.
        self._velocity, self._slope, self._own = np.zeros((3, 6))
        self._ramp_end_s = -np.inf

    def set(self, longest_s: float, hold_s: float) -> None:
        """
        Change what counts as a stream.

        :param longest_s: longest interval between messages [s]
        :param hold_s: how long a stream goes on after a message was due [s]; 0: two intervals
        """
        self._estimator.clocks.set(_ALL, longest_s, hold_s)

    def take(self, twist: FloatArray, present: FloatArray, now_s: float, period_s: float,
             limits: FloatArray, messages: int = 1, sent_s: float = 0.0) -> None:
        """
        Take in the twist of a message.

        :param twist: [m/s, rad/s], shape (6,)
        :param present: of the hand, which counts if the stream begins [m/s, rad/s], shape (6,)
        :param now_s: simulation time [s]
        :param period_s: length of a control period [s]
        :param limits: of linear and angular velocity [m/s, rad/s], shape (2,)
        :param messages: how many messages came since the last call, of which this is the last
        :param sent_s: when it was sent, by any clock [s]; 0: unknown
        """
        clock = self._clock
        streams = clock.continues(now_s)
        before = self.velocity(now_s) if streams else present
        _, self._own = self._estimator.take(clock, twist, before, now_s, period_s,
                                            np.repeat(limits, 3) / _SPEED_UP_S, messages, sent_s)
        duration_s = max(clock.interval_s, period_s) if streams else period_s
        self._velocity, self._slope = twist, (twist - before) / duration_s
        self._ramp_end_s = now_s + duration_s

    def velocity(self, now_s: float) -> FloatArray:
        """Return the velocity that the hand shall have [m/s, rad/s], shape (6,)."""
        left_s = self._ramp_end_s - now_s
        return self._velocity - self._slope * left_s if left_s > 1e-9 else self._velocity

    def acceleration(self, now_s: float) -> FloatArray:
        """
        Return the acceleration of the twists themselves [m/s^2, rad/s^2], shape (6,).

        It is zero after a jump, and where messages are late.
        """
        ramps = now_s < self._ramp_end_s - 1e-9
        return np.clip(self._slope, -self._own, self._own) if ramps else np.zeros(6)
