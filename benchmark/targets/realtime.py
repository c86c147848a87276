# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Real-time factor, periods and CPU time of the node, seen by a subscriber's process."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
import tempfile

import numpy as np
from numpy.typing import NDArray
from targets.figures import Figure, Settings, Target
from targets.physics import Bare, panda
from targets.watched import Watched, watched_loop, watched_node, Window

#: Rate [Hz], timestep [s], total length of the windows [s], largest share of a core [%].
RUNS = ((1000, 0.001, 60.0, 35.0), (500, 0.002, 15.0, 15.0), (100, 0.002, 15.0, 5.0))
#: Length of the windows of the plain loop, as a fraction of those of the node, and the least [s].
_PLAIN, _PLAIN_S = 0.25, 2.0
_TOPIC = ('joint_states',)


def measure(settings: Settings) -> Iterator[Figure]:
    """Measure factor, period and CPU at some rates."""
    with tempfile.TemporaryDirectory() as folder:
        for rate, timestep_s, whole_s, most in RUNS:
            model = Bare(panda(timestep_s)).save(Path(folder))
            every = round(1.0 / (rate * timestep_s))
            length_s = whole_s * settings.scale / settings.rounds
            settings.report(f'realtime, {rate} Hz')
            waits = settings.wait_scale
            with (watched_node(_TOPIC, waits, f'timestep:={timestep_s}',
                               f'publish_rate:={rate}.0') as node,
                  watched_loop(_TOPIC, waits, model, every, True) as loop):
                ours, theirs = _alternate(
                    node, loop, length_s, max(_PLAIN_S * waits, _PLAIN * length_s),
                    settings.rounds)
            if rate == RUNS[0][0]:
                settings.series['periods'] = {
                    'rate': rate, 'node': _histogram(ours), 'plain loop': _histogram(theirs)}
            yield from _figures(rate, most, ours, theirs)


def _alternate(node: Watched, loop: Watched, length_s: float, plain_s: float, rounds: int
               ) -> tuple[list[Window], list[Window]]:
    ours, theirs = [], []
    for _ in range(rounds):
        ours.append(node.watch(length_s, walls=True))
        theirs.append(loop.watch(plain_s, walls=True))
    return ours, theirs


def _periods_ms(window: Window) -> NDArray[np.float64]:
    return np.diff(np.asarray(window.walls)) * 1e3


def _histogram(windows: Sequence[Window]) -> dict[str, list[float]]:
    periods = np.concatenate([_periods_ms(window) for window in windows])
    edges = np.arange(0.0, 3.01, 0.02)
    counts, _ = np.histogram(np.clip(periods, 0.0, 3.0), edges)
    return {'edges_ms': np.round(edges, 3).tolist(), 'part': (counts / len(periods)).tolist()}


def _figures(rate: int, most: float, ours: Sequence[Window], theirs: Sequence[Window]
             ) -> Iterator[Figure]:
    what = f'`realtime`, {rate} Hz'
    p99 = Target('<=', 1.3) if rate == RUNS[0][0] else None
    for words, unit, target, digits, value in (
            ('real-time factor', '', Target('>=', 0.999), 4, _factor),
            ('99 % of the periods below', 'ms', p99, 2, _p99_ms),
            ('of a core', '%', Target('<=', most), 1, _core)):
        yield Figure('realtime', f'{what}: {words}', [value(window) for window in ours], unit,
                     target, digits, plain=[value(window) for window in theirs],
                     more_is_better=value is _factor)


def _factor(window: Window) -> float:
    return window.simulated_s / window.wall_s


def _p99_ms(window: Window) -> float:
    return float(np.quantile(_periods_ms(window), 0.99))


def _core(window: Window) -> float:
    return 100.0 * window.core
