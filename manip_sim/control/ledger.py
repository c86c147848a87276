# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Which command owns each joint until when: the newest one that has begun, joint by joint."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
import math
from typing import TypeVar

import numpy as np

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.commands import (
    Command, CommandHandle, GripperCommand, JointTrajectory, Status, STOPPED, TrajectoryStop)

C = TypeVar('C', bound=Command)
#: Largest number of trajectories that wait for their start; clients may send any number.
_MOST_WAITING = 1000


class Ledger:
    """
    The commands for some joints, or for the actuators of a gripper, that have not ended.

    At most one that runs owns a joint. Who took it last is known after that command has ended.

    :param count: number of joints
    :ivar running: commands that own the joints of their indices, in the order of these
    :ivar waiting: trajectories that start later, in the order of their starts; they own no joints
        yet
    """

    remembered = ('running', 'waiting', '_owners')

    def __init__(self, count: int) -> None:
        self.running: list[Command] = []
        self.waiting: list[JointTrajectory] = []
        #: Of the command that took each joint last, or of what took the joint from all commands.
        self._owners = [CommandHandle(Status.DONE) for _ in range(count)]

    @property
    def trajectories(self) -> list[JointTrajectory]:
        """All trajectories, including those that start later."""
        return [*self.waiting, *(c for c in self.running if isinstance(c, JointTrajectory))]

    def take(self, command: Command, indices: IntArray | None = None) -> None:
        """
        Give a command joints, which all other commands lose.

        :param indices: of the joints; None for those that it names
        """
        self._pass_on(command.indices if indices is None else indices, command.handle,
                      Status.REPLACED)

    def begin(self, command: Command) -> None:
        """
        Let a command run that has taken its joints.

        Commands run in the order of their joints, as their order of arrival must make no
        difference.
        """
        self.running.append(command)
        if len(self.running) > 1:
            self.running.sort(key=_first_joint)

    def replace(self, older: Command, newer: Command) -> None:
        """Let a command run in place of one that runs for the same joints."""
        self._own(newer.indices, newer.handle)
        self.running[self.running.index(older)] = newer
        older.handle.end(Status.REPLACED)

    def start(self, trajectory: JointTrajectory) -> None:
        """Let a trajectory that waits take its joints from what runs, not from what waits."""
        self.waiting.remove(trajectory)
        self._own(trajectory.indices, trajectory.handle)
        self.running = list(_without(self.running, trajectory.indices, Status.REPLACED))

    def release(self, indices: IntArray, status: Status, reason: str = '') -> None:
        """Take joints from the commands that own or await them; end those that have none left."""
        self._pass_on(indices, CommandHandle(Status.ABORTED, reason), status, reason)

    def _pass_on(self, indices: IntArray, owner: CommandHandle, status: Status, reason: str = ''
                 ) -> None:
        self._own(indices, owner)
        if self.running:
            self.running = list(_without(self.running, indices, status, reason))
        if self.waiting:
            self.waiting = list(_without(self.waiting, indices, status, reason))

    def _own(self, indices: IntArray, handle: CommandHandle) -> None:
        for index in indices.tolist():
            self._owners[index] = handle

    def enqueue(self, trajectory: JointTrajectory) -> None:
        """
        Let a trajectory wait; commands that run, or start before it, go on until it starts.

        It is aborted if too many wait.
        """
        before = [older for older in self.waiting if _start(older) < _start(trajectory)]
        after = self.waiting[len(before):]
        if len(self.waiting) >= _MOST_WAITING:
            trajectory.handle.end(
                Status.ABORTED, f'{_MOST_WAITING} trajectories wait for their starts already')
            return
        rest = _without(after, trajectory.indices, Status.REPLACED)
        self.waiting = sorted([*before, *rest, trajectory],
                              key=lambda waiting: (_start(waiting), _first_joint(waiting)))

    def stop(self, stop: TrajectoryStop) -> IntArray:
        """Take joints from all trajectories, and return those that followed one."""
        self.waiting = list(_without(self.waiting, stop.indices, *STOPPED))
        followed = [np.intersect1d(stop.indices, command.indices) for command in self.running
                    if isinstance(command, JointTrajectory)]
        stopped = np.concatenate([np.empty(0, dtype=np.int64), *followed])
        self.release(stopped, *STOPPED)
        self._own(stop.indices, CommandHandle(Status.ABORTED, STOPPED[1]))
        return stopped

    def finish(self, command: Command, error: FloatArray) -> None:
        """
        End a command that is done; its joints stay its own until a newer one takes them.

        :param error: goal minus measured position
        """
        self.running.remove(command)
        command.handle.end(Status.DONE, error=error)

    def withdraw(self, handle: CommandHandle, reason: str) -> IntArray:
        """
        Abort a command.

        :param reason: why, for the handle
        :returns: the joints that it was the last to take
        """
        indices = np.array([index for index, owner in enumerate(self._owners) if owner is handle],
                           dtype=np.int64)
        self.running = [command for command in self.running if command.handle is not handle]
        self.waiting = [command for command in self.waiting if command.handle is not handle]
        handle.end(Status.ABORTED, reason)
        self._own(indices, CommandHandle(Status.ABORTED, reason))
        return indices

    def end(self, status: Status, reason: str = '') -> None:
        """End the handles of all commands; what the joints do is up to the caller."""
        for command in (*self.running, *self.waiting):
            command.handle.end(status, reason)

    def current_owner(self, command: Command) -> CommandHandle | None:
        """
        Return what took joints from a command that has been applied, or None if it has them all.

        A trajectory that starts later has its joints until another command takes some of them.
        """
        for waiting in self.waiting:
            if waiting.handle is command.handle:
                return None if len(waiting.indices) == len(command.indices) else CommandHandle()
        owners = (self._owners[index] for index in command.indices.tolist())
        return next((owner for owner in owners if owner is not command.handle), None)

    def awaits(self, handle: CommandHandle) -> bool:
        """Return whether a trajectory has been applied and waits for its start."""
        return any(waiting.handle is handle for waiting in self.waiting)


def takes_from(newer: Command, older: Command) -> bool:
    """
    Return whether a command takes its joints from an older one that has not begun either.

    A trajectory that begins later takes them only from trajectories that do not begin before it,
    and a stop from all trajectories.
    """
    if newer.adds or older.adds:
        return False
    if isinstance(newer, GripperCommand) or isinstance(older, GripperCommand):
        return newer.parts == older.parts
    if isinstance(newer, JointTrajectory) and newer.start_ns:
        return isinstance(older, JointTrajectory) and older.start_ns >= newer.start_ns
    return isinstance(older, JointTrajectory) or not isinstance(newer, TrajectoryStop)


def _start(trajectory: JointTrajectory) -> float:
    """Return when a trajectory starts, since the last reset [s]."""
    return -math.inf if trajectory.start_s is None else trajectory.start_s


def _first_joint(command: Command) -> int:
    return int(command.indices.min())


def _without(commands: Iterable[C], indices: IntArray, status: Status, reason: str = ''
             ) -> Iterator[C]:
    """Yield the rest of commands that lose some joints; end commands that lose all."""
    for command in commands:
        rest = command.without(indices)
        if rest is None:
            command.handle.end(status, reason)
        else:
            yield rest
