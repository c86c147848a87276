# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The folder of a run: rows as they come, so that a run resumes; then a table and a summary."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
import fcntl
import json
import os
from pathlib import Path
from typing import Any

from manip_sim.errors import ManipSimError, ModelError
from manip_sim.experiments.summary import Row, summarize
from manip_sim.quoting import shown

#: Files in the folder; the first says what the run is.
RUN, EPISODES, SUMMARY = 'run.json', 'episodes.parquet', 'summary.json'
_ROWS = 'rows-{}-of-{}.jsonl'


class RunFolder:
    """
    The folder of a run, or of shards of one.

    :param path: of the folder; it is made
    :param description: what the rows depend on, as JSON can hold it
    :param seeds: of the whole run
    :param period_s: length of a control period [s]
    :raises ManipSimError: if the folder has files, but not of this run
    """

    def __init__(self, path: Path, description: Mapping[str, Any], seeds: Sequence[int],
                 period_s: float) -> None:
        self.path = path
        self._seeds = list(seeds)
        self._period_s = period_s
        self._run = {**description, 'seeds': spans(seeds), 'period_s': period_s}
        self._claim()

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
            part = file.with_suffix(f'.{os.getpid()}')
            part.write_text(json.dumps(self._run, indent=2))
            part.replace(file)
        there = read_json(file)
        for key in sorted({*there, *self._run}):
            if there.get(key) != self._run.get(key):
                raise ModelError(
                    f'{self.path} is the folder of another run: its {key} is '
                    f'{shown(there.get(key), 100)}, not {shown(self._run.get(key), 100)}')

    @contextmanager
    def shard(self, number: int, count: int) -> Iterator[Shard]:
        """
        Open a shard for the one process that may write its rows.

        :param number: from 1
        :param count: number of shards
        :raises ModelError: if it runs already, or the folder has shards of another count
        """
        for file in self.path.glob('rows-*.jsonl'):
            other = file.stem.rpartition('-')[2]
            if other != str(count):
                raise ModelError(f'{self.path} has shards of {other}, not of {count}')
        with (self.path / _ROWS.format(number, count)).open('a+') as own:
            try:
                fcntl.flock(own, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                raise ModelError(
                    f'shard {number}/{count} of {self.path} is already running') from error
            yield Shard(own, self._seeds[number - 1::count])

    def rows(self) -> dict[int, Row]:
        """
        Return the rows of all shards so far, by seed, in the order of the seeds.

        :raises ModelError: if two shards have the same seed
        """
        found: dict[int, Row] = {}
        for file in sorted(self.path.glob('rows-*.jsonl')):
            with file.open() as opened:
                for seed, row in read_rows(opened).items():
                    if seed in found:
                        raise ModelError(f'{self.path}: two shards have the seed {seed}')
                    found[seed] = row
        return {seed: found[seed] for seed in self._seeds if seed in found}

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
    :ivar left: the seeds that have no row yet
    :ivar done: number of rows that were there
    """

    def __init__(self, file: Any, seeds: Sequence[int]) -> None:
        self._file = file
        file.seek(0)
        there = read_rows(file)
        # What a process that was killed has left of a line is cut off.
        file.seek(0)
        whole = file.read().rpartition('\n')
        file.seek(0)
        file.truncate(len((whole[0] + whole[1]).encode()))
        self.left = [seed for seed in seeds if seed not in there]
        self.done = len(there)

    def add(self, row: Row) -> None:
        """
        Add a row, which is on the disk afterwards.

        :param row: of a seed of :attr:`left`
        """
        self._file.seek(0, os.SEEK_END)
        self._file.write(json.dumps(row.as_dict()) + '\n')
        self._file.flush()
        os.fsync(self._file.fileno())


def read_rows(lines: Iterable[str]) -> dict[int, Row]:
    """
    Return rows by seed.

    :param lines: JSON each; one without an end is left out
    :raises ModelError: if a line is not a row
    """
    found = {}
    for number, line in enumerate(lines, 1):
        if not line.endswith('\n'):
            break
        try:
            row = Row.of(json.loads(line))
        except (ValueError, TypeError) as error:
            raise ModelError(f'line {number} is not a row: {line[:60]!r}') from error
        found[row.seed] = row
    return found


def read_json(file: Path) -> dict[str, Any]:
    """
    Return what a file of a run says.

    :raises ModelError: if it is not JSON of a run
    """
    try:
        found = json.loads(file.read_text())
    except ValueError as error:
        raise ModelError(f'{file} does not belong to a run: {error}') from error
    if not isinstance(found, dict):
        raise ModelError(f'{file} does not belong to a run')
    return found


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
        ('periods', pyarrow.int64()), ('digest', pyarrow.string()), ('error', pyarrow.string())])
    part = file.with_name(f'.{file.name}.{os.getpid()}')
    parquet.write_table(pyarrow.Table.from_pylist([row.as_dict() for row in rows], schema), part)
    part.replace(file)


def _replace(file: Path, content: bytes) -> None:
    part = file.with_name(f'.{file.name}.{os.getpid()}')
    part.write_bytes(content)
    part.replace(file)
