# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Commands of a robot that have been taken and take effect later, in their order."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

from manip_sim.simulation.commands import Command, CommandHandle, JointTrajectory, Status


class DelayedCommands:
    """A queue of commands; one never overtakes another."""

    def __init__(self) -> None:
        #: When each takes effect, in steps since the reset, and the command.
        self._queue: deque[tuple[int, Command]] = deque()

    def __bool__(self) -> bool:
        return bool(self._queue)

    def add(self, command: Command, due: int) -> None:
        """
        Add a command.

        :param due: when it takes effect at the earliest, in steps since the reset
        """
        last = self._queue[-1][0] if self._queue else 0
        self._queue.append((max(due, last), command))

    def take(self, count: int) -> Iterator[Command]:
        """
        Yield and forget the commands that are due and were not withdrawn.

        :param count: steps since the reset
        """
        while self._queue and self._queue[0][0] <= count:
            _, command = self._queue.popleft()
            if command.handle.is_active:
                yield command

    @property
    def busy_parts(self) -> frozenset[str]:
        """The parts for which a trajectory waits."""
        return frozenset().union(*(command.parts for _, command in self._queue
                                   if isinstance(command, JointTrajectory)))

    def withdraw(self, handle: CommandHandle, reason: str) -> bool:
        """Abort a command, and return whether it was here."""
        for _, command in self._queue:
            if command.handle is handle:
                handle.end(Status.ABORTED, reason)
                return True
        return False

    def clear(self, reason: str) -> None:
        """
        Abort all commands.

        :param reason: why, for their handles
        """
        for _, command in self._queue:
            command.handle.end(Status.ABORTED, reason)
        self._queue.clear()
