# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim run``, ``merge`` and ``compare``: how often policies do a task."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
import contextlib
import importlib.util
import itertools
import json
import os
from pathlib import Path
import signal
import sys
from typing import Any

from manip_sim.cli.composing_options import noise_parameters
from manip_sim.cli.output import table, terminal_width, UsageError, write_whole
from manip_sim.errors import ManipSimError, ModelError, RecordError
from manip_sim.experiments import (
    Experiment, parse_seeds, parse_shard, RunFolder, wilson_interval, Worker)
from manip_sim.experiments.comparison import (
    compare, Comparison, first_difference, Pairs, recorded_episode, seeds_to_add)
from manip_sim.experiments.experiment import Row, success_over
from manip_sim.experiments.policies import policy_content, ROS
from manip_sim.experiments.processes import run_in_processes, run_on_ray
from manip_sim.experiments.run_folder import read_run, RECORDS, Shard, StoredRun
from manip_sim.models.faults import FaultPlan
from manip_sim.models.randomization import Randomization
from manip_sim.quoting import pluralize, quoted
from manip_sim.records.video import write_side_by_side
from manip_sim.startup import processors
from manip_sim.tasks import AnswerTime, Latency, Setting
from manip_sim.tasks.latency import MEASURED

#: Of what a sweep varies: begin of the names of folders, and head of the column.
_FOLDERS = {'command': 'latency', 'state': 'latency', 'answer': 'answer_time'}
_HEADS = {'command': 'latency of a command', 'state': 'latency of a state',
          'answer': 'answer time'}

_INTERRUPTED, _CONTINUE = 130, 'interrupted; run the same command again to continue'
#: Picture of a sweep, in the folder of its runs.
PLOT = 'success.svg'


def run(options: argparse.Namespace) -> tuple[str, int]:
    """Run or merge; return the table, and 1 if the policy failed in an episode, else 0."""
    if importlib.util.find_spec('pyarrow') is None:
        raise ManipSimError("a table of episodes needs pyarrow: pip install 'manip_sim[run]'")
    return _merge(options) if options.command == 'merge' else _run(options)


def _run(options: argparse.Namespace) -> tuple[str, int]:
    options.out = options.out.absolute()
    options.noise, options.late = _noise(options)
    options.late |= {key: jitter for key, jitter in (
        ('command_jitter', options.latency_jitter), ('state_jitter', options.state_latency_jitter))
        if jitter is not None}
    options.timing = {key: value for key, value in (
        ('jitter', options.answer_time_jitter), ('chunk_hz', options.chunk_hz),
        ('ask_ahead', options.ask_ahead)) if value is not None}
    answer_times: list[float | str] = []
    for text in (options.answer_time or '0').split(','):
        try:
            answer_times.append(text if text == MEASURED else float(text))
        except ValueError as error:
            raise ModelError(f"--answer-time must be seconds or '{MEASURED}', got "
                             f'{quoted(text)}') from error
    sweeps: dict[str, list[Any]] = {
        'command': options.latency or [options.late['command']],
        'state': options.state_latency or [options.late['state']],
        'answer': answer_times}
    cases = [dict(zip(sweeps, values)) for values in itertools.product(*sweeps.values())]
    several = [kind for kind, values in sweeps.items() if len(values) > 1]
    if len(several) > 1:
        raise ModelError('only one of --latency, --state-latency and --answer-time can have '
                         'several values')
    if any(len({*values}) < len(values) for values in sweeps.values()):
        raise ModelError('the latencies must differ')
    for case in cases:  # Before the first of them is run.
        Latency.of({'command': case['command'], 'state': case['state']})
        AnswerTime.of({**options.timing, 'time': case['answer']})
    summaries: list[tuple[Any, dict[str, Any]]] = []
    for case in cases:
        folder, late_s = options.out, None
        for kind in several:
            late_s = case[kind]
            folder /= f'{_FOLDERS[kind]}_' + (
                late_s if isinstance(late_s, str) else f'{late_s:g}')
        summary = _run_one(options, case, folder)
        if summary is None:
            return (f'{options.out}: {_CONTINUE}', _INTERRUPTED)
        summaries.append((late_s, summary))
    if not several:
        return _summary_text(summaries[0][1])
    title, head = f'{summaries[0][1]["task"]}, {summaries[0][1]["policy"]}', _HEADS[several[0]]
    numbers = [entry for entry in summaries if not isinstance(entry[0], str)]
    if len(numbers) > 1:
        write_whole(options.out / PLOT, lambda part: part.write_text(
            success_over(title, head, numbers)))
    return _sweep_text(summaries, title, head)


