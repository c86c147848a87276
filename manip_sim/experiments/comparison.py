# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Paired comparison of runs: the same seeds side by side, and how sure their difference is."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
import math
from typing import Any

import numpy as np

from manip_sim.errors import describe_choices, ModelError, RecordError
from manip_sim.experiments.experiment import Row, wilson_interval, Z_95
from manip_sim.experiments.run_folder import RECORDS, spans, StoredRun
from manip_sim.quoting import format_value, pluralize
from manip_sim.records.recorded import Record, RecordedEpisode

#: Keys that may differ between runs that are compared; versions are noted.
_FREE = frozenset({'policy', 'policy_content', 'policy_files', 'versions'})
#: Halvings of an interval of length 1 until it is as short as a float can tell.
_HALVINGS = 60


def mcnemar_p(only_first: int, only_second: int, mid: bool = False) -> float:
    """
    Return the p-value of McNemar's exact test, two-sided, or its mid-p-value.

    The p-value is the probability of pairs as unequal as these, or more, if both succeed equally
    often. With few pairs, it is too careful: it is below 5 % in much fewer than 5 % of the cases.
    The mid-p-value (Fagerland, Lydersen and Laake 2013) counts half of what is as unequal.

    :param only_first: number of pairs in which only the first one succeeds
    :param only_second: number of pairs in which only the second one does
    :param mid: whether to return the mid-p-value
    """
    count, fewer = only_first + only_second, min(only_first, only_second)
    term = total = 1
    for k in range(fewer):
        term = term * (count - k) // (k + 1)
        total += term
    # A ratio of whole numbers is exact.
    share: float = (2 * total - term * mid) / 2**count
    return min(1.0, share)


def difference_interval(only_first: int, only_second: int, count: int) -> tuple[float, float]:
    """
    Return the 95 % score interval (Tango 1998) of the second rate minus the first.

    It leaves out 0 where the score test of McNemar finds a difference at 5 %.

    :param only_first: number of pairs in which only the first one succeeds
    :param only_second: number of pairs in which only the second one does
    :param count: number of pairs, from 1
    """
    difference = (only_second - only_first) / count

    def deviation(assumed: float) -> float:
        """Return the standard deviation of the number of pairs that differ by an assumption."""
        linear = (2 * count - only_second + only_first) * assumed - only_first - only_second
        constant = -only_first * assumed * (1.0 - assumed)
        root = math.sqrt(max(linear * linear - 8.0 * count * constant, 0.0))
        share = (root - linear) / (4.0 * count)
        return math.sqrt(max(count * (2.0 * share + assumed * (1.0 - assumed)), 0.0))

    def limit(end: float) -> float:
        inside, outside = difference, end
        for _ in range(_HALVINGS):
            middle = 0.5 * (inside + outside)
            if count * abs(difference - middle) < Z_95 * deviation(middle):
                inside = middle
            else:
                outside = middle
        return outside
    return limit(-1.0), limit(1.0)


@dataclass(frozen=True)
class Pairs:
    """
    Numbers of seeds by what two runs make of them.

    :ivar both: succeed
    :ivar only_first: the first one succeeds
    :ivar only_second: the second one succeeds
    :ivar neither: succeeds
    """

    both: int
    only_first: int
    only_second: int
    neither: int

    @classmethod
    def of(cls, first: Mapping[int, Row], second: Mapping[int, Row], seeds: Collection[int]
           ) -> Pairs:
        """
        Count the outcomes.

        :param first: rows by seed
        :param second: rows by seed
        :param seeds: that both have
        """
        outcomes = [(first[seed].success, second[seed].success) for seed in seeds]
        return cls(*(outcomes.count(outcome) for outcome in (
            (True, True), (True, False), (False, True), (False, False))))

    @property
    def count(self) -> int:
        """Number of seeds."""
        return self.both + self.only_first + self.only_second + self.neither

    @property
    def difference(self) -> float:
        """The second success rate minus the first."""
        return (self.only_second - self.only_first) / self.count

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval of :attr:`difference`."""
        return difference_interval(self.only_first, self.only_second, self.count)

    @property
    def p(self) -> float:
        """The p-value of McNemar's exact test."""
        return mcnemar_p(self.only_first, self.only_second)

    @property
    def mid_p(self) -> float:
        """The mid-p-value of that test."""
        return mcnemar_p(self.only_first, self.only_second, mid=True)

    def is_worse(self, threshold: float) -> bool:
        """
        Return whether the second one is sure to be worse, at 95 %.

        :param threshold: by how much the second success rate may be lower, from 0
        """
        # With few pairs, the mid-p-value is more careful than the interval, which takes longer.
        return self.mid_p < 0.05 and self.interval[1] < -threshold

    @property
    def width(self) -> float:
        """Width of :attr:`interval`."""
        low, high = self.interval
        return high - low


