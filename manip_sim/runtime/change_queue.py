# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Changes of a simulation from outside, and the journal of those that have taken effect.

Commands wait until the next control period, which in lock-step they bring about.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
import threading
from typing import Any

import numpy as np

from manip_sim.control.commands import (
    Command, CommandHandle, GripperCommand, Status, STOPPED, takes_from, TrajectoryStop)
from manip_sim.control.surroundings import ARENA
from manip_sim.errors import CommandError, ModelError, UnknownNameError
from manip_sim.simulation import Simulation
from manip_sim.simulation.journal_entries import (
    check_sum, NumberedHandles, Operations, plain_commands, plain_state)

#: Returns which atomic parts of a robot, given by its name, need no command.
BusyParts = Callable[[str], frozenset[str]]
#: Interval between digests [control periods].
DIGEST_PERIODS = 100
#: So many entries are written at once.
_MOST = 500
#: Writes entries, each what JSON can hold.
Write = Callable[[Sequence[Any]], object]


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
        for name, buffer in self._buffers.items():
            missing = buffer.missing()
            if missing and missing.difference(self._busy_parts(name)):
                return False
        return True

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


class Journal:
    """
    The journal of a simulation, for its thread alone; nothing is kept until it begins.

    It consists of entries. ``['start', about, state]`` begins it, and begins it again after what
    cannot be represented; then come, in the order of the simulation's thread, ``['commands',
    pairs]`` of a robot's name and a command, ``['withdrawn', robot, number of the handle, part or
    None, reason]``, ``['operation', name, arguments, whether it failed]``, ``['period', check sum
    of positions and velocities]`` at the end of each control period, ``['digest', digest]`` and
    ``['unknown', what]`` for what cannot be repeated.

    :param simulation: whose journal it is
    """

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._write: Write | None = None
        self._entries: list[Any] = []
        self._periods = 0
        self._handles = NumberedHandles()
        self._saved = False
        #: True if a start has to follow.
        self.incomplete = False

    @property
    def active(self) -> bool:
        """True if it is written."""
        return self._write is not None

    def begin(self, about: dict[str, Any], write: Write) -> None:
        """
        Begin with the present state.

        :param about: what the world is made from
        :param write: is called with entries
        """
        self.flush()
        self._write, self.incomplete, self._periods = write, False, 0
        self._handles, self._saved = NumberedHandles(), False
        try:
            state, handles = plain_state(self._simulation)
        except ModelError as error:
            self._entries.append(['unknown', f'the state: {error}'])
            self.end()
            return
        self._handles.add(handles)
        self._entries.append(['start', about, state])
        self.flush()

    def end(self) -> None:
        """Write the remaining entries, and keep none from now on."""
        self.flush()
        self._write = None

    def flush(self) -> None:
        """Write the entries."""
        if self._entries and self._write is not None:
            entries, self._entries = self._entries, []
            self._write(entries)

    def _add(self, *entry: Any) -> None:
        self._entries.append(entry)
        if len(self._entries) >= _MOST:
            self.flush()

    def commands(self, commands: Sequence[tuple[str, Command]]) -> None:
        """Note commands that take effect now, with the names of their robots."""
        if self._write is None or not commands:
            return
        try:
            plain, handles = plain_commands(self._simulation, commands)
        except ModelError as error:
            self.unknown(f'a command: {error}')
            return
        self._handles.add(handles)
        self._add('commands', plain)

    def withdrawn(self, robot: str, command: Command, reason: str) -> None:
        """Note that a command was withdrawn, if it has taken effect before."""
        if self._write is None:
            return
        part = next(iter(command.parts)) if isinstance(command, GripperCommand) else None
        for number in self._handles.numbers_of(command.handle):
            self._add('withdrawn', robot, number, part, reason)

    def operation(self, name: str, arguments: Sequence[Any], failed: bool) -> None:
        """Note an operation that was run."""
        if self._write is None:
            return
        if name == 'restore' and not (failed or self._saved):
            self.unknown('a state was restored that was saved before')
            return
        self._saved |= name == 'save' and not failed
        self._add('operation', name, list(arguments), failed)

    def unknown(self, event: str) -> None:
        """Note a change that cannot be repeated; the journal has to begin again."""
        if self._write is not None:
            self._add('unknown', event)
            self.incomplete = True

    def period(self) -> None:
        """Note the end of a control period."""
        if self._write is None:
            return
        self._periods += 1
        self._add('period', check_sum(self._simulation))
        if self._periods % DIGEST_PERIODS == 0:
            self._add('digest', self._simulation.digest())


