# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of robots with two arms: who commands which joints, and that nobody disturbs another."""

import numpy as np
import pytest

from manip_sim.control.commands import Status
from manip_sim.errors import CommandError

TWO_ARMS = ['Baxter', 'GR1']


@pytest.fixture(params=TWO_ARMS)
def op(request, operator_of):
    """Return an operator of a robot with two arms."""
    return operator_of(request.param)


def goals_of(op, part, offset=0.1):
    """Return goals for all joints of a part, a bit from where they are, within their ranges."""
    model, goals = op.simulation.model, {}
    for name in op.joints_of(part):
        (here,), high = op.where(name), model.joint(name).range[1]
        goals[name] = here + (offset if here + offset < high else -offset)
    return goals


def test_parts_of_two_arms_do_not_overlap_and_arm_is_both(op):
    right, left = op.joints_of('right'), op.joints_of('left')
    assert len(right) == len(left) == 7
    assert set(op.joints_of('arm')) == {*right, *left}
    assert not set(right) & set(left)
    for arm, joints in (('right', right), ('left', left)):
        # What moves the arm's gripper is the arm's.
        body = op.simulation.model.body(op.simulation.robot.robot_model.eef_name[arm]).id
        movers = set()
        while body:
            first = op.simulation.model.body_jntadr[body]
            movers |= {op.simulation.model.joint(first + i).name
                       for i in range(op.simulation.model.body_jntnum[body])}
            body = op.simulation.model.body_parentid[body]
        assert set(joints) <= movers


def test_a_single_arm_is_also_the_right_one(panda_op):
    assert panda_op.joints_of('right') == panda_op.joints_of('arm')
    panda_op.simulation.robot.apply(panda_op.simulation.robot.parse.action('right', [0.1] * 7))
    panda_op.simulation.robot.set_control_mode('right', 'velocity')
    assert panda_op.simulation.robot.joints.mode_of(panda_op.joints_of('arm')[0]) == 'velocity'


@pytest.mark.full
@pytest.mark.parametrize('part', ['right', 'left'])
def test_command_of_one_arm_does_not_move_the_setpoints_of_the_other(op, part):
    other = {'right': 'left', 'left': 'right'}[part]
    before = op.simulation.robot.controller_state(other).reference.position
    goals = goals_of(op, part)
    (handle,) = op.go(goals, part=part)
    op.run(2.0)
    np.testing.assert_array_equal(
        op.simulation.robot.controller_state(other).reference.position, before)
    np.testing.assert_allclose(op.where(*goals), list(goals.values()), atol=2e-3)
    assert handle.status is Status.DONE


def test_two_controllers_of_one_arm_each_give_what_one_of_both_gives(operator_of):
    positions = []
    for together in (True, False):
        op = operator_of('Baxter')
        start = {name: op.where(name)[0] for name in op.joints_of('arm')}
        for k in range(50):
            goals = [{name: start[name] + 0.1 * np.sin(0.1 * k) for name in op.joints_of(part)}
                     for part in ('right', 'left')]
            if together:
                op.go({**goals[0], **goals[1]})
            else:
                # Whose message comes first does not matter.
                for goal, part in sorted(zip(goals, ('right', 'left')),
                                         key=lambda pair: pair[1], reverse=k % 2 == 1):
                    op.go(goal, part=part)
            op.run(0.01)
        positions.append(op.simulation.robot.state().position)
    np.testing.assert_array_equal(*positions)


@pytest.mark.full
def test_arm_reaches_both(op):
    goals = goals_of(op, 'arm')
    (handle,) = op.go(goals, part='arm')
    op.run(2.0)
    np.testing.assert_allclose(op.where(*goals), list(goals.values()), atol=2e-3)
    assert handle.status is Status.DONE


def test_action_of_one_arm_spans_its_ranges_alone(op):
    simulation = op.simulation
    command = simulation.robot.parse.action('left', np.ones(7))
    low, high = np.array([simulation.model.joint(j).range for j in op.joints_of('left')]).T
    np.testing.assert_allclose(command.values, high)
    assert command.parts == {'left'}
    both = simulation.robot.parse.action('arm', np.concatenate([np.ones(7), -np.ones(7)]))
    assert both.parts == {'left', 'right'}
    joints = op.joints_of('arm')
    np.testing.assert_allclose(both.values[7:], [simulation.model.joint(j).range[0]
                                                 for j in joints[7:]])


def test_joint_of_the_other_arm_is_rejected(op):
    joint = op.joints_of('left')[0]
    with pytest.raises(CommandError, match=f"^right has no joint '{joint}' that can be commanded"):
        op.simulation.robot.parse.joint_command([joint], [0.0], part='right')
    with pytest.raises(CommandError, match=f"^right has no joint '{joint}' that can be commanded"):
        op.simulation.robot.parse.trajectory('right', [joint], [1.0], [[0.0]])


