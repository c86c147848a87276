# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Objects with actuators: they come and go, hold, and take commands by actuator."""

from pathlib import Path

import numpy as np
import pytest

from manip_sim.models import compose
from manip_sim.models.object_creation import create_object
from manip_sim.physics.object_spawning import plan_with, plan_without
from manip_sim.simulation import Simulation

FILES = Path(__file__).resolve().parents[1] / 'data/files'
ARM = FILES / 'stand_arm.xml'


def arm(name, position):
    item = create_object({'name': name, 'file': str(ARM)})
    item.place(position)
    return item


def angles(simulation, name):
    return [simulation.data.joint(f'{name}_{joint}').qpos[0] for joint in ('pan', 'lift')]


def advance(simulation, seconds):
    for _ in range(round(seconds * 100)):
        simulation.advance(5)


def command(simulation, **setpoints):
    actuators = simulation.surroundings.commands['actuators']
    actuators.command(actuators.checked(list(setpoints), list(setpoints.values()), [], []))


@pytest.fixture
def simulation():
    return Simulation(compose('Panda'))


def test_an_arm_that_comes_stands_where_it_was_put_and_takes_commands(simulation):
    advance(simulation, 0.1)
    simulation.change_objects(plan_with(simulation.plan, arm('crane', [0.0, 1.0, 0.05])))
    assert simulation.surroundings.other_actuators == ('crane_pan', 'crane_lift')
    advance(simulation, 1.0)
    np.testing.assert_allclose(simulation.data.body('crane').xpos, [0.0, 1.0, 0.05], atol=2e-3)
    np.testing.assert_allclose(angles(simulation, 'crane'), 0.0, atol=1e-2)
    command(simulation, crane_pan=0.7)
    advance(simulation, 2.0)
    assert angles(simulation, 'crane')[0] == pytest.approx(0.7, abs=1e-2)
    states = simulation.surroundings.state_of_actuators().reshape(3, 2)
    np.testing.assert_allclose(states[0], angles(simulation, 'crane'), atol=1e-12)


def test_commands_go_on_when_others_come_and_go(simulation):
    for name, y in (('first', 1.0), ('second', -1.0)):
        simulation.change_objects(plan_with(simulation.plan, arm(name, [0.0, y, 0.05])))
    command(simulation, first_pan=0.3, second_pan=-0.4)
    simulation.change_objects(plan_without(simulation.plan, 'first'))
    assert simulation.surroundings.other_actuators == ('second_pan', 'second_lift')
    advance(simulation, 2.0)
    assert angles(simulation, 'second')[0] == pytest.approx(-0.4, abs=1e-2)
    simulation.change_objects(plan_without(simulation.plan, 'second'))
    assert simulation.surroundings.other_actuators == ()
    assert simulation.surroundings.state_of_actuators().shape == (0,)


def test_tendons_of_the_robot_go_on_when_an_arm_comes():
    simulation = Simulation(compose(FILES / 'differential_wrist.xml'))
    command(simulation, robot0_sum=0.8)
    simulation.change_objects(plan_with(simulation.plan, arm('crane', [0.0, 1.0, 0.05])))
    assert simulation.surroundings.other_actuators[-2:] == ('crane_pan', 'crane_lift')
    advance(simulation, 2.0)
    assert simulation.surroundings.state_of_actuators()[0] == pytest.approx(0.8, abs=1e-2)


def test_the_robot_does_not_notice_that_an_arm_comes():
    """The arm is far away, so the robot moves as it does without it."""
    paths = []
    for comes in (False, True):
        simulation = Simulation(compose('Panda', objects=[
            {'name': 'ball', 'shape': 'sphere', 'size': 0.05, 'position': [2.0, 0.0, 0.05]}]))
        robot = simulation.robot
        robot.apply(*robot.parse.joint_command(['robot0_joint1'], [0.3], [], []))
        advance(simulation, 0.2)
        if comes:
            simulation.change_objects(plan_with(simulation.plan, arm('crane', [0, 3, 0.05])))
        advance(simulation, 0.5)
        paths.append(robot.state().position)
    np.testing.assert_array_equal(*paths)


def test_a_reset_brings_an_arm_back_to_its_start(simulation):
    simulation.change_objects(plan_with(simulation.plan, arm('crane', [0.0, 1.0, 0.05])))
    command(simulation, crane_lift=0.5)
    advance(simulation, 1.0)
    simulation.reset()
    np.testing.assert_array_equal(angles(simulation, 'crane'), 0.0)
    advance(simulation, 1.0)
    np.testing.assert_allclose(angles(simulation, 'crane'), 0.0, atol=1e-2)
