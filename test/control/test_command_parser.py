# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of what makes commands of numbers: validation, clamping, names, modes."""

from contextlib import contextmanager, suppress
import copy
import dataclasses
import itertools

import numpy as np
import pytest

from manip_sim.control.commands import (
    Command, GripperAction, GripperSetpoint, JointSetpoint, NoCommand, Status)
from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.models import compose
from manip_sim.models.world import World
from manip_sim.simulation import Simulation

J1, J2 = 'robot0_joint1', 'robot0_joint2'
FINGER = 'gripper0_right_finger_joint1'
NAN = np.nan


@pytest.fixture
def parse(panda_sim):
    """Return what makes commands for the Panda, whose arm is in position mode."""
    return panda_sim.robot.parse


@pytest.mark.parametrize(('action', 'message'), [
    ([0.0] * 6, r'^arm: an action must have 7 numbers, got 6$'),
    ([], r'^arm: an action must have 7 numbers, got 0$'),
    ([0.0] * 6 + [NAN], r'^arm: an action must be finite, got nan at index 6$'),
    ([-np.inf] + [0.0] * 6, r'^arm: an action must be finite, got -inf at index 0$')])
def test_action_that_does_not_fit_is_rejected(parse, action, message):
    with pytest.raises(CommandError, match=message):
        parse.action('arm', action)


def test_action_for_an_unknown_part_tells_what_there_is(parse):
    with pytest.raises(UnknownNameError, match=r"^unknown part 'left': available: arm, right"):
        parse.action('left', [0.0] * 7)


@pytest.mark.parametrize('part', ['arm', 'right'])
@pytest.mark.parametrize('mode', ['position', 'velocity', 'effort'])
def test_action_spans_the_limits_of_the_mode_and_is_clamped(panda_sim, parse, mode, part):
    panda_sim.robot.set_control_mode(part, mode)
    low, high = panda_sim.robot.joints.ranges(np.arange(7)).T
    goal = parse.action(part, [-1.0, 1.0, 0.0, 5.0, -9.0, 1.0, 1.0])
    assert goal.clamped == 2
    assert goal.modes == (mode,) * 7
    assert goal.parts == {'arm'}
    np.testing.assert_allclose(goal.values, [low[0], high[1], (low[2] + high[2]) / 2.0, high[3],
                                             low[4], high[5], high[6]])


@pytest.mark.parametrize(('names', 'fields', 'message'), [
    ([], {'position': [0.0]}, r'^arm: no joint is named$'),
    ([J1, 'robot0_joint9'], {'position': [0, 0]}, r"^arm has no joint 'robot0_joint9' that can be "
     r"commanded: did you mean 'robot0_joint\d' .*available: robot0_joint1, robot0_joint2"),
    ([J1, FINGER], {'position': [0, 0]}, r"^arm has no joint 'gripper0_right_finger_joint1'"),
    ([J1, J1], {'position': [0, 0]}, r"^arm: joint 'robot0_joint1' is named twice$"),
    ([J1], {'position': [0, 1]}, r'^arm: position must have 1 number, got 2: one for each '),
    ([J1], {'position': [0], 'velocity': [1]}, r"^arm: joint 'robot0_joint1' is in position mode, "
     r'which does not use the field velocity: leave it empty, or NaN for this joint$'),
    ([J1], {'effort': [1]}, r'^arm: effort must have 1 number, got 1: one for each joint$|'
     r"^arm: joint 'robot0_joint1' is in position mode, which does not use the field effort"),
    ([J1, J2], {'position': [0, np.inf]}, r'^arm: position must be finite, got inf at index 1$'),
    ([J1, J2], {'position': [np.inf, -np.inf]}, r'must be finite, got inf at index 0$'),
    ([J1], {'position': [0], 'velocity': [-np.inf]}, r'^arm: velocity must be finite, got -inf'),
    ([J1], {'position': ['0']}, r"^arm: position must be numbers, got \['0'\]$"),
    ([J1, J2], {'position': [0, 'one']}, r'^arm: position must be numbers, got '),
    ([J1], {'position': [1j]}, r'^arm: position must be numbers, got '),
    ([J1, J2], {'position': [[0], [1, 2]]}, r'^arm: position must be numbers, got '),
    ([J1, J2], {'position': [[0, 1]]}, r'^arm: position must have 2 numbers, got '),
    ([J1], {'position': 0.5}, r'^arm: position must have 1 number, got ')])
