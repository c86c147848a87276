# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Keep commands until the next control period; the newest wins and nothing piles up."""

from __future__ import annotations

from collections.abc import Iterable

from manip_sim.simulation.commands import (
    Command, GripperCommand, JointTrajectory, Status, STOPPED, TrajectoryStop)


class CommandBuffer:
    """
    Commands that wait.

    :param lockstep_parts: the atomic parts that must each have one for :meth:`ready`
    """

    def __init__(self, lockstep_parts: Iterable[str] = ()) -> None:
        self._needed = frozenset(lockstep_parts)
        self._waiting: list[Command] = []

    def add(self, command: Command) -> None:
        """
        Keep a command; the newest wins, joint by joint.

        Joints that it names are taken from older commands; one that loses all of them is replaced.
        A trajectory that begins later takes joints from other trajectories only, and a stop ends
        nothing but trajectories.
        """
        kept = []
        stop = isinstance(command, TrajectoryStop)
        for older in self._waiting:
            rest = older.without(command.indices) if _rivals(older, command) else older
            if rest is None:
                older.handle.end(*(STOPPED if stop else (Status.REPLACED,)))
            else:
                kept.append(rest)
        self._waiting = [*kept, command]

    def ready(self, busy_parts: Iterable[str] = ()) -> bool:
        """
        Tell whether every one of the lockstep parts has a command.

        :param busy_parts: parts that have one already, such as a trajectory that they follow
        """
        commanded = frozenset(busy_parts).union(*(c.parts for c in self._waiting))
        return self._needed <= commanded

    @property
    def waits(self) -> bool:
        """Whether there are commands."""
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


def _rivals(older: Command, newer: Command) -> bool:
    """Tell whether a command takes joints from an older one."""
    if isinstance(newer, GripperCommand):
        return isinstance(older, GripperCommand) and older.parts == newer.parts
    if isinstance(older, GripperCommand):
        return False
    if isinstance(newer, TrajectoryStop) or (isinstance(newer, JointTrajectory)
                                             and newer.start_ns):
        return isinstance(older, JointTrajectory)
    return True
