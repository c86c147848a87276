# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Repeat the record of a node by its journal, and compare states and digests."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import contextlib
import json
from typing import Any
import warnings
import weakref

import numpy as np

from manip_sim.errors import DivergenceError, ManipSimError, ModelError, RecordError
from manip_sim.interface.composition import compose_world, Composition
from manip_sim.interface.given_parameters import GivenParameters
from manip_sim.models.strict_yaml import parse_yaml
from manip_sim.models.sources import is_of_others, is_path
from manip_sim.quoting import counted, one_line, quoted
from manip_sim.records.recorded import Record
from manip_sim.simulation import Simulation
from manip_sim.simulation.commands import (
    Command, CommandHandle, GripperCommand, NoCommand, Status)
from manip_sim.simulation.operations import Operations
from manip_sim.simulation.plain_state import check_sum, decoded, restore_plain
from manip_sim.tasks import start

#: Parameters with files that are not in the catalogue.
_FILES = ('robot', 'gripper', 'base', 'arena', 'objects', 'task', 'randomization', 'model_path')


class _Stop(Exception):
    """What follows cannot be repeated, up to where the journal begins again."""


class JournalReplay:
    """
    Repeats the record of a node.

    :param record: of a node
    :ivar problems: what differs or cannot be repeated, a line for each
    :ivar periods: how many control periods were repeated, up to a difference
    :ivar changes: how many commands and operations were
    """

    def __init__(self, record: Record) -> None:
        self._record = record
        self.problems: list[str] = []
        self.periods = self.changes = 0
        self._world: _World | None = None
        self._begun = False

    def repeat(self, progress: Callable[[int], object] = lambda done: None) -> None:
        """
        Repeat the record up to its end, or to where it ends early.

        :param progress: is called with the number of control periods from time to time
        :raises RecordError: if the file is damaged, or holds no journal
        """
        expected: int | None = None
        with warnings.catch_warnings(), np.errstate(all='ignore'):
            warnings.simplefilter('ignore')
            for number, entries in self._messages():
                if expected is not None and number != expected:
                    self._leave(f'messages of the journal are missing: number {number} follows '
                                f'{expected - 1}')
                expected = number + 1
                for entry in entries:
                    self._take(entry)
                progress(self.periods)
        if not self._begun:
            raise RecordError(
                f'{self._record.path} is the record of a node without the beginning of its '
                'journal, so it cannot be repeated: record ~/journal too')

    def _messages(self) -> Iterator[tuple[int, list[Any]]]:
        for text in self._record.journal():
            try:
                message = json.loads(text)
                number, entries = message['number'], message['entries']
            except (ValueError, TypeError, KeyError, RecursionError) as error:
                raise RecordError(f'{self._record.path}: a message of the journal cannot be '
                                  'read') from error
            if type(number) is not int or not isinstance(entries, list):
                raise RecordError(f'{self._record.path}: a message of the journal cannot be read')
            yield number, entries

    def _leave(self, problem: str) -> None:
        """Give up until the journal begins again."""
        if self._world is not None:
            self.problems.append(f'{problem}, after {self._where()}')
        self._world = None

    def _where(self) -> str:
        assert self._world is not None
        return (f'{counted(self.periods, "control period")}, at '
                f'{self._world.simulation.time_ns / 1e9:.6f} s')

    def _take(self, entry: Any) -> None:
        try:
            kind, *content = entry
            if kind == 'start':
                self._begun, self._world = True, None
                self._world = _World(*content)
            elif kind == 'unknown':
                self._leave(f'{one_line(str(content[0]), 200)}, which cannot be repeated')
            elif self._world is not None:
                self._world.take(kind, *content)
                self.periods += kind == 'period'
                self.changes += kind != 'period' and kind != 'digest'
        except _Stop as error:
            self._leave(str(error))
        except Exception as error:  # A record may hold anything.
            what = (str(error) if isinstance(error, ManipSimError)
                    else f'{type(error).__name__} {one_line(str(error), 200)}')
            if self._world is None:
                self.problems.append(f'the journal cannot be repeated here: {what}')
            else:
                self._leave(f'the journal cannot be repeated: {what}')


