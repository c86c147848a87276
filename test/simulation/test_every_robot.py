# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of every robot of the catalogue with its own base and grippers."""

import numpy as np
import pytest

from manip_sim.models.bases import create_base
from manip_sim.models.grippers import create_gripper
from manip_sim.models.robots import create_robot, robot_names
from manip_sim.models.world import World
from manip_sim.simulation import Simulation


@pytest.fixture(params=robot_names())
def simulation(request):
    """Return a simulation of a robot with all that it has by default."""
    robot = create_robot(request.param)
    if robot.default_base is not None:
        robot.add_base(create_base(robot.default_base))
    for arm, gripper in robot.default_gripper.items():
        robot.add_gripper(create_gripper(gripper, idn=f'0_{arm}'), arm)
    return Simulation(World([robot]))


def test_robot_holds_its_start_for_two_seconds(simulation, run):
    own = [simulation.joint_names.index(name) for name in simulation.robot.joints]
    start = simulation.state().position[own]
    np.testing.assert_allclose(start, simulation.robot.init_qpos)
    run(simulation, 2.0)
    np.testing.assert_allclose(simulation.state().position[own], start, atol=1e-3)


def test_nothing_touches_the_tool_at_the_start(simulation, run):
    run(simulation, 0.5)
    for end in simulation.state().end_effectors.values():
        np.testing.assert_allclose(end.external_wrench.force, np.zeros(3), atol=0.01)


def full_stroke_s(gripper):
    """Return how long a stroke takes at the reference's 20 Hz, at the least 3 s."""
    return max(3.0, 2.0 / (20.0 * gripper.speed) + 0.1 if gripper.speed else 0.0)


def test_grippers_close_after_one_message(simulation, run):
    for arm in simulation.end_effectors:
        gripper = simulation.grippers[f'{arm}/gripper']
        ids, goal = gripper.part.actuator_ids, np.ones(gripper.dof)
        opened = []
        for action in (-goal, goal):
            simulation.apply(simulation.parse.action(gripper.part.name, action))
            run(simulation, full_stroke_s(gripper.part.gripper))
            opened.append(simulation.data.act[simulation.model.actuator_actadr[ids]].copy())
        assert (np.abs(opened[1] - opened[0]) > 0.9 * np.ptp(
            simulation.model.actuator_actrange[ids], axis=1)).all()


def test_torque_limits_hold_on_a_step_command(simulation, run):
    part = simulation.parts['arm']
    simulation.set_control_mode('arm', 'effort')
    limit = simulation.limits('arm')[:, 1]
    simulation.set_control_mode('arm', 'position')
    simulation.apply(simulation.parse.action('arm', np.resize([0.5, -0.5], len(limit))))
    joints = [part.joints.index(name) for name in part.driven_joints]
    efforts = []
    run(simulation, 0.5, lambda: efforts.append(np.abs(
        simulation.state().effort[simulation.indices_of['arm']][joints])))
    assert (np.max(efforts, axis=0) <= limit + 1e-9).all()
