# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Growth of the node's memory in ``free``, while two topics are listened to."""

from __future__ import annotations

from collections.abc import Iterator
import statistics
import time

from targets.figures import Figure, Settings, Target
from targets.processes import memory_mb, start_node, start_script
from targets.watched import ONE_CLIENT

TARGET_MB = 1.0
_WARM_S, _WATCHED_S, _BETWEEN_S = 60.0, 90.0, 2.0
_HOUR_S = 3600.0


def measure(settings: Settings) -> Iterator[Figure]:
    """Measure after a warm-up (60 s, scaled), for ``hours`` simulated, else 90 s of wall time."""
    with start_node('stepping:=free') as node, \
            start_script('listener.py', *ONE_CLIENT) as listener:
        listener.ask('ready', 60.0)
        settings.report('memory, the first minute')
        time.sleep(_WARM_S * settings.scale)
        listener.ask('begin')
        begin, taken, simulated_h = time.monotonic(), [], 0.0
        while _goes_on(settings, time.monotonic() - begin, simulated_h):
            taken.append(memory_mb(node.pid))
            time.sleep(min(_BETWEEN_S, _WATCHED_S * settings.scale))
            # It keeps what came; that is forgotten here.
            simulated_h += listener.ask('report')[0] * 1e-9 / _HOUR_S
            listener.ask('begin')
            if len(taken) % 15 == 1:
                settings.report(f'memory, {simulated_h:.2f} h simulated, {taken[-1]:.1f} MB')
    few = max(1, len(taken) // 10)
    before = statistics.median(taken[:few])
    grown = [memory - before for memory in taken]
    yield Figure('memory', f'memory after {simulated_h:.1f} h of simulated time in `free`, '
                 'growth after the first minute', grown[-few:], 'MB', Target('<=', TARGET_MB))
    settings.series['memory'] = {'hours': simulated_h, 'grown_mb': grown}


def _goes_on(settings: Settings, elapsed_s: float, simulated_h: float) -> bool:
    if settings.hours:
        return simulated_h < settings.hours
    return elapsed_s < _WATCHED_S * settings.scale
