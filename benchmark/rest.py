# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Whether arms come to rest whose end effectors can't reach their target, and how soon: a table.

    python3 benchmark/rest.py [ROBOT ...] [--modes MODE ...] [--targets N] [--seed SEED]

Targets are 0.4 to 2 m from the end effector in a random direction, and half of them turned by up
to half a turn; those that are reached do not count. Every other one is sought from the start of
the robot, the rest from anywhere, three joints of ten at an end of their range. Nothing collides.
An arm rests if all of its joints stay slower than 0.002 rad/s for a second.

- arrives: how long the end effector takes until it moves less than 1 mm and turns less than
  0.01 rad in 0.4 s, first: the median and the longest. Time to rest counts from there.
- rests: how many arms rest within 3 s from there, and when half of them and the last of them do.
"""

from __future__ import annotations

import argparse
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
import math
from typing import Any

import mujoco
import numpy as np

from manip_sim.control.commands import CommandHandle, Status
from manip_sim.models import compose
from manip_sim.models.robots import robot_names
from manip_sim.simulation import Simulation

PERIOD_S = 0.01
#: Rest [rad/s], for how long [s], and how soon it shall come [s].
REST, RESTS_S, SOON_S = 0.002, 1.0, 3.0
#: An end effector that moves less than this [m], and turns less [rad], in this time [s] has
#: arrived.
STILL, TURN, STILL_S = 1e-3, 0.01, 0.4
#: A target is given up after so long [s].
LIMIT_S = 24.0
AWAY_M, AT_ENDS = (0.4, 2.0), 0.3


@dataclass
class Arm:
    """
    One arm, and when it came to rest.

    :ivar name: of the arm
    :ivar dofs: of its joints in ``qvel``
    :ivar site: id of its ``grip_site``
    :ivar arrives_s: when the end effector arrived [s]
    :ivar moved_s: when a joint moved last [s]
    """

    name: str
    dofs: Any
    site: int
    arrives_s: float = math.inf
    moved_s: float = 0.0

    @property
    def rests_s(self) -> float:
        """Time from rest of the end effector to rest of the joints [s], infinite without."""
        if not math.isfinite(self.arrives_s) or self.moved_s > LIMIT_S - RESTS_S:
            return math.inf
        return max(self.moved_s - self.arrives_s, 0.0)


def build(name: str, mode: str) -> tuple[Simulation, list[Arm]]:
    """Return a simulation of a robot without contacts, and its arms."""
    simulation = Simulation(compose(name))
    model, robot = simulation.model, simulation.robot
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    if 'base' in robot.parts:
        robot.set_control_mode('base', 'position')
    robot.set_control_mode('arm', mode)
    return simulation, [Arm(arm, robot.parts[arm].dof_addresses, model.site(reader.grip_site).id)
                        for arm, reader in robot.end_effectors.items()]


def place(simulation: Simulation, arm: Arm, random: np.random.Generator) -> None:
    """Put an arm anywhere, some joints at the ends of their ranges."""
    model, data = simulation.model, simulation.data
    for name in simulation.robot.parts[arm.name].joints:
        joint = model.joint(name)
        low, high = joint.range if joint.limited[0] else (-3.0, 3.0)
        share = random.uniform(0.05, 0.95)
        if random.uniform() < AT_ENDS:
            share = float(random.integers(2))
        data.joint(name).qpos[0] = low + share * (high - low)


def send_away(simulation: Simulation, arm: Arm, random: np.random.Generator) -> CommandHandle:
    """Command a pose far from the end effector; return the handle."""
    robot, data = simulation.robot, simulation.data
    way, turn = random.normal(size=3), random.uniform(-1.0, 1.0, 3)
    way *= random.uniform(*AWAY_M) / np.linalg.norm(way)
    quat, more = np.empty(4), np.empty(4)
    mujoco.mju_mat2Quat(quat, data.site_xmat[arm.site])
    angle = float(random.uniform(0.0, np.pi) * random.integers(2))
    mujoco.mju_axisAngle2Quat(more, turn / np.linalg.norm(turn), angle)
    mujoco.mju_mulQuat(quat, more, quat.copy())
    command = robot.parse_cartesian.pose(
        arm.name, data.site_xpos[arm.site] + way, quat[[1, 2, 3, 0]])
    robot.apply(command, period_s=PERIOD_S)
    arm.arrives_s, arm.moved_s = math.inf, 0.0
    return command.handle


def is_still(before: tuple[Any, Any], now: tuple[Any, Any]) -> bool:
    """Return whether two poses, each position and matrix, hardly differ."""
    turned = np.linalg.norm(now[1] - before[1]) / math.sqrt(2.0)
    return bool(np.linalg.norm(now[0] - before[0]) < STILL and turned < TURN)


def run_to_rest(simulation: Simulation, arms: Sequence[Arm]) -> None:
    """Let arms move until all of them rest, and note when."""
    data, steps = simulation.data, round(PERIOD_S / simulation.timestep_s)
    traces: dict[str, deque[Any]] = {arm.name: deque(maxlen=round(STILL_S / PERIOD_S) + 1)
                                     for arm in arms}
    for period in range(round(LIMIT_S / PERIOD_S)):
        now_s = period * PERIOD_S
        for arm in arms:
            trace = traces[arm.name]
            trace.append((data.site_xpos[arm.site].copy(), data.site_xmat[arm.site].copy()))
            if np.abs(data.qvel[arm.dofs]).max() >= REST:
                arm.moved_s = now_s
            if (not math.isfinite(arm.arrives_s) and len(trace) == trace.maxlen
                    and is_still(trace[0], trace[-1])):
                arm.arrives_s = now_s
        if all(math.isfinite(arm.arrives_s) and now_s - arm.moved_s >= RESTS_S for arm in arms):
            return
        simulation.advance(steps)


def measure(name: str, mode: str, targets: Iterable[int], seed: int = 1
            ) -> tuple[list[float], list[float]]:
    """
    Return when end effectors arrive and how much later their arms rest [s], infinite if never.

    :param targets: their numbers
    """
    simulation, arms = build(name, mode)
    robot, data = simulation.robot, simulation.data
    arrive_s: list[float] = []
    rest_s: list[float] = []
    for target in targets:
        random = np.random.default_rng([seed, target])
        simulation.reset()
        if target % 2:
            for arm in arms:
                place(simulation, arm, random)
            mujoco.mj_forward(simulation.model, data)
            robot.joints.reset(data)
        handles = [send_away(simulation, arm, random) for arm in arms]
        run_to_rest(simulation, arms)
        for arm, handle in zip(arms, handles):
            if handle.status is not Status.DONE:
                arrive_s.append(arm.arrives_s)
                rest_s.append(arm.rests_s)
    return arrive_s, rest_s


def main() -> None:
    """Print a row for each robot and mode."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.
                                     RawDescriptionHelpFormatter)
    parser.add_argument('robots', nargs='*', metavar='ROBOT', choices=[[], *robot_names()])
    parser.add_argument('--modes', nargs='+', metavar='MODE',
                        default=['position', 'velocity', 'effort'])
    parser.add_argument('--targets', type=int, default=200, help='for each arm (200)')
    parser.add_argument('--seed', type=int, default=1)
    options = parser.parse_args()
    print('| robot | mode | targets | arrives: median, maximum [s] '
          '| rests within 3 s | rests: median, maximum [s] |')
    print('|---|---|---|---|---|---|')
    for name in options.robots or robot_names():
        for mode in options.modes:
            arrive_s, rest_s = measure(name, mode, range(options.targets), options.seed)
            soon = sum(value <= SOON_S for value in rest_s)
            print(f'| {name} | {mode} | {len(rest_s)} | {np.median(arrive_s):.1f}, '
                  f'{max(arrive_s):.1f} | {soon} | {np.median(rest_s):.1f}, {max(rest_s):.1f} |',
                  flush=True)


if __name__ == '__main__':
    main()
