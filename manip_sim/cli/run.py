# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim run`` and ``manip_sim merge``: how often a policy does a task."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
import contextlib
from html import escape
import importlib.util
import itertools
import os
from pathlib import Path
import signal
import sys
from typing import Any

import numpy as np

from manip_sim.cli.output import table, terminal_width, write_whole
from manip_sim.errors import ManipSimError, ModelError, UnknownNameError
from manip_sim.experiments import Experiment, parse_seeds, parse_shard, RunFolder, Worker
from manip_sim.experiments.policies import ROS
from manip_sim.experiments.processes import run_in_processes, run_on_ray
from manip_sim.experiments.run_folder import read_run, RECORDS, Shard
from manip_sim.experiments.summary import Row
from manip_sim.interface.parameter_spec import read_parameters
from manip_sim.models.faults import FaultPlan
from manip_sim.models.randomization import Randomization
from manip_sim.quoting import quoted
from manip_sim.resources import share_directory
from manip_sim.startup import processors
from manip_sim.tasks import AnswerTime, Latency, Setting
from manip_sim.tasks.late_answers import MEASURED

#: Files of noise in the package, ``config/noise_NAME.yaml``.
_PROFILES = ('franka', 'ideal', 'ur')
#: Of what a sweep varies: begin of the names of folders, and head of the column.
_FOLDERS = {'command': 'latency', 'state': 'latency', 'answer': 'answer_time'}
_HEADS = {'command': 'latency of a command', 'state': 'latency of a state',
          'answer': 'answer time'}

#: Picture of a sweep, in the folder of its runs.
PLOT = 'success.svg'
#: Size of the picture, and its margins on the left, right, top and bottom [pixels].
_WIDTH, _HEIGHT = 640, 400
_LEFT, _RIGHT, _TOP, _BOTTOM = 70, 20, 45, 55
#: Half of the width of the ends of an interval [pixels].
_CAP = 5
#: Lines of the success [%].
_PERCENT = (0, 25, 50, 75, 100)


def run(options: argparse.Namespace) -> tuple[str, int]:
    """Run or merge; return the table, and 1 if the policy failed in an episode, else 0."""
    if importlib.util.find_spec('pyarrow') is None:
        raise ManipSimError("a table of episodes needs pyarrow: pip install 'manip_sim[run]'")
    return _merge(options) if options.command == 'merge' else _run(options)


def _run(options: argparse.Namespace) -> tuple[str, int]:
    options.out = options.out.absolute()
    noise, late = _noise(options)
    for option, key in (('latency_jitter', 'command_jitter'),
                        ('state_latency_jitter', 'state_jitter')):
        if getattr(options, option) is not None:
            late[key] = getattr(options, option)
    options.noise, options.late = noise, late
    options.timing = {key: value for key, value in (
        ('jitter', options.answer_time_jitter), ('chunk_hz', options.chunk_hz),
        ('ask_ahead', options.ask_ahead)) if value is not None}
    sweeps: dict[str, list[Any]] = {
        'command': _or_one(options.latency, late['command']),
        'state': _or_one(options.state_latency, late['state']),
        'answer': _answer_times(options.answer_time)}
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
    if not several:
        summary = _run_one(options, cases[0], options.out)
        return _interrupted(options) if summary is None else _summary_text(summary)
    (kind,) = several
    found = []
    for case in cases:
        late_s = case[kind]
        text = late_s if isinstance(late_s, str) else f'{late_s:g}'
        summary = _run_one(options, case, options.out / f'{_FOLDERS[kind]}_{text}')
        if summary is None:
            return _interrupted(options)
        found.append((late_s, summary))
    _plot(found, kind, options.out / PLOT)
    return _sweep_text(found, kind)


def _plot(found: list[tuple[Any, dict[str, Any]]], kind: str, file: Path) -> None:
    """Draw the success over latencies of which at least two are numbers."""
    numbers = [entry for entry in found if not isinstance(entry[0], str)]
    if len(numbers) > 1:
        title = _sweep_title(found)
        write_whole(file, lambda part: part.write_text(
            success_over(title, _HEADS[kind], numbers)))


def _sweep_title(found: list[tuple[Any, dict[str, Any]]]) -> str:
    return f'{found[0][1]["task"]}, {found[0][1]["policy"]}'


def _or_one(given: list[float] | None, default: float) -> list[float]:
    return [default] if given is None else given


def _answer_times(given: str | None) -> list[float | str]:
    """
    Return the values of --answer-time.

    :raises ModelError: if one is neither a number nor ``measured``
    """
    found: list[float | str] = []
    for text in (given or '0').split(','):
        try:
            found.append(text if text == MEASURED else float(text))
        except ValueError as error:
            raise ModelError(f"--answer-time must be seconds or '{MEASURED}', got "
                             f'{quoted(text)}') from error
    return found


