# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of the three control modes on the Panda and on actuators of other kinds."""

import mujoco
import numpy as np
import pytest

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.world import World
from manip_sim.simulation import Simulation

#: Franka Emika data sheet.
TORQUE_LIMITS_N_M = np.array([87.0] * 4 + [12.0] * 3)
ACTUATORS = {
    'motor': '<motor name="a" joint="joint1" ctrlrange="-30 30"/>',
    'motor with slow gear': '<motor name="a" joint="joint1" gear="50" ctrlrange="-0.6 0.6"/>',
    'motor with fast gear': '<motor name="a" joint="joint1" gear="0.1" ctrlrange="-300 300"/>',
    'motor turned round': '<motor name="a" joint="joint1" gear="-2" ctrlrange="-15 15"/>',
    'motor in parent': '<motor name="a" jointinparent="joint1" ctrlrange="-30 30"/>',
    'position servo': '<position name="a" joint="joint1" kp="2000" kv="40" forcerange="-30 30"/>',
    'position servo without damping': '<position name="a" joint="joint1" kp="2000" gear="2"/>',
    'velocity servo': '<velocity name="a" joint="joint1" kv="30" ctrlrange="-1 1"/>',
    'velocity servo with gear': '<velocity name="a" joint="joint1" kv="2" gear="4" '
                                'ctrlrange="-4 4"/>'}


@pytest.fixture
def sim_of(one_joint_arm):
    """Return a function that makes a simulation of one joint with an actuator."""
    return lambda actuator: Simulation(World([one_joint_arm(actuator)]))


def command(simulation, mode, joint, value):
    """Apply a goal for one joint in a mode."""
    simulation.apply(*simulation.parse.joint_command([joint], **{mode: [value]}))


@pytest.mark.parametrize('joint', range(7))
def test_position_mode_follows_a_sine(panda_sim, joint):
    name, middle = panda_sim.joint_names[joint], panda_sim.robot.init_qpos[joint]
    errors = []
    for k in range(300):
        goal = middle + 0.2 * (1.0 - np.cos(2.0 * np.pi * 0.5 * k * 0.01)) / 2.0
        command(panda_sim, 'position', name, goal)
        panda_sim.advance(5)
        errors.append(panda_sim.state().position[joint] - goal)
    assert np.sqrt(np.mean(np.square(errors))) < 0.02


def test_effort_mode_floats_with_zero_effort(panda_sim, run):
    panda_sim.set_control_mode('arm', 'effort')
    start = panda_sim.state().position
    run(panda_sim, 5.0)
    np.testing.assert_allclose(panda_sim.state().position, start, atol=0.01)


@pytest.mark.parametrize('joint', range(7))
def test_velocity_mode_meets_the_velocity(panda_sim, run, joint):
    panda_sim.set_control_mode('arm', 'velocity')
    command(panda_sim, 'velocity', panda_sim.joint_names[joint], 0.2)
    run(panda_sim, 0.5)
    np.testing.assert_allclose(panda_sim.state().velocity[joint], 0.2, rtol=0.02)
    others = np.delete(panda_sim.state().velocity[:7], joint)
    assert np.abs(others).max() < 0.01


@pytest.mark.parametrize('mode', ['position', 'velocity', 'effort'])
def test_torque_limits_hold_in_every_mode(panda_sim, mode):
    panda_sim.set_control_mode('arm', mode)
    largest = np.zeros(7)
    for k in range(80):
        sign = 1.0 if k // 20 % 2 else -1.0
        panda_sim.apply(panda_sim.parse.action('arm', sign * np.array([1, -1, 1, -1, 1, -1, 1])))
        panda_sim.advance(5)
        largest = np.maximum(largest, np.abs(panda_sim.data.qfrc_actuator[:7]))
    assert (largest <= TORQUE_LIMITS_N_M + 1e-9).all()
    assert (largest > 0.5 * TORQUE_LIMITS_N_M).any()


@pytest.mark.parametrize('mode', ['position', 'velocity', 'effort'])
@pytest.mark.parametrize('actuator', ['motor', 'motor with slow gear', 'position servo'])
def test_torque_limit_of_the_actuator_holds_a_blocked_joint(sim_of, actuator, mode):
    simulation = sim_of(ACTUATORS[actuator])
    simulation.set_control_mode('arm', mode)
    simulation.data.xfrc_applied[simulation.model.body('robot0_link1').id, 4] = -500.0
    simulation.apply(simulation.parse.action('arm', [1.0]))
    efforts = []
    for _ in range(10):
        simulation.advance(5)
        efforts.append(abs(simulation.state().effort[0]))
    assert max(efforts) == pytest.approx(30.0)


@pytest.mark.parametrize('first', ['position', 'velocity', 'effort'])
@pytest.mark.parametrize('second', ['position', 'velocity', 'effort'])
def test_mode_change_holds_the_robot_without_a_jump(panda_sim, run, first, second):
    panda_sim.set_control_mode('arm', first)
    run(panda_sim, 0.1)
    panda_sim.set_control_mode('arm', second)
    before = panda_sim.state().position
    assert panda_sim.joints.mode_of(panda_sim.joint_names[0]) == second
    run(panda_sim, 0.5)
    np.testing.assert_allclose(panda_sim.state().position, before, atol=1e-4)


