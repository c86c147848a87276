# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Joints in impedance mode, whose stiffness, damping and effort are in the commands."""

import math
import pickle

import numpy as np
import pytest
from springs import assert_swings, deflection

from manip_sim.control.commands import JointImpedance, JointSetpoint, Status
from manip_sim.control.modes import LAWS
from manip_sim.errors import CommandError
from manip_sim.laws import law
from manip_sim.models import compose
from manip_sim.models.robots import robot_names
from manip_sim.models.world import World
from manip_sim.runtime.change_queue import CommandBuffer
from manip_sim.simulation import Simulation

ARM = [f'robot0_joint{n}' for n in range(1, 8)]


@pytest.fixture
def impeded(panda_sim):
    """Return a simulation whose arm is in impedance mode."""
    panda_sim.robot.set_control_mode('arm', 'impedance')
    return panda_sim


def impede(simulation, names, *arguments, **numbers):
    commands = simulation.robot.parse.joint_impedance(names, *arguments, **numbers)
    simulation.robot.apply(*commands)
    return commands


@pytest.mark.full
@pytest.mark.parametrize('name', robot_names())
def test_a_push_moves_joints_by_push_over_stiffness(name):
    simulation = Simulation(compose(name))
    robot, joints = simulation.robot, simulation.robot.joints
    robot.set_control_mode('arm', 'impedance')
    names = [joints.names[i] for i in joints.indices_of('arm')]
    stiffness = np.linspace(150.0, 300.0, len(names))
    impede(simulation, names, stiffness=stiffness, damping=0.15 * stiffness)
    moved, effort = deflection(simulation)
    np.testing.assert_allclose(moved, effort / stiffness, rtol=0.01)


def test_gains_change_live_while_a_joint_is_pushed(impeded):
    impeded.data.qfrc_applied[0] = 5.0
    for stiffness in (100.0, 50.0, 400.0):
        impede(impeded, ARM, stiffness=stiffness, damping=20.0)
        for _ in range(300):
            impeded.advance(10)
        assert impeded.robot.state().position[0] == pytest.approx(5.0 / stiffness, rel=0.01)


def test_an_effort_beside_the_spring_moves_a_joint_by_effort_over_stiffness(impeded):
    impede(impeded, ARM, effort=[5.0, *[math.nan] * 6], stiffness=100.0, damping=20.0)
    impeded.advance(2000)
    assert impeded.robot.state().position[0] == pytest.approx(0.05, rel=0.01)
    impede(impeded, ARM[:1], effort=[0.0])
    impeded.advance(2000)
    assert impeded.robot.state().position[0] == pytest.approx(0.0, abs=1e-4)


def test_a_velocity_is_what_the_servo_damps_with_respect_to(impeded):
    impede(impeded, ARM, velocity=[0.2, *[math.nan] * 6], stiffness=100.0, damping=10.0)
    impeded.advance(3000)
    assert impeded.robot.state().position[0] == pytest.approx(0.2 * 10.0 / 100.0, rel=0.01)


def test_a_joint_swings_with_the_damping_that_was_commanded(one_joint_arm):
    simulation = Simulation(World([one_joint_arm('<motor name="a" joint="joint1"/>')],
                                  timestep_s=0.0005))
    simulation.robot.set_control_mode('arm', 'impedance')
    impede(simulation, simulation.robot.joints.names, stiffness=200.0, damping=4.0)
    assert_swings(simulation, 200.0, 4.0)


def test_goals_are_followed_within_limits_and_are_done_at_their_end(impeded):
    robot, joints = impeded.robot, impeded.robot.joints
    (command,) = impede(impeded, ARM[:2], [0.5, 0.4], stiffness=300.0, damping=40.0)
    limit = joints.acceleration_limits(np.array([0]))[0] * impeded.timestep_s
    before = 0.0
    for _ in range(1500):
        impeded.advance(1)
        velocity = robot.controller_state('arm').reference.velocity[0]
        assert abs(velocity - before) <= limit * 1.001
        before = velocity
    assert command.handle.status is Status.DONE
    np.testing.assert_allclose(robot.state().position[:2], [0.5, 0.4], atol=2e-3)


