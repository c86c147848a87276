# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
One world and many, under a stream of joint positions, under OSC and at rest, without ROS.

Beside the bare physics in the same threads, and beside robosuite's Lift where ROBOSUITE_PYTHON
names a Python that has robosuite.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass
from importlib.util import find_spec
import multiprocessing
import os
from pathlib import Path
import time
from typing import Any

import mujoco
import numpy as np

from manip_sim.laws import law
from manip_sim.models import compose
from manip_sim.simulation import Simulation
from manip_sim.worlds import Worlds
from manip_sim.worlds.worlds import SimulationPrototype
from targets.figures import Figure, Settings, Target
from targets.processes import memory_mb, Process

#: Environment variable with the path of a Python that has robosuite, whose MuJoCo is an older one.
ROBOSUITE_PYTHON = 'ROBOSUITE_PYTHON'
#: Steps of a control period: 20 ms, and 50 ms for operational space control.
STEPS, STEPS_OF_OSC = 10, 25
#: The environment whose steps are measured; a control period has 50 ms.
ENVIRONMENT = 'manip_sim/PickCube-v0'
#: Numbers of worlds of the picture, and the threads of their physics.
COUNTS, THREADS = (1, 4, 16, 64), (1, 2)
#: By worlds and threads: what a world-step may cost, as multiples of bare ``mj_step``.
LIMITS = {(1, 1): {'stream': 1.5, 'osc': 1.8, 'rest': 1.1, 'law': 1.1},
          (64, 2): {'stream': 1.3, 'osc': 1.6, 'rest': 1.2, 'law': 1.1}}
_WORDS = {'stream': 'a stream of positions', 'osc': 'OSC at 20 Hz', 'rest': 'at rest',
          'law': 'a law of a user in each step'}
_ROUND_S = 0.3
#: robosuite compiles functions at its first start, for so long at most [s].
_COMPILED_S = 180.0
#: Periods before the first round: only after up to 0.7 s a stream is planned for whole periods.
_SETTLED = 40
#: After as many chunks the bare physics begins again: without control, arms would run away.
_CHUNKS = 5


def panda_worlds(count: int, threads: int | None = None) -> Worlds:
    """Return worlds of a Panda at a table with a cube."""
    return Worlds(compose('Panda', arena='table'), count, threads)


def stream(worlds: Worlds) -> tuple[Callable[[], None], int]:
    """Return a function that streams positions of all joints of the arm, and its steps."""
    robot = worlds.robot
    start = robot.state().position[:, :7]
    phases, names = np.linspace(0.0, 6.0, len(worlds))[:, None], robot.joint_names[:7]
    period_s = STEPS * worlds.timestep_s

    def period() -> None:
        goals = start + 0.1 * np.sin(2.0 * 1e-9 * worlds.time_ns[:, None] + phases)
        robot.command.joint_command(names, position=goals, period_s=period_s)
        worlds.advance(STEPS)
    return period, STEPS


def osc(worlds: Worlds) -> tuple[Callable[[], None], int]:
    """Return a function that gives actions of OSC_POSE at 20 Hz, and its steps."""
    robot = worlds.robot
    robot.set_control_mode('arm', 'effort')
    phases = np.linspace(0.0, 6.0, len(worlds))[:, None] + np.arange(6)
    period_s = STEPS_OF_OSC * worlds.timestep_s

    def period() -> None:
        actions = 0.2 * np.sin(2.0 * 1e-9 * worlds.time_ns[:, None] + phases)
        robot.command_cartesian.action('right', actions, period_s=period_s)
        worlds.advance(STEPS_OF_OSC)
    return period, STEPS_OF_OSC


def rest(worlds: Worlds) -> tuple[Callable[[], None], int]:
    """Return a function that advances without any command, and its steps."""
    return lambda: worlds.advance(STEPS), STEPS


@law(parameters={'stiffness': 300.0, 'damping': 30.0})  # type: ignore[untyped-decorator]
def spring(t: float, q: Any, v: Any, bias: Any, mass: Any, jacobian: Any, wrench: Any,
           setpoint: Any, parameters: Any, memory: Any, effort: Any) -> None:
    """Pull joints to their setpoints as springs with dampers."""
    for i in range(len(q)):
        effort[i] = (bias[i] + parameters[0] * (setpoint[i, 0] - q[i])
                     + parameters[1] * (setpoint[i, 1] - v[i]))


def users_law(worlds: Worlds) -> tuple[Callable[[], None], int]:
    """Return a function that advances with a law of a user in each step, and its steps."""
    worlds.robot.set_law('arm', spring)
    return rest(worlds)


KINDS = {'stream': stream, 'osc': osc, 'rest': rest, 'law': users_law}


