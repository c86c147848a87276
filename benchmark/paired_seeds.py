# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Measure how many seeds it takes to tell two policies apart, with the same seeds and with others.

Two policies for ``reach`` differ in one gain; both may add noise of their own, drawn from the
seed, to their actions. Their episodes are simulated. Then runs of n seeds are drawn from these
episodes many times: with the same n seeds for both policies, where McNemar's exact test has to
reject at 5 %, and with n seeds for each, where the pooled two-sample score test has to. Printed is
the least n with which 80 % of such runs find the difference.

    python3 benchmark/paired_seeds.py [--seeds 500] [--gains 0.0445 0.0425] [--noise 0]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np

from manip_sim.experiments import wilson_interval
from manip_sim.experiments.comparison import mcnemar_p
from manip_sim.experiments.summary import Z_95
from manip_sim.tasks import Episode, Setting

POWER = 0.8
#: Of outcomes of two policies, a number of seeds and of draws: the share that finds a difference.
Power = Callable[[np.ndarray, np.ndarray, int, int, np.random.Generator], float]


def succeeds(episode: Episode, gain: float, noise: float, number: int, seed: int) -> bool:
    """Return whether a policy reaches the goal; its noise depends on its number."""
    episode.reset(seed)
    random = np.random.default_rng([seed, number])
    while not episode.over:
        seen = episode.observation
        way = (seen['goal'] - seen['eef_pose'][0, :3]) / 0.05
        motion = np.clip(gain * way, -1.0, 1.0) + noise * random.normal(size=3)
        episode.step([*motion, 0.0, 0.0, 0.0, 0.0])
    return episode.success


def paired_power(first: np.ndarray, second: np.ndarray, count: int, draws: int,
                 random: np.random.Generator) -> float:
    """Return the share of runs with the same seeds that find a difference."""
    found = 0
    for rows in random.integers(len(first), size=(draws, count)):
        only_first = int((first[rows] & ~second[rows]).sum())
        only_second = int((second[rows] & ~first[rows]).sum())
        found += mcnemar_p(only_first, only_second) < 0.05
    return found / draws


def unpaired_power(first: np.ndarray, second: np.ndarray, count: int, draws: int,
                   random: np.random.Generator) -> float:
    """Return the share of runs with other seeds that find a difference."""
    rates = [outcomes[random.integers(len(outcomes), size=(draws, count))].mean(axis=1)
             for outcomes in (first, second)]
    pooled = (rates[0] + rates[1]) / 2.0
    deviation = np.sqrt(np.maximum(2.0 * pooled * (1.0 - pooled) / count, 1e-300))
    return float((np.abs(rates[0] - rates[1]) > Z_95 * deviation).mean())


def least(power: Power, first: np.ndarray, second: np.ndarray, draws: int) -> int:
    """Return the least number of seeds with enough power, by bisection."""
    low, high = 4, 8
    while power(first, second, high, draws, np.random.default_rng(0)) < POWER:
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        if power(first, second, middle, draws, np.random.default_rng(0)) < POWER:
            low = middle
        else:
            high = middle
    return high


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--seeds', type=int, default=500)
    parser.add_argument('--gains', type=float, nargs=2, default=(0.0445, 0.0425))
    parser.add_argument('--noise', type=float, default=0.0)
    parser.add_argument('--draws', type=int, default=2000)
    options = parser.parse_args()
    episode = Setting('reach').create_episode()
    outcomes = [np.array([succeeds(episode, gain, options.noise, number, seed)
                          for seed in range(options.seeds)])
                for number, gain in enumerate(options.gains)]
    first, second = outcomes
    for gain, found in zip(options.gains, outcomes):
        low, high = (100.0 * limit for limit in wilson_interval(int(found.sum()), len(found)))
        print(f'gain {gain:g}: {100.0 * found.mean():.1f} % of {len(found)} seeds, 95 % interval '
              f'{low:.1f} to {high:.1f} %')
    print(f'only the first {(first & ~second).sum()}, only the second {(second & ~first).sum()}')
    same, others = (least(power, first, second, options.draws)
                    for power in (paired_power, unpaired_power))
    print(f'seeds with which {100.0 * POWER:g} % of runs tell them apart: {same} paired, {others} '
          f'unpaired, {same / others:.2f} times')


if __name__ == '__main__':
    main()