def test_what_a_message_leaves_out_stays_as_it_is(impeded):
    servos = impeded.robot.joints.servos
    of_model = servos._stiffness.copy()
    impede(impeded, ARM[:2], stiffness=[100.0, math.nan], damping=[math.nan, 30.0])
    assert servos._stiffness[:7].tolist() == [100.0, *of_model[1:7]]
    impede(impeded, ARM[:2], [0.1, math.nan], effort=[1.0, 2.0])
    impede(impeded, ARM[:1], stiffness=[200.0])
    impeded.advance(5)
    assert servos._stiffness[0] == 200.0 and servos._damping[1] == 30.0
    assert servos._feedforward[:2].tolist() == [1.0, 2.0]


def test_a_joint_command_moves_goals_and_keeps_the_gains(impeded):
    impede(impeded, ARM, stiffness=100.0, damping=20.0)
    impeded.robot.apply(*impeded.robot.parse.joint_command(ARM[:1], position=[0.3]))
    impeded.data.qfrc_applied[0] = 5.0
    impeded.advance(3000)
    assert impeded.robot.state().position[0] == pytest.approx(0.35, rel=0.01)


@pytest.mark.parametrize('leave', [
    lambda simulation: simulation.robot.set_control_mode('arm', 'position'),
    lambda simulation: simulation.reset()])
def test_another_mode_or_a_reset_ends_efforts_and_velocities(leave, impeded):
    servos = impeded.robot.joints.servos
    impede(impeded, ARM, velocity=[0.1] * 7, effort=[1.0] * 7, stiffness=100.0)
    impeded.advance(10)
    leave(impeded)
    impeded.advance(10)
    assert not servos._feedforward.any() and np.isnan(servos._damped).all()
    if impeded.robot.joints.mode_of(ARM[0]) == 'position':
        model = Simulation(impeded.world).model
        np.testing.assert_array_equal(
            impeded.model.actuator_gainprm[:7, 0], model.actuator_gainprm[:7, 0])


@pytest.mark.parametrize(('numbers', 'text'), [
    ({'position': [0.1]}, 'position must have 2 numbers'),
    ({'position': [0.1, math.inf]}, 'position must be finite, got inf'),
    ({'velocity': [0.1, -math.inf]}, 'velocity must be finite'),
    ({'stiffness': [0.0, 1.0]}, "stiffness of joint 'robot0_joint1' must be greater than 0"),
    ({'damping': -3.0}, "damping of joint 'robot0_joint1' must be greater than 0, got -3"),
    ({'damping': [[1.0], [2.0]]}, 'damping must have 2 numbers'),
    ({'effort': 'high'}, 'effort'), ({'effort': 1.0}, 'effort must have 2 numbers')])
def test_numbers_that_cannot_be_used_are_rejected_and_change_nothing(numbers, text, impeded):
    digest = impeded.digest()
    with pytest.raises(CommandError, match=text):
        impede(impeded, ARM[:2], **numbers)
    assert impeded.digest() == digest


@pytest.mark.parametrize(('names', 'text'), [
    (['robot0_joint8'], "has no joint 'robot0_joint8'"), ([], 'no joint is named'),
    (ARM[:1] * 2, 'named twice'), ('robot0_joint1', 'a sequence of texts'),
    (['gripper0_right_finger_joint1'], 'that can be commanded')])
def test_names_that_cannot_be_used_are_rejected(names, text, impeded):
    with pytest.raises(CommandError, match=text):
        impede(impeded, names, stiffness=100.0)


def test_joints_in_another_mode_take_no_impedance(panda_sim):
    with pytest.raises(CommandError, match="'robot0_joint1' is in position mode, not in impedan"):
        impede(panda_sim, ARM[:1], stiffness=[100.0])


def test_numbers_beyond_limits_are_clamped_and_counted(impeded):
    (command,) = impeded.robot.parse.joint_impedance(
        ARM[:2], [9.0, 0.0], velocity=[0.0, 9.0], effort=[500.0, -500.0])
    assert command.clamped == 4
    assert command.clamped_example == 'position of robot0_joint1 from 9 to 2.8973'
    assert command.pulls[1].tolist() == [87.0, -87.0] and command.values[0] == 2.8973


