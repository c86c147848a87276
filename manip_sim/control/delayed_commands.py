# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Commands of a robot that have been taken and take effect later, in their order."""

from __future__ import annotations

from collections.abc import Iterator

from manip_sim.control.commands import Command, CommandHandle, JointTrajectory, Status
from manip_sim.sensing.delays import InTransit


class DelayedCommands(InTransit[Command]):
    """The commands of a robot that are on their way; those that are withdrawn do not arrive."""

    def take(self, count: int) -> Iterator[Command]:
        """
        Yield and forget the commands that are due and were not withdrawn.

        :param count: steps since the reset
        """
        return (command for command in super().take(count) if command.handle.is_active)

    @property
    def busy_parts(self) -> frozenset[str]:
        """The parts for which a trajectory waits."""
        return frozenset().union(*(command.parts for _, command in self
                                   if isinstance(command, JointTrajectory)))

    def withdraw(self, handle: CommandHandle, reason: str) -> bool:
        """Abort a command, and return whether it was here."""
        for _, command in self:
            if command.handle is handle:
                handle.end(Status.ABORTED, reason)
                return True
        return False

    def abort(self, reason: str) -> None:
        """
        Abort all commands.

        :param reason: why, for their handles
        """
        for _, command in self:
            command.handle.end(Status.ABORTED, reason)
        self.clear()
