# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Repeat recorded episodes and nodes in a fresh simulation, and compare states and digests."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import contextlib
from dataclasses import dataclass
from typing import Any
import warnings

import mujoco
import numpy as np

from manip_sim.control.commands import GripperCommand, NoCommand, Status
from manip_sim.errors import CommandError, DivergenceError, ManipSimError, ModelError, RecordError
from manip_sim.interface.composition import compose_world, Composition, CONTENTS
from manip_sim.interface.parameter_spec import GivenParameters
from manip_sim.models.registry import is_of_others, is_path
from manip_sim.models.user_files import parse_yaml
from manip_sim.quoting import one_line, pluralize, quoted
from manip_sim.records.recorded import files_of, parse_json, Record, RecordedEpisode
from manip_sim.records.recorder import physics_state
from manip_sim.resources import package_version
from manip_sim.simulation import Simulation
from manip_sim.simulation.journal_entries import (
    check_sum, decoded_commands, NumberedHandles, Operations, restore_plain)
from manip_sim.tasks import create_task, Episode, start


@dataclass(frozen=True)
class Repetition:
    """
    Result of repeating an episode.

    :ivar periods: control periods that were repeated
    :ivar difference: where it first differs from the record, and why that may be; None if it
        does not
    :ivar difference_period: the control period in which it first differs, 0 for the start; None
        if it does not
    """

    recorded: RecordedEpisode
    periods: int
    success: bool
    difference: str | None = None
    difference_period: int | None = None


class Replay:
    """Repeats episodes; the simulation of one is used for the next if it has the same world."""

    def __init__(self) -> None:
        self._key: tuple[object, ...] = ()
        self._episode: Episode | None = None

    def repeat(self, recorded: RecordedEpisode) -> Repetition:
        """
        Repeat an episode up to its end, or to where its record ends.

        :raises RecordError: if it cannot be repeated here
        """
        actions, states, taken = recorded.actions, recorded.states, recorded.taken
        if len(states) == 0 or taken is None and len(states) > 1 and len(actions) == 0:
            raise RecordError(f'episode {recorded.number} has no actions that could be repeated')
        if len(states) < len(actions):
            raise RecordError(f'episode {recorded.number} has {len(actions)} actions and '
                              f'{len(states)} states')
        episode, digests = self._fresh(recorded), recorded.digests
        first: tuple[int, str] | None = None
        try:
            for period in range(len(states)):
                if period:
                    due = [(0, actions[period - 1])] if taken is None else (
                        taken.get(period - 1, []))
                    for steps, action in due:
                        episode.take(action, steps)
                    episode.advance()
                if first is None and not np.array_equal(
                        physics_state(episode.simulation), states[period], equal_nan=True):
                    first = period, 'the state'
                if first is None and period in digests and digests[period] != episode.digest:
                    first = period, 'the digest'
        except (CommandError, DivergenceError) as error:
            first = first or (episode.periods + 1, str(error))
        if first is None and recorded.result is not None and (
                episode.digest != recorded.result['digest']):
            first = episode.periods, 'the digest'
        success = episode.success
        if first is None and recorded.result is not None and success != recorded.success:
            first = episode.periods, 'success'
        if first is None:
            return Repetition(recorded, episode.periods, success)
        period, value = first
        instant = f'in period {period} of {len(states) - 1}' if period else 'at the start'
        return Repetition(recorded, episode.periods, success, f'{value} first differs {instant}'
                          + _reason(recorded, episode), period)

    def _fresh(self, recorded: RecordedEpisode) -> Episode:
        about = recorded.about
        key = tuple(about.get(name) for name in (
            'task', 'arguments', 'period_s', 'action', 'latency', 'noise'))
        try:
            if self._episode is None or key != self._key:
                task = create_task(about['task'], **recorded.json('arguments'))
                self._episode, self._key = Episode(
                    task, Simulation(task.world), recorded.period_s, about['action'],
                    recorded.json('latency'), noise=recorded.json('noise')), key
            # Time goes on over the episodes of a record.
            self._episode.simulation.step_count = int(about['steps'])
            self._episode.reset(recorded.seed, recorded.json('drawn') or None)
        except (CommandError, ModelError) as error:
            raise RecordError(f'episode {recorded.number} cannot be repeated here: {error}'
                              ) from error
        except Exception as error:  # A record may say anything in place of names and numbers.
            raise RecordError(f'episode {recorded.number} cannot be repeated here: '
                              f'{type(error).__name__} {one_line(str(error), 200)}') from error
        return self._episode