def _noise(options: argparse.Namespace) -> tuple[dict[str, float], dict[str, float]]:
    """Return noise by the names of the node's parameters, and what it says about latency [s]."""
    values: dict[str, Any] = {}
    for noise in options.noise or ():
        name, is_value, value = noise.partition(':=')
        if is_value:
            try:
                values[name] = float(value)
            except ValueError as error:
                raise ModelError(f'--noise {quoted(noise)}: {quoted(value)} is not a number'
                                 ) from error
            continue
        values |= noise_parameters(noise)
    late = dict.fromkeys(('command', 'state', 'command_jitter', 'state_jitter'), 0.0)
    late |= {key: values.pop(f'latency.{key}') for key in late if f'latency.{key}' in values}
    if any(late.values()):
        task = Setting(options.task, options.robot, options.gripper,
                       control_hz=options.control_hz).create_task()
        late = Latency.of(late).rounded_up(task.world.timestep_s).as_mapping()
    return values, late


def _sweep_text(summaries: list[tuple[Any, dict[str, Any]]], title: str, head: str
                ) -> tuple[str, int]:
    """Return the table of runs with several latencies, and the exit code."""
    rows = []
    for late_s, summary in summaries:
        time_s = summary['median_time_of_success_s']
        late = late_s if isinstance(late_s, str) else f'{late_s:g} s'
        rows.append((late, f'{summary["successes"]} of {summary["episodes"]}',
                     _span(summary['success_rate_95']),
                     '-' if time_s is None else f'{time_s:.2f} s',
                     str(sum(summary['errors'].values()))))
    heads = head, 'success', '95 % interval', 'median time', 'failed'
    return (table(title, heads, rows, terminal_width()),
            int(any(summary['errors'] for _, summary in summaries)))


def _run_one(options: argparse.Namespace, case: dict[str, Any], out: Path
             ) -> dict[str, Any] | None:
    """Run all seeds with latencies and an answer time; return None after an interruption."""
    seeds = parse_seeds(options.seeds)
    shard = parse_shard(options.shard)
    if options.address is not None and options.engine != 'ray':
        raise ModelError('--address is for --engine ray')
    if options.record and importlib.util.find_spec('mcap') is None:
        raise ManipSimError("--record needs mcap: pip install 'manip_sim[records]'")
    if options.policy.startswith(ROS) and (
            options.engine == 'ray' or options.worlds not in (None, 1)):
        raise ModelError('a ROS node acts in one episode at a time: it needs --worlds 1, and no '
                         '--engine ray')
    latency = {**options.late, 'command': case['command'], 'state': case['state']}
    setting = Setting(
        options.task, options.robot, options.gripper, options.action, options.control_hz,
        latency, tuple(options.cameras or ()), options.image_size,
        {**({} if options.randomization is None else {
            'randomization': Randomization(options.randomization)}),
         **({} if options.faults is None else {'faults': FaultPlan(options.faults)})},
        options.noise,
        {**options.timing, 'time': case['answer']})
    records = out / RECORDS if options.record else None
    experiment = Experiment(
        setting, options.policy, records, options.policy_limit, options.batch)
    return run_seeds(experiment, out, seeds, options, shard)


def run_seeds(experiment: Experiment, out: Path, seeds: Sequence[int],
              options: argparse.Namespace, shard_of: tuple[int, int] = (1, 1)
              ) -> dict[str, Any] | None:
    """
    Run the seeds that a folder does not have yet.

    :param options: ``worlds``, ``engine``, ``address``, ``again`` and ``retry_errors``
    :param shard_of: number and count of the shard
    :returns: the summary, or None after an interruption
    """
    ros = experiment.policy.startswith(ROS)
    # Values that cannot be used are reported here, before anything is written.
    folder_before = Path.cwd()
    try:
        worker = Worker(experiment)
        period_s, interface = worker.period_s, worker.interface
    finally:
        os.chdir(folder_before)  # A policy may have left it.
    folder = RunFolder(out, experiment.description, seeds, period_s, options.again)
    folder.write_interface(interface)
    with folder.shard(*shard_of, options.retry_errors) as shard:
        if options.engine == 'ray':
            rows = run_on_ray(experiment, shard.left, options.address, options.worlds)
        else:
            rows = run_in_processes(
                experiment, shard.left,
                1 if ros or experiment.batch and not options.worlds else (
                    options.worlds or processors()))
        try:
            with _interruptible():
                _collect(rows, shard)
        except KeyboardInterrupt:
            folder.finish()
            return None
    return folder.finish()


