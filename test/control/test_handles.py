# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of what is told of a command: it waits, runs, is done, replaced or aborted."""

import numpy as np
import pytest

from manip_sim.control.commands import CommandHandle, Status

J1, J2, J3 = 'robot0_joint1', 'robot0_joint2', 'robot0_joint3'


def test_command_waits_until_it_is_applied(panda_sim):
    (command,) = panda_sim.robot.parse.joint_command([J1], [0.2])
    assert command.handle.status is Status.WAITING
    assert command.handle.is_active
    panda_sim.robot.apply(command)
    assert command.handle.status is Status.RUNNING
    assert command.handle.is_active


def test_goal_is_done_when_its_setpoint_is_there_with_the_error_that_is_left(panda_op):
    (handle,) = panda_op.go({J1: 0.2, J2: 0.3})
    statuses = []
    panda_op.run(1.5, lambda: statuses.append(handle.status))
    assert handle.status is Status.DONE
    assert statuses[20] is Status.RUNNING
    done = statuses.index(Status.DONE)
    assert handle.error.shape == (2,)
    np.testing.assert_allclose(handle.error, 0.0, atol=1e-3)
    assert 0.2 < done * 0.01 < 1.0


def test_error_of_a_goal_that_cannot_be_reached_is_told(panda_op):
    simulation = panda_op.simulation
    simulation.data.qfrc_applied[0] = 40.0
    (handle,) = panda_op.go({J1: 0.3})
    panda_op.run(2.0)
    assert handle.status is Status.DONE
    # A spring between goal and joint.
    assert handle.error[0] == pytest.approx(-40.0 / simulation.model.actuator_gainprm[0, 0],
                                            rel=0.01)


@pytest.mark.parametrize('mode', ['velocity', 'effort'])
def test_velocities_and_efforts_last(panda_op, mode):
    panda_op.simulation.robot.set_control_mode('arm', mode)
    (handle,) = panda_op.go({J1: 0.05}, mode)
    panda_op.run(1.0)
    assert handle.status is Status.RUNNING


def test_goal_is_replaced_when_newer_ones_have_taken_all_of_its_joints(panda_op):
    (older,) = panda_op.go({J1: 1.0, J2: 0.5})
    panda_op.run(0.1)
    (first,) = panda_op.go({J1: -0.2, J3: 0.1})
    assert older.status is Status.RUNNING
    (second,) = panda_op.go({J2: 0.0})
    assert older.status is Status.REPLACED
    assert older.error is None
    panda_op.run(2.0)
    assert (first.status, second.status) == (Status.DONE, Status.DONE)
    np.testing.assert_allclose(panda_op.where(J1, J2, J3), [-0.2, 0.0, 0.1], atol=1e-3)


def test_what_is_left_of_a_goal_is_done_with_the_error_of_its_own_joints(panda_op):
    (older,) = panda_op.go({J1: 1.0, J2: 0.5})
    panda_op.go({J1: -0.2})
    panda_op.run(2.0)
    assert older.status is Status.DONE
    assert older.error.shape == (1,)
    assert panda_op.where(J2)[0] == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize('kind', ['goal', 'trajectory', 'later trajectory'])
def test_reset_aborts(panda_op, kind):
    if kind == 'goal':
        (handle,) = panda_op.go({J1: 1.0})
    else:
        start_ns = 10**9 if kind.startswith('later') else 0
        handle = panda_op.follow('arm', [J1], [1.0], [[0.5]], start_ns=start_ns).handle
    panda_op.run(0.1)
    panda_op.simulation.reset()
    assert (handle.status, handle.reason) == (Status.ABORTED, 'the simulation was reset')
    assert handle.error is None
    panda_op.run(1.5)
    assert abs(panda_op.where(J1)[0]) < 1e-6


@pytest.mark.parametrize('mode', ['velocity', 'effort'])
def test_change_of_mode_aborts(panda_op, mode):
    (goal,) = panda_op.go({J2: 0.5})
    motion = panda_op.follow('arm', [J1], [1.0], [[0.5]]).handle
    later = panda_op.follow('arm', [J3], [1.0], [[0.5]], start_ns=10**9).handle
    panda_op.run(0.1)
    panda_op.simulation.robot.set_control_mode('arm', mode)
    for handle in (goal, motion, later):
        assert handle.status is Status.ABORTED
        assert handle.reason == f'the control mode is {mode} now'


def test_setting_the_present_mode_leaves_a_trajectory_alone(panda_op):
    handle = panda_op.follow('arm', [J1], [0.5], [[0.4]]).handle
    panda_op.run(0.2)
    panda_op.simulation.robot.set_control_mode('arm', 'position')
    assert handle.status is Status.RUNNING
    panda_op.run(0.5)
    assert handle.status is Status.DONE
    assert panda_op.where(J1)[0] == pytest.approx(0.4, abs=1e-3)


def test_time_out_aborts(panda_op):
    panda_op.simulation.robot.set_command_timeout('arm', 0.2)
    (handle,) = panda_op.go({J1: 1.5})
    panda_op.run(0.15)
    assert handle.status is Status.RUNNING
    panda_op.run(0.1)
    assert (handle.status, handle.reason) == (
        Status.ABORTED, 'no fresh command came in time')


def test_empty_trajectory_aborts_trajectories_and_not_goals(panda_op):
    (goal,) = panda_op.go({J2: 0.5})
    motion = panda_op.follow('arm', [J1, J3], [1.0], [[0.5, 0.5]]).handle
    panda_op.run(0.5)
    stop = panda_op.follow('arm', [], [], []).handle
    assert stop.status is Status.DONE
    assert (motion.status, motion.reason) == (
        Status.ABORTED, 'ended by an empty trajectory')
    panda_op.run(1.0)
    assert goal.status is Status.DONE
    assert panda_op.where(J2)[0] == pytest.approx(0.5, abs=1e-3)


def test_trajectory_is_done_at_its_end_with_its_error(panda_op):
    handle = panda_op.follow('arm', [J1, J2], [0.5], [[0.3, 0.2]]).handle
    panda_op.run(0.48)
    assert handle.status is Status.RUNNING
    panda_op.run(0.05)
    assert handle.status is Status.DONE
    np.testing.assert_allclose(handle.error, 0.0, atol=5e-3)


def test_what_became_of_a_command_is_not_changed_any_more():
    handle = CommandHandle()
    handle.end(Status.DONE, error=np.zeros(1))
    handle.end(Status.ABORTED, 'too late')
    assert (handle.status, handle.reason) == (Status.DONE, '')
    assert not handle.is_active