def test_mode_change_while_moving_stops_within_a_few_centiradians(panda_sim, run):
    panda_sim.set_control_mode('arm', 'velocity')
    command(panda_sim, 'velocity', panda_sim.joint_names[0], 0.5)
    run(panda_sim, 0.3)
    here = panda_sim.state().position[0]
    panda_sim.set_control_mode('arm', 'position')
    run(panda_sim, 0.5)
    assert abs(panda_sim.state().velocity[0]) < 1e-3
    assert abs(panda_sim.state().position[0] - here) < 0.02


def test_unknown_mode_tells_the_three(panda_sim):
    with pytest.raises(UnknownNameError, match=r"^unknown control mode 'torque': .*"
                                               r'available: position, velocity, effort$'):
        panda_sim.set_control_mode('arm', 'torque')
    assert panda_sim.joints.mode_of(panda_sim.joint_names[0]) == 'position'


@pytest.mark.parametrize('actuator', ACTUATORS)
def test_every_kind_of_actuator_comes_to_a_position(sim_of, run, actuator):
    simulation, positions = sim_of(ACTUATORS[actuator]), []
    command(simulation, 'position', 'robot0_joint1', 0.5)
    run(simulation, 1.0, lambda: positions.append(simulation.state().position[0]))
    assert positions[-1] == pytest.approx(0.5, abs=1e-3)
    assert max(positions) < 0.51


@pytest.mark.parametrize('actuator', ACTUATORS)
def test_every_kind_of_actuator_meets_a_velocity(sim_of, run, actuator):
    simulation = sim_of(ACTUATORS[actuator])
    simulation.set_control_mode('arm', 'velocity')
    command(simulation, 'velocity', 'robot0_joint1', 0.4)
    run(simulation, 0.5)
    assert simulation.state().velocity[0] == pytest.approx(0.4, rel=0.02)


@pytest.mark.parametrize('actuator', ACTUATORS)
def test_damping_of_the_joint_does_not_slow_a_velocity(one_joint_arm, run, actuator):
    robot = one_joint_arm(ACTUATORS[actuator])
    robot.set_joint_attribute('damping', [20.0])
    simulation = Simulation(World([robot]))
    simulation.set_control_mode('arm', 'velocity')
    command(simulation, 'velocity', 'robot0_joint1', 0.4)
    run(simulation, 0.5)
    assert simulation.state().velocity[0] == pytest.approx(0.4, rel=0.02)


@pytest.mark.parametrize('actuator', ACTUATORS)
def test_every_kind_of_actuator_gives_an_effort(sim_of, actuator):
    simulation = sim_of(ACTUATORS[actuator])
    simulation.set_control_mode('arm', 'effort')
    command(simulation, 'effort', 'robot0_joint1', 0.7)
    simulation.advance(5)
    gravity = simulation.data.qfrc_gravcomp[0]
    assert simulation.state().effort[0] - gravity == pytest.approx(0.7)


def test_gear_does_not_change_the_motion_of_a_motor(sim_of, run):
    ends = []
    for actuator in ('motor', 'motor with slow gear', 'motor with fast gear', 'motor in parent'):
        simulation = sim_of(ACTUATORS[actuator])
        command(simulation, 'position', 'robot0_joint1', 0.5)
        run(simulation, 0.12)
        ends.append(simulation.state().position[0])
    np.testing.assert_allclose(ends, ends[0], rtol=1e-9)


@pytest.mark.parametrize(('actuator', 'limits'), [
    ('motor with slow gear', {'velocity': np.pi, 'effort': 30.0, 'position': 2.0}),
    ('velocity servo', {'velocity': 1.0}), ('velocity servo with gear', {'velocity': 1.0}),
    ('position servo', {'effort': 30.0})])
def test_limits_are_those_at_the_joint(sim_of, actuator, limits):
    simulation = sim_of(ACTUATORS[actuator])
    for mode, limit in limits.items():
        simulation.set_control_mode('arm', mode)
        np.testing.assert_allclose(simulation.joints.ranges(np.array([0])), [[-limit, limit]])


def test_actuator_that_drives_no_joint_is_refused(one_joint_arm):
    robot = one_joint_arm('<motor name="pull" tendon="rope"/>', sections='<tendon>'
                          '<fixed name="rope"><joint joint="joint1" coef="1"/></fixed></tendon>')
    with pytest.raises(ModelError, match=r"^actuator 'robot0_pull' of arm must drive a joint, not "
                                         r'a tendon, a site or a body$'):
        Simulation(World([robot]))


def test_joint_without_an_actuator_is_seen_but_not_driven(one_joint_arm):
    simulation = Simulation(World([one_joint_arm('')], gravity_compensation=False))
    simulation.advance(50)
    expected = mujoco.MjData(simulation.model)
    mujoco.mj_step(simulation.model, expected, 50)
    assert simulation.state().position[0] == expected.qpos[0] > 1e-3
