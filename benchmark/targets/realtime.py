# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Real-time factor, periods and CPU time of the node, seen by a subscriber's process."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import contextlib
from pathlib import Path
import tempfile

import numpy as np
from numpy.typing import NDArray
from targets.figures import Figure, Settings, Target
from targets.physics import Bare, panda
from targets.processes import loops, memory_mb, yardsticks
from targets.watched import Watched, watched_loop, watched_node, Window

#: Rate [Hz], timestep [s], total length of the windows [s], largest share of a core [%].
RUNS = ((1000, 0.001, 60.0, 35.0), (500, 0.002, 15.0, 15.0), (100, 0.002, 15.0, 5.0))
#: Length of the windows of the loops, as a fraction of those of the node, and the least [s].
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
            with contextlib.ExitStack() as stack:
                watched = [stack.enter_context(watched_node(
                    _TOPIC, waits, f'timestep:={timestep_s}', f'publish_rate:={rate}.0'))]
                for apart, command in enumerate(loops(model, str(every), '1'), 1):
                    watched.append(stack.enter_context(
                        watched_loop(_TOPIC, waits, command, apart)))
                ours, *theirs = _alternate(watched, length_s, max(
                    _PLAIN_S * waits, _PLAIN * length_s), settings.rounds)
                memory = [[memory_mb(one.server.pid)] for one in watched]
            if rate == RUNS[0][0]:
                settings.series['periods'] = {
                    'rate': rate, 'node': _histogram(ours), 'plain loop': _histogram(theirs[0])}
            yield from _figures(rate, most, ours, theirs)
            if rate == RUNS[0][0]:
                yield Figure('realtime', f'`realtime`, {rate} Hz: resident memory', memory[0],
                             'MB', digits=0, more_is_better=False, **yardsticks(memory[1:]))


def _alternate(watched: Sequence[Watched], length_s: float, plain_s: float, rounds: int
               ) -> list[list[Window]]:
    windows: list[list[Window]] = [[] for _ in watched]
    for _ in range(rounds):
        for number, one in enumerate(watched):
            windows[number].append(one.watch(plain_s if number else length_s, walls=True))
    return windows


def _periods_ms(window: Window) -> NDArray[np.float64]:
    return np.diff(np.asarray(window.walls)) * 1e3


def _histogram(windows: Sequence[Window]) -> dict[str, list[float]]:
    periods = np.concatenate([_periods_ms(window) for window in windows])
    edges = np.arange(0.0, 3.01, 0.02)
    counts, _ = np.histogram(np.clip(periods, 0.0, 3.0), edges)
    return {'edges_ms': np.round(edges, 3).tolist(), 'part': (counts / len(periods)).tolist()}


def _figures(rate: int, most: float, ours: Sequence[Window],
             theirs: Sequence[Sequence[Window]]) -> Iterator[Figure]:
    what = f'`realtime`, {rate} Hz'
    p99 = Target('<=', 1.3) if rate == RUNS[0][0] else None
    for words, unit, target, digits, value in (
            ('real-time factor', '', Target('>=', 0.999), 4, _factor),
            ('99 % of the periods below', 'ms', p99, 2, _p99_ms),
            ('of a core', '%', Target('<=', most), 1, _core)):
        yield Figure('realtime', f'{what}: {words}', [value(window) for window in ours], unit,
                     target, digits, more_is_better=value is _factor, **yardsticks(
                         [[value(window) for window in windows] for windows in theirs]))


def _factor(window: Window) -> float:
    return window.simulated_s / window.wall_s


def _p99_ms(window: Window) -> float:
    return float(np.quantile(_periods_ms(window), 0.99))


def _core(window: Window) -> float:
    return 100.0 * window.core
