# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Find the goals of several worlds that came at the same instants.

Where the messages of a stream came, and when the next one is due, is then the same in all of these
worlds, and is computed once. Nothing here knows what goals do.
"""

from __future__ import annotations

from collections.abc import Sequence
import copy
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import numpy as np

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.message_clock import MessageClock
from manip_sim.control.setpoints import SetpointGenerator
from manip_sim.control.stream_estimation import WaitingGoal

#: What a clock consists of, besides the coordinates that it is of.
_TIMES = tuple(name for name in vars(MessageClock()) if name not in ('indices', 'where'))
#: Returns the state of a clock without them.
times_of = attrgetter(*_TIMES)


class SharedClock(MessageClock):
    """A clock of messages that came at the same instants in several worlds."""

    @classmethod
    def of(cls, clock: MessageClock) -> SharedClock:
        """Return a clock in the state of another one."""
        shared = cls()
        vars(shared).update(vars(clock))
        return shared

    def take(self, now_s: float, period_s: float, stamp_s: float, messages: int,
             by_goal: Any = None, errors: Any = None) -> int:
        """Take in that messages came, as a clock of one world; what they brought is not asked."""
        return super().take(now_s, period_s, stamp_s, messages, _ask_goals, _ask_goals)

    def can_take(self, now_s: float, message: WaitingGoal) -> bool:
        """Return whether :meth:`take` needs nothing but times for a message that comes now."""
        try:
            copy.copy(self).take(now_s, message.period_s, message.stamp_s, message.messages)
        except _GoalsMatter:
            return False
        return not self.fitted


class _GoalsMatter(Exception):
    """The times of messages depend on the goals that they brought."""


def _ask_goals(*_: object) -> Any:
    raise _GoalsMatter


@dataclass(frozen=True)
class SharedGoals:
    """
    Goals for all joints that came at the same instants.

    :ivar rows: of the generators that they are for
    :ivar clock: of their messages, before these have come
    :ivar clocks: of each generator
    :ivar goals: shape (rows, n)
    :ivar message: one of the messages
    """

    rows: list[int]
    clock: SharedClock
    clocks: list[MessageClock]
    goals: FloatArray
    message: WaitingGoal

    def set_clocks(self) -> None:
        """Let the clocks of all generators show what the shared one does."""
        times = dict(zip(_TIMES, times_of(self.clock)))
        for clock in self.clocks:
            vars(clock).update(times)


def take_goals(generators: Sequence[SetpointGenerator]) -> list[SharedGoals]:
    """
    Take the goals that wait, and return those that several generators have in common.

    The others have taken theirs alone.
    """
    groups: dict[object, tuple[list[int], list[MessageClock], list[WaitingGoal]]] = {}
    for row, generator in enumerate(generators):
        if not generator._waiting:
            continue
        found = _single(generator)
        if found is None:
            generator._take_goals()
            continue
        clock, goal = found
        key = (generator.now_s, goal.messages, goal.stamp_s, goal.period_s, times_of(clock))
        for members, one in zip(groups.setdefault(key, ([], [], [])), (row, clock, goal)):
            members.append(one)  # type: ignore[attr-defined]
    shared = []
    for rows, clocks, waiting in groups.values():
        clock, message = SharedClock.of(clocks[0]), waiting[0]
        if len(rows) < 2 or not clock.can_take(generators[rows[0]].now_s, message):
            for row in rows:
                generators[row]._take_goals()
            continue
        for row in rows:
            generators[row]._waiting.take_all()
        goals = np.concatenate([one.goal for one in waiting]).reshape(len(rows), -1)
        shared.append(SharedGoals(rows, clock, clocks, goals, message))
    return shared


def _single(generator: SetpointGenerator) -> tuple[MessageClock, WaitingGoal] | None:
    """Return the only goal that waits, and its clock, if it is for all joints in their order."""
    goals = generator._waiting._goals
    if len(goals) != 1:
        return None
    clock = stream_of_all(generator, goals[0].indices)
    return None if clock is None else (clock, goals[0])


def stream_of_all(generator: SetpointGenerator, indices: IntArray) -> MessageClock | None:
    """
    Return the clock of messages for some joints, if these are all of them in their order.

    Goals that are fitted are taken alone, because they determine how long they are.
    """
    clock = generator._estimator.clocks._by_indices.get(indices.tobytes())
    if (clock is None or clock.fitted
            or not np.array_equal(clock.indices, np.arange(len(generator.position)))):
        return None
    return clock
