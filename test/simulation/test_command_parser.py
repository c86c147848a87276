# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of how a subsystem takes commands: validation, clamping, time-outs, velocity ramp."""

import numpy as np
import pytest

from manip_sim.errors import CommandError
from manip_sim.models.world import World
from manip_sim.simulation import Simulation
from manip_sim.simulation.drives import GripperDrive

J1, J2 = 'robot0_joint1', 'robot0_joint2'


@pytest.fixture
def arm(panda_sim):
    """Return the drive of the Panda's arm, in position mode."""
    return panda_sim.drive('arm')


@pytest.mark.parametrize(('action', 'message'), [
    ([0.0] * 6, r'^arm: an action must have 7 numbers, got 6$'),
    ([], r'^arm: an action must have 7 numbers, got 0$'),
    ([0.0] * 6 + [np.nan], r'^arm: an action must be finite, got nan at index 6$'),
    ([-np.inf] + [0.0] * 6, r'^arm: an action must be finite, got -inf at index 0$')])
def test_action_that_does_not_fit_is_refused(arm, action, message):
    with pytest.raises(CommandError, match=message):
        arm.action(action)


@pytest.mark.parametrize('mode', ['position', 'velocity', 'effort'])
def test_action_spans_the_limits_of_the_mode_and_is_clamped(panda_sim, arm, mode):
    panda_sim.set_control_mode('arm', mode)
    low, high = arm.limits().T
    goal = arm.action([-1.0, 1.0, 0.0, 5.0, -9.0, 1.0, 1.0])
    assert goal.clamped == 2
    np.testing.assert_allclose(goal.values, [low[0], high[1], (low[2] + high[2]) / 2.0, high[3],
                                             low[4], high[5], high[6]])


@pytest.mark.parametrize(('names', 'position', 'velocity', 'effort', 'message'), [
    ([], [], [], [], r'^arm: no joint is named$'),
    ([J1, 'robot0_joint9'], [0, 0], [], [], r"^arm has no joint 'robot0_joint9' that can be "
     r"commanded: did you mean 'robot0_joint\d' .*available: robot0_joint1, robot0_joint2"),
    ([J1, J1], [0, 0], [], [], r'^arm: a joint is named twice in robot0_joint1, robot0_joint1$'),
    ([J1], [0, 1], [], [], r'^arm: position must have 1 numbers, got 2$'),
    ([J1], [], [], [], r'^arm: position must have 1 numbers, got 0$'),
    ([J1], [0], [1], [], r'^arm is in position mode, which does not use the field velocity: '
     r'leave it empty$'),
    ([J1], [], [], [1], r'^arm is in position mode, which does not use the field effort'),
    ([J1, J2], [0, np.inf], [], [], r'^arm: position must be finite, got inf at index 1$')])
def test_joint_command_that_does_not_fit_is_refused(arm, names, position, velocity, effort,
                                                    message):
    with pytest.raises(CommandError, match=message):
        arm.joint_command(names, position, velocity, effort)


def test_joint_command_is_clamped_and_the_clamps_are_counted(arm):
    goal = arm.joint_command([J2, J1], [-9.0, 0.5], [], [])
    assert goal.clamped == 1
    np.testing.assert_allclose(goal.values, [-1.7628, 0.5])


@pytest.mark.parametrize(('mode', 'limit'), [('velocity', 2.175), ('effort', 87.0)])
def test_velocity_and_effort_are_clamped_to_the_data_sheet(panda_sim, arm, mode, limit):
    panda_sim.set_control_mode('arm', mode)
    fields = {'position': [], 'velocity': [], 'effort': [], mode: [1e9]}
    goal = arm.joint_command([J1], **fields)
    np.testing.assert_allclose(goal.values, [limit])
    assert goal.clamped == 1


def test_position_of_an_unlimited_joint_is_not_clamped(one_joint_arm, run):
    robot = one_joint_arm()
    robot.spec.joint('joint1').limited = 0
    simulation = Simulation(World([robot]))
    goal = simulation.drive('arm').joint_command([J1], [9.0], [], [])
    assert (goal.clamped, list(goal.values)) == (0, [9.0])
    simulation.apply(goal)
    run(simulation, 4.0)
    assert simulation.state().position[0] == pytest.approx(9.0, abs=1e-3)


def test_command_for_some_joints_leaves_the_others(panda_sim, arm, run):
    start = panda_sim.state().position
    panda_sim.apply(arm.joint_command([J2], [0.3], [], []))
    run(panda_sim, 0.2)
    panda_sim.apply(arm.joint_command([J1], [0.4], [], []))
    run(panda_sim, 1.0)
    np.testing.assert_allclose(panda_sim.state().position[:7],
                               [0.4, 0.3, *start[2:7]], atol=1e-3)


def test_refused_command_changes_nothing(panda_sim, arm, run):
    start = panda_sim.state().position
    with pytest.raises(CommandError):
        arm.joint_command([J1, J2], [0.5, np.nan], [], [])
    run(panda_sim, 0.3)
    np.testing.assert_allclose(panda_sim.state().position, start, atol=1e-6)


