# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A part that does too much is stopped, and refuses commands until the reflex is reset."""

import numpy as np
import pytest

from sampling import Driven, sampled

from manip_sim.control.commands import Status
from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.models import compose
from manip_sim.simulation import Simulation
from manip_sim.worlds import Worlds

J1, J2 = 'robot0_joint1', 'robot0_joint2'


def go(simulation, **fields):
    (command,) = simulation.robot.parse.joint_command([J1], **fields)
    simulation.robot.apply(command)
    return command.handle


def test_an_arm_that_is_too_fast_in_effort_mode_brakes_and_refuses_commands(panda_sim, run):
    robot, arm = panda_sim.robot, Driven(panda_sim, 'arm')
    robot.set_control_mode('arm', 'effort')
    robot.set_reflex('arm', 'velocity', 1.2)
    arm.command('effort', [20.0, *[0.0] * 6])
    with sampled(arm) as samples:
        run(panda_sim, 2.0)
    velocity = samples.velocity[:, 0]
    # States are looked at once a control period.
    assert 1.2 < velocity.max() / arm.velocity_limit[0] < 1.3
    slowing = np.diff(velocity)[velocity.argmax():] / 0.002
    assert np.abs(slowing).max() < robot.joints.acceleration_limits(np.array([0]))[0]
    assert np.abs(samples.velocity[-1]).max() < 1e-3
    assert 'the velocity of joint' in robot.reflexes.tripped['arm']
    handle = go(panda_sim, effort=[1.0])
    assert handle.status is Status.ABORTED
    assert handle.reason.startswith('arm was stopped by a reflex: the velocity of joint')
    robot.reset_reflexes()
    assert go(panda_sim, effort=[1.0]).status is Status.RUNNING
    run(panda_sim, 0.1)
    assert panda_sim.data.qvel[0] > 0.05 and robot.reflexes.counts['arm'] == 1


def test_a_push_stops_an_arm_that_rests(panda_sim, run):
    robot = panda_sim.robot
    robot.set_reflex('right', 'force', 20.0)
    gripper = panda_sim.data.body('gripper0_right_right_gripper')
    gripper.xfrc_applied[1] = 19.0
    run(panda_sim, 0.2)
    assert not robot.reflexes.tripped
    gripper.xfrc_applied[1] = 21.0
    run(panda_sim, 0.2)
    assert robot.reflexes.tripped == {'arm': 'the external force is 21 N, allowed is 20 N'}
    # While the push lasts, it stops the arm again.
    robot.reset_reflexes()
    run(panda_sim, 0.02)
    assert robot.reflexes.counts['arm'] == 2


@pytest.mark.parametrize('quantity, limit', [('effort', 0.5), ('torque', 3.0)])
def test_too_much_effort_or_torque_aborts_what_runs(panda_sim, run, quantity, limit):
    robot = panda_sim.robot
    robot.set_reflex('arm', quantity, limit)
    handle = go(panda_sim, position=[2.0])
    run(panda_sim, 0.2)
    assert handle.status is Status.RUNNING
    panda_sim.data.body('gripper0_right_right_gripper').xfrc_applied[:] = [0, 150, 0, 0, 0, 5.0]
    run(panda_sim, 0.1)
    assert handle.status is Status.ABORTED and quantity in handle.reason
    panda_sim.reset()
    assert not robot.reflexes.tripped


def test_what_is_not_stopped_goes_on(operator_of):
    op = operator_of('Baxter')
    robot = op.simulation.robot
    robot.set_reflex('arm', 'velocity', 0.05)
    (right,), (left,) = ([op.joints_of(part)[0]] for part in ('right', 'left'))
    op.go({right: op.where(right)[0] + 0.3})
    op.run(0.5)
    assert list(robot.reflexes.tripped) == ['right']
    (handle,) = op.go({left: op.where(left)[0] + 0.001})
    op.run(0.5)
    assert handle.status is Status.DONE


def test_without_limits_nothing_is_stopped_and_unknown_ones_are_told(panda_sim, run):
    robot = panda_sim.robot
    robot.set_reflex('arm', 'velocity', 0.1)
    robot.set_reflex('arm', 'velocity', 0.0)
    assert robot.reflexes.armed == () and robot.resting
    go(panda_sim, position=[1.0])
    run(panda_sim, 0.3)
    assert not robot.reflexes.tripped
    with pytest.raises(UnknownNameError, match="unknown quantity of a reflex 'power'"):
        robot.set_reflex('arm', 'power', 1.0)
    with pytest.raises(CommandError, match='is a gripper'):
        robot.set_reflex('right/gripper', 'force', 1.0)