def _reason(recorded: RecordedEpisode, episode: Episode) -> str:
    """Return why a repetition may differ, by versions, model and machine."""
    here = f'manip_sim {package_version()} with MuJoCo {mujoco.mj_versionString()}'
    if recorded.versions != here:
        return f': it was recorded by {recorded.versions}, this is {here}'
    if files_of(recorded.model) != files_of(episode.task.world.to_archive()):
        return ': the model is another one than that of the record'
    return f'; both are {here}' + (
        '' if recorded.about.get('machine') is None else
        f", recorded on {recorded.about['machine']} with NumPy {recorded.about.get('numpy')}")


#: Objects, or items of a list of parameters, that a record may ask for; an object takes 0.2 MB.
_MOST_ITEMS = 1000
#: Robots; each makes the checks of the start longer for all: 40 of two arms take a minute.
_MOST_ROBOTS = 32
#: Parameters with files that are not in the catalogue.
_FILES = ('robot', 'gripper', 'base', 'arena', 'objects', 'randomization', 'faults', 'model_path')


class _Stop(Exception):
    """The journal cannot be repeated from here to where it begins again."""


class JournalReplay:
    """
    Repeats the record of a node.

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
                message = parse_json(text)
                number, entries = message['number'], message['entries']
            except (ValueError, TypeError, KeyError, RecursionError) as error:
                raise RecordError(f'{self._record.path}: a message of the journal cannot be '
                                  f'read: {one_line(str(error), 200)}') from error
            if type(number) is not int or not isinstance(entries, list):
                raise RecordError(f'{self._record.path}: a message of the journal cannot be read')
            yield number, entries

    def _leave(self, problem: str) -> None:
        """Give up until the journal begins again."""
        if self._world is not None:
            time_s = self._world.simulation.time_ns / 1e9
            self.problems.append(f'{problem}, after {pluralize(self.periods, "control period")}, '
                                 f'at {time_s:.6f} s')
        self._world = None

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
            reason = (str(error) if isinstance(error, ManipSimError)
                      else f'{type(error).__name__} {one_line(str(error), 200)}')
            if self._world is None:
                self.problems.append(f'the journal cannot be repeated here: {reason}')
            else:
                self._leave(f'the journal cannot be repeated: {reason}')


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
        self._handles = NumberedHandles()
        _check_count(len(about['objects']))
        self._operations.make_objects(about['objects'])
        self._handles.add(restore_plain(self.simulation, state))
        self._entries: dict[str, Callable[..., None]] = {
            'commands': self._commands, 'withdrawn': self._withdrawn,
            'operation': self._operation, 'period': self._period, 'digest': self._digest}

    def _restart(self, seed: int | None) -> None:
        self._seed = self._seed if seed is None else seed
        assert self._task is not None
        start(self._task, self.simulation, self._seed)

    def take(self, kind: str, *content: Any) -> None:
        """Repeat an entry."""
        if self._ends_period and kind != 'digest':
            self._ends_period = False
            if self._task is not None and self.simulation.diverged is None:
                self._task.end_period(self.simulation)
        self._entries[kind](*content)

    def _commands(self, content: Any) -> None:
        commands, handles = decoded_commands(self.simulation, content)
        self._handles.add(handles)
        for robot, command in commands:
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
        spawned = {'spawn': [arguments], 'spawn_all': next(iter(arguments), ())}.get(name, ())
        _check_count(len(self.simulation.plan.object_names) + len(spawned))
        reason = None
        try:
            for item in spawned if not failed else ():
                if item[1] is None:
                    raise _Stop(f'{quoted(item[0])} was spawned from a file, which the record '
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


def _check_count(count: int) -> None:
    if count > _MOST_ITEMS:
        raise RecordError(f'the record has {count} objects, and at most {_MOST_ITEMS} are '
                          'repeated')


def _composed(parameters: dict[str, Any]) -> Composition:
    """
    Compose the world of parameters from a record.

    :raises RecordError: if they name files
    """
    for name, value in parameters.items():
        most = _MOST_ROBOTS if name == 'robots' else _MOST_ITEMS
        if isinstance(value, list) and len(value) > most:
            raise RecordError(f'the parameter {quoted(name)} has {len(value)} items, and at most '
                              f'{most} are repeated')
        if name.rpartition('.')[2] in _FILES:
            for text in map(str, value if isinstance(value, list) else [value]):
                if name in CONTENTS and text.lstrip().startswith('{'):
                    continue
                described = parse_yaml(text, name) if text.lstrip().startswith('{') else {}
                if text and (name == 'model_path' or is_path(text) or is_of_others(text)
                             or 'file' in described):
                    raise RecordError(f'the parameter {quoted(name)} names a file or folder, '
                                      'and a record does not contain those')
    return compose_world(GivenParameters(parameters))
