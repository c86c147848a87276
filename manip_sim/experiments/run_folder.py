# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The folder of a run: rows as they come, so that a run resumes; then a table and a summary."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, ExitStack
from dataclasses import dataclass
import fcntl
import json
import math
import os
from pathlib import Path
from typing import Any

from manip_sim.errors import ManipSimError, ModelError
from manip_sim.experiments.experiment import parse_seeds, Row, summarize, TIMES
from manip_sim.quoting import format_value

#: Files in the folder; the first says what the run is. The last is a folder.
RUN, EPISODES, SUMMARY, RECORDS = 'run.json', 'episodes.parquet', 'summary.json', 'records'
INTERFACE = 'interface.json'
_ROWS = 'rows-{}-of-{}.jsonl'


class RunFolder:
    """
    The folder of a run, or of shards of one.

    :param path: of the folder; it is made
    :param description: what the rows depend on, as JSON can hold it
    :param seeds: of the whole run; those that the folder does not have yet are added to it
    :param period_s: length of a control period [s]
    :param again: remove the rows and records of an earlier run, whatever it was
    :raises ManipSimError: if the folder has files, but not of this run, or has other seeds too
    """

    def __init__(self, path: Path, description: Mapping[str, Any], seeds: Sequence[int],
                 period_s: float, again: bool = False) -> None:
        self.path = path
        self._seeds = list(seeds)
        self._period_s = period_s
        self._run = {**description, 'seeds': spans(seeds), 'period_s': period_s}
        if again and (path / RUN).is_file():
            self._forget()
        self._claim()

    @property
    def seeds(self) -> tuple[int, ...]:
        """The seeds of the whole run, in the order of the rows."""
        return tuple(self._seeds)

    def _forget(self) -> None:
        """Remove rows and records, unless a process adds some; others keep off meanwhile."""
        files = [*self.path.glob('rows-*.jsonl')]
        with ExitStack() as stack:
            for file in files:
                _lock(stack.enter_context(file.open('a+')), file)
            for file in [*files, self.path / EPISODES, self.path / SUMMARY,
                         *(self.path / RECORDS).glob('*.mcap')]:
                file.unlink(missing_ok=True)
            self._write_run()

    def _claim(self) -> None:
        """Write what the run is, or check that the folder is of this run."""
        self.path.mkdir(parents=True, exist_ok=True)
        file = self.path / RUN
        if not file.exists():
            others = [entry.name for entry in self.path.iterdir()]
            if others:
                raise ModelError(f'{self.path} is not the folder of a run, but has {others[0]}: '
                                 'choose another one')
            # Shards may begin at the same time: the first one wins, and all write the same.
            self._write_run()
        there = read_json(file)
        if there.get('policy_content') != self._run.get('policy_content') and (
                there.get('policy') == self._run.get('policy')):
            raise ModelError(f'{self.path} has rows of {self._run.get("policy")} as it was before '
                             'its files changed: choose another folder, or replace the rows '
                             'with --again')
        # Files may lie elsewhere, with the same content.
        for key in sorted({*there, *self._run} - {'seeds', 'policy_files'}):
            if there.get(key) != self._run.get(key):
                raise ModelError(
                    f'{self.path} is the folder of another run: its {key} is '
                    f'{format_value(there.get(key), 100)}, '
                    f'not {format_value(self._run.get(key), 100)}: choose another folder')
        self._add_seeds(parse_seeds(there['seeds']))

    def _add_seeds(self, there: list[int]) -> None:
        """Let the seeds begin with those that are there: shards keep the seeds that they have."""
        if not set(there) <= set(self._seeds):
            raise ModelError(f'{self.path} has the seeds {spans(there)}: name all of them, and '
                             f'those to add, not {spans(self._seeds)}')
        had = set(there)
        self._seeds = [*there, *(seed for seed in self._seeds if seed not in had)]
        if len(self._seeds) > len(there):
            self._run['seeds'] = spans(self._seeds)
            self._write_run()

    def _write_run(self) -> None:
        _replace(self.path / RUN, json.dumps(self._run, indent=2).encode())

    def write_interface(self, interface: Mapping[str, Any]) -> None:
        """
        Write what the policy gets and gives, a file that can be put beside a policy.

        :param interface: as ``manip_sim.tasks.interface_of`` returns it
        """
        _replace(self.path / INTERFACE, json.dumps(interface, indent=1).encode())

    @contextmanager
    def shard(self, number: int, count: int, retry_errors: bool = False) -> Iterator[Shard]:
        """
        Open a shard for the one process that may write its rows.

        :param number: from 1
        :param count: number of shards
        :param retry_errors: run seeds again whose rows have an error
        :raises ModelError: if it runs already, or the folder has shards of another count
        """
        for file in self.path.glob('rows-*.jsonl'):
            other = file.stem.rpartition('-')[2]
            if other != str(count):
                raise ModelError(f'{self.path} has shards of {other}, not of {count}')
        file = self.path / _ROWS.format(number, count)
        with file.open('a+') as opened:
            _lock(opened, file)
            yield Shard(opened, self._seeds[number - 1::count], retry_errors)

    def rows(self) -> dict[int, Row]:
        """
        Return the rows of all shards so far, by seed, in the order of the seeds.

        :raises ModelError: if two shards have the same seed, or a file is damaged
        """
        return _rows_in(self.path, self._seeds)

    def finish(self) -> dict[str, Any]:
        """
        Write the table and the summary of the rows so far, and return the summary.

        :raises ManipSimError: if pyarrow is not installed
        """
        rows = self.rows()
        summary = {**self._run, **summarize(rows.values(), len(self._seeds), self._period_s)}
        write_table(self.path / EPISODES, rows.values())
        _replace(self.path / SUMMARY, json.dumps(summary, indent=2).encode())
        return summary


