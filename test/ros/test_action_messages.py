# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Messages of actions to goals and back, with plain objects that have the fields of the types."""

from types import SimpleNamespace as Plain

from builtin_interfaces.msg import Duration
import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint, MultiDOFJointTrajectory

from manip_sim.interface.topics import actions_of
from manip_sim.models import compose
from manip_sim.ros.action_servers import (
    GripperMessages, messages_of, ParallelGripperMessages, TrajectoryMessages)
from manip_sim.runtime.action_goals import GoalCode, GoalError
from manip_sim.simulation import Simulation

J1, J2 = 'robot0_joint1', 'robot0_joint2'
FINGER = 'gripper0_right_finger_joint1'
FOLLOW = Plain(Feedback=lambda: Plain(header=Header()), Result=Plain)
GRIP = Plain(Feedback=Plain, Result=Plain)
PARALLEL = Plain(Feedback=lambda: Plain(state=JointState()),
                 Result=lambda: Plain(state=JointState()))
TYPES = Plain(FollowJointTrajectory=FOLLOW, GripperCommand=GRIP, ParallelGripperCommand=PARALLEL)


@pytest.fixture
def simulation():
    return Simulation(compose('Panda'))


def messages(simulation, kind, action_type, part):
    return kind(action_type, simulation.robot, part, lambda: simulation.time_ns)


@pytest.fixture
def follow(simulation):
    return messages(simulation, TrajectoryMessages, FOLLOW, 'arm')


@pytest.fixture
def grip(simulation):
    return messages(simulation, GripperMessages, GRIP, 'right/gripper')


@pytest.fixture
def parallel(simulation):
    return messages(simulation, ParallelGripperMessages, PARALLEL, 'right/gripper')


def trajectory(names=(J1,), positions=(0.3,), **point):
    return JointTrajectory(joint_names=list(names), points=[JointTrajectoryPoint(
        positions=list(positions), time_from_start=Duration(nanosec=500_000_000), **point)])


def request(**fields):
    return Plain(**{'trajectory': trajectory(), 'multi_dof_trajectory': MultiDOFJointTrajectory(),
                    'path_tolerance': [], 'goal_tolerance': [],
                    'goal_time_tolerance': Duration(), **fields})


def tolerance(joint=J1, position=0.0, velocity=0.0, acceleration=0.0):
    return Plain(name=joint, position=position, velocity=velocity, acceleration=acceleration)


def run(simulation, goal, seconds=5.0):
    simulation.robot.apply(goal.command, period_s=0.01)
    for _ in range(round(seconds * 100)):
        simulation.advance(5)
        goal.check(simulation)
        if goal.outcome is not None:
            break


def test_trajectory_is_followed_and_its_end_told(simulation, follow):
    goal = follow.goal_of(request(trajectory=trajectory((J2, J1), (0.4, 0.3))))
    run(simulation, goal)
    result = follow.result_of(goal)
    assert (result.error_code, result.error_string) == (0, 'the goal is reached')
    where = [float(simulation.data.joint(joint).qpos[0]) for joint in (J2, J1)]
    np.testing.assert_allclose(where, [0.4, 0.3], atol=1e-3)


def test_feedback_tells_desired_actual_and_their_difference(simulation, follow):
    goal = follow.goal_of(request(trajectory=trajectory((J2, J1), (0.4, 0.3))))
    assert follow.feedback_of(goal).joint_names == [J2, J1]
    run(simulation, goal, 0.25)
    feedback = follow.feedback_of(goal)
    assert feedback.header.stamp.nanosec == simulation.time_ns
    actual = [float(simulation.data.joint(joint).qpos[0]) for joint in (J2, J1)]
    np.testing.assert_array_equal(feedback.actual.positions, actual)
    assert feedback.desired.positions[1] == pytest.approx(0.15, abs=0.02)
    assert feedback.desired.velocities[1] > 0.5 and len(feedback.desired.accelerations) == 2
    np.testing.assert_allclose(np.array(feedback.desired.positions) - actual,
                               feedback.error.positions)
    np.testing.assert_allclose(
        np.subtract(feedback.desired.velocities, feedback.actual.velocities),
        feedback.error.velocities)


