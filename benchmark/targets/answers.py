# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Latency from command to effect, and the rate of a controller's lock-step round trips."""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
from pathlib import Path
import tempfile

import numpy as np
from targets.figures import Figure, Settings, Target
from targets.physics import Bare, panda
from targets.processes import Process, loops, start_node, start_script, yardsticks

PERIOD_S = 0.001
JOINT = 'robot0_joint7'
#: At 1000 Hz, a step of 1 ms in each period, efforts for the arm.
NODE = ('timestep:=0.001', 'publish_rate:=1000.0', 'control_mode.arm:=effort')
#: Targets of quantiles [periods].
QUANTILES = ((50, 1.5), (99, 3.0))
LOCKSTEP_TARGET = 0.8
_COMMANDS, _ROUND_S = 300, 2.0


def measure_effect(settings: Settings) -> Iterator[Figure]:
    """Measure the time from a controller's publication until it sees the effect."""
    settings.report('effect, commands at 1000 Hz in real time')
    count = round(_COMMANDS * settings.scale)
    with tempfile.TemporaryDirectory() as folder:
        bare = Bare(panda(PERIOD_S))
        bare.make_motor(JOINT)
        model = bare.save(Path(folder))
        with contextlib.ExitStack() as stack:
            pairs = []
            for apart, loop in enumerate((None, *loops(model, '1', '1'))):
                server = start_node(*NODE) if loop is None else Process(loop, apart=apart)
                pairs.append((stack.enter_context(server), stack.enter_context(
                    start_script('commander.py', 'effect', JOINT, apart=apart))))
                pairs[-1][1].line()
                _halt(pairs[-1])
            delays = [[_effect(pair, count) for pair in pairs] for _ in range(settings.rounds)]
    for quantile, target in QUANTILES:
        ours, *theirs = ([float(np.percentile(d, quantile)) / PERIOD_S for d in one]
                         for one in zip(*delays))
        name = 'median' if quantile == 50 else f'{quantile}th percentile'
        yield Figure('effect', f'command-to-effect latency at 1000 Hz, {name}',
                     ours, 'periods', Target('<=', target), more_is_better=False,
                     **yardsticks(theirs))


def _halt(pair: tuple[Process, Process]) -> None:
    for process in pair:
        process.halt()


def _effect(pair: tuple[Process, Process], count: int) -> list[float]:
    for process in pair:
        process.go()
    # The first ones come while the two find their pace again.
    pair[1].ask('effect 20')
    delays: list[float] = pair[1].ask(f'effect {count}')
    _halt(pair)
    return delays


def measure_lockstep(settings: Settings) -> Iterator[Figure]:
    """Measure round trips with a controller in another process, against a bare ping-pong."""
    settings.report('lockstep, round trips')
    words = f'rounds {_ROUND_S * settings.scale}'
    with start_node('stepping:=lockstep', *NODE), start_script('commander.py', 'rounds') as ours, \
            start_script('echo.py', piped=False, apart=1), \
            start_script('commander.py', 'rounds', apart=1) as theirs:
        ours.line()
        theirs.line()
        rates = [(ours.ask(words), theirs.ask(words)) for _ in range(settings.rounds + 1)][1:]
    settings.report(f'lockstep, round trips per second: {[round(r[0]) for r in rates]} of '
                    f'{[round(r[1]) for r in rates]}')
    yield Figure('lockstep', '`lockstep` round trips, of a bare ping-pong',
                 [mine / bare for mine, bare in rates], target=Target('>=', LOCKSTEP_TARGET))
