# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Operations on a simulation: run and noted in its journal, at once or before the next period."""

from __future__ import annotations

from collections.abc import Callable
import threading
from typing import Any

from manip_sim.runtime.journal import Journal
from manip_sim.simulation import Simulation
from manip_sim.simulation.operations import Operations


class NotedOperations:
    """
    Runs operations in the simulation's thread; any thread may let one wait for the next period.

    :param simulation: any
    :param steps: physics steps of a control period
    :param report: is called with the key of an operation that waited, and what it raised
    :ivar operations: that there are
    :ivar journal: of what changes the simulation
    """

    def __init__(self, simulation: Simulation, steps: int,
                 report: Callable[[str, Exception], None]) -> None:
        self.operations = Operations(simulation, steps)
        self.journal = Journal(simulation)
        self._report = report
        self._lock = threading.Lock()
        self._waiting: dict[str, tuple[Any, ...]] = {}

    def run(self, operation: str, *arguments: Any, using: Any = None) -> Any:
        """
        Run an operation, and note it.

        :param operation: name of one of :class:`Operations`
        :param arguments: what JSON can hold
        :param using: what the operation would make of its arguments, if that is there already
        :returns: what the operation returns
        :raises ManipSimError: if it cannot be done
        """
        failed = True
        try:
            result = self.operations.run(operation, *arguments, using=using)
            failed = False
            return result
        finally:
            self.journal.operation(operation, arguments, failed)

    def add(self, key: str, operation: str, *arguments: Any) -> None:
        """Let an operation wait; it replaces one that waits with the same key."""
        with self._lock:
            self._waiting[key] = operation, *arguments

    def awaits(self, beginning: str) -> bool:
        """Return whether an operation waits whose key begins so."""
        return any(key.startswith(beginning) for key in self._waiting)

    def run_waiting(self) -> None:
        """Run the operations that wait; what they raise is reported."""
        if self._waiting:
            with self._lock:
                waiting, self._waiting = self._waiting, {}
            for key, operation in waiting.items():
                try:
                    self.run(*operation)
                except Exception as error:  # What it was for may have gone since.
                    self._report(key, error)

    def clear(self) -> None:
        """Forget the operations that wait."""
        with self._lock:
            self._waiting = {}