def _noise(options: argparse.Namespace) -> tuple[dict[str, float], dict[str, float]]:
    """Return noise by the names of the node's parameters, and what it says about latency [s]."""
    found: dict[str, Any] = {}
    for given in options.noise or ():
        name, is_value, value = given.partition(':=')
        if is_value:
            try:
                found[name] = float(value)
            except ValueError as error:
                raise ModelError(f'--noise {quoted(given)}: {quoted(value)} is not a number'
                                 ) from error
            continue
        profile = share_directory() / 'config' / f'noise_{given}.yaml'
        if given not in _PROFILES and not Path(given).is_file():
            raise UnknownNameError('noise', given, _PROFILES)
        found |= read_parameters(profile if given in _PROFILES else Path(given))
    late = dict.fromkeys(('command', 'state', 'command_jitter', 'state_jitter'), 0.0)
    late |= {key: found.pop(f'latency.{key}') for key in late if f'latency.{key}' in found}
    if any(late.values()):
        task = Setting(options.task, options.robot, options.gripper,
                       control_hz=options.control_hz).create_task()
        late = Latency.of(late).rounded_up(task.world.timestep_s).as_mapping()
    return found, late


def _interrupted(options: argparse.Namespace) -> tuple[str, int]:
    return f'{options.out}: interrupted; run the same command again to continue', 130


def _sweep_text(found: list[tuple[Any, dict[str, Any]]], kind: str) -> tuple[str, int]:
    """Return the table of runs with several latencies, and the exit code."""
    rows = []
    for late_s, summary in found:
        low, high = (f'{100.0 * limit:.1f}' for limit in summary['success_rate_95'])
        time_s = summary['median_time_of_success_s']
        late = late_s if isinstance(late_s, str) else f'{late_s:g} s'
        rows.append((late, f'{summary["successes"]} of {summary["episodes"]}',
                     f'{low} to {high} %', '-' if time_s is None else f'{time_s:.2f} s',
                     str(sum(summary['errors'].values()))))
    title = _sweep_title(found)
    heads = _HEADS[kind], 'success', '95 % interval', 'median time', 'failed'
    return (table(title, heads, rows, terminal_width()),
            int(any(summary['errors'] for _, summary in found)))


def _run_one(options: argparse.Namespace, case: dict[str, Any], out: Path
             ) -> dict[str, Any] | None:
    """Run all seeds with latencies and an answer time; return None after an interruption."""
    seeds = parse_seeds(options.seeds)
    number, count = parse_shard(options.shard)
    if options.address is not None and options.engine != 'ray':
        raise ModelError('--address is for --engine ray')
    if options.record and importlib.util.find_spec('mcap') is None:
        raise ManipSimError("--record needs mcap: pip install 'manip_sim[records]'")
    ros = options.policy.startswith(ROS)
    if ros and (options.engine == 'ray' or options.worlds not in (None, 1)):
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
    return run_seeds(experiment, out, seeds, options, (number, count))