@dataclass(frozen=True)
class Comparison:
    """
    Runs with the same seeds; the first one is what the others are compared with.

    :ivar runs: at least two
    :ivar seeds: with which all of them have a row
    """

    runs: tuple[StoredRun, ...]
    seeds: tuple[int, ...]

    @property
    def pairs(self) -> list[Pairs]:
        """Outcomes of the first run and each other one."""
        first, *others = self.runs
        return [Pairs.of(first.rows, run.rows, self.seeds) for run in others]

    @property
    def successes(self) -> list[int]:
        """Number of seeds with which a run succeeds, by run."""
        return [sum(run.rows[seed].success for seed in self.seeds) for run in self.runs]

    @property
    def differing(self) -> list[int]:
        """Seeds that are a success in some runs only."""
        return [seed for seed in self.seeds
                if len({run.rows[seed].success for run in self.runs}) > 1]

    @property
    def equal(self) -> int:
        """Number of seeds whose episodes have the same length and final state in all runs."""
        return sum(len({(run.rows[seed].periods, run.rows[seed].digest)
                        for run in self.runs}) == 1 for seed in self.seeds)

    @property
    def width(self) -> float:
        """Width of the widest of the 95 % intervals of differences."""
        return max(pairs.width for pairs in self.pairs)

    @property
    def notes(self) -> list[str]:
        """Remarks for a reader: seeds that are left out, errors, versions."""
        remarks, first, compared = [], self.runs[0], set(self.seeds)
        for run in self.runs:
            if len(run.rows) < len(run.seeds):
                remarks.append(f'{run.path} is not finished: it has {len(run.rows)} of '
                               f'{pluralize(len(run.seeds), "episode")}')
            if left := [seed for seed in run.rows if seed not in compared]:
                remarks.append(f'{run.path}: {pluralize(len(left), "seed")} left out, which '
                               f'another run does not have: {format_value(spans(left))}')
            if failed := sum(bool(run.rows[seed].error) for seed in self.seeds):
                remarks.append(f'{run.path}: {pluralize(failed, "episode")} without success '
                               'because of an error')
            versions = _differences(first.description['versions'], run.description['versions'])
            remarks += [f'{run.path}: {name} is {theirs}, not {ours}'
                        for name, ours, theirs in versions]
        return remarks

    def as_dict(self) -> dict[str, Any]:
        """Return the comparison as JSON can hold it."""
        runs = [{'run': str(run.path), 'policy': run.description['policy'],
                 'policy_content': run.description['policy_content'], 'successes': successes,
                 'success_rate': successes / len(self.seeds),
                 'success_rate_95': wilson_interval(successes, len(self.seeds))}
                for run, successes in zip(self.runs, self.successes)]
        for described, pairs in zip(runs[1:], self.pairs):
            described['against_first'] = {
                'both': pairs.both, 'only_first': pairs.only_first,
                'only_this': pairs.only_second, 'neither': pairs.neither,
                'difference': pairs.difference, 'difference_95': pairs.interval,
                'mcnemar_p': pairs.p, 'mcnemar_mid_p': pairs.mid_p}
        return {'seeds': spans(self.seeds), 'episodes': len(self.seeds), 'runs': runs,
                'differing_seeds': self.differing, 'equal_episodes': self.equal,
                'notes': self.notes}


