# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim replay``: repeat recorded episodes, and compare them with the record."""

from __future__ import annotations

import argparse
from pathlib import Path

from manip_sim.cli.progress import ProgressBar
from manip_sim.errors import RecordError
from manip_sim.records.converting import records_in
from manip_sim.records.recorded import Record
from manip_sim.records.repeating import Repetition, Replay


def run(options: argparse.Namespace) -> tuple[str, int]:
    """Repeat the episodes; return what differs, how many do not, and the exit code."""
    replay, lines = Replay(), []
    total = equal = succeeded = recorded_success = 0
    with ProgressBar('episodes') as progress:
        for path in records_in(options.files):
            record = Record(path)
            for recorded in record.episodes():
                try:
                    found = replay.repeat(recorded)
                except RecordError as error:
                    raise RecordError(f'{path}: {error}') from error
                total += 1
                equal += found.difference is None
                succeeded += found.success
                recorded_success += recorded.success
                lines += _lines(path, found, options.verify)
                progress.show(total)
            if record.cut_off:
                lines.append(f'{path}: the file ends early, and was read up to there')
    if not options.verify:
        lines.append(f'{succeeded} of {total} succeed, {recorded_success} did when they were '
                     'recorded')
        return '\n'.join(lines), 0
    cut_off = any(line.endswith('up to there') for line in lines)
    lines.append(f'{equal} of {total} equal')
    return '\n'.join(lines), int(equal < total or cut_off)


def _lines(path: Path, found: Repetition, verify: bool) -> list[str]:
    about = f'{path}: episode {found.recorded.number} (seed {found.recorded.seed})'
    if found.difference is not None and verify:
        return [f'{about}: {found.difference}']
    if found.success != found.recorded.success and not verify:
        return [f'{about}: {"success" if found.success else "no success"} after '
                f'{found.periods} periods, not as recorded']
    return []
