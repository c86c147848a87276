# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim compare``: runs with the same seeds, pair by pair."""

from __future__ import annotations

import argparse
import json
import sys

from manip_sim.cli.output import table, terminal_width, UsageError
from manip_sim.cli.run import run_seeds
from manip_sim.errors import ManipSimError, RecordError
from manip_sim.experiments import Experiment, wilson_interval
from manip_sim.experiments.comparison import (
    compare, Comparison, first_difference, Pairs, recorded_episode, seeds_to_add)
from manip_sim.experiments.policies import policy_content
from manip_sim.experiments.run_folder import read_run, StoredRun
from manip_sim.quoting import pluralize
from manip_sim.records.video import write_side_by_side

_INTERRUPTED = 130
#: Seeds that differ and are listed, and shown in videos; of more, only the number is told.
_LISTED, _FILMED = 50, 10
_MOST_SEEDS = 10_000


def run(options: argparse.Namespace) -> tuple[str, int]:
    """Compare; return the tables, and 1 if a run is worse by more than the threshold."""
    try:
        comparison = _compare(options)
        if options.until is not None and comparison.width > options.until:
            grown = _add_seeds(options, comparison)
            if grown is None:
                return 'interrupted; run the same command again to continue', _INTERRUPTED
            comparison = grown
        lines = _film(options, comparison) if options.video is not None else []
    except (ManipSimError, OSError) as error:
        raise UsageError(str(error)) from error
    worse = [] if options.threshold is None else [
        run for run, pairs in zip(comparison.runs[1:], comparison.pairs)
        if pairs.is_worse(options.threshold)]
    if options.json:
        text = json.dumps({**comparison.as_dict(), 'videos': lines,
                           'worse': [str(run.path) for run in worse]}, indent=2)
    else:
        text = _text(options, comparison, lines)
    return text, int(bool(worse))


def _compare(options: argparse.Namespace) -> Comparison:
    return compare([read_run(path) for path in options.runs], options.across)


def _add_seeds(options: argparse.Namespace, comparison: Comparison) -> Comparison | None:
    """Add seeds to all runs until the intervals are narrow; None after an interruption."""
    how = argparse.Namespace(worlds=options.worlds, engine='processes', address=None, again=False,
                             retry_errors=False)
    while comparison.width > options.until:
        seeds = seeds_to_add(comparison, options.until, options.most or _MOST_SEEDS)
        if all(len(seeds) == len(run.rows) for run in comparison.runs):
            break
        for run in comparison.runs:
            experiment = Experiment.of(run.description, run.records, options.policy_limit)
            # Those that are there come first.
            own = [*dict.fromkeys([*run.seeds, *seeds])]
            print(f'{run.path}: {len(own)} seeds', file=sys.stderr)
            if run_seeds(experiment, run.path.absolute(), own, how) is None:
                return None
        comparison = _compare(options)
    return comparison


def _film(options: argparse.Namespace, comparison: Comparison) -> list[str]:
    """Write videos of seeds that differ; return a line for each that there is none of."""
    lines = []
    options.video.mkdir(parents=True, exist_ok=True)
    for seed in comparison.differing[:_FILMED]:
        try:
            episodes = [recorded_episode(run, seed) for run in comparison.runs]
        except RecordError as error:
            lines.append(f'no video of seed {seed}: {error}')
            continue
        titles = [f'{run.path.name}: {_outcome(run, seed)}' for run in comparison.runs]
        file = options.video / f'{seed}.mp4'
        write_side_by_side(file, episodes, titles, options.camera)
        lines.append(f'{file}: {", ".join(titles)}')
    return lines


def _outcome(run: StoredRun, seed: int) -> str:
    row = run.rows[seed]
    return 'success' if row.success else 'error' if row.error else 'no success'