class Bare:
    """
    The physics of worlds alone, in as many threads: one shared model, one ``MjData`` for each.

    :param worlds: whose states it starts from
    """

    def __init__(self, worlds: Worlds) -> None:
        self._worlds = worlds
        self._model = worlds.simulations[0].model
        self._datas = [mujoco.MjData(self._model) for _ in worlds.simulations]
        self._threads = worlds.threads
        self._pool = ThreadPoolExecutor(max(self._threads - 1, 1))
        self._left = 0

    def start(self) -> None:
        """Take the states of the worlds, which stay where they are."""
        self._left = _CHUNKS
        for data, simulation in zip(self._datas, self._worlds.simulations):
            mujoco.mj_copyData(data, self._model, simulation.data)

    def step(self, steps: int) -> None:
        """Run a chunk of steps in all worlds."""
        if not self._left:
            self.start()
        self._left -= 1
        shares = [self._datas[begin::self._threads] for begin in range(self._threads)]
        others = [self._pool.submit(self._run, share, steps) for share in shares[1:] if share]
        self._run(shares[0], steps)
        for other in others:
            other.result()

    def _run(self, datas: list[mujoco.MjData], steps: int) -> None:
        for data in datas:
            mujoco.mj_step(self._model, data, steps)

    def close(self) -> None:
        """End the threads."""
        self._pool.shutdown()


@dataclass(frozen=True)
class Cost:
    """Cost of a call: wall time, and CPU time of all threads [s]."""

    wall_s: float
    cpu_s: float


def costs(worlds: Worlds, kind: str, settings: Settings) -> tuple[list[Cost], list[Cost]]:
    """Return the costs of a world-step of worlds and of the bare physics, in rounds (A B A B)."""
    period, steps = KINDS[kind](worlds)
    bare = Bare(worlds)
    ours, base = [], []
    for _ in range(_SETTLED):
        period()
    for _ in range(settings.rounds):
        ours.append(_cost(period, steps * len(worlds), settings))
        bare.start()
        base.append(_cost(lambda: bare.step(steps), steps * len(worlds), settings))
    bare.close()
    return ours, base


def _cost(call: Callable[[], object], units: int, settings: Settings) -> Cost:
    """Return what a unit costs, of calls that do as many each."""
    count, begin, begin_cpu = 0, time.perf_counter(), time.process_time()
    while not count or time.perf_counter() - begin < _ROUND_S * settings.scale:
        call()
        count += 1
    return Cost((time.perf_counter() - begin) / count / units,
                (time.process_time() - begin_cpu) / count / units)


def measure(settings: Settings) -> Iterator[Figure]:
    """Measure worlds in threads, what a copy costs, state and command, and robosuite's Lift."""
    series: dict[str, Any] = {'counts': COUNTS, 'worlds': {}, 'mj_step': {}}
    for threads in THREADS:
        for count in COUNTS:
            limits = LIMITS.get((count, threads), {})
            for kind in limits or ('stream',):
                settings.report(f'worlds, {count} in {threads} threads, {_WORDS[kind]}')
                with panda_worlds(count, threads) as worlds:
                    ours, bare = costs(worlds, kind, settings)
                if limits:
                    what = (f'{_worlds(count, threads)}, {_WORDS[kind]}: a world-step, '
                            'times bare `mj_step`')
                    yield Figure(
                        'worlds', f'{what}, CPU time', [o.cpu_s / b.cpu_s for o, b in zip(
                            ours, bare)], target=Target('<=', limits[kind]))
                    yield Figure('worlds', f'{what}, wall time',
                                 [o.wall_s / b.wall_s for o, b in zip(ours, bare)])
                if kind == 'stream':  # The fastest round, because noise only adds.
                    for name, values in (('worlds', ours), ('mj_step', bare)):
                        series[name].setdefault(str(threads), []).append(
                            1.0 / min(cost.wall_s for cost in values))
    settings.series['worlds'] = series
    settings.report('worlds, environments')
    yield from _environments(settings)
    settings.report('worlds, copies, state and command')
    yield from _copies(settings)
    yield from _calls(settings)
    settings.report("worlds, robosuite's Lift")
    yield from _lift(settings)


def _worlds(count: int, threads: int) -> str:
    return (f'{count} world{"s" * (count > 1)}, physics in {threads} '
            f'thread{"s" * (threads > 1)}')


def _environment(count: int, threads: int) -> Any:
    """Return environments in one process, in episodes."""
    import gymnasium

    import manip_sim.env  # noqa: F401  It registers them.
    envs: Any = gymnasium.make_vec(
        ENVIRONMENT, num_envs=count, vectorization_mode='vector_entry_point', threads=threads)
    envs.reset(seed=0)
    envs.action_space.seed(0)
    return envs