def test_joint_command_that_does_not_fit_is_rejected(parse, names, fields, message):
    with pytest.raises(CommandError, match=message):
        parse.joint_command(names, **fields, part='arm')


def test_joint_command_without_a_part_is_told_as_such(parse):
    with pytest.raises(CommandError, match=r"^joint_command has no joint 'elbow' that can be "
                                           r'commanded: .*available: robot0_joint1'):
        parse.joint_command(['elbow'], [0.0])


def test_joint_command_is_clamped_and_the_clamps_are_counted(parse):
    (goal,) = parse.joint_command([J2, J1], [-9.0, 0.5])
    assert goal.clamped == 1
    np.testing.assert_allclose(goal.values, [-1.7628, 0.5])


def test_what_is_clamped_is_named_with_its_value_and_its_limit(parse):
    (goal,) = parse.joint_command([J1, J2], [0.5, -9.0])
    assert goal.clamped_example == 'robot0_joint2 from -9 to -1.7628'
    motion = parse.trajectory('arm', [J1, J2], [1.0, 2.0], [[0.0, 0.0], [0.1, 5.0]])
    assert motion.clamped_example == 'robot0_joint2 from 5 to 1.7628'
    action = parse.action('arm', [0.0, 0.5, -3.0, *[0.0] * 4])
    assert action.clamped_example == 'data[2] from -3 to -1'
    assert parse.action('right/gripper', [1.5]).clamped_example == 'data[0] from 1.5 to 1'
    (finger,) = parse.joint_command(['gripper0_right_finger_joint1'], [0.5])
    assert finger.clamped_example == 'gripper0_right_finger_joint1 from 0.5 to 0.04'
    assert parse.joint_command([J1], [0.5])[0].clamped_example == ''


@pytest.mark.parametrize(('mode', 'limit'), [('velocity', 2.175), ('effort', 87.0)])
def test_velocity_and_effort_are_clamped_to_the_data_sheet(panda_sim, parse, mode, limit):
    panda_sim.robot.set_control_mode('arm', mode)
    for sign in (-1.0, 1.0):
        (goal,) = parse.joint_command([J1], **{mode: [sign * 1e9]})
        np.testing.assert_allclose(goal.values, [sign * limit])
        assert goal.clamped == 1


def test_position_of_an_unlimited_joint_is_not_clamped(one_joint_arm, run):
    robot = one_joint_arm()
    robot.spec.joint('joint1').limited = 0
    simulation = Simulation(World([robot]))
    (goal,) = simulation.robot.parse.joint_command([J1], [9.0])
    assert (goal.clamped, list(goal.values)) == (0, [9.0])
    simulation.robot.apply(goal)
    run(simulation, 4.0)
    assert simulation.robot.state().position[0] == pytest.approx(9.0, abs=1e-3)


def test_nan_is_no_command_for_a_joint(panda_sim, parse, run):
    start = panda_sim.robot.state().position
    (goal,) = parse.joint_command([J1, J2], [NAN, 0.3], velocity=[NAN, NAN])
    assert list(goal.indices) == [1]
    panda_sim.robot.apply(goal)
    run(panda_sim, 1.0)
    np.testing.assert_allclose(panda_sim.robot.state().position[:7], [start[0], 0.3, *start[2:7]],
                               atol=1e-3)