def test_a_state_with_impedances_is_continued_bit_by_bit(impeded):
    impede(impeded, ARM, [0.2, *[math.nan] * 6], velocity=[0.1] * 7, effort=[1.0] * 7,
           stiffness=100.0, damping=20.0)
    impeded.advance(20)
    state = pickle.loads(pickle.dumps(impeded.save()))
    other = Simulation(impeded.world)
    other.restore(state)
    for simulation in (impeded, other):
        simulation.advance(50)
        impede(simulation, ARM[:3], effort=[2.0, 0.0, 1.0])
        simulation.advance(50)
    assert impeded.digest() == other.digest()


def test_messages_of_one_period_say_together_what_each_says_last(impeded):
    parse, buffer = impeded.robot.parse, CommandBuffer()
    (goal,) = parse.joint_command(ARM[:2], position=[0.1, 0.2])
    commands = [*parse.joint_impedance(ARM[:2], [0.3, math.nan], stiffness=[100.0, math.nan]),
                *parse.joint_impedance(ARM[:2], stiffness=[math.nan, 50.0], effort=[1.0, 2.0]),
                *parse.joint_impedance(ARM[1:3], damping=30.0)]
    for command in (goal, *commands):
        buffer.add(command)
    first, second, third = buffer.take()
    assert type(first) is JointSetpoint and type(second) is JointImpedance
    assert second.values[0] == 0.3 and np.isnan(second.values[1]) and second.messages == 2
    assert second.pulls[2].tolist() == [100.0, 50.0] and second.pulls[1].tolist() == [1.0, 2.0]
    assert commands[0].handle.status is Status.REPLACED and third is commands[2]


@law
def following(t, q, v, bias, mass, jacobian, wrench, setpoint, parameters, memory, effort):
    for i in range(len(q)):
        effort[i] = bias[i]
        for j in range(len(q)):
            effort[i] += mass[i, j] * (setpoint[j, 2] + 400.0 * (setpoint[j, 0] - q[j])
                                       + 40.0 * (setpoint[j, 1] - v[j]))


def arrivals(schedule):
    """Return the numbers of the messages that arrive in each of 150 control periods."""
    random, due = np.random.default_rng(5), [[] for _ in range(160)]
    for number in range(0, 100, 2):
        if schedule == 'lost' and random.random() < 0.3 or schedule == 'never' and number > 40:
            continue
        late = int(random.integers(6)) if schedule == 'late' else 0
        due[number + late] += [number] * (2 if schedule == 'twice' else 1)
    return due[:150]


@pytest.mark.parametrize('schedule', ['late', 'lost', 'twice', 'never'])
@pytest.mark.parametrize('mode', ['impedance', 'law:following'])
def test_messages_off_schedule_keep_the_limits_and_end_at_the_last_goal(
        mode, schedule, panda_sim, monkeypatch):
    monkeypatch.setattr(LAWS, '_laws', {'following': following})
    robot = panda_sim.robot
    robot.set_control_mode('arm', mode)
    limits = [limit(np.arange(1))[0] for limit in (
        robot.joints.velocity_limits, robot.joints.acceleration_limits)]
    velocities, goal = [0.0], 0.0
    for numbers in arrivals(schedule):
        for number in numbers:
            goal = 0.4 * (1.0 - math.cos(0.06 * number))
            robot.apply(*robot.parse.joint_command(ARM[:1], position=[goal]), period_s=0.01)
            if mode == 'impedance':
                impede(panda_sim, ARM[:1], stiffness=400.0, damping=40.0)
        panda_sim.advance(5)
        velocities.append(robot.joints.setpoints.velocity[0])
    assert np.abs(velocities).max() <= limits[0]
    assert np.abs(np.diff(velocities)).max() <= 1.5 * limits[1] * 0.01
    panda_sim.advance(500)
    assert abs(robot.state().position[0] - goal) < 1e-3


def test_a_stream_of_impedances_is_followed_as_one_of_positions(impeded):
    other = Simulation(impeded.world)
    other.robot.set_control_mode('arm', 'impedance')
    for period in range(60):
        goals = [0.2 * math.sin(0.1 * period)]
        impeded.robot.apply(*impeded.robot.parse.joint_impedance(ARM[:1], goals), period_s=0.02)
        other.robot.apply(*other.robot.parse.joint_command(ARM[:1], position=goals),
                          period_s=0.02)
        for simulation in (impeded, other):
            simulation.advance(10)
    np.testing.assert_array_equal(impeded.data.qpos, other.data.qpos)
