# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Keep commands until the next control period; newer ones replace older ones."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from manip_sim.simulation.commands import Command, Status, STOPPED, TrajectoryStop
from manip_sim.simulation.ledger import takes_from


class CommandBuffer:
    """
    Commands that wait for the next control period.

    :param lockstep_parts: the atomic parts that must each have a command for :meth:`ready`
    """

    def __init__(self, lockstep_parts: Iterable[str] = ()) -> None:
        self._needed = frozenset(lockstep_parts)
        self._waiting: list[Command] = []

    def add(self, command: Command) -> None:
        """
        Keep a command; the newest wins, joint by joint.

        Its joints are removed from older commands; one that loses all of its joints is replaced.
        A trajectory that begins later removes joints from other trajectories only, and so does an
        empty trajectory (a stop), which aborts those that lose all of their joints.
        """
        kept = []
        stop = isinstance(command, TrajectoryStop)
        for older in self._waiting:
            rest = older.without(command.indices) if takes_from(command, older) else older
            if rest is None:
                command = _counting(older, command)
                older.handle.end(*(STOPPED if stop else (Status.REPLACED,)))
            else:
                kept.append(rest)
        self._waiting = [*kept, command]

    def ready(self, busy_parts: Iterable[str] = ()) -> bool:
        """
        Return whether each of the lock-step parts has a command.

        :param busy_parts: parts that need no command, such as those that follow a trajectory
        """
        return not self.missing(busy_parts)

    def missing(self, busy_parts: Iterable[str] = ()) -> frozenset[str]:
        """
        Return the lock-step parts that have no command.

        :param busy_parts: parts that need no command, such as those that follow a trajectory
        """
        return self._needed.difference(busy_parts, *(c.parts for c in self._waiting))

    @property
    def waits(self) -> bool:
        """Whether any command waits."""
        return bool(self._waiting)

    def take(self) -> list[Command]:
        """Return the commands in the order of their arrival, and forget them."""
        commands, self._waiting = self._waiting, []
        return commands

    def clear(self, reason: str) -> None:
        """
        Abort all commands.

        :param reason: why, for their handles
        """
        for command in self.take():
            command.handle.end(Status.ABORTED, reason)


def _counting(older: Command, newer: Command) -> Command:
    """Return a command that knows of the message of the same stream that it replaces."""
    if type(older) is not type(newer) or older.goal is None or newer.goal is None or (
            not np.array_equal(older.indices, newer.indices)):
        return newer
    copied = np.array_equal(older.goal, newer.goal)
    return replace(newer, messages=older.messages + (0 if copied else newer.messages))