def run_seeds(experiment: Experiment, out: Path, seeds: Sequence[int],
              options: argparse.Namespace, shard_of: tuple[int, int] = (1, 1)
              ) -> dict[str, Any] | None:
    """
    Run the seeds that a folder does not have yet.

    :param experiment: to run
    :param out: folder of the run
    :param seeds: of the whole run
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
    successes, episodes = shard.successes, shard.done
    with contextlib.closing(rows), _progress(shard) as bar:  # type: ignore[type-var]
        for row in rows:
            shard.add(row)
            episodes, successes = episodes + 1, successes + row.success
            bar.set_postfix_str(f'{100.0 * successes / episodes:.1f} % succeed', refresh=False)
            bar.update()


def _progress(shard: Shard) -> Any:
    try:
        from tqdm import tqdm
    except ImportError as error:
        raise ManipSimError("progress needs tqdm: pip install 'manip_sim[run]'") from error
    # Without a terminal, a line now and then.
    often = 0.1 if sys.stderr.isatty() else 30.0
    return tqdm(total=shard.done + len(shard.left), initial=shard.done, unit='episode',
                mininterval=often, dynamic_ncols=True)


def _merge(options: argparse.Namespace) -> tuple[str, int]:
    first = read_run(options.folders[0])
    runs = []
    for path in options.folders:  # A RunFolder would be made where there is none.
        runs.append(RunFolder(path, first.description, read_run(path).seeds, first.period_s))
    seeds = [*dict.fromkeys(seed for folder in runs for seed in folder.seeds)]
    target = RunFolder(options.out, first.description, seeds, first.period_s)
    given: dict[int, Path] = {}
    with target.shard(1, 1) as shard:
        left = set(shard.left)
        for folder in runs:
            for seed, row in folder.rows().items():
                if seed in given:
                    raise ModelError(f'{given[seed]} and {folder.path} both have the seed {seed}: '
                                     'the same shard twice')
                given[seed] = folder.path
                if seed in left:
                    shard.add(row)
    return _summary_text(target.finish())


def _thinks(time: dict[str, Any]) -> str:
    """Return how long the policy thinks in simulated time."""
    found = 'as long as it takes' if time['measured'] else f'{time["mean_s"]:g} s'
    if time['jitter_s']:
        found += f' +- {time["jitter_s"]:g} s'
    if time['chunk_hz'] is not None:
        found += f', chunks at {time["chunk_hz"]:g} Hz'
    return found + (f', asked {time["ask_ahead"]} actions ahead' if time['ask_ahead'] else '')


def _answers(summary: dict[str, Any]) -> str:
    """Return how long the policy takes, and whether that is longer than a control period."""
    mean_s, longest_s = (summary['answer_time_s'][kind] or 0.0 for kind in ('mean', 'max'))
    period_s = summary['period_s']
    late = '' if longest_s <= period_s else f'; a control period is {1e3 * period_s:g} ms'
    return f'after {1e3 * mean_s:.3g} ms of wall time, {1e3 * longest_s:.3g} ms at most{late}'


def _summary_text(summary: dict[str, Any]) -> tuple[str, int]:
    count, late = summary['episodes'], summary['latency']
    low, high = (f'{100.0 * limit:.1f}' for limit in summary['success_rate_95'])
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
                    f'{100.0 * (summary["success_rate"] or 0.0):.1f} %, 95 % interval {low} to '
                    f'{high} %'),
        ('median time', '-' if time_s is None else f'{time_s:.2f} s'),
        ('mean return', f'{summary["mean_return"] or 0.0:.2f}'), ('answers', _answers(summary))]
    rows += [('failed', f'{number} x {error}') for error, number in summary['errors'].items()]
    return (table('Run', ('what', 'value'), rows, terminal_width()),
            int(bool(summary['errors'])))


def success_over(title: str, head: str, found: Sequence[tuple[float, dict[str, Any]]]) -> str:
    """
    Return an SVG of success rates with their 95 % intervals over latencies.

    :param title: above the picture
    :param head: of the horizontal axis
    :param found: latencies [s], in any order, two of which differ, with the summary of each run
    """
    found = sorted(found, key=lambda entry: entry[0])
    lowest, highest = found[0][0], found[-1][0]
    right, bottom = _WIDTH - _RIGHT, _HEIGHT - _BOTTOM

    def across(late_s: float) -> float:
        share = (late_s - lowest) / (highest - lowest)
        return float(np.round(_LEFT + 20 + share * (right - _LEFT - 40), 1))

    def up(rate: float) -> float:
        return float(np.round(bottom - rate * (bottom - _TOP), 1))

    parts = [_label(_WIDTH / 2, 24, title, 'middle'),
             _label((_LEFT + right) / 2, _HEIGHT - 14, f'{head} [s]', 'middle'),
             _label(18, _TOP - 12, 'success [%]', 'start')]
    for percent in _PERCENT:
        y = up(percent / 100.0)
        parts += [_line(_LEFT, y, right, y, '#ddd'), _label(_LEFT - 8, y + 4, str(percent), 'end')]
    parts += [_label(across(late_s), bottom + 20, f'{late_s:g}', 'middle') for late_s, _ in found]
    points = []
    for late_s, summary in found:
        x, (low, high) = across(late_s), map(up, summary['success_rate_95'])
        parts += [_line(x, low, x, high), _line(x - _CAP, low, x + _CAP, low),
                  _line(x - _CAP, high, x + _CAP, high)]
        points.append((x, up(summary['success_rate'] or 0.0)))
    parts.append('<polyline fill="none" stroke="#1f77b4" points="'
                 + ' '.join(f'{x:g},{y:g}' for x, y in points) + '"/>')
    parts += [f'<circle cx="{x:g}" cy="{y:g}" r="4" fill="#1f77b4"/>' for x, y in points]
    return (f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}" '
            f'font-family="sans-serif" font-size="13">\n'
            f'<rect width="{_WIDTH}" height="{_HEIGHT}" fill="white"/>\n'
            + '\n'.join(parts) + '\n</svg>\n')


def _label(x: float, y: float, text: str, anchor: str) -> str:
    return f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}">{escape(text)}</text>'


def _line(x: float, y: float, to_x: float, to_y: float, color: str = '#1f77b4') -> str:
    return f'<line x1="{x:g}" y1="{y:g}" x2="{to_x:g}" y2="{to_y:g}" stroke="{color}"/>'
