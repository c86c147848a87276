# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Cost of further Pandas in one world, against that in MuJoCo alone; without ROS."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import time

from manip_sim.models import compose_robot, World
from manip_sim.simulation import Simulation
from targets.figures import Figure, Settings, Target
from targets.physics import Bare

COUNTS = (1, 2, 4, 8)
TARGET = 0.8
TIMESTEP_S = 0.001
_DISTANCE_M = 1.5
_ROUND_S = 0.4


def build(count: int) -> Simulation:
    """Return a world of Pandas side by side."""
    robots = []
    for n in range(count):
        robot = compose_robot('Panda', idn=n)
        robot.set_base_xpos([0.0, n * _DISTANCE_M, 0.0])
        robots.append(robot)
    return Simulation(World(robots, timestep_s=TIMESTEP_S))


def rate(period: Callable[[], object], duration_s: float) -> float:
    """Return how many calls per second of CPU time there are."""
    count, begin = 0, time.thread_time()
    while (now := time.thread_time()) - begin < duration_s:
        for _ in range(20):
            period()
        count += 20
    return count / (now - begin)


def measure(settings: Settings) -> Iterator[Figure]:
    """Measure steps with the states of all robots, against bare steps, for each number."""
    duration_s = _ROUND_S * settings.scale
    worlds = {}
    for count in COUNTS:
        settings.report(f'robots, a world of {count}')
        simulation = build(count)
        worlds[count] = simulation, Bare(simulation)

    def ratio(count: int) -> float:
        simulation, bare = worlds[count]
        robots = list(simulation.robots.values())

        def period() -> None:
            simulation.advance(1)
            for robot in robots:
                robot.state()
        return rate(period, duration_s) / bare.steps_per_s(duration_s, 1, time.thread_time)
    rounds = [{count: ratio(count) for count in COUNTS} for _ in range(settings.rounds)]
    yield Figure('robots', '1 Panda, a state each step, in process, of bare `mj_step`',
                 [ratios[1] for ratios in rounds])
    for count in COUNTS[1:]:
        yield Figure('robots', f'{count} Pandas in one world: the same, of that of 1',
                     [ratios[count] / ratios[1] for ratios in rounds],
                     target=Target('>=', TARGET))
