# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The thread that runs the simulation: how it ends for those who ask it something."""

from concurrent.futures import ThreadPoolExecutor
from threading import Event
import time

import pytest

pytest.importorskip('rclpy', reason='the runner is part of the node')

from manip_sim.errors import SimulationEnded  # noqa: E402
from manip_sim.models.robots import Panda  # noqa: E402
from manip_sim.models.world import World  # noqa: E402
from manip_sim.ros.runner import Runner  # noqa: E402
from manip_sim.simulation import Simulation  # noqa: E402
from manip_sim.simulation.commands import Status  # noqa: E402


@pytest.fixture
def runner():
    return Runner(Simulation(World([Panda()])), lambda state: None, steps=5)


def test_a_call_after_the_end_is_refused(runner):
    runner.stop()
    with pytest.raises(SimulationEnded, match='the simulation has ended'):
        runner.call(lambda: None)


def test_a_call_before_the_start_is_answered_at_once(runner):
    assert runner.call(lambda: 7) == 7
    runner.set_real_time_factor(2.0)
    assert runner.real_time_factor == 2.0


def test_a_call_that_waits_is_refused_at_the_end():
    published, released = Event(), Event()

    def publish(_):
        published.set()
        released.wait(10.0)

    runner = Runner(Simulation(World([Panda()])), publish, steps=5)
    runner.start()
    assert published.wait(10.0)
    with ThreadPoolExecutor(2) as pool:
        waiting = pool.submit(runner.call, lambda: None)
        wait_until(lambda: runner._calls)
        ending = pool.submit(runner.stop)
        wait_until(lambda: runner._stopping)
        released.set()
        with pytest.raises(SimulationEnded, match='the simulation has ended'):
            waiting.result(timeout=10.0)
        ending.result(timeout=10.0)


def wait_until(condition):
    end = time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < end, 'timed out'


def test_a_command_that_fails_is_told_and_the_simulation_goes_on():
    simulation, told = Simulation(World([Panda()])), []
    runner = Runner(simulation, lambda state: None, steps=5, paused=True,
                    tell_failure=lambda command, error: told.append((command, str(error))))
    command = simulation.parse.action('arm', [0.0] * 7)

    def fail(*_, **__):
        raise RuntimeError('broken')
    simulation.joints.apply = fail
    runner.start()
    (handle,) = runner.submit([command])
    runner.step()
    runner.step()
    runner.stop()
    assert told == [(command, 'broken')]
    assert (handle.status, handle.reason) == (Status.ABORTED, 'broken')
    assert runner.error is None
