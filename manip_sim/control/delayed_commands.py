# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Commands of a robot that have been taken and take effect later, in their order."""

from __future__ import annotations

from collections.abc import Iterator

from manip_sim.control.commands import (
    Command, CommandHandle, GripperCommand, JointTrajectory, Status)
from manip_sim.sensing.delays import InTransit


class DelayedCommands(InTransit[Command]):
    """The commands of a robot that are on their way; those that are withdrawn do not arrive."""

    def send_in_order(self, value: Command, arrival: int) -> None:
        """
        Add a command that does not arrive before what was sent before.

        Of commands that arrive at one instant, those for other joints have an order of their own,
        as their order of arrival must make no difference.

        :param arrival: the earliest one, in steps since the reset
        """
        super().send_in_order(value, arrival)
        arrival = self._queue[-1][0]
        left: list[Command] = []
        while self._queue and self._queue[-1][0] == arrival:
            left.insert(0, self._queue.pop()[1])
        while left:
            first = min((command for number, command in enumerate(left) if not any(
                _is_for_same(command, older) for older in left[:number])), key=_order)
            left.remove(first)
            self.send(first, arrival)

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
        entry = next((entry for entry in self if entry[1].handle is handle), None)
        if entry is None:
            return False
        self._queue.remove(entry)
        handle.end(Status.ABORTED, reason)
        return True

    def abort(self, reason: str) -> None:
        """
        Abort all commands.

        :param reason: why, for their handles
        """
        for _, command in self:
            command.handle.end(Status.ABORTED, reason)
        self.clear()


def _is_for_same(command: Command, other: Command) -> bool:
    """Return whether two commands are for the same gripper, or for some same joints."""
    if isinstance(command, GripperCommand) or isinstance(other, GripperCommand):
        return command.parts == other.parts
    return not set(command.indices.tolist()).isdisjoint(other.indices.tolist())


def _order(command: Command) -> tuple[list[str], list[int]]:
    return sorted(command.parts), command.indices.tolist()
