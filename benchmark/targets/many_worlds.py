# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Many worlds under a stream of joint positions, under OSC and at rest, and the bare physics."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import mujoco
import numpy as np

from manip_sim.models import compose
from manip_sim.worlds import Worlds

#: Steps of a control period: 20 ms, and 50 ms for operational space control.
STEPS, STEPS_OF_OSC = 10, 25


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


KINDS = {'stream': stream, 'osc': osc, 'rest': rest}


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
        self.start()

    def start(self) -> None:
        """Take the states of the worlds, which stay where they are."""
        for data, simulation in zip(self._datas, self._worlds.simulations):
            mujoco.mj_copyData(data, self._model, simulation.data)

    def step(self, steps: int) -> None:
        """Run steps in all worlds."""
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


def resident_bytes() -> int:
    """Return how much memory of this process is in use."""
    return int(Path('/proc/self/statm').read_text().split()[1]) * 4096