@pytest.mark.parametrize('mode', ['velocity', 'effort'])
def test_command_that_was_meant_for_another_mode_is_dropped(panda_sim, arm, run, mode):
    goal = arm.joint_command([J1], [0.5], [], [])
    points = arm.trajectory([J1], [0.2], [[0.5]], None, None)
    panda_sim.set_control_mode('arm', mode)
    panda_sim.apply(goal)
    panda_sim.apply(points)
    run(panda_sim, 0.3)
    assert abs(panda_sim.state().position[0]) < 1e-6


@pytest.mark.parametrize(('arguments', 'message'), [
    (([J1], [], [], None, None), r'^a trajectory needs at least one point$'),
    (([J1], [-1.0], [[0.0]], None, None), r'^time_from_start must not be negative and must '
     r'increase from point to point, got \[-1\.0\]$'),
    (([J1], [1.0, 1.0], [[0], [0]], None, None), r'must increase .*got \[1\.0, 1\.0\]$'),
    (([J1], [np.nan], [[0.0]], None, None), r'^arm: time_from_start must be finite, got nan'),
    (([J1], [1.0], [[0.0, 1.0]], None, None), r'^arm: positions must have 1 numbers at each of 1 '
     r'points$'),
    (([J1], [1.0, 2.0], [[0.0], []], None, None), r'^arm: positions must have 1 numbers at each of'
     r' 2 points$'),
    (([J1], [1.0], [[np.nan]], None, None), r'^arm: positions must be finite$'),
    (([J1], [1.0], [[0.0]], [[]], None), r'^arm: velocities must have 1 numbers'),
    (([J1], [1.0], [[0.0]], [[0.0]], [[np.inf]]), r'^arm: accelerations must be finite$'),
    ((['elbow'], [1.0], [[0.0]], None, None), r"^arm has no joint 'elbow'")])
def test_trajectory_that_does_not_fit_is_refused(arm, arguments, message):
    with pytest.raises(CommandError, match=message):
        arm.trajectory(*arguments)


def test_trajectory_needs_position_mode(panda_sim, arm):
    panda_sim.set_control_mode('arm', 'velocity')
    with pytest.raises(CommandError, match=r'^arm follows trajectories in position mode only, it '
                                           r'is in velocity mode$'):
        arm.trajectory([J1], [1.0], [[0.1]], None, None)


def test_twist_is_only_for_bases(arm):
    assert not arm.takes_twist
    with pytest.raises(CommandError, match=r'^arm takes a twist in velocity mode only, it is in '
                                           r'position mode$'):
        arm.twist(0.0, 0.0, 0.0)


def test_command_for_joints_of_several_parts_is_split(panda_sim, run):
    goals = panda_sim.joint_command({'gripper0_right_finger_joint1': 0.01, J1: 0.2})
    assert {goal.part for goal in goals} == {'arm', 'right/gripper'}
    for goal in goals:
        panda_sim.apply(goal)
    run(panda_sim, 1.0)
    assert panda_sim.data.joint(J1).qpos[0] == pytest.approx(0.2, abs=1e-3)


@pytest.mark.parametrize(('names', 'fields', 'message'), [
    ([], ([], [], []), r'^joint_command: no joint is named$'),
    (['elbow'], ([0], [], []), r"^no joint 'elbow' can be commanded: .*available: robot0_joint1"),
    ([J1], ([0, 1], [], []), r'^joint_command: position must have 1 numbers or none, got 2$'),
    ([J1], ([0], [0], []), r'^joint_command: no part of it is in velocity mode, leave the field '
     r'velocity empty$')])
def test_command_for_several_parts_that_does_not_fit_is_refused(panda_sim, names, fields, message):
    with pytest.raises(CommandError, match=message):
        panda_sim.split_joint_command(names, *fields)


def test_parts_in_different_modes_each_take_their_field(panda_sim):
    panda_sim.set_control_mode('arm', 'velocity')
    finger = 'gripper0_right_finger_joint1'
    arm, gripper = panda_sim.split_joint_command([J1, finger], [np.nan, 0.01], [0.3, np.nan], [])
    np.testing.assert_allclose(arm.values, [0.3])
    np.testing.assert_allclose(gripper.values, [0.01])


@pytest.mark.parametrize('joint', range(7))
def test_step_command_does_not_exceed_the_velocity_limit_by_much(panda_sim, arm, run, joint):
    start, speeds = panda_sim.state().position[joint], []
    goal = start + (-1.0 if joint in (1, 5) else 1.0)
    panda_sim.apply(arm.joint_command([panda_sim.joint_names[joint]], [goal], [], []))
    run(panda_sim, 1.5, lambda: speeds.append(abs(panda_sim.state().velocity[joint])))
    assert max(speeds) < 1.15 * panda_sim.model.jnt_user[joint, 0]
    assert panda_sim.state().position[joint] == pytest.approx(goal, abs=1e-2)


def test_drive_of_a_gripper_needs_a_gripper(panda_sim):
    with pytest.raises(ValueError, match=r'^arm is not a gripper$'):
        GripperDrive(panda_sim.model, panda_sim.parts['arm'], 0.002)
