# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Changes of a simulation from outside, and the journal of those that have taken effect."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
import threading
from typing import Any

from manip_sim.control.commands import Command, CommandHandle, GripperCommand, Status
from manip_sim.control.surroundings import ARENA
from manip_sim.errors import ModelError
from manip_sim.runtime.pending_commands import PendingCommands
from manip_sim.simulation import Simulation
from manip_sim.simulation.json_state import Encoder
from manip_sim.simulation.json_state import check_sum, NumberedHandles, plain_state
from manip_sim.simulation.operations import Operations

#: Interval between digests [control periods].
DIGEST_PERIODS = 100
#: So many entries are written at once.
_MOST = 500
#: Writes entries, each what JSON can hold.
Write = Callable[[Sequence[Any]], object]


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
        encoder = Encoder(self._simulation.states.control.index_of)
        try:
            encoded = encoder.encode(list(commands))
        except ModelError as error:
            self.unknown(f'a command: {error}')
            return
        self._handles.add(met for met in encoder.met if isinstance(met, CommandHandle))
        self._add('commands', encoded)

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

    def unknown(self, what: str) -> None:
        """Note a change that cannot be repeated; the journal has to begin again."""
        if self._write is not None:
            self._add('unknown', what)
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
