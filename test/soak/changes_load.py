# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Robots that come and go at random, among commands, modes, resets and restored states."""

from __future__ import annotations

from collections import Counter
import random
import time

import numpy as np
from random_messages import NUMBERS, TEXTS
from target import Row, SoakError

from manip_sim.errors import DivergenceError, ManipSimError
from manip_sim.models import compose
from manip_sim.models.robots import robot_names
from manip_sim.models.user_files import AllowedRoots
from manip_sim.physics.poses_and_twists import Pose
from manip_sim.simulation import Simulation
from manip_sim.simulation.robot_spawning import (
    plan_with_robot, plan_without_robot, RequestedRobot)

_NAMES = ('left', 'gripper0', 'end_effector', 'table')
#: Robots that are there at once.
_MOST = 3


class _Changed:
    """A simulation, and what happens to it."""

    def __init__(self, rng: random.Random) -> None:
        self._rng = rng
        self.simulation = Simulation(compose('Panda', arena='table'))
        self._saved = self.simulation.save()

    def come(self) -> None:
        """Ask for a robot."""
        rng, simulation = self._rng, self.simulation
        name, kind, y = rng.choice(_NAMES), rng.choice(robot_names()), rng.uniform(-9.0, 9.0)
        if rng.random() < 0.3:
            name, kind, y = rng.choice(TEXTS), rng.choice((kind, *TEXTS)), rng.choice(NUMBERS)
        robot = RequestedRobot({'robot': kind}, 'request', AllowedRoots([], 'spawn_roots')).create(
            name, Pose.checked([0.0, y, 0.0], [0.0, 0.0, 0.0, 1.0]))
        simulation.change_robots(plan_with_robot(simulation, robot))

    def go(self) -> None:
        """Ask for a robot to go."""
        names = self.simulation.spawned_robots
        name = self._rng.choice(names or TEXTS)
        self.simulation.change_robots(plan_without_robot(self.simulation, name))

    def save(self) -> None:
        """Save the state."""
        self._saved = self.simulation.save()

    def restore(self) -> None:
        """Restore the present state, or the last one, which may be one with other robots."""
        if self._rng.random() < 0.5:
            self.save()
        self.simulation.restore(self._saved)

    def reset(self) -> None:
        """Reset, sometimes with a seed."""
        self.simulation.reset(self._rng.choice((None, 1, -1)))

    def command(self) -> None:
        """Command a part of a robot, sometimes in another mode."""
        rng = self._rng
        robot = rng.choice(list(self.simulation.robots.values()))
        part = rng.choice(list(robot.parts))
        count = robot.parts[part].gripper.dof if robot.parts[part].gripper else len(
            robot.joints.indices_of(part))
        numbers = [rng.choice((0.3, -0.3, *NUMBERS)) if rng.random() < 0.05 else
                   rng.uniform(-0.3, 0.3) for _ in range(count)]
        if rng.random() < 0.3:
            robot.set_control_mode(part, rng.choice(('position', 'velocity', 'effort', 'x')))
        else:
            robot.apply(robot.parse.action(part, numbers), period_s=0.01)


def changes(count: int, seed: int) -> Row:
    """Change a world at random; what is rejected changes nothing, and all can go at the end."""
    rng, done = random.Random(seed), Counter[str]()
    begin = time.monotonic()
    changed = _Changed(rng)
    simulation = changed.simulation
    for _ in range(count):
        crowded = len(simulation.spawned_robots) >= _MOST
        act = rng.choice((changed.go if crowded else changed.come, changed.go, changed.save,
                          changed.restore, changed.reset, changed.command, changed.command))
        before = simulation.digest()
        try:
            act()
        except ManipSimError as error:
            done['rejected'] += 1
            if simulation.digest() != before:
                raise SoakError(f'{act.__name__} was rejected, and changed the state') from error
        else:
            done[act.__name__] += 1
        try:
            simulation.advance(5)
        except DivergenceError:
            simulation.reset()
    for name in simulation.spawned_robots:
        simulation.change_robots(plan_without_robot(simulation, name))
    simulation.reset()
    simulation.advance(5)
    if not np.isfinite(simulation.data.qpos).all():
        raise SoakError('the state is not finite')
    if min(done[name] for name in ('come', 'go', 'restore', 'command', 'rejected')) == 0:
        raise SoakError(f'only {dict(done)}')
    rate = count / (time.monotonic() - begin)
    return {'load': 'robots that come and go', 'amount': f'{count} changes', 'growth': '',
            'result': f"{rate:.0f}/s, {done['come']} came, {done['rejected']} rejected, "
                      'which changed nothing; state finite'}