class ChangeQueue:
    """
    Commands and operations, at once or before the next control period.

    Any thread may let them wait; all else is for the simulation's thread.

    :param simulation: any
    :param steps: physics steps of a control period
    :param lockstep_parts: by robot, the parts that must have had a command; None: no lock-step
    :param waits_for_arena: whether lock-step needs an operation on joints of the arena, too
    :param report: is called with what failed, such as the parts of a command, and the exception
    :ivar commands: that wait
    :ivar operations: that there are
    :ivar journal: of what took effect
    """

    def __init__(self, simulation: Simulation, steps: int,
                 lockstep_parts: Mapping[str, Iterable[str]] | None, waits_for_arena: bool,
                 report: Callable[[str, Exception], None]) -> None:
        self._simulation = simulation
        self._period_s = steps * simulation.timestep_s
        self._waits_for_arena = waits_for_arena
        self._report = report
        self.commands = PendingCommands(simulation, lockstep_parts)
        self.operations = Operations(simulation, steps)
        self.journal = Journal(simulation)
        self._lock = threading.Lock()
        self._waiting: dict[str, tuple[Any, ...]] = {}

    def run(self, operation: str, *arguments: Any, using: Any = None) -> Any:
        """
        Run an operation, and note it.

        Arguments, results and errors are as of ``SimulationThread.change``.
        """
        failed = True
        try:
            result = self.operations.run(operation, *arguments, using=using)
            failed = False
            return result
        finally:
            self.journal.operation(operation, arguments, failed)

    def at_next_period(self, key: str, operation: str, *arguments: Any, stamp_ns: int = 0) -> None:
        """
        Let an operation wait for the next control period.

        :param key: a later operation with the same key replaces one that waits; ``arena/<joint>``
            of a command for a joint of the arena
        :param operation: name of one of :class:`Operations`; what it raises is reported
        :param arguments: what JSON can hold
        :param stamp_ns: in lock-step, stamp of the state that it answers [ns]; 0: not given
        :raises CommandError: in lock-step, if that is not the present state
        """
        self.commands.check_stamp(stamp_ns)
        with self._lock:
            self._waiting[key] = operation, *arguments

    @property
    def _misses_arena(self) -> bool:
        if not self._waits_for_arena:
            return False
        with self._lock:
            return not any(key.startswith(f'{ARENA}/') for key in self._waiting)

    @property
    def complete(self) -> bool:
        """True if all has come that lock-step waits for."""
        return self.commands.complete and not self._misses_arena

    @property
    def missing(self) -> dict[str, list[str]]:
        """The parts that lock-step waits for, by robot or ``arena``."""
        return {**self.commands.missing, **({ARENA: [ARENA]} if self._misses_arena else {})}

    def take_effect(self) -> None:
        """Run the operations and apply the commands that wait; what they raise is reported."""
        if self._waiting:
            with self._lock:
                waiting, self._waiting = self._waiting, {}
            for key, operation in waiting.items():
                try:
                    self.run(*operation)
                except Exception as error:  # What it was for may have gone since.
                    self._report(key, error)
        # They may have been withdrawn meanwhile.
        taken = [(name, command) for name, command in self.commands.take()
                 if command.handle.is_active]
        self.journal.commands(taken)
        for name, command in taken:
            self._apply(name, command)

    def _apply(self, robot: str, command: Command) -> None:
        try:
            self._simulation.robots[robot].apply(command, period_s=self._period_s)
        except Exception as error:
            command.handle.end(Status.ABORTED, str(error))
            self._report(', '.join(sorted(command.parts)), error)

    def clear(self, reason: str) -> None:
        """
        Abort the commands and forget the operations that wait.

        :param reason: why, for the handles of the commands
        """
        self.commands.clear(reason)
        with self._lock:
            self._waiting = {}