@contextlib.contextmanager
def _interruptible() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM, which Slurm sends when time is up, raise KeyboardInterrupt."""
    before = {number: signal.signal(number, signal.default_int_handler)
              for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _collect(rows: Iterator[Row], shard: Shard) -> None:
    """Add rows as they come, and show how far it is."""
    try:
        from tqdm import tqdm
    except ImportError as error:
        raise ManipSimError("progress needs tqdm: pip install 'manip_sim[run]'") from error
    successes, episodes = shard.successes, shard.done
    with contextlib.closing(rows), tqdm(  # type: ignore[type-var]
            total=episodes + len(shard.left), initial=episodes, unit='episode',
            # Without a terminal, a line now and then.
            mininterval=0.1 if sys.stderr.isatty() else 30.0, dynamic_ncols=True) as bar:
        for row in rows:
            shard.add(row)
            episodes, successes = episodes + 1, successes + row.success
            bar.set_postfix_str(f'{100.0 * successes / episodes:.1f} % succeed', refresh=False)
            bar.update()


def _merge(options: argparse.Namespace) -> tuple[str, int]:
    first = read_run(options.folders[0])
    # A RunFolder alone would be made where there is none.
    runs = [RunFolder(path, first.description, read_run(path).seeds, first.period_s)
            for path in options.folders]
    seeds = [*dict.fromkeys(seed for folder in runs for seed in folder.seeds)]
    target = RunFolder(options.out, first.description, seeds, first.period_s)
    folders_by_seed: dict[int, Path] = {}
    with target.shard(1, 1) as shard:
        left = set(shard.left)
        for folder in runs:
            for seed, row in folder.rows().items():
                if seed in folders_by_seed:
                    raise ModelError(f'{folders_by_seed[seed]} and {folder.path} both have the '
                                     f'seed {seed}: the same shard twice')
                folders_by_seed[seed] = folder.path
                if seed in left:
                    shard.add(row)
    return _summary_text(target.finish())


def _thinks(time: dict[str, Any]) -> str:
    """Return how long the policy thinks in simulated time."""
    duration = 'as long as it takes' if time['measured'] else f'{time["mean_s"]:g} s'
    if time['jitter_s']:
        duration += f' +- {time["jitter_s"]:g} s'
    if time['chunk_hz'] is not None:
        duration += f', chunks at {time["chunk_hz"]:g} Hz'
    return duration + (f', asked {time["ask_ahead"]} actions ahead' if time['ask_ahead'] else '')


def _answers(summary: dict[str, Any]) -> str:
    """Return how long the policy takes, and whether that is longer than a control period."""
    mean_s, longest_s = (summary['answer_time_s'][kind] or 0.0 for kind in ('mean', 'max'))
    period_s = summary['period_s']
    late = '' if longest_s <= period_s else f'; a control period is {1e3 * period_s:g} ms'
    return f'after {1e3 * mean_s:.3g} ms of wall time, {1e3 * longest_s:.3g} ms at most{late}'


def _summary_text(summary: dict[str, Any]) -> tuple[str, int]:
    count, late = summary['episodes'], summary['latency']
    time_s = summary['median_time_of_success_s']
    rows = [
        ('task', f'{summary["task"]}, {summary["robot"]}'), ('policy', summary['policy']),
        ('actions', f'{summary["action"]}, {summary["control_hz"]:g} Hz'),
        ('latency', ', '.join(
            f'{kind} {late[f"{kind}_s"]:g} s' + (
                f' +- {jitter:g} s' if (jitter := late.get(f'{kind}_jitter_s')) else '')
            for kind in ('command', 'state'))),
        *((('thinks', _thinks(summary['answer_time'])),) if 'answer_time' in summary else ()),
        *((('noise', ', '.join(f'{name} {value:g}' for name, value in noise.items())),)
          if (noise := summary.get('noise')) else ()),
        ('episodes', f'{count} of {summary["of"]}'),
        ('success', f'{summary["successes"]} of {count}: '
                    f'{100.0 * (summary["success_rate"] or 0.0):.1f} %, 95 % interval '
                    f'{_span(summary["success_rate_95"])}'),
        ('median time', '-' if time_s is None else f'{time_s:.2f} s'),
        ('mean return', f'{summary["mean_return"] or 0.0:.2f}'), ('answers', _answers(summary))]
    rows += [('failed', f'{number} x {error}') for error, number in summary['errors'].items()]
    return (table('Run', ('what', 'value'), rows, terminal_width()),
            int(bool(summary['errors'])))


#: Seeds that differ and are listed, and shown in videos; of more, only the number is told.
_LISTED, _FILMED = 50, 10
_MOST_SEEDS = 10_000


def compare_runs(options: argparse.Namespace) -> tuple[str, int]:
    """Compare; return the tables, and 1 if a run is worse by more than the threshold."""
    try:
        comparison = compare([read_run(path) for path in options.runs], options.across)
        if options.until is not None and comparison.width > options.until:
            grown = _add_seeds(options, comparison)
            if grown is None:
                return _CONTINUE, _INTERRUPTED
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
            all_seeds = [*dict.fromkeys([*run.seeds, *seeds])]
            print(f'{run.path}: {len(all_seeds)} seeds', file=sys.stderr)
            if run_seeds(experiment, run.path.absolute(), all_seeds, how) is None:
                return None
        comparison = compare([read_run(path) for path in options.runs], options.across)
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
             *([] if options.threshold is None else [
                 f'{run.path}: {_verdict(pairs, options.threshold)}'
                 for run, pairs in zip(comparison.runs[1:], comparison.pairs)]),
             *comparison.notes, *_changed(comparison), *lines]
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
