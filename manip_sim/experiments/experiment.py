# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
A run, which is a setting and a policy, its seeds, and the worker that runs an episode.

An episode is a row of numbers; rows are summarized and plotted.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
import contextlib
from dataclasses import asdict, dataclass, field
import functools
from html import escape
import json
import math
from pathlib import Path
import platform
import random
import re
import statistics
import sys
import time
from typing import Any

import mujoco
import numpy as np

from manip_sim.errors import ManipSimError, ModelError
from manip_sim.experiments.policies import (
    files_read, LIMIT_S, load_policy, LOCAL_LIMIT_S, policy_content, PolicyFailure, ROS,
    wrap_errors)
from manip_sim.quoting import one_line, quoted
from manip_sim.resources import package_version
from manip_sim.tasks import AnswerTime, Episode, interface_of, Latency, Setting
from manip_sim.tasks.expert import Expert, Policy

#: More seeds than anybody runs: most likely a mistake.
MOST = 10_000_000
_PIECE = re.compile(r'(\d{1,18})(?::(\d{1,18})(?::(\d{1,18}))?)?', re.ASCII)
_SHARD = re.compile(r'(\d{1,9})/(\d{1,9})', re.ASCII)
#: Columns of wall times.
TIMES = ('wall_time_s', 'answer_mean_s', 'answer_max_s')
#: Of the normal distribution, for 95 %.
Z_95 = 1.959964


def parse_seeds(text: str) -> list[int]:
    """
    Return the seeds that a text stands for, in its order.

    :param text: such as ``7``, ``0:1000``, which is 0 to 999, ``0:1000:10`` or ``1,5,10:20``
    :raises ModelError: if it is none of these, or empty, or has a seed twice
    """
    seeds: list[int] = []
    for piece in text.split(','):
        match = _PIECE.fullmatch(piece.strip())
        if match is None:
            raise ModelError(f'seeds {quoted(text)}: {quoted(piece)} must be like 7, 0:1000 or '
                             '0:1000:10, of whole numbers from 0')
        first, stop, step = (None if group is None else int(group) for group in match.groups())
        assert first is not None
        span = range(first, first + 1 if stop is None else stop, 1 if step is None else step or 1)
        if not span or step == 0:
            raise ModelError(f'seeds {quoted(text)}: {quoted(piece)} has no seed; 0:1000 is 0 to '
                             '999')
        if len(seeds) + len(span) > MOST:
            raise ModelError(f'seeds {quoted(text)}: more than {MOST} seeds')
        seeds += span
    if len(set(seeds)) != len(seeds):
        raise ModelError(f'seeds {quoted(text)}: a seed appears twice')
    return seeds


def parse_shard(text: str) -> tuple[int, int]:
    """
    Return number and count of a shard.

    :param text: from ``1/4`` to ``4/4``
    :raises ModelError: if it is not like that
    """
    match = _SHARD.fullmatch(text.strip())
    number, count = (int(group) for group in match.groups()) if match else (0, 0)
    if not 1 <= number <= count:
        fits = f'from 1/{count} to {count}/{count}' if count else 'like 1/4'
        raise ModelError(f'shard {quoted(text)} must be {fits}')
    return number, count


@dataclass(frozen=True)
class Experiment:
    """
    Everything that decides the row of a seed; a worker gets a copy.

    :ivar setting: task, robot, actions, latency
    :ivar policy: as for :func:`load_policy`
    :ivar records: folder for a record of each episode; None for no records
    :ivar limit_s: how long an answer of the policy may take, wall time [s]; None for 10 s of a
        ROS node, 600 s of any other
    :ivar batch: number of episodes whose observations the policy gets at once, with a leading
        axis; 0: one, without that axis
    """

    setting: Setting
    policy: str
    records: Path | None = None
    limit_s: float | None = None
    batch: int = 0

    @classmethod
    def of(cls, description: Mapping[str, Any], records: Path | None = None,
           limit_s: float | None = None) -> Experiment:
        """
        Return the experiment of a description.

        :param description: as :attr:`description` returns it
        :param records: folder for a record of each episode; None for no records
        :param limit_s: how long an answer of the policy may take, wall time [s]; None for the
            default
        :raises ModelError: if something in it is missing or cannot be used
        """
        try:
            late = {key.removesuffix('_s'): value
                    for key, value in description['latency'].items()}
            size = description['image_size']
            setting = Setting(
                description['task'], description['robot'], description['gripper'],
                description['action'], description['control_hz'], late,
                tuple(description['cameras']), None if size is None else (size[0], size[1]),
                description['composition'], description.get('noise', {}),
                AnswerTime(**description.get('answer_time', {})))
            return cls(setting, description['policy'], records, limit_s,
                       description.get('batch', 0))
        except (KeyError, TypeError, AttributeError, IndexError) as error:
            raise ModelError(f'the description of a run cannot be used: {type(error).__name__}: '
                             f'{error}') from error

    @property
    def policy_limit_s(self) -> float:
        """Longest wait for an answer of the policy, wall time [s]."""
        default_s = LIMIT_S if self.policy.startswith(ROS) else LOCAL_LIMIT_S
        return default_s if self.limit_s is None else self.limit_s

    @functools.cached_property
    def description(self) -> dict[str, Any]:
        """
        Everything that the rows depend on, as JSON can hold it.

        It is that of the first call, also in copies: it takes long with large files.
        """
        setting, late = self.setting, self.setting.latency
        answer_time = AnswerTime.of(setting.answer_time)
        assert isinstance(late, Latency)
        read = files_read(self.policy)
        return {
            'task': setting.task, 'robot': str(setting.robot), 'gripper': _plain(setting.gripper),
            'action': setting.action, 'control_hz': setting.control_hz, 'latency': asdict(late),
            'cameras': [_plain(camera) for camera in setting.cameras],
            'image_size': _plain(setting.image_size),
            'composition': _plain(setting.plain_composition),
            **({'noise': dict(setting.noise)} if setting.noise else {}),
            **({} if answer_time.is_none else {'answer_time': answer_time.as_dict()}),
            'policy': self.policy, 'policy_content': policy_content(self.policy, read),
            **({'batch': self.batch} if self.batch else {}),
            **({'policy_files': read} if read else {}),
            'versions': {'manip_sim': package_version(), 'mujoco': mujoco.mj_versionString(),
                         'numpy': np.__version__, 'python': platform.python_version()}}