def stream(simulation, positions):
    """Command positions of a joint, one each control period; return the handles."""
    handles = []
    for position in positions:
        handles.append(go(simulation, position=[position]))
        simulation.advance(5)
    return handles


#: A motion of the first joint from its start within 0.4 of the limits of the Panda.
SMOOTH = 0.1 * (1.0 - np.cos(5.0 * 0.01 * np.arange(120)))


def test_a_continuous_stream_passes_and_a_jump_in_it_stops_the_arm_before_it_acts(panda_sim):
    robot = panda_sim.robot
    robot.set_reflex('arm', 'discontinuity', 1.0)
    stream(panda_sim, SMOOTH)
    assert not robot.reflexes.tripped
    before = robot.joints.setpoints.position[0]
    handle, = stream(panda_sim, [SMOOTH[-1] + 0.05])
    assert handle.status is Status.ABORTED
    assert "times the acceleration limit of joint 'robot0_joint1', allowed is 1" in handle.reason
    panda_sim.advance(500)
    assert abs(robot.joints.setpoints.position[0] - before) < 2e-3
    assert robot.safety_state == 'protective_stop'
    robot.reset_reflexes()
    at = float(robot.joints.setpoints.position[0])
    assert stream(panda_sim, at + SMOOTH)[-1].status is not Status.ABORTED


@pytest.mark.parametrize(('positions', 'stops'), [
    ([0.002], True), ([1e-4], False),  # From rest.
    ([0.0, 0.0, 1e-4, 2e-4, 3e-4], False), ([0.0, 0.0, 0.0, 5e-3, 0.0], True),
    ([*SMOOTH[:40], *SMOOTH[42:]], True)])  # It skips what two messages would have said.
def test_what_positions_demand_is_compared_with_the_limits(positions, stops, panda_sim):
    panda_sim.robot.set_reflex('right', 'discontinuity', 2.0)
    stream(panda_sim, positions)
    assert bool(panda_sim.robot.reflexes.tripped) is stops


def test_lost_messages_are_no_discontinuity_and_other_commands_begin_anew(panda_sim):
    robot = panda_sim.robot
    robot.set_reflex('arm', 'discontinuity', 1.0)
    for number, position in enumerate(SMOOTH):
        if number % 7 not in (3, 4):
            stream(panda_sim, [position])
        else:
            panda_sim.advance(5)
    assert not robot.reflexes.tripped
    robot.apply(robot.parse.trajectory('arm', [J1], [1.0], [[0.6]]))
    panda_sim.advance(600)
    assert not robot.reflexes.tripped
    stream(panda_sim, 0.6 + SMOOTH)
    assert not robot.reflexes.tripped


def test_a_restored_state_remembers_what_was_commanded(panda_sim):
    panda_sim.robot.set_reflex('arm', 'discontinuity', 1.0)
    stream(panda_sim, SMOOTH[:30])
    saved, digests = panda_sim.save(), []
    for _ in range(2):
        stream(panda_sim, SMOOTH[30:60])
        assert not panda_sim.robot.reflexes.tripped
        digests.append(panda_sim.digest())
        panda_sim.reset()
        panda_sim.restore(saved)
    assert digests[0] == digests[1]


def test_many_worlds_stop_where_a_command_jumps():
    worlds = Worlds(compose('Panda'), 2)
    with worlds:
        for simulation in worlds.simulations:
            simulation.robot.set_reflex('arm', 'discontinuity', 1.0)
        for number, position in enumerate(SMOOTH):
            positions = np.array([[position], [position + 0.1 * (number == 90)]])
            worlds.robot.command.joint_command([J1], position=positions, period_s=0.01)
            worlds.advance(5)
        assert [bool(s.robot.reflexes.tripped) for s in worlds.simulations] == [False, True]


def test_one_arm_that_was_stopped_leaves_the_other_one_checked():
    simulation = Simulation(compose('Baxter'))
    robot = simulation.robot
    robot.set_reflex('arm', 'discontinuity', 1.0)
    for side in ('right', 'left'):
        index = robot.joints.indices_of(side)[0]
        command, = robot.parse.joint_command([robot.joints.names[index]], position=[
            float(robot.joints.setpoints.position[index]) + 0.1])
        robot.apply(command)
        simulation.advance(5)
        assert command.handle.status is Status.ABORTED
    assert robot.reflexes.tripped.keys() == {'right', 'left'}
