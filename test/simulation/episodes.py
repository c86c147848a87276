# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Print the digests of seeded episodes; ``python episodes.py 0 200``.

One for each seed, with commands for joints, end effectors (poses, OSC) and grippers; after them,
for every tenth seed, an episode of a scripted expert, which grasps, and two of three worlds at
once.
"""

from collections.abc import Iterator
import random
import sys

from manip_sim.models import compose
from manip_sim.simulation import Simulation
from manip_sim.tasks import create_task, Episode
from manip_sim.worlds import Worlds

NOISE = {'type': 'gaussian', 'magnitude': 0.05}
ROBOTS = ('Panda', 'UR5e', 'Baxter')
TASKS = ('pick_cube', 'stack_cubes', 'open_drawer', 'push_cube', 'insert_peg', 'wipe_table')


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


def of_experts(seeds: range) -> Iterator[str]:
    """Yield the digest at the end of an episode of each seed; tasks and robots take turns."""
    for number, seed in enumerate(seeds):
        task = create_task(TASKS[number % len(TASKS)], ROBOTS[number // len(TASKS) % 2])
        one = Episode(task, Simulation(task.world))
        success = one.run(task.expert(one.simulation), seed)
        yield f'{one.digest} {task.name} {success}'


def of_worlds(seeds: range) -> Iterator[str]:
    """Yield the digests of worlds in which a stream of goals and OSC go on at once."""
    with Worlds(compose('Panda', arena='table', initialization_noise=NOISE, seed=0), 3,
                threads=2) as worlds:
        robot = worlds.robot
        names, osc = robot.joint_names[:7], [False, False, True]
        robot.set_control_mode('arm', 'effort', osc)
        for seed in seeds:
            draw = random.Random(seed)
            worlds.reset([seed, seed + 1, seed + 2])
            start = robot.state().position[:, :7]
            for _ in range(10):
                goals = start + [[draw.uniform(-0.1, 0.1) for _ in names] for _ in worlds.reasons]
                robot.command.joint_command(names, position=goals, where=[True, True, False])
                robot.command_cartesian.action(
                    'right', [[draw.uniform(-1.0, 1.0) for _ in range(6)] for _ in goals],
                    where=osc)
                worlds.advance(10)
            yield from worlds.digest()


if __name__ == '__main__':
    begin, end = map(int, sys.argv[1:3])
    for found in (digests(begin, end), of_experts(range(begin, end, 10)),
                  of_worlds(range(begin, end, 10))):
        for digest in found:
            print(digest)