def seed_generators(seed: int) -> None:
    """
    Seed the generators that whole programs share: of Python, NumPy, and torch if it is loaded.

    A policy that draws from them does the same each time with the same seed, and two policies
    that are compared draw the same.

    :param seed: of an episode, from 0
    """
    random.seed(seed)
    np.random.seed(seed % 2**32)  # noqa: NPY002, what others draw from is theirs to choose
    if 'torch' in sys.modules:
        sys.modules['torch'].manual_seed(seed % 2**63)


class Worker:
    """
    Runs the episodes of an experiment in one process: one after the other, or a batch at once.

    :param experiment: to run
    :param report: gets when an answer of the policy is asked for, as ``time.monotonic()`` [s], and
        0 when it has come
    :raises ManipSimError: if the task or the policy cannot be used, with what fits
    """

    def __init__(self, experiment: Experiment,
                 report: Callable[[float], None] = lambda asked_s: None) -> None:
        self._experiment, self._report = experiment, report
        self._runners = [_EpisodeRunner(experiment)]
        self._episode = self._runners[0].episode
        with self._reported():
            self._policy: Policy = load_policy(
                experiment.policy, self._episode, experiment.policy_limit_s, experiment.batch > 0)

    @property
    def period_s(self) -> float:
        """Length of a control period [s]."""
        return self._episode.period_s

    @property
    def interface(self) -> dict[str, Any]:
        """Inputs and outputs of the policy, as JSON can hold them."""
        return interface_of(self._episode)

    def run(self, seed: int) -> Row:
        """
        Return the row of a seed; what a policy raises is in the row.

        :param seed: of the episode
        :raises RecordError: if a record cannot be written
        """
        (row,) = self.run_at_once([seed])
        return row

    def run_at_once(self, seeds: Sequence[int]) -> Iterator[Row]:
        """
        Yield the rows of a batch, as its episodes end; what a policy raises is in the row.

        :param seeds: of the episodes; several need an experiment with batches
        :raises RecordError: if a record cannot be written
        """
        while len(self._runners) < len(seeds):
            self._runners.append(_EpisodeRunner(self._experiment))
        observes = not isinstance(self._policy, Expert)
        running = {seed: runner.run(seed, self._reset_policy, observes)
                   for seed, runner in zip(seeds, self._runners)}
        # Nothing has been asked: each goes on to its first observation.
        answers: dict[int, Any] = dict.fromkeys(seeds)
        while answers:
            observations = {}
            for seed, answer in answers.items():
                episode = running[seed]
                try:
                    observations[seed] = (
                        episode.throw(answer) if isinstance(answer, PolicyFailure)
                        else episode.send(answer))
                except StopIteration as end:
                    yield end.value
            answers = self._answers(observations)

    def _answers(self, observations: Mapping[int, Any]) -> dict[int, Any]:
        """Return answers of the policy and the wall time that they took [s], or its failure."""
        asked_s = time.perf_counter()
        try:
            answers = self._act(observations) if observations else ()
        except PolicyFailure as failure:
            return dict.fromkeys(observations, failure)
        took_s = time.perf_counter() - asked_s
        return {seed: (answer, took_s) for seed, answer in zip(observations, answers)}

    @contextlib.contextmanager
    def _reported(self) -> Iterator[None]:
        self._report(time.monotonic())
        try:
            yield
        finally:
            self._report(0.0)

    def _reset_policy(self, seed: int) -> None:
        seed_generators(seed)
        with self._reported(), wrap_errors('reset() of the policy', PolicyFailure):
            self._policy.reset(seed)

    def _act(self, observations: Mapping[int, Any]) -> Sequence[Any]:
        """Return the answer of the policy for each seed."""
        policy: Any = self._policy
        with self._reported(), wrap_errors('act() of the policy', PolicyFailure):
            if not self._experiment.batch:
                return [np.asarray(policy.act(observation))
                        for observation in observations.values()]
            first = next(iter(observations.values()))
            together = {key: np.stack([observation[key] for observation in observations.values()])
                        for key in first}
            answers = np.asarray(policy.act(together, np.array([*observations])))
            if answers.ndim not in (2, 3) or len(answers) != len(observations):
                raise ValueError(
                    f'for {len(observations)} episodes it must return an array of the shape '
                    f'({len(observations)}, {self._episode.actions.size}), or one with a second '
                    f'axis for chunks of actions, got {answers.shape}')
            return list(answers)