def test_joints_of_one_part_in_different_fields_each_take_the_one_of_their_mode(panda_sim, parse):
    panda_sim.robot.set_control_mode('arm', 'velocity')
    joint, finger = parse.joint_command([J1, FINGER], [NAN, 0.01], [0.3, NAN])
    assert (type(joint), type(finger)) == (JointSetpoint, GripperSetpoint)
    assert joint.modes == ('velocity',)
    np.testing.assert_allclose(joint.values, [0.3])
    np.testing.assert_allclose(finger.values, [0.01])


def test_field_may_have_numbers_of_the_joints_that_use_it_alone(panda_sim, parse):
    panda_sim.robot.set_control_mode('arm', 'velocity')
    joint, finger = parse.joint_command([J1, FINGER, J2], [0.01], [0.3, -0.2])
    assert joint.indices.tolist() == [0, 1]
    np.testing.assert_allclose(joint.values, [0.3, -0.2])
    np.testing.assert_allclose(finger.values, [0.01])


def test_field_with_too_few_numbers_is_rejected(panda_sim, parse):
    with pytest.raises(CommandError, match=r'^joint_command: position must have 3 numbers, got '
                                           r'2: one for each joint$'):
        parse.joint_command([J1, J2, 'robot0_joint3'], [0.1, 0.2])


def test_rejected_command_changes_nothing(panda_sim, parse, run):
    start = panda_sim.robot.state().position
    with pytest.raises(CommandError):
        parse.joint_command([J1, J2], [0.5, np.inf])
    run(panda_sim, 0.3)
    np.testing.assert_allclose(panda_sim.robot.state().position, start, atol=1e-6)


def test_command_for_some_joints_leaves_the_others(panda_sim, parse, run):
    start = panda_sim.robot.state().position
    panda_sim.robot.apply(*parse.joint_command([J2], [0.3]))
    run(panda_sim, 0.2)
    panda_sim.robot.apply(*parse.joint_command([J1], [0.4]))
    run(panda_sim, 1.0)
    np.testing.assert_allclose(panda_sim.robot.state().position[:7],
                               [0.4, 0.3, *start[2:7]], atol=1e-3)


def test_command_for_joints_of_several_parts_moves_them_all(panda_sim, parse, run):
    goals = parse.joint_command([FINGER, J1, FINGER.replace('1', '2')], [0.01, 0.2, -0.01])
    assert {part for goal in goals for part in goal.parts} == {'arm', 'right/gripper'}
    panda_sim.robot.apply(*goals)
    run(panda_sim, 1.0)
    assert panda_sim.data.joint(J1).qpos[0] == pytest.approx(0.2, abs=1e-3)
    assert panda_sim.data.joint(FINGER).qpos[0] == pytest.approx(0.01, abs=1e-3)


def test_what_commands_for_the_same_joints_share_cannot_be_changed(parse):
    first, second = (parse.joint_command([J1, FINGER], position=[0.1, 0.01]) for _ in range(2))
    for one, other in zip(first, second):
        assert one.indices is other.indices and one.values is not other.values
        with pytest.raises(ValueError, match='read-only'):
            one.indices[0] = 5


def test_equal_numbers_make_commands_that_are_told_apart(parse):
    for make in (lambda: parse.action('arm', [0.5] * 7),
                 lambda: parse.action('right/gripper', [1.0]),
                 lambda: parse.joint_command([J1], position=[0.1])[0],
                 lambda: parse.joint_command([FINGER], position=[0.01])[0],
                 lambda: parse.trajectory('arm', [J1], [1.0], [[0.1]])):
        first, second = make(), make()
        assert first == first and first != second
        assert {first: 'first', second: 'second'}[first] == 'first'


def test_what_a_command_holds_is_given_by_name_alone():
    kinds = [Command]
    for kind in kinds:
        kinds += kind.__subclasses__()
        with pytest.raises(TypeError, match='takes 1 positional argument but 2 were given'):
            kind(frozenset({'arm'}))
    assert {GripperAction, GripperSetpoint, JointSetpoint} < set(kinds)


