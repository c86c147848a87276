# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Integral terms of servos take away the errors that dry friction leaves, and wind up nowhere."""

import numpy as np
import pytest

from manip_sim.models.world import World
from manip_sim.simulation import Simulation

#: Dry friction of the joints of the Panda [N m].
FRICTION = np.array([5.0, 5.0, 3.0, 3.0, 1.0, 1.0, 1.0])
#: Friction that nothing overcomes, as of a wall [N m].
WALL = 1e4
GAIN = 5.0


def rub(simulation, friction):
    """Let the joints of the arm have dry friction that their servos do not know."""
    simulation.model.dof_frictionloss[:7] = friction
    simulation.forward()


def go(simulation, run, goal, seconds=2.0):
    """Let the arm go somewhere, and return how far from there it ends [rad]."""
    robot = simulation.robot
    robot.apply(*robot.parse.joint_command(robot.joints.names, position=goal))
    run(simulation, seconds)
    return np.abs(robot.state().position[:7] - goal).max()


def test_an_arm_with_dry_friction_ends_where_it_was_to_go(panda_sim, run):
    robot, start = panda_sim.robot, panda_sim.robot.state().position[:7]
    rub(panda_sim, FRICTION)
    goal = start + [0.3, -0.2, 0.2, -0.2, 0.3, 0.2, -0.3]
    assert 2e-4 < go(panda_sim, run, goal) < 2e-3
    robot.set_integral_gain('arm', GAIN)
    run(panda_sim, 2.0)
    assert np.abs(robot.state().position[:7] - goal).max() < 2e-5
    assert go(panda_sim, run, start) < 2e-5


def released(world, run, way, gain):
    """Return how far beyond its goal a joint goes when a wall before it is gone [rad]."""
    simulation = Simulation(world)
    robot = simulation.robot
    robot.set_integral_gain('arm', gain)
    start = robot.state().position[:7]
    goal = start + way * np.eye(7)[0]
    assert go(simulation, run, start, 0.1) < 1e-9  # Servos have looked at the joints.
    rub(simulation, WALL)
    assert go(simulation, run, goal, 3.0) == pytest.approx(way, rel=0.01)
    rub(simulation, 0.0)
    places = []
    run(simulation, 3.0, lambda: places.append(robot.state().position[0]))
    assert np.abs(robot.state().position[:7] - goal).max() < 2e-5
    return max(places) - goal[0]


@pytest.mark.parametrize('way', [0.002, 0.3])
def test_nothing_winds_up_in_a_joint_that_is_blocked(panda, run, way):
    world = World([panda])
    gain = Simulation(world).model.actuator('robot0_torq_j1').gainprm[0]
    bound = 0.2 * 87.0 / gain  # A fifth of the highest effort over the stiffness.
    assert released(world, run, way, 0.0) < 1e-4
    # Far from its goal, the integral term rests; it acts on the last of the way back alone.
    assert released(world, run, way, GAIN) <= (bound if way < bound else 0.1 * bound)


def test_an_impedance_keeps_its_stiffness_with_an_integral_gain(panda_sim, run):
    robot = panda_sim.robot
    robot.set_integral_gain('arm', GAIN)
    robot.set_control_mode('arm', 'impedance')
    start = robot.state().position[:7]
    robot.apply(*robot.parse.joint_impedance(
        robot.joints.names, start, stiffness=[200.0] * 7, damping=[20.0] * 7))
    panda_sim.data.qfrc_applied[0] = 2.0
    run(panda_sim, 3.0)
    assert robot.state().position[0] - start[0] == pytest.approx(0.01, rel=0.01)
