# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of every robot of the catalogue with its own base and grippers."""

from xml.etree import ElementTree

import numpy as np
import pytest

from sampling import Driven, sampled, whole_robot

from manip_sim.models import compose, urdf_of
from manip_sim.models.robots import robot_names
from manip_sim.simulation import Simulation


@pytest.fixture(params=robot_names())
def simulation(request):
    """Return a simulation of a robot with all that it has by default."""
    return whole_robot(request.param, contacts=True)


def test_robot_holds_its_start_for_two_seconds(simulation, run):
    robot = simulation.robot
    own = [robot.joint_names.index(name) for name in robot.robot_model.joints]
    start = simulation.robot.state().position[own]
    np.testing.assert_allclose(start, simulation.robot.robot_model.init_qpos)
    run(simulation, 2.0)
    np.testing.assert_allclose(simulation.robot.state().position[own], start, atol=1e-3)


@pytest.mark.parametrize('name', robot_names())
def test_the_urdf_has_the_velocity_limits_that_are_kept(name):
    world = compose(name)
    controlled = Simulation(world).robot.joints
    limits = {joint.get('name'): float(joint.find('limit').get('velocity'))
              for joint in ElementTree.fromstring(urdf_of(world).xml).iter('joint')
              if joint.get('name') in controlled.names}
    assert limits == dict(zip(controlled.names, controlled.velocity_limits(
        controlled.find(controlled.names))))


def test_nothing_touches_the_tool_at_the_start(simulation, run):
    run(simulation, 0.5)
    for end in simulation.robot.state().end_effectors.values():
        np.testing.assert_allclose(end.external_wrench.force, np.zeros(3), atol=0.01)


def full_stroke_s(gripper):
    """Return how long a stroke takes at robosuite's 20 Hz, at the least 3 s."""
    return max(3.0, 2.0 / (20.0 * gripper.speed) + 0.1 if gripper.speed else 0.0)


@pytest.mark.full
def test_grippers_close_after_one_message(simulation, run):
    for part, gripper in simulation.robot.grippers.items():
        ids, goal = gripper.part.actuator_ids, np.ones(gripper.dof)
        opened = []
        for action in (-goal, goal):
            simulation.robot.apply(simulation.robot.parse.action(part, action))
            run(simulation, full_stroke_s(gripper.part.gripper))
            opened.append(simulation.data.act[simulation.model.actuator_actadr[ids]].copy())
        assert (np.abs(opened[1] - opened[0]) > 0.9 * np.ptp(
            simulation.model.actuator_actrange[ids], axis=1)).all()


def test_torque_limits_hold_on_a_step_command(simulation, run):
    arm = Driven(simulation, 'arm')
    simulation.robot.set_control_mode('arm', 'effort')
    low, high = simulation.robot.joints.ranges(simulation.robot.joints.indices_of('arm')).T
    simulation.robot.set_control_mode('arm', 'position')
    count = len(arm.names)
    simulation.robot.apply(simulation.robot.parse.action('arm', np.resize([0.5, -0.5], count)))
    with sampled(arm) as samples:
        run(simulation, 0.5)
    assert (samples.effort <= high + 1e-9).all() and (samples.effort >= low - 1e-9).all()
    assert np.abs(samples.effort).max() > 1.0