def test_the_same_names_mean_something_else_in_another_mode(panda_sim, parse):
    (goal,) = parse.joint_command([J1, J2], position=[9.0, 9.0])
    panda_sim.robot.set_control_mode('arm', 'velocity')
    with pytest.raises(CommandError, match='is in velocity mode, which does not use'):
        parse.joint_command([J1, J2], position=[9.0, 9.0])
    (speed,) = parse.joint_command([J1, J2], velocity=[9.0, 9.0])
    assert (goal.modes, speed.modes) == (('position',) * 2, ('velocity',) * 2)
    np.testing.assert_array_equal(speed.values, panda_sim.robot.limits('arm')[:2, 1])
    assert (goal.values != speed.values).all()


@contextmanager
def changing_at_each_look(joints, modes):
    """Let joints change between two modes each time somebody looks at them."""
    looks = itertools.count()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(type(joints), 'modes', property(
            lambda _: (modes[next(looks) % 2],) * len(joints.names)), raising=False)
        yield


@pytest.mark.parametrize('modes', [
    ('position', 'velocity'), ('velocity', 'position'), ('effort', 'velocity')])
@pytest.mark.parametrize('goals', [[900.0, 900.0], [NAN, 900.0]])
def test_goals_keep_to_one_mode_though_it_changes_while_they_are_read(
        panda_sim, parse, modes, goals):
    joints, commands = panda_sim.robot.joints, []
    names, highest = joints.names[:2], {}
    for mode in modes:
        panda_sim.robot.set_control_mode('arm', mode)
        highest[mode] = joints.clamps(np.arange(2))[1, 1]
    with changing_at_each_look(joints, modes):
        for field in modes * 4:
            try:
                commands += parse.joint_command(names, **{field: goals})
            except CommandError as error:
                assert 'mode, which does not use the field' in str(error)
            commands.append(parse.action('arm', np.ones(7)))
    # What the parser keeps of these lists of names must not be wrong for ever.
    for mode in modes:
        panda_sim.robot.set_control_mode('arm', mode)
        commands += parse.joint_command(names, **{mode: goals})
        assert commands[-1].modes[0] == mode
    assert len(commands) > 10
    for command in commands:
        assert len(set(command.modes)) == 1
        assert command.values[list(command.indices).index(1)] == highest[command.modes[0]]


@pytest.mark.parametrize('modes', [('position', 'velocity'), ('velocity', 'position')])
def test_trajectories_and_twists_keep_to_one_mode_though_it_changes_while_they_are_read(modes):
    robot = Simulation(compose('PandaOmron')).robot
    position = robot.joints.clamps(robot.joints.find([J1]))[0, 1]
    robot.set_control_mode('base', 'velocity')
    speed = robot.joints.clamps(robot.joints.twist_indices)[0, 1]
    trajectories, twists = [], []
    with changing_at_each_look(robot.joints, modes):
        for _ in range(6):
            with suppress(CommandError):
                twists.append(robot.parse.twist(90.0, 0.0, 0.0))
            with suppress(CommandError):
                trajectories.append(robot.parse.trajectory('arm', [J1], [5.0], [[90.0]]))
            robot.joints.modes  # noqa: B018 - so that both meet both modes.
    assert {command.trajectory.positions[-1, 0] for command in trajectories} == {position}
    assert {command.twist[0] for command in twists} == {speed}


@pytest.mark.parametrize('mode', ['velocity', 'effort'])
def test_command_that_was_meant_for_another_mode_is_aborted(panda_sim, parse, run, mode):
    (goal,) = parse.joint_command([J1], [0.5])
    motion = parse.trajectory('arm', [J1], [0.2], [[0.5]])
    panda_sim.robot.set_control_mode('arm', mode)
    panda_sim.robot.apply(goal, motion)
    run(panda_sim, 0.3)
    assert abs(panda_sim.robot.state().position[0]) < 1e-6
    for command in (goal, motion):
        assert command.handle.status is Status.ABORTED
        assert command.handle.reason == 'the control mode has changed'


