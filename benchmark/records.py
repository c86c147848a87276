# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
What recording costs in a control period, without a camera and with one of 640 x 480 pixels.

Rendering is not part of it. The image is noise on a coarse pattern, about 90 kB as JPEG. Repeated
periods alternate, so that other load on the machine meets all of them.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import sys
import tempfile
import time

import numpy as np

from manip_sim.records import EpisodeRecorder
from manip_sim.simulation import Simulation
from manip_sim.startup import use_one_blas_thread
from manip_sim.tasks import create_task, Episode


def main() -> int:
    """Print the costs; return 1 if the median with a camera is above a limit."""
    parser = argparse.ArgumentParser(description='Measure what recording costs in a control '
                                     'period, without a camera and with one of 640 x 480 pixels.')
    parser.add_argument('--periods', type=int, default=400, help='%(default)s by default')
    parser.add_argument('--max', type=float, metavar='MS', help='exit with 1 if the median with a '
                        'camera is above this [ms]')
    options = parser.parse_args()
    use_one_blas_thread()
    task = create_task('pick_cube', 'Panda')
    episode = Episode(task, Simulation(task.world))
    random = np.random.default_rng(0)
    coarse = random.integers(0, 255, (30, 40, 3)).repeat(16, axis=0).repeat(16, axis=1)
    image = (coarse + random.normal(0.0, 4.0, coarse.shape)).clip(0, 255).astype(np.uint8)
    times: dict[str, list[float]] = {'control and physics': [], 'record': [], 'with a camera': []}
    action = np.zeros(episode.actions.size)
    with tempfile.TemporaryDirectory() as folder, EpisodeRecorder(
            Path(folder, 'a.mcap'), episode) as recorder, EpisodeRecorder(
            Path(folder, 'b.mcap'), episode) as with_camera:
        episode.reset(0)
        recorder.begin(0)
        with_camera.begin(0, {'front': image})
        for _ in range(options.periods):
            instants = [time.perf_counter()]
            episode.step(action)
            instants.append(time.perf_counter())
            recorder.period(action)
            instants.append(time.perf_counter())
            with_camera.period(action, images={'front': image})
            instants.append(time.perf_counter())
            for found, begin, end in zip(times.values(), instants, instants[1:]):
                found.append(1e3 * (end - begin))
        recorder.end()
        with_camera.end()
    for name, found in times.items():
        print(f'{name:20} median {np.median(found):5.2f} ms   99 % {np.quantile(found, 0.99):5.2f}'
              f' ms   least {min(found):5.2f} ms')
    return int(options.max is not None and np.median(times['with a camera']) > options.max)


if __name__ == '__main__':
    sys.exit(main())
