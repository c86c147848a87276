# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What changes a simulation from outside: commands and operations, noted as they take effect."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
import threading
from typing import Any

from manip_sim.control.commands import Command, Status
from manip_sim.control.surroundings import ARENA
from manip_sim.runtime.journal import Journal
from manip_sim.runtime.pending_commands import PendingCommands
from manip_sim.simulation import Simulation
from manip_sim.simulation.operations import Operations


class PendingChanges:
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

        Arguments, results and errors are those of ``SimulationThread.change``.
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
        """Whether all has come that lock-step waits for."""
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