class Shard:
    """
    The rows of a shard.

    :param file: of its rows, locked
    :param seeds: all of its seeds
    :param retry_errors: count rows with an error as missing
    :ivar left: the seeds that have no row yet
    :ivar done: number of rows that were there
    :ivar successes: number of those that succeeded
    """

    def __init__(self, file: Any, seeds: Sequence[int], retry_errors: bool = False) -> None:
        self._file = file
        file.seek(0)
        there = {seed: row for seed, row in read_rows(file).items()
                 if not (retry_errors and row.error)}
        # The remainder of a line of a process that was killed is cut off.
        file.seek(0)
        whole = file.read().rpartition('\n')
        file.seek(0)
        file.truncate(len((whole[0] + whole[1]).encode()))
        self.left = [seed for seed in seeds if seed not in there]
        self.done = len(there)
        self.successes = sum(row.success for row in there.values())

    def add(self, row: Row) -> None:
        """
        Add a row, which is on the disk afterwards.

        :param row: of a seed of :attr:`left`
        """
        self._file.seek(0, os.SEEK_END)
        self._file.write(json.dumps(row.as_dict()) + '\n')
        self._file.flush()
        os.fsync(self._file.fileno())


@dataclass(frozen=True)
class StoredRun:
    """
    A run as it lies in its folder, complete or not.

    :ivar path: of the folder
    :ivar description: what the rows depend on, as :attr:`Experiment.description` has it
    :ivar seeds: of the whole run
    :ivar period_s: length of a control period [s]
    :ivar rows: those that are there, by seed, in the order of the seeds
    """

    path: Path
    description: Mapping[str, Any]
    seeds: tuple[int, ...]
    period_s: float
    rows: Mapping[int, Row]

    @property
    def records(self) -> Path | None:
        """The folder of the records; None if there are none."""
        folder = self.path / RECORDS
        return folder if folder.is_dir() else None


