# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
What control costs beside the physics of one robot at a table, as a table.

    python3 benchmark/control_cost.py [ROBOT] [--steps N ...]

Time of the thread in control periods, the tenth percentile of interleaved rounds: other load on
the machine makes Python slower than MuJoCo. The measure is `mj_step` of as many steps in one call.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
import time

import mujoco
import numpy as np

from manip_sim.models import compose
from manip_sim.models.robots import robot_names
from manip_sim.simulation import Simulation

ROUNDS, PERIODS, WARM_UP = 7, 60, 40


def periods(name: str, steps: int) -> dict[str, Callable[[], object]]:
    """Return what is measured by its name; all but the first and the last run a period."""
    def start(mode: str = 'position') -> Simulation:
        simulation = Simulation(compose(name, arena='table', cube=True))
        simulation.robot.set_control_mode('arm', mode)
        return simulation

    bare, rest, stream, poses, osc = (
        start(), start(), start(), start(), start('effort'))
    own = mujoco.MjData(bare.model)
    mujoco.mj_copyData(own, bare.model, bare.data)
    period_s, robot = steps * bare.timestep_s, stream.robot
    joints = [robot.joints.names[index] for index in robot.joints.indices_of('arm')]
    home = robot.measured('arm')[:len(joints)]
    phases = dict.fromkeys(('stream', 'poses', 'osc'), 0.0)

    def follow() -> None:
        phases['stream'] += period_s
        goal = home + 0.1 * np.sin(phases['stream'])
        robot.apply(*robot.parse.joint_command(joints, position=goal), period_s=period_s)
        stream.advance(steps)

    def act(simulation: Simulation, what: str) -> None:
        phases[what] += period_s
        action = [0.1 * np.sin(phases[what]), 0.1 * np.cos(phases[what]), 0.0, 0.0, 0.0, 0.0]
        arm = simulation.robot
        arm.apply(arm.parse_cartesian.action('right', action), period_s=period_s)
        simulation.advance(steps)

    return {
        '`mj_step`': lambda: mujoco.mj_step(bare.model, own, steps),
        'at rest': lambda: rest.advance(steps),
        'stream of positions': follow,
        'actions of OSC_POSE, position mode': lambda: act(poses, 'poses'),
        'actions of OSC_POSE, effort mode': lambda: act(osc, 'osc'),
        'parse a command': lambda: robot.parse.joint_command(joints, position=home),
        '`state()`': lambda: rest.robot.state()}


def measure(name: str, steps: int) -> dict[str, float]:
    """Return the costs [us]."""
    todo = periods(name, steps)
    found: dict[str, list[int]] = {what: [] for what in todo}
    for run in todo.values():
        for _ in range(WARM_UP):
            run()
    for _ in range(ROUNDS):
        for what, run in todo.items():
            for _ in range(PERIODS):
                begin = time.thread_time_ns()
                run()
                found[what].append(time.thread_time_ns() - begin)
    return {what: float(np.percentile(values, 10)) / 1e3 for what, values in found.items()}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.
                                     RawDescriptionHelpFormatter)
    parser.add_argument('robot', nargs='?', default='Panda', choices=robot_names())
    parser.add_argument('--steps', type=int, nargs='+', default=[5, 10, 25], metavar='N',
                        help='physics steps of a control period (5 10 25)')
    options = parser.parse_args()
    print('| steps | what | us | of `mj_step` |\n|---|---|---|---|')
    for steps in options.steps:
        costs = measure(options.robot, steps)
        for what, cost_us in costs.items():
            print(f'| {steps} | {what} | {cost_us:.1f} | {cost_us / costs["`mj_step`"]:.2f} |',
                  flush=True)


if __name__ == '__main__':
    main()