def test_of_a_command_only_the_joints_whose_mode_changed_are_lost(panda_sim, parse, run):
    start = panda_sim.robot.state().position
    (goal,) = parse.joint_command([J1, FINGER], [0.4, 0.01])[:1]
    both = dataclasses.replace(goal, indices=np.array([0, 1]), values=np.array([0.4, 0.3]),
                               modes=('position', 'velocity'))
    panda_sim.robot.apply(both)
    run(panda_sim, 1.0)
    assert both.handle.status is Status.DONE
    np.testing.assert_allclose(panda_sim.robot.state().position[:2], [0.4, start[1]], atol=1e-3)


@pytest.mark.parametrize(('arguments', 'message'), [
    (([J1], [-1.0], [[0.0]]), r'^time_from_start must not be negative and must increase from '
     r'point to point, got -1 s at point 0$'),
    (([J1], [1.0, 1.0], [[0], [0]]), r'must increase .*got 1 s at point 1 after 1 s$'),
    (([J1], [NAN], [[0.0]]), r'^arm: time_from_start must be finite, got nan'),
    (([J1], [1.0], [[0.0, 1.0]]), r'^arm: positions must have 1 number at each of 1 point$'),
    (([J1], [1.0, 2.0], [[0.0], []]), r'^arm: positions must have 1 number at each of 2 points'),
    (([J1], [1.0], [[NAN]]), r'^arm: positions must be finite$'),
    (([J1], [1.0], [[0.0]], [[]]), r'^arm: velocities must have 1 number'),
    (([J1], [1.0], [[0.0]], [[0.0]], [[np.inf]]), r'^arm: accelerations must be finite$'),
    (([J1], [1.0], [[0.0]], None, [[0.0]]), r'^arm: accelerations need velocities$'),
    (([], [1.0], [[]]), r'^arm: no joint is named$'),
    (([J1, J1], [1.0], [[0.0, 0.0]]), r"^arm: joint 'robot0_joint1' is named twice$"),
    ((['elbow'], [1.0], [[0.0]]), r"^arm has no joint 'elbow'"),
    ((['elbow'], [], []), r"^arm has no joint 'elbow'"),
    (([J1], np.arange(1.0, 10_002.0), np.zeros((10_001, 1))),
     r'^arm: a trajectory may have at most 10000 points, got 10001$')])
def test_trajectory_that_does_not_fit_is_rejected(parse, arguments, message):
    with pytest.raises(CommandError, match=message):
        parse.trajectory('arm', *arguments)


def test_gripper_takes_no_trajectory(parse):
    with pytest.raises(UnknownNameError, match=r"^unknown part 'right/gripper': .*arm, right$"):
        parse.trajectory('right/gripper', [FINGER], [1.0], [[0.01]])


def test_trajectory_needs_position_mode(panda_sim, parse):
    panda_sim.robot.set_control_mode('arm', 'velocity')
    with pytest.raises(CommandError, match='^arm follows trajectories in position or impedance '
                                           "mode only, joint 'robot0_joint1' is in velocity "
                                           'mode$'):
        parse.trajectory('arm', [J1], [1.0], [[0.1]])


def test_twist_is_only_for_bases(parse):
    with pytest.raises(CommandError, match=r'^base: this robot has no base that takes a twist$'):
        parse.twist(0.0, 0.0, 0.0)


def test_commands_are_told_apart_by_identity_and_not_by_what_they_say(panda_sim):
    robot = panda_sim.robot
    x = np.array([0.0, 0.0, 0.0, 1.0])
    commands = [*robot.parse.joint_command([J1], position=[0.1]),
                robot.parse.action('right/gripper', [1.0]),
                robot.parse_cartesian.pose('right', np.zeros(3), x, '')]
    assert len({type(command) for command in commands}) == 3
    for command in commands:
        assert copy.copy(command) != command == command


def trajectory_of(simulation, times_s, positions, start_s=0.0, names=(J1,)):
    """Return the command for a trajectory that is parsed at ten seconds."""
    return simulation.robot.parse.trajectory(
        'arm', list(names), times_s, positions, start_ns=round(start_s * 1e9), now_ns=10**10)


