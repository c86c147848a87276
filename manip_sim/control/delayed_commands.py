# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Commands of a robot that have been taken and take effect later, in their order."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import takewhile
from typing import NamedTuple

from manip_sim.control.cartesian.cartesian_commands import GuardedTwist
from manip_sim.control.commands import (
    Command, CommandHandle, GripperCommand, JointTrajectory, Status)
from manip_sim.sensing.robot_sensing import InTransit


class _Waiting(NamedTuple):
    """
    A command and its place among those that arrive at one instant, by number, parts and joints.

    :ivar number: how many commands it has to follow one by one: each for the same gripper as the
        next, or for some same joints
    """

    number: int
    parts: list[str]
    joints: list[int]
    command: Command

    def holds_back(self, command: Command) -> bool:
        """Return whether a later command must not overtake."""
        if isinstance(command, GripperCommand) or isinstance(self.command, GripperCommand):
            return command.parts == self.command.parts
        return not set(command.indices.tolist()).isdisjoint(self.joints)


class DelayedCommands(InTransit[_Waiting]):
    """The commands of a robot that are on their way; those that are withdrawn do not arrive."""

    remembered = ('_queue',)

    def add(self, command: Command, arrival: int) -> None:
        """
        Add a command that does not arrive before the commands added before it.

        Any order of arrival at one instant in which commands for the same gripper or joints do not
        overtake each other makes the same order (Foata's normal form).

        :param arrival: the earliest one, in steps since the reset
        """
        arrival = max(arrival, self._queue[-1][0]) if self._queue else arrival
        together = [waiting for _, waiting in takewhile(
            lambda entry: entry[0] == arrival, reversed(self._queue))]
        new = _Waiting(1 + max((older.number for older in together if older.holds_back(command)),
                               default=0),
                       sorted(command.parts), command.indices.tolist(), command)
        later = sum(older[:3] > new[:3] for older in together)
        self._queue.insert(len(self._queue) - later, (arrival, new))

    def due(self, count: int) -> Iterator[Command]:
        """
        Yield and forget the commands that are due and were not withdrawn.

        :param count: steps since the reset
        """
        return (waiting.command for waiting in self.take(count)
                if waiting.command.handle.is_active)

    @property
    def busy_parts(self) -> frozenset[str]:
        """The parts for which a motion that has an end waits."""
        return frozenset().union(*(
            waiting.command.parts for _, waiting in self
            if isinstance(waiting.command, (JointTrajectory, GuardedTwist))))

    def withdraw(self, handle: CommandHandle, reason: str) -> bool:
        """Abort a command, and return whether it was here."""
        entry = next((entry for entry in self if entry[1].command.handle is handle), None)
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
        for _, waiting in self:
            waiting.command.handle.end(Status.ABORTED, reason)
        self.clear()
