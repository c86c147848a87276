# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim record``, ``convert`` and ``replay``: records of nodes and episodes."""

from __future__ import annotations

import argparse
from pathlib import Path

from manip_sim.cli.output import ProgressBar
from manip_sim.errors import RecordError
from manip_sim.quoting import pluralize
from manip_sim.records.converting import convert as convert_records, records_in
from manip_sim.records.recorded import Record
from manip_sim.records.replay import JournalReplay, Repetition, Replay
from manip_sim.ros_environment import check_ros_environment, missing_module


def record(options: argparse.Namespace) -> tuple[str, int]:
    check_ros_environment()
    try:
        from manip_sim.records.node_recorder import record_node
    except ImportError as error:
        raise RecordError(missing_module(error)) from error
    name = f'/{options.node.strip("/")}'
    with ProgressBar('messages') as progress:
        text, found = record_node(
            options.file, name, options.topics, options.duration, progress.show)
    return text, int(not found)


def replay(options: argparse.Namespace) -> tuple[str, int]:
    """Repeat the records; return what differs, how many do not, and the exit code."""
    repeated = _Repeated(options.verify)
    for path in records_in(options.files):
        found = Record(path)
        if found.of_node:
            repeated.node(found)
        else:
            repeated.episodes(found)
        if found.cut_off:
            repeated.cut_off = True
            repeated.lines.append(f'{path}: the file ends early, and was read up to there')
    return repeated.result()


class _Repeated:
    """Results of repeated records."""

    def __init__(self, verify: bool) -> None:
        self._verify = verify
        self._replay = Replay()
        self.lines: list[str] = []
        self.cut_off = False
        self._total = self._equal = self._episodes = 0
        self._succeeded = self._recorded_success = 0

    def episodes(self, record: Record) -> None:
        with ProgressBar('episodes') as progress:
            for recorded in record.episodes():
                try:
                    found = self._replay.repeat(recorded)
                except RecordError as error:
                    raise RecordError(f'{record.path}: {error}') from error
                self._total += 1
                self._episodes += 1
                self._equal += found.difference is None
                self._succeeded += found.success
                self._recorded_success += recorded.success
                self.lines += _lines(record.path, found, self._verify)
                progress.show(self._episodes)

    def node(self, record: Record) -> None:
        replay = JournalReplay(record)
        with ProgressBar('control periods') as progress:
            replay.repeat(progress.show)
        self._total += 1
        self._equal += not replay.problems
        if self._verify:
            self.lines += [f'{record.path}: {problem}' for problem in replay.problems]
        self.lines.append(f'{record.path}: {pluralize(replay.periods, "control period")} '
                          f'repeated, with {pluralize(replay.changes, "change")} from outside')

    def result(self) -> tuple[str, int]:
        if self._verify:
            return '\n'.join([*self.lines, f'{self._equal} of {self._total} equal']), int(
                self._equal < self._total or self.cut_off)
        if self._episodes or not self._total:
            self.lines.append(f'{self._succeeded} of {self._episodes} succeed, '
                              f'{self._recorded_success} did when they were recorded')
        return '\n'.join(self.lines), 0


def _lines(path: Path, found: Repetition, verify: bool) -> list[str]:
    about = f'{path}: episode {found.recorded.number} (seed {found.recorded.seed})'
    if found.difference is not None and verify:
        return [f'{about}: {found.difference}']
    if found.success != found.recorded.success and not verify:
        return [f'{about}: {"success" if found.success else "no success"} after '
                f'{found.periods} periods, not as recorded']
    return []


def convert(options: argparse.Namespace) -> tuple[str, int]:
    with ProgressBar('episodes') as progress:
        episodes, periods, notes = convert_records(
            records_in(options.files), options.to, options.out, progress.show,
            options.only_success)
    summary = f'{pluralize(episodes, "episode")}, {pluralize(periods, "control period")}'
    if notes:
        summary += f'; {len(notes)} incomplete'
    return '\n'.join([*notes, f'{options.out} ({summary})']), 0
