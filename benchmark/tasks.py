# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
How often the scripted experts succeed, as a table of tasks and robots.

    python3 benchmark/tasks.py [TASK ...] [--robots ROBOT ...] [--seeds N] [--page FILE]

The seeds are 0 to N - 1. In brackets is the 95 % interval of Wilson's score. Each line is printed
when it is done; the time is simulated, the median of the successful episodes. A page gets the new
lines in place of those of the same tasks and robots, such as docs/reference/experts.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path
import statistics

from manip_sim.errors import ModelError
from manip_sim.experiments import wilson_interval
from manip_sim.simulation import Simulation
from manip_sim.tasks import create_task, Episode, task_names

HEADER = ('| task | robot | success | 95 % interval | median time | seeds that fail |\n'
          '|---|---|---|---|---|---|\n')
ROBOTS = ('Panda', 'UR5e', 'IIWA', 'Sawyer', 'Kinova3', 'FR3', 'XArm7')


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


def line(name: str, robot: str, count: int) -> str:
    """Return the line of a task and a robot."""
    try:
        failed, times_s = measure(name, robot, range(count))
    except ModelError as error:
        return f'| `{name}` | {robot} | {error} | | | |'
    low, high = wilson_interval(len(times_s), count)
    median = f'{statistics.median(times_s):.1f} s' if times_s else '-'
    listed = ', '.join(map(str, failed[:10])) + ', ...' * (len(failed) > 10)
    return (f'| `{name}` | {robot} | {len(times_s)} of {count} | {100.0 * low:.1f} to '
            f'{100.0 * high:.1f} % | {median} | {listed} |')


def update(page: Path, lines: Iterable[str]) -> None:
    """Put lines into the table of a page, which is sorted by task; other text stays."""
    text = page.read_text()
    begin, end = text.index(HEADER), text.rindex('|\n') + 2
    rows = [*text[begin + len(HEADER):end].splitlines(), *lines]
    by_case = {tuple(row.split('|')[1:3]): row for row in rows if row.startswith('|')}
    robots = [f' {robot} ' for robot in ROBOTS]
    ordered = sorted(by_case, key=lambda case: (
        case[0], robots.index(case[1]) if case[1] in robots else len(robots), case[1]))
    page.write_text(text[:begin] + HEADER + ''.join(
        f'{by_case[case]}\n' for case in ordered) + text[end:])


def main() -> None:
    """Print the table, and put it into a page."""
    parser = argparse.ArgumentParser(description='Success of scripted experts.')
    parser.add_argument('tasks', nargs='*', metavar='TASK', help='by default all')
    parser.add_argument('--robots', nargs='+', default=ROBOTS, metavar='ROBOT')
    parser.add_argument('--seeds', type=int, default=200, metavar='N')
    parser.add_argument('--page', type=Path, metavar='FILE', help='that gets the lines')
    options = parser.parse_args()
    print(HEADER, end='', flush=True)
    for name in options.tasks or task_names():
        for robot in options.robots:
            found = line(name, robot, options.seeds)
            print(found, flush=True)
            if options.page is not None:
                update(options.page, [found])


if __name__ == '__main__':
    main()
