# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The thread that runs the simulation: how it ends for those who ask it something."""

from concurrent.futures import ThreadPoolExecutor
import time

import pytest

pytest.importorskip('rclpy', reason='the runner is part of the node')

from manip_sim.errors import SimulationEnded  # noqa: E402
from manip_sim.models.robots import Panda  # noqa: E402
from manip_sim.models.world import World  # noqa: E402
from manip_sim.ros.runner import Runner  # noqa: E402
from manip_sim.simulation import Simulation  # noqa: E402


@pytest.fixture
def runner():
    return Runner(Simulation(World([Panda()])), lambda state: None, steps=5)


def test_a_call_after_the_end_is_refused(runner):
    runner.stop()
    with pytest.raises(SimulationEnded, match='the simulation has ended'):
        runner.call(lambda: None)


def test_a_call_that_waits_is_refused_at_the_end(runner):
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(runner.call, lambda: None)
        end = time.monotonic() + 10.0
        while not runner._calls:
            assert time.monotonic() < end, 'timed out'
        runner.stop()
        with pytest.raises(SimulationEnded, match='the simulation has ended'):
            waiting.result(timeout=10.0)
