# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
How often the scripted experts succeed, as a table of tasks and robots.

    python3 benchmark/tasks.py [TASK ...] [--robots ROBOT ...] [--seeds N]

The seeds are 0 to N - 1. In brackets is the 95 % interval of Wilson's score. Each line is printed
when it is done; the time is simulated, the median of the successful episodes.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import statistics

from manip_sim.errors import ModelError
from manip_sim.experiments import wilson_interval
from manip_sim.simulation import Simulation
from manip_sim.tasks import create_task, Episode, task_names

ROBOTS = ('Panda', 'UR5e', 'IIWA', 'Sawyer', 'Kinova3')


def measure(name: str, robot: str, seeds: Sequence[int]) -> tuple[list[int], list[float]]:
    """Return the seeds for which the expert fails, and the times of the others [s]."""
    task = create_task(name, robot)
    episode = Episode(task, Simulation(task.world))
    expert = task.expert(episode.simulation)
    failed, times_s = [], []
    for seed in seeds:
        if episode.run(expert, seed):
            times_s.append(episode.periods * episode.period_s)
        else:
            failed.append(seed)
    return failed, times_s


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description='Success of scripted experts.')
    parser.add_argument('tasks', nargs='*', metavar='TASK', help='by default all')
    parser.add_argument('--robots', nargs='+', default=ROBOTS, metavar='ROBOT')
    parser.add_argument('--seeds', type=int, default=200, metavar='N')
    options = parser.parse_args()
    print('| task | robot | success | 95 % interval | median time | seeds that fail |\n'
          '|---|---|---|---|---|---|', flush=True)
    for name in options.tasks or task_names():
        for robot in options.robots:
            try:
                failed, times_s = measure(name, robot, range(options.seeds))
            except ModelError as error:
                print(f'| `{name}` | {robot} | {error} | | | |', flush=True)
                continue
            low, high = wilson_interval(len(times_s), options.seeds)
            median = f'{statistics.median(times_s):.1f} s' if times_s else '-'
            listed = ', '.join(map(str, failed[:10])) + ', ...' * (len(failed) > 10)
            print(f'| `{name}` | {robot} | {len(times_s)} of {options.seeds} | '
                  f'{100.0 * low:.1f} to {100.0 * high:.1f} % | {median} | {listed} |', flush=True)


if __name__ == '__main__':
    main()
