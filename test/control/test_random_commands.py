# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Random valid commands for random joints, in every mode, with resets, stops and saved states."""

import numpy as np
import pytest
from robot_kinds import KINDS

from manip_sim.errors import CommandError
from manip_sim.models import compose
from manip_sim.simulation import Simulation

#: The seed is one with which errors that control had were found.
PERIODS, SEED = 300, 2
MODES = ('position', 'velocity', 'effort')


class Driver:
    """
    Drives a robot by a few streams of commands after the other, each of one kind.

    :param simulation: of the robot
    :param random: generator of what is drawn
    """

    def __init__(self, simulation, random):
        self.simulation, self.robot, self._random = simulation, simulation.robot, random
        parts = self.robot.parts
        self._parts = [name for name, part in parts.items() if part.gripper is None
                       and part.atomic == (name,) and part.driven_joints]
        self._grippers = [name for name, part in parts.items() if part.gripper is not None]
        self._arms = list(self.robot.end_effectors)
        self._kinds = [self._joints, self._trajectory, self._pose, self._twist, self._action]
        self._kinds += [self._gripper] if self._grippers else []
        self._kinds += [self._base, self._base] if 'base' in parts else []
        self._saved, self._part = simulation.save(), self._parts[0]
        self.begin()

    def begin(self):
        """Begin another stream, often where the last one was, perhaps for some joints of it."""
        random = self._random
        self._kind = self._one(self._kinds)
        if self._kind == self._base:
            self._part = 'base'
        elif random.random() < 0.5:
            self._part = self._one(self._parts)
        self._arm = self._one(self._arms)
        joints = self.robot.joints
        own = joints.indices_of(self._part)
        few = random.choice(len(own), random.integers(1, len(own) + 1), replace=False)
        self._indices = own[np.sort(few)] if random.random() < 0.5 else own
        self._names = [joints.names[i] for i in self._indices]
        self._phases, self._rate = random.uniform(0.0, 6.0, 6), random.uniform(0.02, 1.5)

    def _one(self, of):
        return of[self._random.integers(len(of))]

    def disturb(self):
        """Change a mode, stop a part, reset, save or restore, each now and then."""
        draw = self._random.random()
        if draw < 0.05:
            self.robot.set_control_mode(self._one(self._parts), self._one(MODES))
        elif draw < 0.07:
            self.robot.apply(self.robot.parse.trajectory(self._one(self._parts), [], [], []))
        elif draw < 0.08:
            self.simulation.reset()
        elif draw < 0.10:
            self._saved = self.simulation.save()
        elif draw < 0.11:
            self.simulation.restore(self._saved)

    def command(self, number, period_s):
        """Apply the next command of the stream; return whether it was valid."""
        wave = np.sin(self._rate * number + np.resize(self._phases, len(self._names)))
        try:
            self.robot.apply(*self._kind(wave, period_s), period_s=period_s)
        except CommandError:
            return False
        return True

    def _joints(self, wave, period_s):
        joints = self.robot.joints
        mode = joints.modes[self._indices[0]]
        low, high = np.clip(joints.ranges(self._indices), -1e3, 1e3).T
        return self.robot.parse.joint_command(self._names, **{
            mode: (low + high) / 2.0 + 0.7 * (high - low) * wave})

    def _trajectory(self, wave, period_s):
        count = int(self._random.integers(1, 4))
        low, high = np.clip(self.robot.joints.ranges(self._indices), -4.0, 4.0).T
        times_s = period_s * np.cumsum(self._random.uniform(0.5, 20.0, count))
        points = (low + high) / 2.0 + 0.6 * (high - low) * wave * np.ones((count, 1))
        speeds = self._random.uniform(-0.5, 0.5, points.shape)
        return [self.robot.parse.trajectory(
            self._part, self._names, times_s, points, self._one([None, speeds]))]

    def _pose(self, wave, period_s):
        quat = self._random.normal(size=4)
        return [self.robot.parse_cartesian.pose(
            self._arm, 0.6 * self._phases[:3] / 3.0, quat / np.linalg.norm(quat))]

    def _twist(self, wave, period_s):
        return [self.robot.parse_cartesian.twist(
            self._arm, wave[0] * np.cos(self._phases[:3]), wave[-1] * np.cos(self._phases[3:]))]

    def _action(self, wave, period_s):
        return [self.robot.parse_cartesian.action(self._arm, np.resize(wave, 6))]

    def _gripper(self, wave, period_s):
        part = self._one(self._grippers)
        return [self.robot.parse.action(part, np.resize(wave, self.robot.parts[part].gripper.dof))]

    def _base(self, wave, period_s):
        return [self.robot.parse.twist(*np.resize(wave, 3))]


@pytest.mark.full
@pytest.mark.parametrize('name', KINDS)
def test_no_valid_commands_stop_a_robot_from_being_simulated(name):
    random = np.random.default_rng(SEED)
    driver = Driver(Simulation(compose(name, arena='table')), random)
    simulation, valid = driver.simulation, 0
    for number in range(PERIODS):
        if random.random() < 0.25:
            driver.begin()
        driver.disturb()
        steps = int(random.choice([1, 2, 5, 5, 10]))
        valid += driver.command(number, steps * simulation.timestep_s)
        # An error of the physics, or of control, would be raised.
        simulation.advance(steps)
        state = driver.robot.state()
        assert np.isfinite([state.position, state.velocity, state.effort]).all()
    assert valid > PERIODS / 4
