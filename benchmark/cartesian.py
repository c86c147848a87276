# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
What Cartesian commands cost, as ratios to the bare physics, how many poses are reached, and how.

The poses to be reached are those of random joint positions within 40 % of the ranges about their
middle, so each can be reached by some way; local methods such as this one find about four of five
from the start. Straightness is measured on paths of setpoints to poses nearby.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
import time
from typing import Any

import mujoco
import numpy as np

from manip_sim.control.commands import Status
from manip_sim.models import compose
from manip_sim.simulation import Simulation

POSES = 100
LIMIT_S = 6.0
RATE_HZ = 100
ROUNDS, PERIODS = 5, 100
#: A pose is reached within this [m], [rad].
NEAR, TURNED = 1e-3, np.radians(0.5)
#: Number of paths, largest joint displacement at their ends [rad], and their duration [s].
WAYS, AWAY_RAD, WAY_S = 28, 0.8, 3.0


def build(name: str, mode: str) -> tuple[Simulation, int]:
    """Return a simulation of a robot at a table, and the steps of a control period."""
    simulation = Simulation(compose(name, arena='table'))
    simulation.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    simulation.robot.set_control_mode('arm', mode)
    return simulation, round(1.0 / (RATE_HZ * simulation.timestep_s))


def best_s(function: Callable[[], object]) -> float:
    """Return the shortest time of a call, over several rounds of many calls [s]."""
    times = []
    for _ in range(ROUNDS):
        begin = time.thread_time()
        for _ in range(PERIODS):
            function()
        times.append((time.thread_time() - begin) / PERIODS)
    return min(times)


def pose_at(simulation: Simulation, arm: str, positions: Any) -> tuple[Any, Any]:
    """Return the pose of the end effector at joint positions, position and rotation matrix."""
    model, data = simulation.model, mujoco.MjData(simulation.model)
    data.qpos[:] = simulation.data.qpos
    data.qpos[simulation.robot.parts[arm].qpos_addresses] = positions
    mujoco.mj_kinematics(model, data)
    site = model.site(simulation.robot.end_effectors[arm].grip_site).id
    return data.site_xpos[site].copy(), data.site_xmat[site].reshape(3, 3).copy()


def joint_ranges(simulation: Simulation, arm: str) -> Any:
    """Return the ranges of the joints of an arm [rad], shape (2, n)."""
    model = simulation.model
    ids = [model.joint(joint).id for joint in simulation.robot.parts[arm].driven_joints]
    limited = model.jnt_limited[ids].astype(bool)
    return np.where(limited[:, None], model.jnt_range[ids], (-3.0, 3.0)).T


def random_poses(simulation: Simulation, arm: str) -> list[tuple[Any, Any]]:
    """Return poses of the end effector, position and rotation matrix, that the arm can take."""
    low, high = joint_ranges(simulation, arm)
    random = np.random.default_rng(3)
    return [pose_at(simulation, arm, (low + high) / 2.0 + random.uniform(-0.4, 0.4, len(low))
                    * (high - low)) for _ in range(POSES)]


def deviations(simulation: Simulation, steps: int, arm: str) -> list[float]:
    """Return the largest distance of each path of setpoints from the straight line [m]."""
    random, (low, high) = np.random.default_rng(4), joint_ranges(simulation, arm)
    robot, quat, found = simulation.robot, np.empty(4), []
    for _ in range(WAYS):
        simulation.reset()
        start = robot.controller_state(arm).reference.position
        goal = pose_at(simulation, arm, np.clip(
            start + random.uniform(-AWAY_RAD, AWAY_RAD, len(start)), low + 0.1, high - 0.1))
        mujoco.mju_mat2Quat(quat, goal[1].ravel())
        command = robot.parse_cartesian.pose(arm, goal[0], quat[[1, 2, 3, 0]])
        robot.apply(command, period_s=1.0 / RATE_HZ)
        way = [pose_at(simulation, arm, start)[0]]
        for _ in range(round(WAY_S * RATE_HZ)):
            simulation.advance(steps)
            way.append(pose_at(simulation, arm, robot.controller_state(arm).reference.position)[0])
        if command.handle.status is Status.DONE:
            along = (goal[0] - way[0]) / np.linalg.norm(goal[0] - way[0])
            offset = np.array(way) - way[0]
            found.append(float(np.linalg.norm(
                offset - np.outer(offset @ along, along), axis=1).max()))
    return found