@pytest.mark.parametrize(('past_s', 'seen'), [(0.0, {0, 1, 2}), (0.15, {1, 2})])
def test_feedback_has_the_index_of_the_point_that_the_trajectory_goes_to(
        simulation, past_s, seen):
    # As control_msgs has it since version 6.3.
    follow = messages(simulation, TrajectoryMessages, Plain(
        Feedback=lambda: Plain(header=Header(), index=-1), Result=Plain), 'arm')
    simulation.advance(100)
    times_s, sent, indices = (0.1, 0.3, 0.5), JointTrajectory(joint_names=[J1]), []
    sent.points = [JointTrajectoryPoint(positions=[0.1 * time_s], time_from_start=Duration(
        nanosec=round(time_s * 1e9))) for time_s in times_s]
    if past_s:
        sent.header.stamp.nanosec = simulation.time_ns - round(past_s * 1e9)
    goal = follow.goal_of(request(trajectory=sent))
    simulation.robot.apply(goal.command, period_s=0.01)
    while goal.outcome is None:
        simulation.advance(5)
        goal.check(simulation)
        indices.append(follow.feedback_of(goal).index)
        since_s = past_s + 0.01 * len(indices)
        if min(abs(since_s - at_s) for at_s in times_s) > 0.011:
            assert indices[-1] == min(sum(at_s < since_s for at_s in times_s), 2), since_s
    assert set(indices) == seen


@pytest.mark.parametrize('field', ['path_tolerance', 'goal_tolerance'])
def test_tolerances_and_their_time_are_those_of_the_message(simulation, follow, field):
    simulation.data.qfrc_applied[0] = -20.0
    goal = follow.goal_of(request(**{field: [tolerance(position=1e-6)]},
                                  goal_time_tolerance=Duration(nanosec=250_000_000)))
    run(simulation, goal)
    result = follow.result_of(goal)
    if field == 'path_tolerance':
        assert result.error_code == GoalCode.PATH_TOLERANCE_VIOLATED
    else:
        assert result.error_code == GoalCode.GOAL_TOLERANCE_VIOLATED
        assert goal.view.time_ns == pytest.approx(750_000_000, abs=10_000_001)
    assert J1 in result.error_string


def test_velocity_tolerance_is_not_taken_for_one_of_position(simulation, follow):
    goal = follow.goal_of(request(path_tolerance=[tolerance(velocity=1e-9)]))
    run(simulation, goal)
    assert 'the velocity of joint' in follow.result_of(goal).error_string


@pytest.mark.parametrize(('fields', 'code', 'text'), [
    ({'trajectory': trajectory(['elbow'])}, 'INVALID_JOINTS', "no joint 'elbow'"),
    ({'trajectory': trajectory(positions=[0.1, 0.2])}, 'INVALID_GOAL', 'must have 1 number'),
    ({'trajectory': trajectory(effort=[1.0])}, 'INVALID_GOAL', 'not supported in trajectories'),
    ({'trajectory': JointTrajectory(joint_names=[J1])}, 'INVALID_GOAL', 'at least one point'),
    ({'multi_dof_trajectory': MultiDOFJointTrajectory(joint_names=['base'])}, 'INVALID_GOAL',
     'leave multi_dof_trajectory empty'),
    ({'component_goal_tolerance': [Plain()]}, 'INVALID_GOAL',
     'leave component_goal_tolerance empty'),
    ({'path_tolerance': [tolerance('elbow')]}, 'INVALID_JOINTS', "the joint 'elbow'"),
    ({'path_tolerance': [tolerance(acceleration=-2.0)]}, 'INVALID_GOAL', 'got -2'),
    ({'goal_time_tolerance': Duration(sec=-2)}, 'INVALID_GOAL', 'got -2 s')])
def test_goal_that_cannot_be_is_rejected_with_its_code(follow, fields, code, text):
    with pytest.raises(GoalError, match=text) as error:
        follow.goal_of(request(**fields))
    assert error.value.code is GoalCode[code]


def test_stamp_that_is_past_is_of_an_old_trajectory(simulation, follow):
    simulation.advance(1000)
    old = trajectory()
    old.header.stamp.nanosec = 1000
    with pytest.raises(GoalError, match='ended 1.500 s ago') as error:
        follow.goal_of(request(trajectory=old))
    assert error.value.code is GoalCode.OLD_HEADER_TIMESTAMP