def test_modes_and_timeouts_are_those_of_each_arm(op):
    simulation = op.simulation
    simulation.robot.set_control_mode('left', 'velocity')
    modes = simulation.robot.joints.modes_of(simulation.robot.joints.indices_of('arm'))
    assert sorted(modes) == ['position'] * 7 + ['velocity'] * 7
    simulation.robot.set_command_timeout('left', 0.1)
    op.go(goals_of(op, 'right'))
    op.go(dict.fromkeys(op.joints_of('left'), 0.05), 'velocity')
    op.run(0.3)
    joints = simulation.robot.joints
    assert (joints.timeouts['left'], joints.timeouts['right']) == (1, 0)
    simulation.robot.set_control_mode('arm', 'effort')
    assert set(joints.modes_of(joints.indices_of('arm'))) == {'effort'}


@pytest.mark.full
def test_trajectories_of_both_arms_run_side_by_side(op):
    handles, ends = [], {}
    for part in ('right', 'left'):
        goals = goals_of(op, part)
        ends.update(goals)
        handles.append(op.follow(part, list(goals), [1.0], [list(goals.values())]).handle)
        op.run(0.3)
    assert [h.status for h in handles] == [Status.RUNNING] * 2
    op.run(1.2)
    assert [h.status for h in handles] == [Status.DONE] * 2
    np.testing.assert_allclose(op.where(*ends), list(ends.values()), atol=2e-3)


@pytest.mark.full
def test_command_of_the_other_arm_leaves_a_trajectory_alone(op):
    goals = goals_of(op, 'right')
    handle = op.follow('right', list(goals), [1.0], [list(goals.values())]).handle
    op.run(0.5)
    op.go(goals_of(op, 'left'))
    op.run(1.0)
    assert handle.status is Status.DONE
    np.testing.assert_allclose(op.where(*goals), list(goals.values()), atol=2e-3)


@pytest.mark.full
def test_trajectory_gives_up_only_the_joints_that_a_newer_command_names(op):
    goals = goals_of(op, 'arm', 0.2)
    handle = op.follow('arm', list(goals), [1.0], [list(goals.values())]).handle
    op.run(0.5)
    taken = op.joints_of('right')[3]
    (here,) = op.where(taken)
    op.go({taken: here})
    op.run(1.5)
    assert handle.status is Status.DONE
    assert handle.error.shape == (13,)
    expected = {**goals, taken: here}
    np.testing.assert_allclose(op.where(*expected), list(expected.values()), atol=2e-3)


@pytest.mark.full
def test_trajectory_of_one_arm_takes_its_joints_from_one_of_both(op):
    both = goals_of(op, 'arm', 0.2)
    older = op.follow('arm', list(both), [1.0], [list(both.values())]).handle
    op.run(0.3)
    left = goals_of(op, 'left', -0.1)
    newer = op.follow('left', list(left), [0.8], [list(left.values())]).handle
    op.run(1.5)
    assert (older.status, newer.status) == (Status.DONE, Status.DONE)
    expected = {**both, **left}
    np.testing.assert_allclose(op.where(*expected), list(expected.values()), atol=2e-3)


@pytest.mark.full
def test_empty_trajectory_of_one_arm_leaves_the_other(op):
    handles = {}
    for part in ('right', 'left'):
        goals = goals_of(op, part)
        handles[part] = op.follow(part, list(goals), [1.0], [list(goals.values())]).handle
    op.run(0.3)
    op.follow('left', [], [], [])
    assert handles['left'].status is Status.ABORTED
    op.run(1.2)
    assert handles['right'].status is Status.DONE


def test_busy_parts_are_those_that_follow_or_await_a_trajectory(op):
    assert op.simulation.robot.joints.busy_parts == set()
    goals = goals_of(op, 'left')
    op.follow('left', list(goals), [0.5], [list(goals.values())])
    assert op.simulation.robot.joints.busy_parts == {'left'}
    op.run(0.2)
    assert op.simulation.robot.joints.busy_parts == {'left'}
    op.run(0.5)
    assert op.simulation.robot.joints.busy_parts == set()
    later_ns = op.simulation.time_ns + 10**9
    op.follow('left', list(goals), [0.5], [list(goals.values())], start_ns=later_ns)
    assert op.simulation.robot.joints.busy_parts == {'left'}


@pytest.mark.full
@pytest.mark.parametrize('part', ['torso', 'head', 'legs', 'base'])
def test_every_part_follows_a_trajectory(operator_of, part):
    op = operator_of({'torso': 'PandaOmron', 'base': 'PandaOmron'}.get(part, 'GR1'))
    if part not in op.simulation.robot.parts:
        pytest.fail(f'no robot with {part}')
    op.simulation.robot.set_control_mode(part, 'position')
    goals = goals_of(op, part, 0.05)
    handle = op.follow(part, list(goals), [1.0], [list(goals.values())]).handle
    op.run(2.0)
    assert handle.status is Status.DONE
    np.testing.assert_allclose(op.where(*goals), list(goals.values()), atol=3e-3)
