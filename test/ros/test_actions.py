# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The actions of control_msgs in a running node, as MoveIt's controller manager calls them."""

from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Duration
from harness import Served
import mujoco
import pytest
from rclpy.action import ActionClient, get_action_names_and_types
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectoryPoint

from manip_sim.interface.topics import actions_of

pytest.importorskip('control_msgs', reason='the optional package control_msgs is not installed')

from control_msgs.action import (  # noqa: E402
    FollowJointTrajectory, GripperCommand, ParallelGripperCommand)
from control_msgs.msg import JointTolerance  # noqa: E402

from manip_sim.runtime.action_goals import GoalCode  # noqa: E402

J1 = 'robot0_joint1'
FINGER = 'gripper0_right_finger_joint1'


@pytest.fixture(scope='module')
def served():
    node = Served({'arena': 'table'})
    yield node.node
    node.close()


@pytest.fixture
def run(client):
    """Return a function that sends a goal and returns status, result and feedbacks."""
    def wait(future):
        client.spin_until(future.done)
        return future.result()

    def send(action_type, name, goal, cancel_after=None):
        action = ActionClient(client.node, action_type, name)
        clients.append(action)
        client.spin_until(action.server_is_ready)
        told = []
        handle = wait(action.send_goal_async(goal, lambda m: told.append(m.feedback)))
        if not handle.accepted:
            return None, None, told
        if cancel_after is not None:
            client.spin_until(lambda: len(told) >= cancel_after)
            wait(handle.cancel_goal_async())
        answer = wait(handle.get_result_async())
        return answer.status, answer.result, told
    clients = []
    yield send
    for action in clients:
        action.destroy()


def trajectory(position=0.3, joint=J1, **fields):
    goal = FollowJointTrajectory.Goal(**fields)
    goal.trajectory.joint_names = [joint]
    goal.trajectory.points = [JointTrajectoryPoint(
        positions=[position], time_from_start=Duration(nanosec=500_000_000))]
    return goal


def gripper(position, max_effort=0.0):
    goal = GripperCommand.Goal()
    goal.command.position, goal.command.max_effort = position, max_effort
    return goal


def follow(run, goal, part='arm', **more):
    return run(FollowJointTrajectory, f'{part}/follow_joint_trajectory', goal, **more)


def test_the_codes_are_those_of_the_package():
    result = FollowJointTrajectory.Result
    for code in GoalCode:
        assert code == getattr(result, code.name)


def test_the_node_has_the_actions_of_the_table_with_their_types(served, client):
    expected = {f'/{action.name}': [action.type.replace('/', '/action/')]
                for action in actions_of(served.simulation.robot.parts)}
    client.spin_until(lambda: {
        name: types for name, types in get_action_names_and_types(client.node)
        if not types[0].startswith('simulation_interfaces/')} == expected)


@pytest.mark.parametrize('part', ['arm', 'right'])
def test_trajectory_is_followed_with_feedback(run, served, part):
    target = {'arm': 0.3, 'right': 0.0}[part]
    status, result, told = follow(run, trajectory(target), part)
    assert (status, result.error_code) == (GoalStatus.STATUS_SUCCEEDED, 0)
    assert served.simulation.data.joint(J1).qpos[0] == pytest.approx(target, abs=1e-3)
    assert told[0].joint_names == [J1] and len(told[0].actual.positions) == 1


@pytest.mark.parametrize(('fields', 'code'), [
    ({'path_tolerance': [JointTolerance(name=J1, position=1e-9)]}, 'PATH_TOLERANCE_VIOLATED'),
    ({'goal_tolerance': [JointTolerance(name=J1, position=1e-14)],
      'goal_time_tolerance': Duration(nanosec=100_000_000)}, 'GOAL_TOLERANCE_VIOLATED')])
def test_violated_tolerance_aborts(run, served, fields, code):
    status, result, _ = follow(run, trajectory(0.2, **fields))
    assert (status, result.error_code) == (GoalStatus.STATUS_ABORTED, GoalCode[code])
    assert J1 in result.error_string


def test_goal_that_cannot_be_is_rejected(run, served):
    assert follow(run, trajectory(joint='elbow'))[0] is None


def test_goal_can_be_cancelled(run, served):
    status, _, told = follow(run, trajectory(-0.4), cancel_after=2)
    assert status == GoalStatus.STATUS_CANCELED and len(told) >= 2


def test_gripper_reaches_positions_and_stalls_at_what_it_holds(run, served):
    status, result, told = run(GripperCommand, 'right/gripper/gripper_cmd', gripper(0.04))
    assert status == GoalStatus.STATUS_SUCCEEDED
    assert result.reached_goal and not result.stalled and told

    def hold_the_cube():
        model, data = served.simulation.model, served.simulation.data
        model.body_gravcomp[model.body('cube').id] = 1.0
        cube = data.joint(int(model.body('cube').jntadr[0]))
        site = data.site('gripper0_right_grip_site')
        cube.qpos[:3], cube.qvel[:] = site.xpos, 0.0
        mujoco.mju_mat2Quat(cube.qpos[3:], site.xmat)
    served.thread.call(hold_the_cube)
    status, result, _ = run(GripperCommand, 'right/gripper/gripper_cmd', gripper(0.0, 15.0))
    assert status == GoalStatus.STATUS_SUCCEEDED
    assert result.stalled and not result.reached_goal
    assert result.position == pytest.approx(0.025, abs=1e-3)
    assert result.effort == pytest.approx(-15.0, rel=0.02)


def test_parallel_gripper_command_moves_the_same_fingers(run, served):
    goal = ParallelGripperCommand.Goal(command=JointState(name=[FINGER], position=[0.035]))
    status, result, told = run(
        ParallelGripperCommand, 'right/gripper/parallel_gripper_cmd', goal)
    assert status == GoalStatus.STATUS_SUCCEEDED and result.reached_goal
    assert result.state.name == [FINGER]
    assert result.state.position[0] == pytest.approx(0.035, abs=1e-3)
    assert told[0].state.name == [FINGER]
