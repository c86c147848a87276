# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
What a control period costs, as a ratio to the bare physics in the same run.

usage: python3 benchmark/period_cost.py [robot]
"""

from __future__ import annotations

from collections.abc import Callable
import math
import sys
import time

import mujoco

from manip_sim.models import compose
from manip_sim.simulation import Simulation

STEPS = 5
ROUNDS = 7
PERIODS = 300


def best_s(function: Callable[[], object]) -> float:
    """Return the shortest time of a call, over several rounds of many calls [s]."""
    times = []
    for _ in range(ROUNDS):
        begin = time.perf_counter()
        for _ in range(PERIODS):
            function()
        times.append((time.perf_counter() - begin) / PERIODS)
    return min(times)


def build(name: str) -> Simulation:
    """Return the simulation of a robot with its default base and grippers."""
    return Simulation(compose(name))


def streaming(simulation: Simulation) -> Callable[[], object]:
    """Return a function that commands a goal for all joints of the arm, and advances."""
    robot = simulation.robot
    names = [name for name in robot.parts['arm'].driven_joints if name]
    start = robot.state().position[:len(names)]

    def period() -> None:
        goal = start + 0.05 * math.sin(2.0 * simulation.time_s)
        robot.apply(*robot.parse.joint_command(names, goal),
                    period_s=STEPS * simulation.timestep_s)
        simulation.advance(STEPS)
    return period


def publishing(simulation: Simulation) -> Callable[[], object] | None:
    """Return a function that publishes a state on all topics, or None without ROS."""
    try:
        import rclpy
    except ImportError:
        return None
    from manip_sim.ros.log import RejectionLog
    from manip_sim.ros.publishers import StatePublishers
    from manip_sim.interface.scope import Scope
    rclpy.init()
    node = rclpy.create_node('benchmark')
    publishers = StatePublishers(node, simulation.robot, Scope(), RejectionLog(node.get_logger()))
    return lambda: publishers.publish(simulation)


def main() -> None:
    """Print a table."""
    name = sys.argv[1] if len(sys.argv) > 1 else 'Panda'
    simulation = build(name)
    model, data = simulation.model, mujoco.MjData(simulation.model)
    for field in ('qpos', 'qvel', 'act', 'ctrl'):
        getattr(data, field)[:] = getattr(simulation.data, field)
    bare = best_s(lambda: mujoco.mj_step(model, data, STEPS))
    rows = [(f'mj_step, {STEPS} steps', bare),
            ('Simulation.advance', best_s(lambda: simulation.advance(STEPS))),
            ('SimulatedRobot.state', best_s(simulation.robot.state)),
            ('streamed goals, advance', best_s(streaming(simulation)))]
    publish = publishing(simulation)
    if publish is not None:
        rows.append(('state and publish', best_s(publish)))
    print(f'{name}, mujoco {mujoco.__version__}')
    for what, seconds in rows:
        print(f'{what:23s} {seconds * 1e6:8.1f} us  {seconds / bare:6.2f} x bare physics')


if __name__ == '__main__':
    main()
