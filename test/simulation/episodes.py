# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Print the digests of seeded episodes: joints, poses and OSC; ``python episodes.py 0 200``."""

from collections.abc import Iterator
import random
import sys

from manip_sim.models import compose
from manip_sim.simulation import Simulation

NOISE = {'type': 'gaussian', 'magnitude': 0.05}
ROBOTS = ('Panda', 'UR5e', 'Baxter')


def episode(simulation: Simulation, seed: int) -> str:
    """Run ten control periods of 10 ms with random commands, and return the digest."""
    robot, draw = simulation.robot, random.Random(seed)
    arm, = [name for name in ('right',) if name in robot.end_effectors]
    mode = ('position', 'effort', 'velocity')[seed % 3]
    robot.set_control_mode(arm, mode)
    simulation.reset(seed=seed)
    count = len(robot.parts[arm].actuators)
    for period in range(10):
        if period < 3 and mode != 'effort':
            robot.apply(robot.parse.action(arm, [draw.uniform(-1.0, 1.0) for _ in range(count)]))
        elif period % 2:
            robot.apply(robot.parse_cartesian.action(
                arm, [draw.uniform(-1.0, 1.0) for _ in range(6)]))
        robot.apply(robot.parse.action(
            f'{arm}/gripper', [draw.uniform(-1.0, 1.0)] * robot.robot_model.grippers[arm].dof))
        simulation.advance(5)
    return simulation.digest()


def digests(first: int, last: int) -> Iterator[str]:
    """Yield the digests of episodes; the robots take turns."""
    simulations = [Simulation(compose(name, arena='table', initialization_noise=NOISE, seed=0))
                   for name in ROBOTS]
    for seed in range(first, last):
        yield episode(simulations[seed // 3 % len(simulations)], seed)


if __name__ == '__main__':
    for digest in digests(*map(int, sys.argv[1:3])):
        print(digest)
