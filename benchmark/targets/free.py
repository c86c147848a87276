# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Steps of the node in ``free``, as a ratio to MuJoCo alone on the same cores."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import contextlib
from pathlib import Path
import statistics
import tempfile

from targets.figures import Figure, Settings, Target
from targets.physics import Bare, panda
from targets.processes import loops, yardsticks
from targets.watched import ONE_CLIENT, Watched, watched_loop, watched_node

TIMESTEP_S = 0.001
#: Who listens, and the targets for every tenth and for every step.
SITUATIONS = (('one client', ONE_CLIENT, (0.80, 0.30)),
              ('all topics subscribed', ('all',), (0.55, 0.12)),
              ('nobody subscribed', ('nobody',), (0.95, 0.60)))
EVERY = ((10, 'every 10th step'), (1, 'every step'))
#: Of the picture: steps between two states.
STEPS = (1, 2, 5, 10, 20, 50, 100)
_OURS_S, _BARE_S = 1.8, 0.8


class FreeRun:
    """
    Ratios of the node, and of the loops, to bare physics, round by round.

    :param folder: for the model of the loops
    :param settings: how often and how long
    """

    def __init__(self, folder: Path, settings: Settings) -> None:
        self._bare = Bare(panda(TIMESTEP_S))
        self._model = self._bare.save(folder)
        self._settings = settings

    def ratios(self, topics: tuple[str, ...], every: int, rounds: int,
               beside: Sequence[Sequence[str]]) -> list[list[float]]:
        """Return the ratios of the node and of each loop."""
        scale, waits = self._settings.scale, self._settings.wait_scale
        with contextlib.ExitStack() as stack:
            watched = [stack.enter_context(watched_node(
                topics, waits, 'stepping:=free', f'timestep:={TIMESTEP_S}',
                f'publish_rate:={1.0 / (TIMESTEP_S * every)}'))]
            for apart, command in enumerate(beside, 1):
                watched.append(stack.enter_context(watched_loop(topics, waits, command, apart)))
            found: list[list[float]] = [[] for _ in watched]
            for _ in range(rounds):
                bare = self._bare.steps_per_s(_BARE_S * scale, every)
                for ratios, one in zip(found, watched):
                    ratios.append(_steps_per_s(one, _OURS_S * scale) / bare)
        return found

    def loops(self, every: int, *words: str) -> list[list[str]]:
        """Return the commands of the loops."""
        return loops(self._model, str(every), '0', *words)

    def bound(self, every: int, rounds: int) -> list[float]:
        """Return the ratios of physics and publication alone, in one thread, for one client."""
        scale, ratios = self._settings.scale, []
        with watched_loop(ONE_CLIENT, self._settings.wait_scale,
                          self.loops(every, 'prepared')[0]) as loop:
            for _ in range(rounds):
                fast = _steps_per_s(loop, _OURS_S * scale)
                ratios.append(fast / self._bare.steps_per_s(_BARE_S * scale, every))
        return ratios


def _steps_per_s(watched: Watched, duration_s: float) -> float:
    window = watched.watch(duration_s)
    return window.simulated_s / TIMESTEP_S / window.wall_s


def measure(settings: Settings) -> Iterator[Figure]:
    """Measure the node with one client, with all topics subscribed and with nobody."""
    with tempfile.TemporaryDirectory() as folder:
        run = FreeRun(Path(folder), settings)
        for who, topics, targets in SITUATIONS:
            for (every, words), target in zip(EVERY, targets):
                settings.report(f'free, {who}, {words}')
                beside = [] if topics == ('all',) else run.loops(every)
                ours, *theirs = run.ratios(topics, every, settings.rounds, beside)
                yield Figure('free', f'`free`, {who}, {words}, of bare `mj_step`', ours,
                             target=Target('>=', target),
                             **(yardsticks(theirs) if theirs else {}))
                if topics == ONE_CLIENT:
                    yield Figure('free', f'physics and prepared messages alone, {who}, {words}',
                                 run.bound(every, settings.rounds))


def measure_rates(settings: Settings) -> Iterator[Figure]:
    """Measure the node with one client at several rates, for the picture too."""
    rounds = min(3, settings.rounds)
    series: dict[str, list[float]] = {'steps': [], 'node': [], 'plain loop': []}
    settings.series['rates'] = series
    with tempfile.TemporaryDirectory() as folder:
        run = FreeRun(Path(folder), settings)
        for every in STEPS:
            settings.report(f'rates, a state every {every} steps')
            ours, theirs = run.ratios(ONE_CLIENT, every, rounds, run.loops(every)[:1])
            for name, value in (('steps', every), ('node', statistics.median(ours)),
                                ('plain loop', statistics.median(theirs))):
                series[name].append(value)
            yield Figure('rates', f'`free`, one client, a state every {every} steps, of bare '
                         '`mj_step`', ours)
