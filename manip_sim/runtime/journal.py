# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What has changed a simulation from outside, in the order in which it took effect."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from manip_sim.control.commands import Command, CommandHandle, GripperCommand
from manip_sim.errors import ModelError
from manip_sim.simulation import Simulation
from manip_sim.simulation.json_codec import Encoder
from manip_sim.simulation.json_state import check_sum, NumberedHandles, plain_state

#: How often there is a digest [control periods].
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
        #: Whether a start has to follow.
        self.incomplete = False

    @property
    def active(self) -> bool:
        """Whether it is written."""
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
        """Write what is left, and keep nothing from now on."""
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
