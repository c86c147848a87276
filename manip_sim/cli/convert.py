# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim convert``: records as data sets for learning."""

from __future__ import annotations

import argparse

from manip_sim.cli.output import ProgressBar
from manip_sim.quoting import counted
from manip_sim.records.converting import convert, records_in


def run(options: argparse.Namespace) -> tuple[str, int]:
    with ProgressBar('episodes') as progress:
        episodes, periods, notes = convert(records_in(options.files), options.to, options.out,
                                           progress.show, options.only_success)
    summary = f'{counted(episodes, "episode")}, {counted(periods, "control period")}'
    if notes:
        summary += f'; {len(notes)} incomplete'
    return '\n'.join([*notes, f'{options.out} ({summary})']), 0