def _text(options: argparse.Namespace, comparison: Comparison, lines: list[str]) -> str:
    first, width = comparison.runs[0], terminal_width()
    about, count = first.description, len(comparison.seeds)
    rows = []
    for run, successes in zip(comparison.runs, comparison.successes):
        content = run.description['policy_content']
        rows.append((str(run.path), run.description['policy'] + (
            f' ({content[:8]})' if content else ''), f'{successes} of {count}',
            f'{100.0 * successes / count:.1f} %',
            _span(wilson_interval(successes, count))))
    tables = [table(
        f'{about["task"]}, {about["robot"]}, {about["action"]}, {about["control_hz"]:g} Hz: '
        f'{count} seeds', ('run', 'policy', 'success', 'rate', '95 % interval'), rows, width)]
    tables.append(table(
        f'Difference from {first.path}',
        ('run', 'difference', '95 % interval', 'both', 'only first', 'only this', 'neither',
         "McNemar's p", 'mid-p'), [
            (str(run.path), f'{100.0 * pairs.difference:+.1f} %', _span(pairs.interval, '+'),
             str(pairs.both), str(pairs.only_first), str(pairs.only_second), str(pairs.neither),
             f'{pairs.p:.3g}', f'{pairs.mid_p:.3g}')
            for run, pairs in zip(comparison.runs[1:], comparison.pairs)], width))
    tables.append(_differing(comparison, width))
    notes = [f'{comparison.equal} of {count} episodes are equal to the last bit in all runs',
             *_verdicts(options, comparison), *comparison.notes, *_changed(comparison), *lines]
    return '\n'.join([text for text in tables if text] + notes)


def _span(limits: tuple[float, float], sign: str = '') -> str:
    low, high = (f'{100.0 * limit:{sign}.1f}' for limit in limits)
    return f'{low} to {high} %'


def _differing(comparison: Comparison, width: int) -> str:
    """Return the table of the seeds with which only some runs succeed."""
    first, *others = comparison.runs
    seeds = comparison.differing[:_LISTED]
    columns = [('seed', *map(str, seeds)), *(
        (str(run.path), *(_outcome(run, seed) for seed in seeds)) for run in comparison.runs)]
    if first.records:
        columns += [(f'states of {run.path} differ',
                     *(_begin_of_difference(first, run, seed) for seed in seeds))
                    for run in others if run.records]
    title = f'{pluralize(len(comparison.differing), "seed")} with different success'
    if len(comparison.differing) > _LISTED:
        title += f'; the first {_LISTED}'
    header, *rows = zip(*columns)
    return table(title, header, rows, width)


def _begin_of_difference(first: StoredRun, second: StoredRun, seed: int) -> str:
    try:
        period = first_difference(first, second, seed)
    except RecordError as error:
        return str(error)
    if period is None:
        return 'never'
    if period == 0:
        return 'at the start'
    return f'from period {period} on ({period * first.period_s:.2f} s)'


def _verdicts(options: argparse.Namespace, comparison: Comparison) -> list[str]:
    """Return a line for each run about the threshold, if there is one."""
    if options.threshold is None:
        return []
    return [f'{run.path}: {_verdict(pairs, options.threshold)}'
            for run, pairs in zip(comparison.runs[1:], comparison.pairs)]


def _verdict(pairs: Pairs, threshold: float) -> str:
    by = f'by more than {100.0 * threshold:g} %'
    if pairs.is_worse(threshold):
        return f'worse {by}'
    if pairs.interval[0] >= -threshold:
        return f'not worse {by}'
    return f'these seeds do not tell whether it is worse {by}; --until adds some'


def _changed(comparison: Comparison) -> list[str]:
    """Return a line for each run whose policy is another one by now."""
    missing = policy_content('no/such/policy.py:act')
    return [f'{run.path}: {run.description["policy"]} has changed since'
            for run in comparison.runs
            if policy_content(run.description['policy'], run.description.get('policy_files', ()))
            not in (run.description['policy_content'], missing)]
