# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Emergency stop, recovery, and the state that a robot is in."""

import numpy as np
import pytest

from manip_sim.control.commands import Status
from manip_sim.errors import CommandError
from manip_sim.models import compose
from manip_sim.models.robots import robot_names
from manip_sim.models.world import compose_robot, World
from manip_sim.simulation import Simulation
from manip_sim.simulation.journal_entries import Operations

ARM = [f'robot0_joint{n}' for n in range(1, 8)]


def move(robot, position):
    (command,) = robot.parse.joint_command(ARM[:1], position=[position])
    robot.apply(command)
    return command.handle


def test_a_moving_arm_brakes_within_its_limits_and_refuses_commands(panda_sim):
    robot = panda_sim.robot
    assert robot.safety_state == 'running'
    handle = move(robot, 1.5)
    panda_sim.advance(200)
    before = robot.controller_state('arm').velocity[0]
    assert before > 0.3
    robot.emergency_stop()
    limit = robot.joints.acceleration_limits(np.array([0]))[0] * panda_sim.timestep_s
    assert robot.safety_state == 'emergency_stop' and handle.status is Status.ABORTED
    for _ in range(300):
        panda_sim.advance(1)
        now = robot.controller_state('arm').velocity[0]
        assert abs(now - before) <= 1.5 * limit
        before = now
    assert abs(now) < 1e-3
    for command in (*robot.parse.joint_command(ARM[:1], position=[0.0]),
                    robot.parse.action('right/gripper', [1.0])):
        robot.apply(command)
        assert command.handle.status is Status.ABORTED and 'recover' in command.handle.reason


def test_a_reset_of_reflexes_does_not_end_an_emergency_stop(panda_sim):
    robot = panda_sim.robot
    robot.emergency_stop()
    robot.emergency_stop()
    with pytest.raises(CommandError, match='emergency stop: call recover'):
        robot.reset_reflexes()
    assert robot.safety_state == 'emergency_stop' and robot.reflexes.counts['arm'] == 1


def test_a_robot_that_recovers_takes_commands_when_its_joints_rest(panda_sim):
    robot = panda_sim.robot
    move(robot, 1.5)
    panda_sim.advance(200)
    robot.emergency_stop()
    panda_sim.advance(5)
    robot.recover()
    assert robot.safety_state == 'recovering'
    assert move(robot, 0.0).status is Status.ABORTED
    with pytest.raises(CommandError, match='yet to come to rest'):
        robot.reset_reflexes()
    for _ in range(200):
        panda_sim.advance(5)
        if robot.safety_state == 'running':
            break
    assert abs(robot.controller_state('arm').velocity[0]) < 0.01
    assert move(robot, 0.0).status is not Status.ABORTED
    for _ in range(500):
        panda_sim.advance(5)
    assert abs(robot.state().position[0]) < 1e-3


def test_a_reset_of_reflexes_is_for_all_robots_or_for_none():
    """One of two robots recovers, so the reflex that has stopped the other one stays."""
    models = [compose_robot('UR5e', idn=1), compose_robot('Panda', idn=0)]
    models[0].set_base_xpos([2.0, 0.0, 0.0])
    simulation = Simulation(World(models))
    stopped, moving = simulation.robots.values()
    move(moving, 1.5)
    simulation.advance(200)
    moving.emergency_stop()
    moving.recover()
    stopped.set_reflex('arm', 'effort', 1e-6)
    simulation.advance(5)
    simulation.advance(5)
    assert [robot.safety_state for robot in (moving, stopped)] == ['recovering', 'protective_stop']
    with pytest.raises(CommandError, match='yet to come to rest'):
        Operations(simulation, 5).run('reset_reflexes')
    assert stopped.safety_state == 'protective_stop'
    for _ in range(100):
        simulation.advance(5)
    Operations(simulation, 5).run('reset_reflexes')
    assert {robot.safety_state for robot in (moving, stopped)} == {'running'}


def test_recovery_at_rest_is_at_once_and_twice_is_as_once(panda_sim):
    robot = panda_sim.robot
    robot.recover()
    assert robot.safety_state == 'running'
    robot.emergency_stop()
    panda_sim.advance(5)
    robot.recover()
    robot.recover()
    assert robot.safety_state == 'running'


def test_a_reflex_is_a_protective_stop_from_which_a_robot_recovers(panda_sim):
    robot = panda_sim.robot
    robot.set_reflex('arm', 'velocity', 0.05)
    move(robot, 1.5)
    for _ in range(40):
        panda_sim.advance(5)
    assert robot.safety_state == 'protective_stop'
    for _ in range(100):
        panda_sim.advance(5)
    robot.recover()
    assert robot.safety_state == 'running'


def test_an_emergency_stop_is_a_part_of_the_state_and_a_reset_ends_it(panda_sim):
    robot = panda_sim.robot
    digest = panda_sim.digest()
    robot.emergency_stop()
    state = panda_sim.save()
    assert panda_sim.digest() != digest
    panda_sim.reset()
    assert robot.safety_state == 'running'
    other = Simulation(panda_sim.world)
    other.restore(state)
    assert other.robot.safety_state == 'emergency_stop'


@pytest.mark.full
@pytest.mark.parametrize('name', robot_names())
def test_every_robot_stops_and_recovers(name):
    simulation = Simulation(compose(name))
    robot = simulation.robot
    rng = np.random.default_rng(0)
    for part in robot.parts.values():
        if part.gripper is None and part.atomic == (part.name,) and part.actuators:
            robot.apply(robot.parse.action(part.name, rng.uniform(-0.5, 0.5, len(part.actuators))))
    for _ in range(20):
        simulation.advance(5)
    robot.emergency_stop()
    for _ in range(600):
        simulation.advance(5)
    held = robot.measured()[:robot.measured().size // 3]
    for _ in range(200):
        simulation.advance(5)
    now = robot.measured()[:robot.measured().size // 3]
    assert np.abs(now - held).max() < 2e-3
    robot.recover()
    assert robot.safety_state == 'running'