@pytest.mark.parametrize(('start_s', 'time_s', 'slowed', 'kept'), [
    (9.5, 2.0, False, True), (9.5, 0.51, True, False), (10.5, 0.01, True, True),
    (10.5, 2.0, False, True), (10.0, 0.01, True, True)])
def test_a_trajectory_begins_now_if_it_is_under_way_and_has_to_be_slowed_down(
        panda_sim, start_s, time_s, slowed, kept):
    command = trajectory_of(panda_sim, [time_s], [[1.0]], start_s)
    assert (command.slowed > 1.0) == slowed
    assert command.start_ns == (round(start_s * 1e9) if kept else 0)


def test_a_trajectory_may_begin_in_an_hour_and_not_later(panda_sim):
    assert trajectory_of(panda_sim, [1.0], [[0.1]], 3609.9).start_ns == 3_609_900_000_000
    with pytest.raises(CommandError, match='would start in 3600 s'):
        trajectory_of(panda_sim, [1.0], [[0.1]], 3610.1)


def test_a_trajectory_has_not_ended_before_its_last_point(panda_sim):
    assert trajectory_of(panda_sim, [0.2, 2.0], [[0.1], [0.2]], 9.5).start_ns == 9_500_000_000


def test_a_trajectory_may_have_ten_thousand_points(panda_sim):
    command = trajectory_of(panda_sim, 0.01 * np.arange(1.0, 10_001.0), np.zeros((10_000, 1)))
    assert len(command.trajectory.times_s) == 10_000


def test_a_trajectory_is_slowed_down_a_thousand_times_at_most(panda_sim):
    whole = 0.01 * trajectory_of(panda_sim, [0.01], [[1.0]]).slowed
    slowed = trajectory_of(panda_sim, [whole / 999.9], [[1.0]]).slowed
    assert slowed == pytest.approx(999.9)
    with pytest.raises(CommandError, match='would have to move'):
        trajectory_of(panda_sim, [whole / 1000.1], [[1.0]])


def test_the_joint_that_is_farthest_above_its_own_limit_is_told(panda_sim):
    # The limit of the last joint is 2.61 rad/s.
    here = float(panda_sim.data.joint('robot0_joint7').qpos[0])
    with pytest.raises(CommandError, match="'robot0_joint1' would .* its limit is 2.175$"):
        trajectory_of(panda_sim, [1e-4], [[1.0, here + 1.1]], names=[J1, 'robot0_joint7'])


@pytest.mark.parametrize('names, fields, parts', [
    ([J1], {}, {'arm'}),
    ([J1, J2], {'position': [NAN, NAN]}, {'arm'}),
    ([J1, J2], {'position': [], 'velocity': [NAN]}, {'arm'}),
    ([J1, FINGER], {'position': [NAN, NAN], 'effort': [NAN, NAN]}, {'arm', 'right/gripper'})])
def test_names_without_a_number_are_no_command_for_their_parts(panda_sim, names, fields, parts):
    robot = panda_sim.robot
    (command,) = robot.parse.joint_command(names, **fields)
    assert type(command) is NoCommand and command.parts == parts
    panda_sim.advance(5)
    robot.apply(command)
    assert command.handle.status is Status.DONE
    assert robot.resting


@pytest.mark.parametrize('fields', [{}, {'position': []}, {'position': [NAN], 'effort': [NAN]}])
def test_a_message_of_nothing_is_no_command_at_all(panda_sim, fields):
    assert panda_sim.robot.parse.joint_command([], **fields) == []


def test_a_part_without_a_number_beside_one_that_has_some_gets_no_command(panda_sim):
    first, second = panda_sim.robot.parse.joint_command(
        [J1, FINGER, J2], position=[0.1, NAN, NAN])
    assert (type(first), first.parts) == (JointSetpoint, {'arm'})
    assert (type(second), second.parts) == (NoCommand, {'right/gripper'})