def test_gripper_command_is_told_where_the_first_driven_joint_is(simulation, grip):
    goal = grip.goal_of(Plain(command=Plain(position=0.03, max_effort=9.0)))
    assert (goal.command.joints, goal.command.max_effort) == ((FINGER,), 9.0)
    assert vars(grip.feedback_of(goal)) == {}
    run(simulation, goal, 0.1)
    feedback = grip.feedback_of(goal)
    assert feedback.position == float(simulation.data.joint(FINGER).qpos[0])
    assert feedback.reached_goal is False and feedback.stalled is False
    run(simulation, goal)
    result = grip.result_of(goal)
    assert result.position == pytest.approx(0.03, abs=1e-3)
    assert result.effort == simulation.efforts.values[simulation.model.joint(FINGER).dofadr[0]]
    # The type support takes nothing but Python's own True for true.
    assert result.reached_goal is True and result.stalled is False


def test_parallel_gripper_command_is_a_joint_state_of_one_joint(simulation, parallel):
    goal = parallel.goal_of(Plain(command=JointState(
        name=[FINGER], position=[0.03], velocity=[0.02], effort=[7.0])))
    assert (goal.command.max_effort, goal.command.max_velocity) == (7.0, 0.02)
    assert parallel.feedback_of(goal).state == JointState()
    run(simulation, goal)
    result, feedback = parallel.result_of(goal), parallel.feedback_of(goal)
    assert result.reached_goal is True and result.stalled is False
    assert result.state == feedback.state
    assert result.state.name == [FINGER]
    assert result.state.position[0] == pytest.approx(0.03, abs=1e-3)
    assert result.state.header.stamp.nanosec == simulation.time_ns % 10**9


def test_parallel_gripper_command_needs_a_position_only(parallel):
    goal = parallel.goal_of(Plain(command=JointState(position=[0.01])))
    assert goal.command.joints == (FINGER,)
    assert (goal.command.max_effort, goal.command.max_velocity) == (0.0, 0.0)


@pytest.mark.parametrize(('command', 'code', 'text'), [
    (JointState(), 'INVALID_GOAL', 'command.position must have one element, got 0'),
    (JointState(position=[0.0, 0.0]), 'INVALID_GOAL', 'must have one element, got 2'),
    (JointState(position=[0.0], effort=[1.0, 1.0]), 'INVALID_GOAL',
     'command.effort must have one element or none, got 2'),
    (JointState(position=[0.0], effort=[-1.0]), 'INVALID_GOAL', 'max_effort must be finite'),
    (JointState(position=[0.0], name=['thumb']), 'INVALID_JOINTS', "no joint 'thumb'")])
def test_parallel_gripper_command_that_cannot_be_is_rejected(parallel, command, code, text):
    with pytest.raises(GoalError, match=text) as error:
        parallel.goal_of(Plain(command=command))
    assert error.value.code is GoalCode[code]


@pytest.mark.parametrize('robot', ['Panda', 'Baxter', 'PandaOmron', 'GR1'])
@pytest.mark.parametrize('gripper', ['default', 'VacuumGripper', 'WipingGripper'])
def test_a_robot_has_the_actions_of_the_table(robot, gripper):
    simulated = Simulation(compose(robot, gripper=gripper)).robot
    found = [f'{m.part}/{m.name}' for m in messages_of(TYPES, simulated, lambda: 0)]
    assert sorted(found) == sorted(a.name for a in actions_of(simulated.parts))
    grippers = 0 if gripper == 'WipingGripper' else 2 * len(simulated.grippers)
    assert sum('gripper_cmd' in name for name in found) == grippers
    assert 'arm/follow_joint_trajectory' in found and 'right/follow_joint_trajectory' in found


def test_older_versions_of_the_package_have_no_parallel_gripper_command(simulation):
    types = Plain(FollowJointTrajectory=FOLLOW, GripperCommand=GRIP)
    found = messages_of(types, simulation.robot, lambda: 0)
    assert [m.name for m in found] == ['follow_joint_trajectory'] * 2 + ['gripper_cmd']
