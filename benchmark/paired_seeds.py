# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Measure how many seeds it takes to tell two policies apart, with the same seeds and with others.

Their episodes are simulated with the seeds from 0 on. By default they are policies for ``reach``
that differ in one gain, and may add noise to their actions. With ``--demonstrations`` they are
networks that behaviour_cloning.py trains on so many demonstrations of ``pick_cube``, and with
``--runs`` those of two folders of ``manip_sim run``.

Then runs of n seeds are drawn from these episodes many times: with the same n seeds for both
policies, where McNemar's test has to reject at 5 % by its mid-p-value, and by its exact p-value;
and with n seeds for each, where the pooled two-sample score test has to. Printed is the least n
with which 80 % of such runs find the difference. With many seeds, their ratio is
(b + c - d²) / (p (1 - p) + q (1 - q)), where p and q are the rates, d is their difference, and b
and c are the shares of seeds with which only one of them succeeds. It is least if the worse one
never succeeds alone (c = 0).

    python3 benchmark/paired_seeds.py [--seeds 500] [--gains 0.0445 0.0425] [--noise 0] [--shared]
    python3 benchmark/paired_seeds.py --demonstrations 100 50
    python3 benchmark/paired_seeds.py --runs OLD NEW
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from manip_sim.experiments import wilson_interval
from manip_sim.experiments.comparison import compare, mcnemar_p
from manip_sim.experiments.experiment import Z_95
from manip_sim.experiments.run_folder import read_run
from manip_sim.tasks import Episode, Setting

POWER = 0.8
#: Of two policies, by seed: whether they succeed.
Outcomes = NDArray[np.bool_]
#: Of outcomes of two policies, a number of seeds and of draws: the share that finds a difference.
Power = Callable[[Outcomes, Outcomes, int, int], float]


def succeeds(episode: Episode, gain: float, noise: float, stream: list[int]) -> bool:
    """Return whether a policy reaches the goal of the seed its stream of noise begins with."""
    episode.reset(stream[0])
    random = np.random.default_rng(stream)
    while not episode.over:
        seen = episode.observation
        way = (seen['goal'] - seen['eef_pose'][0, :3]) / 0.05
        motion = np.clip(gain * way, -1.0, 1.0) + noise * random.normal(size=3)
        episode.step([*motion, 0.0, 0.0, 0.0, 0.0])
    return episode.success


def of_gains(options: argparse.Namespace) -> dict[str, Outcomes]:
    """Return the outcomes of two policies for reach."""
    episode = Setting('reach').create_episode()
    return {f'{number}: gain {gain:g}': np.array([
        succeeds(episode, gain, options.noise, [seed] if options.shared else [seed, number])
        for seed in range(options.seeds)]) for number, gain in enumerate(options.gains)}


def of_demonstrations(options: argparse.Namespace) -> dict[str, Outcomes]:
    """Return the outcomes of two networks, of which the one with less data has part of it."""
    from behaviour_cloning import demonstrate, success, trained
    return {f'{count} demonstrations': success(
        'Panda', trained(*demonstrate('Panda', count), epochs=200), options.seeds)
        for count in options.demonstrations}


def of_runs(options: argparse.Namespace) -> dict[str, Outcomes]:
    """Return the outcomes of two runs, by the seeds that both have."""
    comparison = compare([read_run(path) for path in options.runs])
    return {str(run.path): np.array([run.rows[seed].success for seed in comparison.seeds])
            for run in comparison.runs}


def paired_power(mid: bool) -> Power:
    """Return the power of runs with the same seeds, by the mid-p-value or the exact one."""
    def power(first: Outcomes, second: Outcomes, count: int, draws: int) -> float:
        shares = [(first & ~second).mean(), (second & ~first).mean()]
        counts = np.random.default_rng(0).multinomial(
            count, [*shares, 1.0 - sum(shares)], size=draws)[:, :2]
        pairs, often = np.unique(counts, axis=0, return_counts=True)
        found = [mcnemar_p(int(b), int(c), mid) < 0.05 for b, c in pairs]
        return float(often[found].sum()) / draws
    return power


def unpaired_power(first: Outcomes, second: Outcomes, count: int, draws: int) -> float:
    """Return the share of runs with other seeds that find a difference."""
    random = np.random.default_rng(0)
    rates = [random.binomial(count, outcomes.mean(), draws) / count
             for outcomes in (first, second)]
    pooled = (rates[0] + rates[1]) / 2.0
    deviation = np.sqrt(np.maximum(2.0 * pooled * (1.0 - pooled) / count, 1e-300))
    return float((np.abs(rates[0] - rates[1]) > Z_95 * deviation).mean())


def least(power: Power, first: Outcomes, second: Outcomes, draws: int) -> int:
    """Return the least number of seeds with enough power, by bisection."""
    low, high = 4, 8
    while power(first, second, high, draws) < POWER:
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        if power(first, second, middle, draws) < POWER:
            low = middle
        else:
            high = middle
    return high


def limits(first: Outcomes, second: Outcomes) -> tuple[float, float]:
    """Return the ratio of seeds in the limit of many, and the least one with these rates."""
    rates = first.mean(), second.mean()
    difference = abs(rates[0] - rates[1])
    unpaired = sum(rate * (1.0 - rate) for rate in rates)
    return (float(((first ^ second).mean() - difference**2) / unpaired),
            float((difference - difference**2) / unpaired))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--seeds', type=int, default=500)
    parser.add_argument('--gains', type=float, nargs=2, default=(0.0445, 0.0425))
    parser.add_argument('--noise', type=float, default=0.0)
    parser.add_argument('--shared', action='store_true',
                        help='draw the noise of both policies from the seed alone')
    parser.add_argument('--demonstrations', type=int, nargs=2)
    parser.add_argument('--runs', type=Path, nargs=2)
    parser.add_argument('--draws', type=int, default=20_000)
    options = parser.parse_args()
    source: Any = (of_runs if options.runs else of_demonstrations if options.demonstrations
                   else of_gains)
    outcomes = source(options)
    for name, found in outcomes.items():
        low, high = (100.0 * limit for limit in wilson_interval(int(found.sum()), len(found)))
        print(f'{name}: {100.0 * found.mean():.1f} % of {len(found)} seeds, 95 % interval '
              f'{low:.1f} to {high:.1f} %')
    first, second = outcomes.values()
    print(f'only the first {(first & ~second).sum()}, only the second {(second & ~first).sum()}')
    mid, exact, others = (least(power, first, second, options.draws) for power in (
        paired_power(mid=True), paired_power(mid=False), unpaired_power))
    print(f'seeds with which {100.0 * POWER:g} % of runs tell them apart: {mid} paired ({exact} '
          f'by the exact p), {others} unpaired, {mid / others:.2f} times ({exact / others:.2f})')
    print('in the limit of many seeds {:.2f} times, with these rates at least {:.2f}'.format(
        *limits(first, second)))


if __name__ == '__main__':
    main()
