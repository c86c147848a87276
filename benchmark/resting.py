# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Measure the rest of arms that press on their pedestal, their body or a table; print a table.

    python3 benchmark/resting.py [ROBOT ...] [--modes MODE ...] [--timesteps-ms MS ...]

Each motion is random, by up to 1.6 rad, and ends where the arm is blocked; a reset precedes every
third. A motion takes 5 s, or 3 s more than the joint that is farthest from its goal takes at
its velocity limit. For the last 0.3 s the arm must rest: none of its joints may be faster than
0.003 rad/s (slide joints: m/s) in any physics step. A motion that does not rest goes on for up to
20 s, as an arm whose links rub against each other may still be on its way to the goal. Motions
that end without a contact do not count. In mode `position` joints get one goal, in `velocity` a
velocity for 0.8 s, then zero. In `effort` a PD controller outside of the simulation leads the
joints to goals with 2.4 Hz, critically damped, at 95 % of the effort limit at most, 500 times a
second by default.

- moving: how many motions do not end at rest, of how many with contact.
- for ever: how many of these do not rest in the 20 s after that either.
- speed: the greatest of a joint in the worst motion, and of its mean over the 0.3 s: a joint that
  slides has both, one that oscillates only the first.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
import math
from typing import Any

import mujoco
import numpy as np

from manip_sim.models import compose
from manip_sim.models.robots import robot_names
from manip_sim.simulation import Simulation

PERIOD_S = 0.01
#: Duration of a motion at least, what is added to its way at full speed, of its end, in which it
#: must rest, and what it gets if it does not [s].
MOTION_S, SETTLING_S, END_S, LATER_S = 5.0, 3.0, 0.3, 20.0
#: Speed of a joint at rest [rad/s or m/s].
REST = 0.003
#: Goals are at most so far from the start [rad or m].
REACH = 1.6
#: Angular frequency of the controller in effort mode [rad/s], and its share of the effort limit.
FREQUENCY, SHARE = 15.0, 0.95


@dataclass
class Outcome:
    """
    The end of a motion.

    :ivar motion: its number
    :ivar speed: the greatest of a joint [rad/s or m/s]
    :ivar drift: the greatest mean velocity of a joint [rad/s or m/s]
    :ivar contacts: names of the two shapes, as a set
    :ivar later_s: how much later it rests, infinite if it does not in :data:`LATER_S` [s]
    """

    motion: int
    speed: float
    drift: float
    contacts: set[str]
    later_s: float

    @property
    def rests(self) -> bool:
        """True if the joints rest."""
        return self.speed < REST