class _EpisodeRunner:
    """
    A runner of one episode after the other, each of which goes on when its policy has answered.

    :param experiment: whose episodes run
    """

    def __init__(self, experiment: Experiment) -> None:
        self._experiment = experiment
        self.episode: Episode = experiment.setting.create_episode()
        self._answers = experiment.setting.create_answers(self.episode)
        self._are_late = not AnswerTime.of(experiment.setting.answer_time).is_none

    def run(self, seed: int, reset_policy: Callable[[int], None], observes: bool
            ) -> Generator[Any, tuple[Any, float], Row]:
        """
        Yield observations, and return the row of a seed.

        It gets an answer of the policy and the wall time that it took [s], or the failure of the
        policy, which is in the row.

        :param reset_policy: begins an episode of the policy
        :param observes: whether the policy needs observations
        :raises RecordError: if a record cannot be written
        """
        episode, answers, recorder = self.episode, self._answers, self._recorder(seed)
        total, error, answers_s = 0.0, '', list[float]()
        begin_s = time.perf_counter()
        episode.reset(seed)
        answers.reset(seed)
        recorded = recorder is not None
        observation = episode.observation if recorded or observes else None
        if recorder is not None:
            recorder.begin(seed, observation=observation)
        try:
            reset_policy(seed)
            while not episode.over:
                asks = answers.asks
                if asks:
                    answer, took_s = yield observation
                    answers_s.append(took_s)
                    answers.answer(answer, took_s)
                if recorder is None:
                    answers.advance()
                else:
                    due = answers.begin_period()
                    if self._are_late:
                        recorder.taken(due)
                    episode.advance()
                reward = episode.reward
                total += reward
                if recorded or observes and answers.asks and not episode.over:
                    observation = episode.observation
                if recorder is not None:
                    recorder.period(due[-1][1] if due else None, reward, observation=observation,
                                    answer_s=answers_s[-1] if asks else None)
        except ManipSimError as failure:
            error = one_line(str(failure), 300)
        faults = episode.simulation.faults.summary()
        row = Row(seed, not error and episode.success, total, episode.periods, episode.digest,
                  error, json.dumps(faults) if faults else '', time.perf_counter() - begin_s,
                  statistics.fmean(answers_s) if answers_s else 0.0, max(answers_s, default=0.0))
        if recorder is not None:
            recorder.end(row.success, row.digest, error)
            recorder.close()
        return row

    def _recorder(self, seed: int) -> Any:
        if self._experiment.records is None:
            return None
        from manip_sim.records import EpisodeRecorder  # It needs the extra records.
        self._experiment.records.mkdir(parents=True, exist_ok=True)
        return EpisodeRecorder(
            self._experiment.records / f'{seed}.mcap', self.episode,
            self._experiment.description, overwrite=True)


