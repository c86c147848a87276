# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Keep commands until the next control period, which in lock-step they bring about."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
import threading

import numpy as np

from manip_sim.control.commands import (
    Command, CommandHandle, Status, STOPPED, takes_from, TrajectoryStop)
from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.simulation import Simulation

#: Returns which atomic parts of a robot, given by its name, need no command.
BusyParts = Callable[[str], frozenset[str]]


class CommandBuffer:
    """
    Commands that wait for the next control period.

    :param lockstep_parts: the atomic parts that must each have a command, see :meth:`missing`
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
            if (command.adds and type(command) is type(older)
                    and np.array_equal(command.indices, older.indices)):
                command = command.over(older)
                older.handle.end(Status.REPLACED)
                continue
            rest = older.without(command.indices) if takes_from(command, older) else older
            if rest is None:
                command = _counting(older, command)
                older.handle.end(*(STOPPED if stop else (Status.REPLACED,)))
            else:
                kept.append(rest)
        self._waiting = [*kept, command]

    def missing(self, busy_parts: Iterable[str] = ()) -> frozenset[str]:
        """
        Return the lock-step parts that have no command.

        :param busy_parts: parts that need no command, such as those that follow a trajectory
        """
        return self._needed.difference(busy_parts, *(c.parts for c in self._waiting))

    @property
    def waits(self) -> bool:
        """True if any command waits."""
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


class PendingCommands:
    """
    Commands by robot until they are used; in lock-step, also whether all have come.

    Any thread may add commands; all else is for the simulation's thread.

    :param simulation: whose robots they are for
    :param lockstep_parts: by robot, the parts that must have had a command; None without
        lock-step
    """

    def __init__(self, simulation: Simulation,
                 lockstep_parts: Mapping[str, Iterable[str]] | None) -> None:
        self._simulation = simulation
        self._lockstep = lockstep_parts is not None
        needed = lockstep_parts or {}
        self._buffers = {
            name: CommandBuffer(atomic for part in needed.get(name, ())
                                for atomic in robot.parts[part].atomic)
            for name, robot in simulation.robots.items()}
        self._busy: list[BusyParts] = []
        self._lock = threading.Lock()
        #: Stamp of the state that commands may answer [ns]; None until the next one is shown.
        self._present_ns: int | None = None

    def sync_robots(self) -> None:
        """
        Follow robots that have come or gone; lock-step does not wait for those that have come.

        Commands for those that have gone are aborted.
        """
        robots = self._simulation.robots
        with self._lock:
            for name in self._buffers.keys() - robots.keys():
                self._buffers[name].clear(f"robot '{name}' was deleted")
            self._buffers = {name: self._buffers.get(name) or CommandBuffer(()) for name in robots}

    def keep_busy(self, busy_parts: BusyParts) -> None:
        """
        Exempt parts from those that lock-step waits for, as it exempts parts with trajectories.

        :param busy_parts: returns these atomic parts of a robot, given by its name
        """
        self._busy = [*self._busy, busy_parts]

    def add(self, commands: Iterable[Command], stamp_ns: int, robot: str | None
            ) -> list[CommandHandle]:
        """
        Keep validated commands.

        Arguments, results and errors are as of ``SimulationThread.submit``.
        """
        name, buffers = self._simulation.robot.name if robot is None else robot, self._buffers
        if name not in buffers or name not in self._simulation.robots:
            raise UnknownNameError('robot', name, buffers)
        commands, buffer = list(commands), buffers[name]
        for command in commands:
            self._simulation.robots[name].check_own(command)
        with self._lock:
            if self._lockstep:
                self.check_stamp(stamp_ns)
            elif stamp_ns:
                commands = [replace(command, sent_ns=stamp_ns) for command in commands]
            for command in commands:
                buffer.add(command)
        return [command.handle for command in commands]

    def check_stamp(self, stamp_ns: int) -> None:
        """
        Reject, in lock-step, the stamp of another state than the present one.

        :param stamp_ns: of a command [ns]; 0: not given
        :raises CommandError: naming both states
        """
        if self._lockstep and stamp_ns and stamp_ns != self._present_ns:
            raise CommandError(f'lockstep: the command answers the state of '
                               f'{stamp_ns / 1e9:.9f} s, {self._present()}')

    def _present(self) -> str:
        if self._present_ns is None:
            return 'all commands for that state have come already'
        return f'the present state is that of {self._present_ns / 1e9:.9f} s'

    def may_answer(self, time_ns: int) -> None:
        """
        Accept commands that answer a state from now on.

        :param time_ns: its simulation time [ns]
        """
        with self._lock:
            self._present_ns = time_ns

    @property
    def complete(self) -> bool:
        """True if every part that lock-step waits for has a command, or needs none."""
        return not any(buffer.missing() and buffer.missing(self._busy_parts(name))
                       for name, buffer in self._buffers.items())

    @property
    def missing(self) -> dict[str, list[str]]:
        """The parts that lock-step waits for, by robot; robots without any are left out."""
        missing = {name: sorted(buffer.missing(self._busy_parts(name)))
                   for name, buffer in self._buffers.items()}
        return {name: parts for name, parts in missing.items() if parts}

    def _busy_parts(self, robot: str) -> frozenset[str]:
        return self._simulation.robots[robot].busy_parts.union(
            *(busy_parts(robot) for busy_parts in self._busy))

    def take(self) -> list[tuple[str, Command]]:
        """Return the commands with their robots' names; accept no answers to the present state."""
        with self._lock:
            self._present_ns = None
            return [(name, command) for name, buffer in self._buffers.items() if buffer.waits
                    for command in buffer.take()]

    def clear(self, reason: str) -> None:
        """
        Abort all commands, and accept no answers to the present state.

        :param reason: why, for their handles
        """
        with self._lock:
            self._present_ns = None
            for buffer in self._buffers.values():
                buffer.clear(reason)
