# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Measure many worlds beside bare ``mj_step`` in the same threads, and print a table.

Ratios are those of the wall time of a world-step, of the CPU time in brackets; the bare physics
steps copies of the same model from the same states, in the same threads, in chunks as long as a
control period. Rounds take turns, and the least of each counts, because noise only adds.

    python3 benchmark/worlds.py [--worlds 1 4 16 64] [--threads 1 2] [--what stream osc rest law]
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
import sys
import time

os.environ.setdefault('OMP_NUM_THREADS', '1')
sys.path.insert(0, str(Path(__file__).resolve().parent))

import mujoco  # noqa: E402
from targets.figures import Settings  # noqa: E402
from targets.many_worlds import costs, KINDS, memory_of_a_world, panda_worlds  # noqa: E402

from manip_sim.models import compose  # noqa: E402
from manip_sim.simulation import Simulation  # noqa: E402
from manip_sim.worlds import Worlds  # noqa: E402
from manip_sim.worlds.worlds import SimulationPrototype  # noqa: E402

ROUNDS = 5


def row(worlds: Worlds, kind: str) -> str:
    """Return the row of a table."""
    ours, bare = costs(worlds, kind, Settings(ROUNDS, 1.0, 0.0, lambda _: None))
    wall_s, bare_wall_s = (min(cost.wall_s for cost in times) for times in (ours, bare))
    cpu_s, bare_cpu_s = (min(cost.cpu_s for cost in times) for times in (ours, bare))
    return (f'{len(worlds):6} {worlds.threads:7} {kind:7} {wall_s / bare_wall_s:6.2f} '
            f'({cpu_s / bare_cpu_s:5.2f}) {1e6 * wall_s:8.2f} {1e6 * bare_wall_s:8.2f} '
            f'{1.0 / wall_s:9.0f}')


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--worlds', type=int, nargs='+', default=[1, 4, 16, 64])
    parser.add_argument('--threads', type=int, nargs='+', default=[1, 2])
    parser.add_argument('--what', nargs='+', choices=KINDS, default=list(KINDS))
    arguments = parser.parse_args()
    print(f'MuJoCo {mujoco.__version__}, Panda at a table with a cube, '
          f'{len(os.sched_getaffinity(0))} processors')
    print(f'{"worlds":>6} {"threads":>7} {"what":7} {"times mj_step":14} {"us":>8} {"bare us":>8} '
          f'{"steps/s":>9}')
    for count in arguments.worlds:
        for threads in arguments.threads:
            for kind in arguments.what:
                with panda_worlds(count, threads) as worlds:
                    print(row(worlds, kind), flush=True)
    count = max(arguments.worlds)
    template = SimulationPrototype(Simulation(compose('Panda', arena='table')))
    copies, took = [], []
    for _ in range(count):
        begin = time.perf_counter()
        copies.append(template.copy())
        took.append(time.perf_counter() - begin)
    print(f'a copy {1e3 * min(took):.2f} ms, number {count} {1e3 * took[-1]:.2f} ms; '
          f'{memory_of_a_world():.2f} MB for each of 512')


if __name__ == '__main__':
    main()