class _World:
    """A simulation that repeats entries."""

    def __init__(self, about: dict[str, Any], state: dict[str, Any]) -> None:
        composition = _composed(about['parameters'])
        self._steps = composition.steps
        self.simulation = Simulation(composition.world)
        self._operations = Operations(self.simulation, self._steps)
        self._task, self._seed = composition.task, about['task_seed']
        self._ends_period = False
        if self._task is not None:
            self._operations.restart = self._restart
            self._restart(None)
        #: Handles of commands by their numbers, as long as something has them.
        self._handles: weakref.WeakValueDictionary[int, CommandHandle] = (
            weakref.WeakValueDictionary())
        self._numbers = 0
        self._operations.make_objects(about['objects'])
        self._number(restore_plain(self.simulation, state))
        self._entries: dict[str, Callable[..., None]] = {
            'commands': self._commands, 'withdrawn': self._withdrawn,
            'operation': self._operation, 'period': self._period, 'digest': self._digest}

    def _restart(self, seed: int | None) -> None:
        self._seed = self._seed if seed is None else seed
        assert self._task is not None
        start(self._task, self.simulation, self._seed)

    def _number(self, handles: list[CommandHandle]) -> None:
        for handle in handles:
            self._handles[self._numbers] = handle
            self._numbers += 1

    def take(self, kind: str, *content: Any) -> None:
        """Repeat an entry."""
        if self._ends_period and kind != 'digest':
            self._ends_period = False
            if self._task is not None and self.simulation.diverged is None:
                self._task.end_period(self.simulation)
        self._entries[kind](*content)

    def _commands(self, content: Any) -> None:
        commands, handles = decoded(self.simulation, content)
        self._number(handles)
        for robot, command in commands:
            if not isinstance(command, Command):
                raise ModelError('a command is none')
            try:
                self.simulation.robots[robot].apply(
                    command, period_s=self._steps * self.simulation.timestep_s)
            except Exception as error:  # As in the node.
                command.handle.end(Status.ABORTED, str(error))

    def _withdrawn(self, name: str, number: int, part: str | None, reason: str) -> None:
        handle, robot = self._handles.get(number), self.simulation.robots[name]
        if handle is not None:
            kind = NoCommand if part is None else GripperCommand
            robot.withdraw(kind(
                robot=robot.robot_model, parts=frozenset(() if part is None else (part,)),
                indices=np.empty(0, np.int64), handle=handle), str(reason))

    def _operation(self, name: str, arguments: list[Any], failed: bool) -> None:
        if name not in self._operations.names:
            raise ModelError(f'there is no operation {quoted(name)}')
        reason = None
        try:
            if name == 'spawn' and arguments[1] is None and not failed:
                raise _Stop(f'{quoted(arguments[0])} was spawned from a file, which the record '
                            'does not contain')
            self._operations.run(name, *arguments)
        except ManipSimError as error:
            reason = str(error)
        if (reason is not None) is not failed:
            raise _Stop(f'the operation {quoted(name)} did '
                        + (f'not fail in the node, and fails here: {reason}' if reason else
                           'fail in the node, and does not here'))

    def _period(self, expected: int) -> None:
        with contextlib.suppress(DivergenceError):
            self.simulation.advance(self._steps)
        self._ends_period = True
        if check_sum(self.simulation) != expected:
            raise _Stop('the state differs')

    def _digest(self, expected: str) -> None:
        if self.simulation.digest() != expected:
            raise _Stop('the digest differs')


def _composed(given: dict[str, Any]) -> Composition:
    """
    Compose the world of parameters from a record.

    :raises RecordError: if they name files
    """
    for name, value in given.items():
        if name.rpartition('.')[2] in _FILES:
            for text in map(str, value if isinstance(value, list) else [value]):
                described = parse_yaml(text, name) if text.lstrip().startswith('{') else {}
                if text and (name == 'model_path' or is_path(text) or is_of_others(text)
                             or 'file' in described):
                    raise RecordError(f'the parameter {quoted(name)} names a file or folder, '
                                      'and a record does not contain those')
    return compose_world(GivenParameters(given))
