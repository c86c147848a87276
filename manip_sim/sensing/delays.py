# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Delays of messages in simulated time, and the messages on their way."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
import math
from typing import Generic, TypeVar

from manip_sim.sensing.randomness import NormalRows

#: Share of a timestep by which a duration may miss a whole number of them.
ROUNDING = 1e-6

Sent = TypeVar('Sent')


class Delay:
    """
    The single delays of one way; they depend on the seed, the name and the step only.

    :param name: of the way, unique in its world
    :ivar mean_s: mean of the delays before those below zero become zero [s]
    :ivar jitter_s: their standard deviation [s]
    """

    def __init__(self, name: str, timestep_s: float) -> None:
        self._name = name
        self._timestep_s = timestep_s
        self.mean_s = self.jitter_s = 0.0
        self.set_seed(0)

    def set_seed(self, seed: int) -> None:
        """Draw from a seed from now on."""
        self._rows = NormalRows(seed, self._name, 1)

    @property
    def mean_steps(self) -> int:
        """The mean in whole steps."""
        return self._in_steps(self.mean_s)

    def steps(self, count: int) -> int:
        """
        Return the delay of a message sent after some steps, in whole steps, from 0.

        :param count: steps since the reset
        """
        delay_s = self.mean_s
        if self.jitter_s:
            delay_s = delay_s + self.jitter_s * float(self._rows.row(count)[0])
        return self._in_steps(delay_s)

    def _in_steps(self, delay_s: float) -> int:
        return math.ceil(max(delay_s, 0.0) / self._timestep_s - ROUNDING)


class InTransit(Generic[Sent]):
    """Sent values, by their arrival in steps since the reset."""

    def __init__(self) -> None:
        self._queue: deque[tuple[int, Sent]] = deque()

    def __bool__(self) -> bool:
        return bool(self._queue)

    def __iter__(self) -> Iterator[tuple[int, Sent]]:
        return iter(self._queue)

    def send(self, value: Sent, arrival: int) -> None:
        """
        Add a value, which may overtake earlier ones.

        :param arrival: in steps since the reset
        """
        self._queue.append((arrival, value))

    @property
    def last(self) -> Sent | None:
        """The value sent last."""
        return self._queue[-1][1] if self._queue else None

    def withdraw_last(self) -> int:
        """Forget the value sent last, and return when it would have arrived."""
        return self._queue.pop()[0]

    def take(self, count: int) -> Iterator[Sent]:
        """
        Yield and forget the arrived values, in the order in which they were sent.

        :param count: steps since the reset
        """
        while self._queue and self._queue[0][0] <= count:
            yield self._queue.popleft()[1]

    def newest(self, count: int) -> Sent:
        """
        Return the newest value that has arrived, or the oldest of all while none has.

        Older values are forgotten.

        :param count: steps since the reset
        """
        place = next((index for index in range(len(self._queue) - 1, -1, -1)
                      if self._queue[index][0] <= count), 0)
        for _ in range(place):
            self._queue.popleft()
        return self._queue[0][1]

    def clear(self) -> None:
        """Forget everything."""
        self._queue.clear()


class Measurements(InTransit[tuple[int, Sent]]):
    """Measurements with their instants in steps since the reset, which arrive later."""

    def record(self, count: int, value: Sent, delay: int) -> None:
        """
        Add a measurement of the present instant; it replaces those made then or later.

        :param count: steps since the reset
        :param delay: until it arrives, in steps; the first one is known at once
        """
        arrival = count + delay if self else count
        while (last := self.last) is not None and last[0] >= count:
            arrival = self.withdraw_last()
        self.send((count, value), arrival)
