# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Measure many worlds beside bare ``mj_step`` in the same threads, and print a table.

Ratios are those of the wall time of a world-step, of the CPU time in brackets; the bare physics
steps copies of the same model from the same states, in the same threads, in chunks as long as a
control period. Rounds take turns, and the least of each counts, because noise only adds.

    python3 benchmark/worlds.py [--worlds 1 4 16 64] [--threads 1 2] [--what stream osc rest]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
import os
from pathlib import Path
import sys
import time

os.environ.setdefault('OMP_NUM_THREADS', '1')
sys.path.insert(0, str(Path(__file__).resolve().parent))

import mujoco  # noqa: E402
from targets.many_worlds import Bare, KINDS, panda_worlds, resident_bytes  # noqa: E402

from manip_sim.models import compose  # noqa: E402
from manip_sim.simulation import Simulation  # noqa: E402
from manip_sim.worlds import Worlds  # noqa: E402
from manip_sim.worlds.template import Template  # noqa: E402

ROUNDS, ROUND_S = 5, 0.4


def measure(period: Callable[[], None], steps: int, duration_s: float) -> tuple[float, float]:
    """Return wall and CPU time of a world-step [s]."""
    done, wall, cpu = 0, time.perf_counter(), time.process_time()
    while time.perf_counter() - wall < duration_s:
        period()
        done += steps
    return (time.perf_counter() - wall) / done, (time.process_time() - cpu) / done


def row(worlds: Worlds, kind: str) -> str:
    """Return the row of a table."""
    period, steps = KINDS[kind](worlds)
    bare = Bare(worlds)
    ours, base = [], []
    for _ in range(ROUNDS):
        ours.append(measure(period, steps * len(worlds), ROUND_S))
        bare.start()
        base.append(measure(lambda: bare.step(steps), steps * len(worlds), ROUND_S / 2))
    bare.close()
    (wall, cpu), (bare_wall, bare_cpu) = (
        [min(of) for of in zip(*times)] for times in (ours, base))
    return (f'{len(worlds):6} {worlds.threads:7} {kind:7} {wall / bare_wall:6.2f} '
            f'({cpu / bare_cpu:5.2f}) {1e6 * wall:8.2f} {1e6 * bare_wall:8.2f} {1.0 / wall:9.0f}')


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
    template = Template(Simulation(compose('Panda', arena='table')))
    before, copies, took = resident_bytes(), [], []
    for _ in range(count):
        begin = time.perf_counter()
        copies.append(template.copy())
        took.append(time.perf_counter() - begin)
    for simulation in copies:
        simulation.advance(10)
    print(f'a copy {1e3 * min(took):.2f} ms, number {count} {1e3 * took[-1]:.2f} ms; '
          f'{(resident_bytes() - before) / 1e6 / count:.2f} MB for each')


if __name__ == '__main__':
    main()
