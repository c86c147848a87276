# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Which commands run or wait for their start, and which of them owns each joint."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TypeVar

import numpy as np

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.simulation.commands import (
    Command, CommandHandle, JointTrajectory, Status, STOPPED, TrajectoryStop)
from manip_sim.simulation.ownership import JointOwners

C = TypeVar('C', bound=Command)


class ActiveCommands:
    """
    The commands that have not ended; at most one that runs owns a joint.

    :param count: number of joints
    :ivar running: commands that own the joints of their indices
    :ivar waiting: trajectories that start later, which own no joints yet
    """

    def __init__(self, count: int) -> None:
        self.running: list[Command] = []
        self.waiting: list[JointTrajectory] = []
        self._owners = JointOwners(count)

    @property
    def trajectories(self) -> list[JointTrajectory]:
        """All trajectories, including those that start later."""
        return [*self.waiting, *(c for c in self.running if isinstance(c, JointTrajectory))]

    def release(self, indices: IntArray, status: Status, reason: str = '') -> None:
        """Take joints from the commands that own or await them; end those that have none left."""
        self._owners.release(indices, reason)
        self.running = list(_without(self.running, indices, status, reason))
        self.waiting = list(_without(self.waiting, indices, status, reason))

    def take(self, command: Command) -> None:
        """Give a command its joints, which all other commands lose."""
        self.release(command.indices, Status.REPLACED)
        self._owners.take(command.indices, command.handle)

    def await_start(self, trajectory: JointTrajectory) -> None:
        """Let a trajectory wait; commands that run go on until it starts."""
        self.waiting = [*_without(self.waiting, trajectory.indices, Status.REPLACED), trajectory]

    def stop(self, stop: TrajectoryStop) -> IntArray:
        """Take joints from all trajectories, and return those that followed one."""
        self.waiting = list(_without(self.waiting, stop.indices, *STOPPED))
        followed = [np.intersect1d(stop.indices, command.indices) for command in self.running
                    if isinstance(command, JointTrajectory)]
        stopped = np.concatenate([np.empty(0, dtype=np.int64), *followed])
        self.release(stopped, *STOPPED)
        self._owners.release(stop.indices, STOPPED[1])
        return stopped

    def withdraw(self, handle: CommandHandle, reason: str) -> IntArray:
        """
        Abort a command.

        :param reason: why, for the handle
        :returns: the joints that it was the last to take
        """
        own = self._owners.of(handle)
        self.running = [command for command in self.running if command.handle is not handle]
        self.waiting = [command for command in self.waiting if command.handle is not handle]
        handle.end(Status.ABORTED, reason)
        self._owners.release(own, reason)
        return own

    def rival(self, command: Command) -> CommandHandle | None:
        """
        Return what took joints from a command that has been applied, or None if it has them all.

        A trajectory that starts later has its joints until another command takes some of them.
        """
        for waiting in self.waiting:
            if waiting.handle is command.handle:
                return None if len(waiting.indices) == len(command.indices) else CommandHandle()
        return self._owners.rival(command.handle, command.indices)

    def awaits(self, handle: CommandHandle) -> bool:
        """Tell whether a trajectory has been applied and waits for its start."""
        return any(waiting.handle is handle for waiting in self.waiting)

    def reference(self, handle: CommandHandle, now_s: float
                  ) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """
        Return position, velocity and acceleration of a trajectory that runs, or None.

        Unlike the setpoints, they are not held back for joints that cannot keep up.

        :param now_s: simulation time since the last reset [s]
        """
        for command in self.running:
            if command.handle is handle and isinstance(command, JointTrajectory):
                position, velocity, acceleration = (
                    values[command.columns]
                    for values in command.trajectory.at(now_s - (command.start_s or 0.0)))
                return position, velocity, acceleration
        return None


def _without(commands: Iterable[C], indices: IntArray, status: Status, reason: str = ''
             ) -> Iterator[C]:
    """Yield what is left of commands that lose some joints; end those that lose all."""
    for command in commands:
        rest = command.without(indices)
        if rest is None:
            command.handle.end(status, reason)
        else:
            yield rest