def read_run(path: Path) -> StoredRun:
    """
    Read the folder of a run, and change nothing in it.

    :param path: of the folder
    :raises ModelError: if it is not the folder of a run, or a file in it is damaged
    """
    file = path / RUN
    if not file.is_file():
        raise ModelError(f'{path} is not the folder of a run: it has no {RUN}')
    description = read_json(file)
    text, period_s = description.pop('seeds', None), description.pop('period_s', None)
    if not isinstance(text, str) or not isinstance(period_s, float) or not (
            0.0 < period_s < math.inf):
        raise ModelError(f'{file} does not belong to a run: it needs the seeds and the length of '
                         'a control period')
    seeds = parse_seeds(text)
    return StoredRun(path, description, tuple(seeds), period_s, _rows_in(path, seeds))


def _rows_in(folder: Path, seeds: Iterable[int]) -> dict[int, Row]:
    """Return the rows of all shards by seed, in the order of some seeds."""
    by_seed: dict[int, Row] = {}
    for file in sorted(folder.glob('rows-*.jsonl')):
        with file.open() as opened:
            try:
                rows = read_rows(opened)
            except (ModelError, ValueError) as error:
                raise ModelError(f'{file}: {error}') from error
        for seed, row in rows.items():
            if seed in by_seed:
                raise ModelError(f'{folder}: two shards have the seed {seed}')
            by_seed[seed] = row
    return {seed: by_seed[seed] for seed in seeds if seed in by_seed}


def read_rows(lines: Iterable[str]) -> dict[int, Row]:
    """
    Return rows by seed; of several of a seed, the last one.

    :param lines: JSON each; one without an end is left out
    :raises ModelError: if a line is not a row
    """
    rows = {}
    for number, line in enumerate(lines, 1):
        if not line.endswith('\n'):
            break
        try:
            row = Row.of(json.loads(line))
        except (ValueError, TypeError, AttributeError) as error:
            raise ModelError(f'line {number} is not a row: {line[:60]!r}') from error
        rows[row.seed] = row
    return rows


def read_json(file: Path) -> dict[str, Any]:
    """
    Return what a file of a run says.

    :raises ModelError: if it is not JSON of a run
    """
    try:
        content = json.loads(file.read_text())
    except ValueError as error:
        raise ModelError(f'{file} does not belong to a run: {error}') from error
    if not isinstance(content, dict):
        raise ModelError(f'{file} does not belong to a run')
    return content


def spans(seeds: Sequence[int]) -> str:
    """Return seeds as a text that ``parse_seeds`` reads, such as ``0:1000``."""
    pieces: list[list[int]] = []
    for seed in seeds:
        if pieces and pieces[-1][-1] == seed - 1:
            pieces[-1][1:] = [seed]
        else:
            pieces.append([seed])
    return ','.join(str(piece[0]) if len(piece) == 1 else f'{piece[0]}:{piece[-1] + 1}'
                    for piece in pieces)


def write_table(file: Path, rows: Iterable[Row]) -> None:
    """
    Write rows as Parquet.

    :raises ManipSimError: if pyarrow is not installed
    """
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as error:
        raise ManipSimError("a table of episodes needs pyarrow: pip install 'manip_sim[run]'"
                            ) from error
    schema = pyarrow.schema([
        ('seed', pyarrow.int64()), ('success', pyarrow.bool_()), ('return', pyarrow.float64()),
        ('periods', pyarrow.int64()), ('digest', pyarrow.string()), ('error', pyarrow.string()),
        ('faults', pyarrow.string()),
        *((name, pyarrow.float64()) for name in TIMES)])
    part = file.with_name(f'.{file.name}.{os.getpid()}')
    parquet.write_table(pyarrow.Table.from_pylist([row.as_dict() for row in rows], schema), part)
    part.replace(file)


def _lock(opened: Any, file: Path) -> None:
    """Lock a file of rows; a process that adds rows to it has it locked."""
    try:
        fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        number, count = file.stem.split('-')[1::2]
        raise ModelError(
            f'shard {number}/{count} of {file.parent} is already running') from error


def _replace(file: Path, content: bytes) -> None:
    part = file.with_name(f'.{file.name}.{os.getpid()}')
    part.write_bytes(content)
    part.replace(file)
