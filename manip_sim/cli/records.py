# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim record``, ``replay``, ``convert`` and ``demonstrate``: records."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import contextlib
import importlib.util
import sys
from types import ModuleType
from typing import TYPE_CHECKING

from manip_sim.cli.output import ProgressBar
from manip_sim.errors import ManipSimError, RecordError
from manip_sim.experiments.demonstrations import (
    action_of, Demonstration, Demonstrator, Device, open_device)
from manip_sim.quoting import pluralize
from manip_sim.records.converting import convert as convert_records, records_in
from manip_sim.records.recorded import Record
from manip_sim.records.replay import JournalReplay, Replay
from manip_sim.ros_environment import check_ros_environment, missing_module
from manip_sim.tasks import Setting

if TYPE_CHECKING:
    from manip_sim.viewer.task_page import TaskPage


def record(options: argparse.Namespace) -> tuple[str, int]:
    check_ros_environment()
    try:
        from manip_sim.records.node_recorder import record_node
    except ImportError as error:
        raise RecordError(missing_module(error)) from error
    name = f'/{options.node.strip("/")}'
    with ProgressBar('messages') as progress:
        text, written = record_node(
            options.file, name, options.topics, options.duration, progress.show)
    return text, int(not written)


def replay(options: argparse.Namespace) -> tuple[str, int]:
    """Repeat the records; return what differs, how many do not, and the exit code."""
    repeated = _Repeated(options.verify)
    for path in records_in(options.files):
        record = Record(path)
        if record.of_node:
            repeated.node(record)
        else:
            repeated.episodes(record)
        if record.cut_off:
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
                    repetition = self._replay.repeat(recorded)
                except RecordError as error:
                    raise RecordError(f'{record.path}: {error}') from error
                self._total += 1
                self._episodes += 1
                self._equal += repetition.difference is None
                self._succeeded += repetition.success
                self._recorded_success += recorded.success
                about = f'{record.path}: episode {recorded.number} (seed {recorded.seed})'
                if self._verify and repetition.difference is not None:
                    self.lines.append(f'{about}: {repetition.difference}')
                elif not self._verify and repetition.success != recorded.success:
                    self.lines.append(
                        f'{about}: {"success" if repetition.success else "no success"} after '
                        f'{repetition.periods} periods, not as recorded')
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


def convert(options: argparse.Namespace) -> tuple[str, int]:
    with ProgressBar('episodes') as progress:
        episodes, periods, notes = convert_records(
            records_in(options.files), options.to, options.out, progress.show,
            options.only_success)
    summary = f'{pluralize(episodes, "episode")}, {pluralize(periods, "control period")}'
    if notes:
        summary += f'; {len(notes)} incomplete'
    return '\n'.join([*notes, f'{options.out} ({summary})']), 0


_BROWSER = 'browser'


def demonstrate(options: argparse.Namespace) -> tuple[str, int]:
    """Demonstrate; return a line each, and 1 if one does not repeat, or none was kept."""
    if importlib.util.find_spec('mcap') is None:
        raise ManipSimError("demonstrations need mcap: pip install 'manip_sim[records]'")
    setting = Setting(options.task, options.robot, options.gripper, action_of(options.device),
                      options.rate)
    episode = setting.create_episode()
    with contextlib.ExitStack() as stack:
        device: Device = stack.enter_context(contextlib.closing(
            _pages().PageDevice(episode, options.listen, options.port)
            if options.device == _BROWSER else open_device(options.device, episode.actions.names)))
        page: TaskPage | None = None
        if options.view and options.device != _BROWSER:
            page = stack.enter_context(contextlib.closing(_pages().TaskPage(
                episode, options.listen, options.port)))
            print(f'the world is shown on {page.address}', file=sys.stderr)
        if device.help:
            print(device.help, file=sys.stderr)
        progress = stack.enter_context(ProgressBar('s'))

        def show(time_s: float, success: bool, force: float) -> None:
            progress.show(int(time_s), f', external force {force:.1f} N' + (
                ', success' if success else ''))
            if page is not None:
                page.update()
        options.out.mkdir(parents=True, exist_ok=True)
        kept = [*_demonstrations(options, Demonstrator(
            episode, device, options.out, {'device': options.device}, show))]
    successes = sum(demonstration.success for demonstration in kept)
    equal = sum(demonstration.repeats for demonstration in kept)
    return (f'{options.out}: {pluralize(len(kept), "demonstration")}, '
            f'{successes} with success; {equal} of {len(kept)} repeat'), int(
                equal < len(kept) or not kept)


def _demonstrations(options: argparse.Namespace, demonstrator: Demonstrator
                    ) -> Iterator[Demonstration]:
    """Yield the demonstrations that are kept; tell of each."""
    seed, count = options.seed, 0
    while count < options.episodes:
        if (options.out / f'{seed}.mcap').exists():
            seed += 1
            continue
        try:
            demonstration = demonstrator.run(seed)
        except KeyboardInterrupt:
            return
        print(_line(demonstration), file=sys.stderr)
        if demonstration.file is not None:
            yield demonstration
            seed, count = seed + 1, count + 1
        if demonstration.quits:
            return


def _pages() -> ModuleType:
    try:
        from manip_sim.viewer import task_page
    except ImportError as error:
        raise ManipSimError(missing_module(error)) from error
    return task_page


def _line(demonstration: Demonstration) -> str:
    """Return what became of a demonstration, and of its repetition."""
    outcome = 'success' if demonstration.success else 'no success'
    about = (f'seed {demonstration.seed}: {outcome} after '
             f'{pluralize(demonstration.periods, "control period")}')
    if demonstration.repetition is None:
        return f'{about}, discarded'
    if demonstration.repeats:
        return f'{about}, repeats to {outcome}: {demonstration.file}'
    return f'{about}, does not repeat: {demonstration.repetition.difference}'