def _environments(settings: Settings) -> Iterator[Figure]:
    """Measure environments with random actions, beside the bare physics of their worlds."""
    if find_spec('gymnasium') is None:
        settings.report('environments are skipped: gymnasium is not installed')
        return
    threads = THREADS[-1]
    envs = _environment(COUNTS[-1], threads)
    worlds, costs_of, bare_costs = envs.unwrapped.worlds, [], []
    units = STEPS_OF_OSC * len(worlds)
    bare = Bare(worlds)
    envs.step(envs.action_space.sample())
    for _ in range(settings.rounds):
        costs_of.append(_cost(lambda: envs.step(envs.action_space.sample()), units, settings))
        bare.start()
        bare_costs.append(_cost(lambda: bare.step(STEPS_OF_OSC), units, settings))
    bare.close()
    envs.close()
    what = (f'`{ENVIRONMENT}`, {len(worlds)} in {threads} threads, random actions: a step, '
            'times bare `mj_step`')
    yield Figure('worlds', f'{what}, CPU time', [
        ours.cpu_s / base.cpu_s for ours, base in zip(costs_of, bare_costs)],
        target=Target('<=', 2.0))
    yield Figure('worlds', f'{what}, wall time', [
        ours.wall_s / base.wall_s for ours, base in zip(costs_of, bare_costs)])


def _copies(settings: Settings) -> Iterator[Figure]:
    template, count = SimulationPrototype(Simulation(compose('Panda', arena='table'))), COUNTS[-1]
    took = []
    for _ in range(settings.rounds):
        copies, begin = [], 0.0
        for _ in range(count):
            begin = time.perf_counter()
            copies.append(template.copy())
        took.append(1e3 * (time.perf_counter() - begin))
    yield Figure('worlds', f'construction of world {count}', took, 'ms', Target('<=', 1.0))
    yield Figure('worlds', 'memory of a world, of 512', [memory_of_a_world()], 'MB',
                 Target('<=', 0.5))


def memory_of_a_world() -> float:
    """Return the memory of a world [MB], of 512 that follow a stream, beside 64 others."""
    # In this process they would find memory that others have given back.
    with ProcessPoolExecutor(1, multiprocessing.get_context('spawn')) as process:
        return process.submit(_memory).result()


def _memory() -> float:
    """Return the memory of a world [MB], in a process that has not given any back."""
    def begin(count: int) -> Worlds:
        worlds = panda_worlds(count, 1)
        period, _ = stream(worlds)
        for _ in range(3):
            period()
        return worlds
    with begin(64):
        before = memory_mb(os.getpid())
        with begin(512) as worlds:
            return (memory_mb(os.getpid()) - before) / len(worlds)


def _calls(settings: Settings) -> Iterator[Figure]:
    robot = Simulation(compose('Panda', arena='table')).robot
    names, goal = robot.joint_names[:7], robot.state().position[:7]
    calls: dict[str, Callable[[], object]] = {
        '`robot.state()`': robot.state,
        '`robot.parse.joint_command`': lambda: robot.parse.joint_command(names, position=goal)}
    for what, call in calls.items():
        took = []
        for _ in range(settings.rounds):
            begin = time.thread_time()
            for _ in range(1000):
                call()
            took.append(1e3 * (time.thread_time() - begin))
        yield Figure('worlds', what, took, 'us', Target('<=', 15.0), digits=1)


def _lift(settings: Settings) -> Iterator[Figure]:
    """Compare with robosuite's Lift, in a process with its own MuJoCo."""
    python = os.environ.get(ROBOSUITE_PYTHON)
    if python is None:
        settings.report(f"robosuite's Lift is skipped: {ROBOSUITE_PYTHON} is not set")
        return
    number = 0
    with Process([python, str(Path(__file__).with_name('robosuite_lift.py'))], piped=True) as lift:
        lift.line(_COMPILED_S)
        for count, threads in LIMITS:
            with panda_worlds(count, threads) as worlds:
                move, _ = osc(worlds)

                def period(worlds: Worlds = worlds, move: Callable[[], None] = move) -> None:
                    nonlocal number
                    number += 1
                    grips = np.full((len(worlds), 1), 0.2 * np.sin(0.1 * number))
                    worlds.robot.command.action('right/gripper', grips)
                    move()
                rounds = _beside(lift, period, count, settings)
            yield Figure('worlds', f"{_worlds(count, threads)}, OSC at 20 Hz: periods per CPU "
                         "time, of those of robosuite's Lift", rounds, target=Target('>=', 1.0))
            if find_spec('gymnasium') is not None:
                envs = _environment(count, threads)

                def step(envs: Any = envs) -> None:
                    envs.step(envs.action_space.sample())
                rounds = _beside(lift, step, count, settings)
                envs.close()
                yield Figure('worlds', f"`{ENVIRONMENT}`, {count} in {threads} thread"
                             f"{'s' * (threads > 1)}, random actions: steps per CPU time, of "
                             "those of robosuite's Lift", rounds, target=Target('>=', 1.0))


def _beside(lift: Process, call: Callable[[], object], units: int, settings: Settings
            ) -> list[float]:
    """Return the CPU time of a step of Lift over that of a unit, in rounds."""
    return [1.0 / (_cost(call, units, settings).cpu_s * float(
        lift.ask(str(_ROUND_S * settings.scale)))) for _ in range(settings.rounds)]
