# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Motions into the ends of joints' ranges, faster than they can stop, and what comes next."""

import itertools

import numpy as np
import pytest
from robot_kinds import KINDS
from sampling import Driven, whole_robot

from manip_sim.errors import CommandError


@pytest.mark.full
@pytest.mark.parametrize(('name', 'late', 'then'), [
    *itertools.product(['Panda'], [0, 1], ['velocity', 'effort', 'stop', 'go on']),
    *itertools.product(['SO101', 'GR1'], [0], ['velocity', 'stop']),
    *itertools.product(['SO101', 'GR1'], [1], ['effort', 'go on'])])
def test_joints_that_come_fast_to_the_ends_of_their_ranges_stop_there(name, late, then):
    simulation = whole_robot(name)
    robot, arm = simulation.robot, Driven(simulation, 'arm')
    setpoints, indices = robot.joints.setpoints, robot.joints.indices_of('arm')
    limited = np.isfinite(arm.high)
    ends = np.where(limited, np.clip(arm.high, -4.0, 4.0), arm.position)
    speeds = np.where(limited, 0.9 * arm.velocity_limit, 0.0)
    command = robot.parse.trajectory('arm', arm.names, [3.0], [ends], [speeds])
    robot.apply(command, period_s=0.01)
    count = int(command.trajectory.end_s / simulation.timestep_s - 1e-6)
    for steps in [5] * (count // 5) + [1] * (count % 5):
        simulation.advance(steps)
    assert (np.abs(setpoints.velocity[indices]) > 0.5 * arm.velocity_limit)[limited].all()
    for _ in range(late):
        simulation.advance(1)
    # Whatever comes now, there is hardly any way left, or none.
    if then in ('velocity', 'effort'):
        robot.set_control_mode('arm', then)
    elif then == 'stop':
        robot.apply(robot.parse.trajectory('arm', arm.names, [], []))
    for _ in range(100):
        simulation.advance(5)
        assert (setpoints.position[indices] <= arm.high).all()
        assert (setpoints.velocity[indices] <= 1e-9)[setpoints.position[indices] == arm.high].all()
    assert np.abs(simulation.data.qvel).max() < 0.5


@pytest.mark.full
def test_joint_rests_at_the_end_of_its_range_while_a_spline_is_beyond_it():
    simulation = whole_robot('Panda')
    robot, arm = simulation.robot, Driven(simulation, 'arm')
    goal = arm.high[0] - 0.01
    robot.apply(robot.parse.trajectory(
        'arm', arm.names[:1], [1.0, 2.0], [[goal], [goal]], [[2.0], [-2.0]]), period_s=0.01)
    positions = []
    for _ in range(400):
        simulation.advance(5)
        positions.append(arm.position[0])
    beyond = np.flatnonzero(np.array(positions) > arm.high[0] - 1e-3)
    assert (np.array(positions)[beyond[20]:beyond[-1] - 1] > arm.high[0] - 1e-4).all()
    assert beyond[-1] - beyond[0] > 100
    assert arm.position[0] == pytest.approx(goal, abs=1e-4)


def random_command(robot, parts, random):
    """Return a random command for a part, goals beyond its ranges included."""
    part = parts[random.integers(len(parts))]
    joints = robot.joints
    indices = joints.indices_of(part)
    names, limit = [joints.names[i] for i in indices], joints.servos.velocity_limit[indices]
    low, high = np.clip(joints.clamps(indices), -4.0, 4.0).T
    if 'effort' in {joints.modes[i] for i in indices}:
        return []
    if joints.modes[indices[0]] == 'velocity':
        return robot.parse.joint_command(
            names, velocity=random.choice([-2.0, 0.5, 2.0], len(names)) * limit)
    if random.random() < 0.5:
        return robot.parse.joint_command(
            names, position=np.where(random.random(len(names)) < 0.5, low - 0.1, high + 0.1))
    count = int(random.integers(1, 4))
    return [robot.parse.trajectory(
        part, names, np.cumsum(random.uniform(0.01, 0.4, count)),
        random.choice([low, high, (low + high) / 2.0], count),
        random.uniform(-1.0, 1.0, (count, len(names))) * limit)]


@pytest.mark.full
@pytest.mark.parametrize('name', KINDS)
def test_setpoints_keep_ranges_and_velocity_limits_whatever_is_commanded(name):
    random = np.random.default_rng(1)
    simulation = whole_robot(name, contacts=True)
    robot, setpoints = simulation.robot, simulation.robot.joints.setpoints
    parts = [part for part in dict.fromkeys(robot.joints.parts_of(
        np.arange(len(robot.joints.names)))) if robot.parts[part].driven_joints]
    parts.sort()
    for _ in range(250):
        if random.random() < 0.08:
            robot.set_control_mode(parts[random.integers(len(parts))],
                                   ('position', 'velocity')[random.integers(2)])
        if random.random() < 0.2:
            try:
                robot.apply(*random_command(robot, parts, random), period_s=0.01)
            except CommandError as error:
                assert 'would have to move at' in str(error)
        simulation.advance(int(random.choice([1, 5, 5, 10])))
        assert (np.abs(setpoints.velocity) <= 1.02 * robot.joints.servos.velocity_limit).all()
        assert (setpoints.velocity <= 1e-9)[setpoints.position >= setpoints.joints['high']].all()
        assert (setpoints.velocity >= -1e-9)[setpoints.position <= setpoints.joints['low']].all()
