# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
What Cartesian commands cost, as ratios to the bare physics, and how many poses are reached.

The poses are those of random joint positions within 40 % of the ranges about their middle, so each
can be reached by some way; local methods such as this one find about four of five from the start.

usage: python3 benchmark/cartesian.py [robot]
"""

from __future__ import annotations

from collections.abc import Callable
import sys
import time
from typing import Any

import mujoco
import numpy as np

from manip_sim.models import compose
from manip_sim.simulation import Simulation

POSES = 100
LIMIT_S = 6.0
RATE_HZ = 100
ROUNDS, PERIODS = 5, 100
#: A pose is reached within this [m], [rad].
NEAR, TURNED = 1e-3, np.radians(0.5)


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


def random_poses(simulation: Simulation, arm: str) -> list[tuple[Any, Any]]:
    """Return poses of the hand, position and rotation matrix, that the arm can take."""
    model, part = simulation.model, simulation.robot.parts[arm]
    data, random = mujoco.MjData(model), np.random.default_rng(3)
    ids = [model.joint(joint).id for joint in part.driven_joints]
    limited = model.jnt_limited[ids].astype(bool)
    low, high = np.where(limited[:, None], model.jnt_range[ids], (-3.0, 3.0)).T
    site = model.site(simulation.robot.end_effectors[arm].grip_site).id
    poses = []
    for _ in range(POSES):
        data.qpos[:] = simulation.data.qpos
        data.qpos[part.qpos_addresses] = (low + high) / 2.0 + random.uniform(
            -0.4, 0.4, len(ids)) * (high - low)
        mujoco.mj_kinematics(model, data)
        poses.append((data.site_xpos[site].copy(), data.site_xmat[site].reshape(3, 3).copy()))
    return poses


def time_to(simulation: Simulation, steps: int, arm: str, pose: tuple[Any, Any]) -> float:
    """Return how long the hand takes to a pose from the start [s], or infinity."""
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
    """Print a table."""
    name = sys.argv[1] if len(sys.argv) > 1 else 'Panda'
    print(f'{name}, mujoco {mujoco.__version__}')
    for mode in ('position', 'effort'):
        simulation, steps = build(name, mode)
        arm = next(iter(simulation.robot.end_effectors))
        times = [time_to(simulation, steps, arm, pose) for pose in random_poses(simulation, arm)]
        reached = [seconds for seconds in times if np.isfinite(seconds)]
        print(f'{mode}: {len(reached)} of {POSES} random poses reached, '
              f'median {np.median(reached):.2f} s')
        print_costs(simulation, steps, arm)


if __name__ == '__main__':
    main()
