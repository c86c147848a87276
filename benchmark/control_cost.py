# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Measure the cost of control beside the physics of one robot at a table.

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
from manip_sim.simulation import SimulatedRobot, Simulation
from targets.many_worlds import spring

ROUNDS, PERIODS, WARM_UP = 7, 60, 40
#: Length of motions that do not end while they are measured [s].
LONG_S = 1e5
#: Periods of which a stream is measured at once, as only some of them begin with a message.
TOGETHER = 10
#: Rates of streams [Hz].
RATES = {'poses': (20, 50), 'twists': (20, 50, 100), 'base twists': (20, 50)}
#: Names of the steps that periods with a belt, and with a mobile base, are compared with.
BELT, BASE = '`mj_step` with a belt', '`mj_step` with a mobile base'


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


def features(name: str, steps: int) -> dict[str, Callable[[], object]]:
    """Return periods in which an arm is held or moves slowly, by what is switched on."""
    def held(prepare: Callable[[Simulation, SimulatedRobot], object], mode: str = 'position'
             ) -> Callable[[], object]:
        simulation = Simulation(compose(name, arena='table', cube=True))
        simulation.robot.set_control_mode('arm', mode)
        prepare(simulation, simulation.robot)
        return lambda: simulation.advance(steps)

    def suck(simulation: Simulation) -> None:
        robot = simulation.robot
        robot.apply(robot.parse.action('right/gripper', [1.0]))

    def on_conveyor(prepare: Callable[[Simulation], object]) -> Callable[[], object]:
        simulation = Simulation(compose(name, arena='conveyor', gripper='VacuumGripper'))
        prepare(simulation)
        return lambda: simulation.advance(steps)

    conveyor = Simulation(compose(name, arena='conveyor', gripper='VacuumGripper'))
    own = mujoco.MjData(conveyor.model)
    mujoco.mj_copyData(own, conveyor.model, conveyor.data)

    def impede(robot: SimulatedRobot) -> None:
        cartesian, pose = robot.joints.cartesian, robot.state().end_effectors['right'].pose
        cartesian.set('right', 'cartesian_stiffness', [500.0] * 3 + [30.0] * 3)
        robot.apply(robot.parse_cartesian.pose('right', pose.position, pose.quat_xyzw))

    def press(robot: SimulatedRobot) -> None:
        impede(robot)
        robot.apply(robot.parse_cartesian.force_mode(
            'right', [0, 0, 1, 0, 0, 0], [0.0] * 6, [0.1] * 6))

    def move(robot: SimulatedRobot, share: float) -> None:
        joint = robot.joints.names[robot.joints.indices_of('arm')[0]]
        robot.set_speed_scaling(share)
        robot.apply(robot.parse.trajectory('arm', [joint], [LONG_S], [[1.0]]))

    return {
        'a law of a user': held(lambda _, robot: robot.set_law('arm', spring)),
        'impedance of the joints': held(lambda _, robot: None, 'impedance'),
        'impedance of the end effector': held(lambda _, robot: impede(robot), 'effort'),
        'force mode': held(lambda _, robot: press(robot), 'effort'),
        'a motion until contact': held(lambda _, robot: robot.apply(
            robot.parse_cartesian.until_contact(
                'right', [0.0, 0.0, 1e-5], [0.0] * 3, force=50.0, distance=1.0,
                duration_s=LONG_S))),
        'a payload': held(lambda _, robot: robot.set_payload('right', 0.5)),
        'an integral gain': held(lambda _, robot: robot.set_integral_gain('arm', 5.0)),
        'a trajectory': held(lambda _, robot: move(robot, 1.0)),
        'a trajectory at half its speed': held(lambda _, robot: move(robot, 0.5)),
        'a reflex on collisions': held(lambda _, robot: robot.set_reflex(
            'arm', 'collision', 'default')),
        'a fault of the states': held(lambda simulation, _: simulation.faults.inject(
            {'what': 'noisy_state', 'part': 'arm', 'value': 1e-4})),
        BELT: lambda: mujoco.mj_step(conveyor.model, own, steps),
        'a belt': on_conveyor(lambda _: None),
        'a belt, and a suction cup that leaks': on_conveyor(suck)}


def streams(name: str, steps: int) -> dict[str, Callable[[], object]]:
    """Return :data:`TOGETHER` periods of streams that come at :data:`RATES`, by what they are."""
    def followed(what: str, rate_hz: int) -> Callable[[], object]:
        simulation = Simulation(compose('PandaOmron') if what == 'base twists' else compose(
            name, arena='table', cube=True))
        robot, step_s, due_s, time_s = simulation.robot, simulation.timestep_s, 0.0, 0.0
        arm = robot.parse_cartesian
        pose = next(iter(robot.state().end_effectors.values())).pose

        def run() -> None:
            nonlocal due_s, time_s
            for _ in range(TOGETHER):
                if time_s > due_s - 1e-9:
                    way = 0.05 * np.array([np.sin(time_s), np.cos(time_s), 0.0])
                    robot.apply(
                        arm.pose('right', pose.position + way, pose.quat_xyzw) if what == 'poses'
                        else arm.twist('right', way, [0.0] * 3) if what == 'twists'
                        else robot.parse.twist(way[0], way[1], 0.1), period_s=steps * step_s)
                    due_s += 1.0 / rate_hz
                time_s += steps * step_s
                simulation.advance(steps)
        return run

    mobile = Simulation(compose('PandaOmron'))
    own = mujoco.MjData(mobile.model)
    mujoco.mj_copyData(own, mobile.model, mobile.data)
    return {BASE: lambda: mujoco.mj_step(mobile.model, own, TOGETHER * steps), **{
        f'{what}, {rate_hz} Hz': followed(what, rate_hz)
        for what, rates in RATES.items() for rate_hz in rates}}


def measure(name: str, steps: int) -> dict[str, float]:
    """Return the costs [us]."""
    together = streams(name, steps)
    todo = {**periods(name, steps), **features(name, steps), **together}
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
    return {what: float(np.percentile(values, 10)) / 1e3 / (TOGETHER if what in together else 1)
            for what, values in found.items()}


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
            bare_us = costs[BELT if 'belt' in what else BASE if 'base' in what else '`mj_step`']
            print(f'| {steps} | {what} | {cost_us:.1f} | {cost_us / bare_us:.2f} |', flush=True)


if __name__ == '__main__':
    main()
