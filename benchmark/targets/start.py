# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
The time until the first state comes, against importing what anyone needs and compiling.

With laws of control that are kept, as at each start but the first one of an installation; and
without any, as then: the node compiles them first, and says so.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import contextlib
import os
from pathlib import Path
import statistics
import subprocess
import sys
import tempfile
import time

from manip_sim.models import compose
from targets.figures import Figure, Settings, Target
from targets.processes import Process, loops, start_node, start_script, yardsticks

TARGET = 1.3
#: Time that a new listener gets for its own start and DDS discovery [s].
_SETTLE_S = 0.7
#: All laws are compiled in so long at most [s].
_COMPILED_S = 180.0
BARE = ('import sys, rclpy, mujoco, numpy; mujoco.MjModel.from_xml_path(sys.argv[1]); '
        "print('compiled', flush=True)")


def measure(settings: Settings) -> Iterator[Figure]:
    """Measure from the start of a process to its first state in another process."""
    with tempfile.TemporaryDirectory() as folder:
        model = Path(folder, 'model.xml')
        model.write_text(compose('Panda').to_xml())
        beside, rounds = loops(str(model), '5', '1'), []
        # The first round reads from the disk.
        before = 0 if settings.smoke else 1
        for n in range(before + settings.rounds):
            settings.report(f'start, {n} of {settings.rounds}')
            rounds.append((_bare_s(model), *map(_first_state_s, [None, *beside])))
    rounds = rounds[before:]
    settings.report('start [s]: ' + '; '.join(
        f'{what} {[round(times[n], 2) for times in rounds]}'
        for n, what in enumerate(('bare', 'node', 'plain loop', 'C++ loop')[:len(rounds[0])])))
    ours, *theirs = ([later / times[0] for times, later in zip(rounds, column)]
                     for column in list(zip(*rounds))[1:])
    yield Figure('start', 'start to first `joint_states`, over imports and compiling', ours,
                 target=Target('<=', TARGET), more_is_better=False, **yardsticks(theirs))
    settings.report('start, cold cache')
    yield from _cold(statistics.median(bare for bare, *_ in rounds))


def _cold(bare_s: float) -> Iterator[Figure]:
    """Measure a start where no laws are kept, and how long all of them take then, and later."""
    with tempfile.TemporaryDirectory() as cache, _environment(XDG_CACHE_HOME=cache):
        yield Figure('start', 'the same with a cold cache of laws',
                     [_first_state_s(limit_s=_COMPILED_S) / bare_s], more_is_better=False)
    with tempfile.TemporaryDirectory() as cache, _environment(XDG_CACHE_HOME=cache):
        for kind in ('cold', 'warm'):
            begin = time.monotonic()
            subprocess.run([sys.executable, '-m', 'manip_sim.control.law.loading'], check=True,
                           stderr=subprocess.DEVNULL)
            yield Figure('start', f'all laws from a {kind} cache', [time.monotonic() - begin],
                         's', digits=1, more_is_better=False)


@contextlib.contextmanager
def _environment(**changes: str) -> Iterator[None]:
    """Let processes that are started meanwhile have other environment variables."""
    before = {name: os.environ.get(name) for name in changes}
    os.environ.update(changes)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _bare_s(model: Path) -> float:
    begin = time.monotonic()
    with Process([sys.executable, '-c', BARE, str(model)], piped=True) as process:
        process.line()
        return time.monotonic() - begin


def _first_state_s(loop: Sequence[str] | None = None, limit_s: float = 30.0) -> float:
    """Start the node, or one of the loops; the first state comes in a time."""
    apart = int(loop is not None)
    with contextlib.ExitStack() as stack:
        listener = stack.enter_context(
            start_script('listener.py', 'joint_states', apart=apart))
        listener.ask('begin')
        time.sleep(_SETTLE_S)
        begin = time.monotonic()
        stack.enter_context(start_node() if loop is None else Process(loop, apart=1))
        return float(listener.ask('first', limit_s)) - begin