def print_straightness(deviation: list[float]) -> None:
    """Print how many paths stay how close to the straight line."""
    within = [sum(value < limit for value in deviation) for limit in (1e-4, 1e-3)]
    in_mm = 1e3 * np.array(deviation)
    print(f'ways: {within[0]} of {len(deviation)} within 0.1 mm of the line, {within[1]} within '
          f'1 mm, median {np.median(in_mm):.3f} mm, at most {in_mm.max():.1f} mm')


def time_to(simulation: Simulation, steps: int, arm: str, pose: tuple[Any, Any]) -> float:
    """Return how long the end effector takes to a pose from the start [s], or infinity."""
    quat, vector = np.empty(4), np.empty(3)
    mujoco.mju_mat2Quat(quat, pose[1].ravel())
    robot, data = simulation.robot, simulation.data
    simulation.reset()
    robot.apply(robot.parse_cartesian.pose(arm, pose[0], quat[[1, 2, 3, 0]]), period_s=0.01)
    site = simulation.model.site(robot.end_effectors[arm].grip_site).id
    for period in range(round(LIMIT_S * RATE_HZ)):
        simulation.advance(steps)
        turned = pose[1] @ data.site_xmat[site].reshape(3, 3).T
        mujoco.mju_mat2Quat(quat, turned.ravel())
        mujoco.mju_quat2Vel(vector, quat, 1.0)
        if (np.linalg.norm(pose[0] - data.site_xpos[site]) < NEAR
                and np.linalg.norm(vector) < TURNED):
            return (period + 1) / RATE_HZ
    return float('inf')


def print_costs(simulation: Simulation, steps: int, arm: str) -> None:
    """Print what control periods cost."""
    simulation.reset()
    robot, model, data = simulation.robot, simulation.model, mujoco.MjData(simulation.model)
    for field in ('qpos', 'qvel', 'act', 'ctrl'):
        getattr(data, field)[:] = getattr(simulation.data, field)
    bare = best_s(lambda: mujoco.mj_step(model, data, steps))

    def twisted() -> None:
        robot.apply(robot.parse_cartesian.twist(arm, [0.0, 0.0, 0.02], [0.0] * 3),
                    period_s=1.0 / RATE_HZ)
        simulation.advance(steps)
    for what, seconds in (('at rest', best_s(lambda: simulation.advance(steps))),
                          ('a twist in each', best_s(twisted))):
        print(f'  period, {what:15s} {seconds * 1e6:7.1f} us {seconds / bare:6.2f} x bare physics')


def main() -> None:
    """Print a table for each robot."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('robots', nargs='*', default=['Panda'], metavar='ROBOT',
                        help='Panda by default')
    names = parser.parse_args().robots
    everywhere: list[float] = []
    for name in names:
        print(f'{name}, mujoco {mujoco.__version__}')
        for mode in ('position', 'effort'):
            simulation, steps = build(name, mode)
            arm = next(iter(simulation.robot.end_effectors))
            if mode == 'position':
                everywhere += (deviation := deviations(simulation, steps, arm))
                print_straightness(deviation)
            poses = random_poses(simulation, arm)
            times = [time_to(simulation, steps, arm, pose) for pose in poses]
            reached = [seconds for seconds in times if np.isfinite(seconds)]
            print(f'{mode}: {len(reached)} of {POSES} random poses reached, '
                  f'median {np.median(reached):.2f} s')
            print_costs(simulation, steps, arm)
    if len(names) > 1:
        print('all robots')
        print_straightness(everywhere)


if __name__ == '__main__':
    main()