def _plain(value: Any) -> Any:
    """Return a value as JSON can hold it."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return value if isinstance(value, (int, float, str, type(None))) else str(value)


@dataclass(frozen=True)
class Row:
    """
    An episode.

    :ivar seed: that drew its start
    :ivar success: whether it ended in success
    :ivar returned: the sum of its rewards
    :ivar periods: number of its control periods
    :ivar digest: of its final state
    :ivar error: why it ended early, such as what the policy raised; empty if it did not
    :ivar faults: that were injected, as JSON; empty if none were planned
    :ivar wall_time_s: how long it took, wall time [s]; this and what follows is another one each
        time, so that rows are equal without it
    :ivar answer_mean_s: mean of the wall times of the policy's answers [s]
    :ivar answer_max_s: longest of them [s]
    """

    seed: int
    success: bool
    returned: float
    periods: int
    digest: str
    error: str = ''
    faults: str = ''
    wall_time_s: float = field(default=0.0, compare=False)
    answer_mean_s: float = field(default=0.0, compare=False)
    answer_max_s: float = field(default=0.0, compare=False)

    def as_dict(self) -> dict[str, Any]:
        """Return the columns of the row."""
        columns = asdict(self)
        return {'return' if key == 'returned' else key: value for key, value in columns.items()}

    @classmethod
    def of(cls, columns: dict[str, Any]) -> Row:
        """
        Return the row of some columns.

        :param columns: as :meth:`as_dict` returns them
        :raises TypeError: if one is missing or unknown, or has another type
        """
        row = cls(**{'returned' if key == 'return' else key: value
                     for key, value in columns.items()})
        for name, kind in (('seed', int), ('success', bool), ('returned', float),
                           ('periods', int), ('digest', str), ('error', str), ('faults', str),
                           *((name, float) for name in TIMES)):
            if type(getattr(row, name)) is not kind:
                raise TypeError(f'{name} must be {kind.__name__}')
        return row


def wilson_interval(successes: int, count: int) -> tuple[float, float]:
    """
    Return the 95 % interval of Wilson's score for a share of successes.

    :param successes: of ``count``
    :param count: number of episodes, from 1
    """
    share, z2 = successes / count, Z_95 * Z_95
    middle = (share + z2 / (2.0 * count)) / (1.0 + z2 / count)
    half = Z_95 / (1.0 + z2 / count) * math.sqrt(
        share * (1.0 - share) / count + z2 / (4.0 * count * count))
    # At the ends, rounding must not turn 0 or 1 into a little more or less.
    return (max(middle - half, 0.0) if successes else 0.0,
            min(middle + half, 1.0) if successes < count else 1.0)


def summarize(rows: Iterable[Row], seeds: int, period_s: float) -> dict[str, Any]:
    """
    Return the summary of a run, as JSON can hold it.

    :param rows: of the episodes so far
    :param seeds: number of episodes that there will be
    :param period_s: length of a control period [s]
    """
    finished = list(rows)
    times_s = [row.periods * period_s for row in finished if row.success]
    successes = len(times_s)
    low, high = wilson_interval(successes, len(finished)) if finished else (0.0, 1.0)
    return {
        'episodes': len(finished), 'of': seeds, 'complete': len(finished) == seeds,
        'successes': successes,
        'success_rate': successes / len(finished) if finished else None,
        'success_rate_95': [low, high],
        'mean_return': statistics.fmean(row.returned for row in finished) if finished else None,
        'wall_time_s': sum(row.wall_time_s for row in finished),
        'answer_time_s': {
            'mean': statistics.fmean(row.answer_mean_s for row in finished) if finished else None,
            'max': max((row.answer_max_s for row in finished), default=None)},
        'median_time_of_success_s': statistics.median(times_s) if times_s else None,
        'errors': dict(Counter(row.error for row in finished if row.error).most_common(20))}


#: Size of the picture, and its margins on the left, right, top and bottom [pixels].
_WIDTH, _HEIGHT = 640, 400
_LEFT, _RIGHT, _TOP, _BOTTOM = 70, 20, 45, 55
#: Half of the width of the ends of an interval [pixels].
_CAP = 5
#: Lines of the success [%].
_PERCENT = (0, 25, 50, 75, 100)


def success_over(title: str, head: str, summaries: Sequence[tuple[float, dict[str, Any]]]) -> str:
    """
    Return an SVG of success rates with their 95 % intervals over latencies.

    :param title: above the picture
    :param head: of the horizontal axis
    :param summaries: latencies [s], in any order, two of which differ, and the summary of each
        run
    """
    summaries = sorted(summaries, key=lambda entry: entry[0])
    lowest, highest = summaries[0][0], summaries[-1][0]
    right, bottom = _WIDTH - _RIGHT, _HEIGHT - _BOTTOM

    def across(late_s: float) -> float:
        share = (late_s - lowest) / (highest - lowest)
        return round(_LEFT + 20 + share * (right - _LEFT - 40), 1)

    def up(rate: float) -> float:
        return round(bottom - rate * (bottom - _TOP), 1)

    parts = [_label(_WIDTH / 2, 24, title, 'middle'),
             _label((_LEFT + right) / 2, _HEIGHT - 14, f'{head} [s]', 'middle'),
             _label(18, _TOP - 12, 'success [%]', 'start')]
    for percent in _PERCENT:
        y = up(percent / 100.0)
        parts += [_line(_LEFT, y, right, y, '#ddd'), _label(_LEFT - 8, y + 4, str(percent), 'end')]
    parts += [_label(across(late_s), bottom + 20, f'{late_s:g}', 'middle')
              for late_s, _ in summaries]
    points = []
    for late_s, summary in summaries:
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