def compare(runs: Sequence[StoredRun], across: Collection[str] = ()) -> Comparison:
    """
    Compare runs by the seeds that all of them have.

    :param runs: at least two
    :param across: keys of the description that may differ, besides the policy's
    :raises ModelError: if a run is there twice, they are runs of something else, or they have no
        seed in common
    """
    if len(runs) < 2:
        raise ModelError('a comparison needs at least two runs')
    first, *others = runs
    for key in across:
        if not any(key in run.description for run in runs):
            known = sorted({key for run in runs for key in run.description} - _FREE)
            raise ModelError(
                f'no run has the option {format_value(key)}: {describe_choices(key, known)}')
    folders: set[Any] = set()
    for run in runs:
        if run.path.resolve() in folders:
            raise ModelError(f'{run.path} is there twice')
        folders.add(run.path.resolve())
    for run in others:
        for name, ours, theirs in _differences(first.description, run.description):
            if name not in _FREE and name not in across:
                raise ModelError(
                    f'{run.path} is no run of the same episodes as {first.path}: its {name} is '
                    f'{format_value(theirs, 100)}, not {format_value(ours, 100)}; '
                    f'--across {name} compares them all the same')
    seeds = [seed for seed in first.rows if all(seed in run.rows for run in others)]
    if not seeds:
        having = ', '.join(f'{run.path} has {format_value(spans([*run.rows]) or "none")}'
                           for run in runs)
        raise ModelError(f'the runs have no seed in common: {having}')
    return Comparison(tuple(runs), tuple(seeds))


def _differences(first: Mapping[str, Any], second: Mapping[str, Any]
                 ) -> Iterator[tuple[str, Any, Any]]:
    """Yield the keys that differ, with both values; None for one that is missing."""
    for key in sorted({*first, *second}):
        if first.get(key) != second.get(key):
            yield key, first.get(key), second.get(key)


def seeds_to_add(comparison: Comparison, width: float, most: int) -> list[int]:
    """
    Return the seeds that all runs should have next for an interval of a width.

    These are first the seeds that some of them lack, then as many as the width seems to need, but
    at most as many as there are.

    :param comparison: of the runs so far
    :param width: of the interval of the difference, from 0 to 1
    :param most: number of seeds beyond which none are added
    :returns: all seeds, with the seeds of the runs; as many as before if ``most`` is reached
    """
    seeds = [*dict.fromkeys(seed for run in comparison.runs for seed in run.seeds)]
    count = len(comparison.seeds)
    if len(seeds) > count:
        return seeds
    needed = math.ceil(count * min((comparison.width / width)**2, 2.0)) + 1
    new = range(max(seeds) + 1, max(seeds) + 1 + max(0, min(needed, most) - count))
    return [*seeds, *new]


def first_difference(first: StoredRun, second: StoredRun, seed: int) -> int | None:
    """
    Return the control period after which the states of two records first differ, 0 for the start.

    :param first: a run with a record of the seed
    :param second: another one
    :param seed: of the episode
    :returns: None if they are equal to the last bit to the end
    :raises RecordError: if the record of an episode of the rows is missing or damaged
    """
    states = [recorded_episode(run, seed).states for run in (first, second)]
    for period, (ours, theirs) in enumerate(zip(*states)):
        if not np.array_equal(ours, theirs, equal_nan=True):
            return period
    shortest = min(map(len, states))
    return None if all(len(of_run) == shortest for of_run in states) else shortest


def recorded_episode(run: StoredRun, seed: int) -> RecordedEpisode:
    """
    Return the record of an episode of a run.

    :raises RecordError: if there is none, or it is damaged, or not of the run's row
    """
    path = run.path / RECORDS / f'{seed}.mcap'
    if not path.is_file():
        raise RecordError(f'there is no {path}')
    for episode in Record(path).episodes():
        if (episode.result or {}).get('digest') == run.rows[seed].digest:
            return episode
    raise RecordError(f'{path} is not the record of the row of seed {seed}')