class Bench:
    """
    A robot, and the arm of it that moves.

    :param robot: its name
    :param mode: ``position``, ``velocity`` or ``effort``
    :param timestep_s: of a physics step [s]
    :param arena: its name
    :param rate_hz: of the controller in effort mode [Hz]
    """

    def __init__(self, robot: str, mode: str, timestep_s: float, arena: str = 'empty',
                 rate_hz: float = 500.0) -> None:
        cube: dict[str, Any] = {'cube': False} if arena == 'table' else {}
        self.simulation = Simulation(compose(robot, arena=arena, timestep_s=timestep_s, **cube))
        self.robot = self.simulation.robot
        self.part = 'right'
        arm = self.robot.parts[self.part]
        self.joints, self.dofs, self.qpos = arm.joints, arm.dof_addresses, arm.qpos_addresses
        self.mode = mode
        self.robot.set_control_mode(self.part, mode)
        self.steps = round((1.0 / rate_hz if mode == 'effort' else PERIOD_S) / timestep_s) or 1
        self.period_s = self.steps * timestep_s
        dynamics = [self.robot.dynamics()[joint] for joint in self.joints]
        self.ranges = np.array([joint.position_range or (-np.inf, np.inf) for joint in dynamics]).T
        self.velocity_limits = np.array([joint.velocity_limit for joint in dynamics])
        self.effort_limits = np.array([
            np.inf if joint.effort_range is None else joint.effort_range[1] for joint in dynamics])
        self.start = self.positions

    @property
    def positions(self) -> Any:
        """Positions of the joints [rad or m], a copy."""
        return self.simulation.data.qpos[self.qpos]

    @property
    def velocities(self) -> Any:
        """Velocities of the joints [rad/s or m/s], a copy."""
        return self.simulation.data.qvel[self.dofs]

    def command(self, field: str, values: Any) -> None:
        """Send a command to all joints."""
        fields: dict[str, Any] = {field: list(values)}
        self.robot.apply(*self.robot.parse.joint_command(self.joints, **fields))

    def goal(self, random: np.random.Generator) -> Any:
        """Draw a position of the joints."""
        return np.clip(self.start + random.uniform(-REACH, REACH, len(self.joints)),
                       self.ranges[0] + 0.01, self.ranges[1] - 0.01)

    def duration_s(self, goal: Any) -> float:
        """Return the duration of a motion to a goal, in whole control periods [s]."""
        way_s = float((np.abs(goal - self.positions) / self.velocity_limits).max())
        needed = way_s + SETTLING_S if self.mode == 'position' else 0.0
        return self.period_s * math.ceil(max(MOTION_S, needed) / self.period_s - 1e-9)

    def controller(self, random: np.random.Generator, goal: Any, duration_s: float
                   ) -> Iterator[None]:
        """Yield for each period, after the commands of a random motion."""
        velocity = np.clip(1.5 * random.uniform(-1.0, 1.0, len(self.joints))
                           + self.start - self.positions,
                           -self.velocity_limits, self.velocity_limits)
        begin = self.positions
        if self.mode == 'position':
            self.command('position', goal)
        for period in range(round(duration_s / self.period_s)):
            now_s = period * self.period_s
            if self.mode == 'velocity' and now_s < 1.0:
                self.command('velocity', velocity * (now_s < 0.8))
            elif self.mode == 'effort':
                reference = begin + min(1.0, now_s) * (goal - begin)
                pull = FREQUENCY * (reference - self.positions) - 2.0 * self.velocities
                effort = FREQUENCY * self.inertias() * pull
                limits = SHARE * self.effort_limits
                self.command('effort', np.clip(effort, -limits, limits))
            yield

    def inertias(self) -> Any:
        """Return the diagonal elements of the mass matrix of the joints."""
        model, data = self.simulation.model, self.simulation.data
        unit, product = np.zeros(model.nv), np.zeros(model.nv)
        found = []
        for dof in self.dofs:
            unit[:] = np.arange(model.nv) == dof
            mujoco.mj_mulM(model, data, product, unit)
            found.append(product[dof])
        return np.array(found)

    def run(self, motion: int, seed: int) -> Outcome:
        """Run a motion, look at its end in each physics step, and let it rest."""
        random = np.random.default_rng([seed, motion])
        if motion % 3 == 0:
            self.simulation.reset()
        goal = self.goal(random)
        duration_s = self.duration_s(goal)
        periods = self.controller(random, goal, duration_s + LATER_S + END_S)
        for _ in range(round((duration_s - END_S) / self.period_s)):
            next(periods)
            self.simulation.advance(self.steps)
        end = self.watch(periods)
        outcome = Outcome(motion, float(np.abs(end).max()), float(np.abs(np.mean(end, 0)).max()),
                          self.contacts(), 0.0)
        while np.abs(end).max() >= REST and outcome.later_s < LATER_S:
            outcome.later_s += END_S
            end = self.watch(periods)
        if np.abs(end).max() >= REST:
            outcome.later_s = math.inf
        return outcome

    def watch(self, periods: Iterator[None]) -> Any:
        """Return the velocities of the joints in each step of the next :data:`END_S`."""
        velocities = []
        for _ in range(round(END_S / self.period_s)):
            next(periods)
            for _ in range(self.steps):
                self.simulation.advance(1)
                velocities.append(self.velocities)
        return np.array(velocities)

    def contacts(self) -> set[str]:
        """Return the names of the shapes that press on each other."""
        model, contacts = self.simulation.model, self.simulation.data.contact
        return {' '.join(model.geom(geom).name for geom in contact.geom)
                for contact in contacts if contact.efc_address >= 0}


def measure(robot: str, mode: str, timestep_s: float, motions: Iterable[int],
            arena: str = 'empty', seed: int = 1, rate_hz: float = 500.0) -> list[Outcome]:
    """
    Return the ends of motions that have contacts.

    :param motions: their numbers
    """
    bench = Bench(robot, mode, timestep_s, arena, rate_hz)
    outcomes = [bench.run(motion, seed) for motion in motions]
    return [outcome for outcome in outcomes if outcome.contacts]


def main() -> None:
    """Print a row for each robot, mode and timestep."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.
                                     RawDescriptionHelpFormatter)
    parser.add_argument('robots', nargs='*', metavar='ROBOT', choices=[[], *robot_names()])
    parser.add_argument('--modes', nargs='+', default=['position', 'velocity'],
                        choices=['position', 'velocity', 'effort'])
    parser.add_argument('--timesteps-ms', nargs='+', type=float, default=[0.5, 1.0, 2.0, 5.0])
    parser.add_argument('--arena', default='empty')
    parser.add_argument('--motions', type=int, default=12)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--rate', type=float, default=500.0, help='in effort mode [Hz] (500)')
    parser.add_argument('--details', action='store_true', help='a line for each that moves')
    options = parser.parse_args()
    print('| robot | mode | timestep [ms] | moving, of | for ever | speed, mean [rad/s] |')
    print('|---|---|---|---|---|---|')
    for robot in options.robots or robot_names():
        for mode in options.modes:
            for timestep_ms in options.timesteps_ms:
                outcomes = measure(robot, mode, timestep_ms * 1e-3, range(options.motions),
                                   options.arena, options.seed, options.rate)
                moving = [outcome for outcome in outcomes if not outcome.rests]
                ever = sum(math.isinf(outcome.later_s) for outcome in moving)
                worst = max(outcomes, key=lambda each: each.speed, default=None)
                print(f'| `{robot}` | {mode} | {timestep_ms:g} | {len(moving)}, {len(outcomes)} | '
                      f'{ever} | '
                      + (f'{worst.speed:.4f}, {worst.drift:.4f} |' if worst else '- |'),
                      flush=True)
                for outcome in moving if options.details else []:
                    print(f'  motion {outcome.motion}: {outcome.speed:.4f}, {outcome.drift:.4f}, '
                          f'rests {outcome.later_s:.1f} s later: '
                          + ', '.join(sorted(outcome.contacts)[:4]), flush=True)


if __name__ == '__main__':
    main()
