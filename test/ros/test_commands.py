# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What commands do."""

import math

from builtin_interfaces.msg import Duration
import numpy as np
import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from manip_sim.ros.messages import CONTROLLER_TYPE, message_class

ARM = [f'robot0_joint{n}' for n in range(1, 8)]
LOWER = np.array([-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973])
UPPER = np.array([2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973])


def arm_position(client):
    return np.array(client.state('arm/joint_states').position)


@pytest.mark.full
def test_the_robot_holds_its_start_before_the_first_command(serve, client):
    serve()
    start = arm_position(client)
    states = client.listen(JointState, 'arm/joint_states')
    client.spin_until(lambda: len(states) > 100)
    np.testing.assert_allclose(states[-1].position, start, atol=1e-3)


@pytest.mark.full
def test_an_abstract_action_spans_the_joint_ranges(serve, client):
    serve()
    action = [0.1, 0.2, -0.1, 0.0, 0.1, 0.2, 0.1]
    client.publish('arm/command', Float64MultiArray(data=action))
    goal = LOWER + (np.array(action) + 1.0) / 2.0 * (UPPER - LOWER)
    client.spin_until(lambda: np.abs(arm_position(client) - goal).max() < 2e-3)


@pytest.mark.full
def test_one_gripper_message_closes_fully(serve, client):
    serve()
    client.publish('right/gripper/command', Float64MultiArray(data=[1.0]))
    client.spin_until(lambda: abs(client.state('right/gripper/joint_states').position[0]) < 1e-3)
    client.publish('right/gripper/command', Float64MultiArray(data=[-1.0]))
    client.spin_until(lambda: client.state('right/gripper/joint_states').position[0] > 0.039)


def test_a_joint_command_moves_the_named_joints_and_no_others(serve, client):
    serve()
    start = arm_position(client)
    client.publish('arm/joint_command', JointState(
        name=['robot0_joint7', 'robot0_joint1'], position=[0.5, 0.25]))
    client.spin_until(lambda: abs(arm_position(client)[6] - 0.5) < 1e-3)
    end = arm_position(client)
    np.testing.assert_allclose(end[0], 0.25, atol=2e-3)
    np.testing.assert_allclose(end[1:6], start[1:6], atol=2e-3)


def test_the_combined_joint_command_reaches_arm_and_gripper(serve, client):
    serve()
    client.publish('joint_command', JointState(
        name=['gripper0_right_finger_joint1', 'robot0_joint1'], position=[0.03, -0.2]))
    client.spin_until(lambda: abs(client.state().position[0] + 0.2) < 1e-3)


def test_the_gripper_takes_finger_positions(serve, client):
    serve()
    client.publish('right/gripper/joint_command', JointState(
        name=['gripper0_right_finger_joint1', 'gripper0_right_finger_joint2'],
        position=[0.01, -0.01]))
    client.spin_until(
        lambda: abs(client.state('right/gripper/joint_states').position[0] - 0.01) < 5e-4)


def point(positions, seconds, velocities=()):
    return JointTrajectoryPoint(
        positions=positions, velocities=velocities,
        time_from_start=Duration(sec=int(seconds), nanosec=int((seconds % 1) * 1e9)))


@pytest.mark.full
def test_a_trajectory_is_followed_and_replaced_by_a_newer_one(serve, client):
    serve()
    start = arm_position(client)
    client.publish('arm/joint_trajectory', JointTrajectory(
        joint_names=['robot0_joint1'], points=[point([0.4], 1.0), point([0.8], 20.0)]))
    client.spin_until(lambda: arm_position(client)[0] > 0.1)
    client.publish('arm/joint_trajectory', JointTrajectory(
        joint_names=['robot0_joint1'], points=[point([-0.1], 0.5, [0.0])]))
    client.spin_until(lambda: abs(arm_position(client)[0] + 0.1) < 1e-3)
    np.testing.assert_allclose(arm_position(client)[1:], start[1:], atol=2e-3)


def test_a_trajectory_with_times_out_of_order_is_rejected_as_a_whole(serve, client):
    log = client.log()
    serve()
    start = arm_position(client)
    client.publish('arm/joint_trajectory', JointTrajectory(
        joint_names=['robot0_joint1'], points=[point([0.4], 1.0), point([0.8], 0.5)]))
    client.spin_until(lambda: any('must increase' in line for line in log))
    np.testing.assert_allclose(arm_position(client), start, atol=1e-3)


def test_a_trajectory_in_the_past_is_rejected(serve, client):
    log = client.log()
    serve()
    states = client.listen(JointState, 'joint_states')
    client.spin_until(lambda: len(states) > 60)
    message = JointTrajectory(joint_names=['robot0_joint1'], points=[point([0.4], 0.1)])
    message.header.stamp = states[0].header.stamp
    message.header.stamp.nanosec += 1
    client.publish('arm/joint_trajectory', message)
    client.spin_until(lambda: any('s ago, by its stamp' in line for line in log))


def test_a_position_past_its_limit_is_clamped_and_told(serve, client):
    log = client.log()
    node = serve()
    client.publish('arm/joint_command', JointState(name=['robot0_joint6'], position=[9.0]))
    client.spin_until(lambda: abs(arm_position(client)[5] - UPPER[5]) < 2e-3)
    assert node.commands.robots[0].statistics['arm'].clamped == 1
    told = 'clamped 1 number of a message on arm/joint_command: robot0_joint6 from 9 to 3.7525'
    client.spin_until(lambda: any(told in line for line in log))


def test_effort_and_velocity_modes_take_their_own_fields(serve, client):
    serve(control_mode__arm='velocity', command_timeout__arm=0.0)
    client.publish('arm/joint_command', JointState(name=['robot0_joint1'], velocity=[0.2]))
    client.spin_until(lambda: abs(client.state().velocity[0] - 0.2) < 0.004)


def test_without_fresh_commands_velocity_goes_to_zero_and_comes_back(serve, client):
    serve(control_mode__arm='velocity')
    command = JointState(name=['robot0_joint1'], velocity=[0.3])
    for _ in range(2):
        client.publish('arm/joint_command', command)
        client.spin_until(lambda: client.state().velocity[0] > 0.25)
        client.spin_until(lambda: abs(client.state().velocity[0]) < 1e-3)


def test_a_trajectory_with_a_stamp_of_now_is_followed(serve, client):
    serve()
    message = JointTrajectory(joint_names=['robot0_joint1'], points=[point([0.2], 0.5, [0.0])])
    message.header.stamp = client.state().header.stamp
    client.publish('arm/joint_trajectory', message)
    client.spin_until(lambda: abs(arm_position(client)[0] - 0.2) < 1e-3)


@pytest.mark.full
def test_a_trajectory_without_points_ends_the_present_one(serve, client):
    serve()
    client.publish('arm/joint_trajectory', JointTrajectory(
        joint_names=['robot0_joint1'], points=[point([2.0], 4.0)]))
    client.spin_until(lambda: arm_position(client)[0] > 0.1)
    client.publish('arm/joint_trajectory', JointTrajectory())
    client.spin_until(lambda: abs(client.state().velocity[0]) < 1e-4)
    assert arm_position(client)[0] < 1.0


@pytest.mark.full
def test_a_trajectory_that_is_too_fast_is_slowed_down_and_told(serve, client):
    log = client.log()
    node = serve()
    client.publish('arm/joint_trajectory', JointTrajectory(
        joint_names=['robot0_joint1'], points=[point([1.5], 0.2)]))
    client.spin_until(lambda: any('slowed a trajectory' in line for line in log))
    client.spin_until(lambda: abs(arm_position(client)[0] - 1.5) < 2e-3)
    assert node.commands.robots[0].statistics['arm'].slowed == 1


@pytest.mark.full
def test_each_arm_of_two_is_commanded_alone_and_both_together(serve, client):
    serve(robot='Baxter')
    start = client.state('arm/joint_states')
    right, left = 'robot0_right_s0', 'robot0_left_s0'
    at = dict(zip(start.name, start.position))
    for arm, joint in (('right', right), ('left', left)):
        client.publish(f'{arm}/joint_trajectory', JointTrajectory(
            joint_names=[joint], points=[point([at[joint] + 0.3], 1.0)]))
    client.publish('arm/joint_command', JointState(
        name=['robot0_left_w2', 'robot0_right_w2'], position=[0.1, -0.1]))

    def arrived():
        state = client.state('arm/joint_states')
        now = dict(zip(state.name, state.position))
        return (abs(now[right] - at[right] - 0.3) < 2e-3 and abs(now[left] - at[left] - 0.3) < 2e-3
                and abs(now['robot0_left_w2'] - 0.1) < 2e-3)
    client.spin_until(arrived)
    assert list(client.state('right/joint_states').name) == [
        name for name in start.name if 'right' in name]


@pytest.mark.full
def test_an_arm_does_not_take_the_joints_of_the_other(serve, client):
    log = client.log()
    node = serve(robot='Baxter')
    client.publish('right/joint_command', JointState(name=['robot0_left_s0'], position=[0.1]))
    client.spin_until(lambda: any("right has no joint 'robot0_left_s0'" in line for line in log))
    assert node.commands.robots[0].statistics['right'].rejected == 1


@pytest.mark.full
def test_a_best_effort_publisher_is_heard_and_a_reliable_one_beside_it_once(serve, client):
    node = serve()
    best_effort = client.node.create_publisher(
        Float64MultiArray, 'arm/command', QoSProfile(
            depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
    client.spin_until(lambda: best_effort.get_subscription_count() > 0)
    statistics = node.commands.robots[0].statistics['arm']
    client.spin_until(lambda: best_effort.publish(Float64MultiArray(data=[0.0] * 7))
                      or statistics.accepted > 0)
    before = client.settled(lambda: statistics.accepted)
    client.publish('arm/command', Float64MultiArray(data=[0.1] * 7))
    assert client.settled(lambda: statistics.accepted) == before + 1


def test_the_state_of_a_controller_says_what_is_wanted_and_what_is(serve, client):
    node = serve()
    states = client.listen(message_class(CONTROLLER_TYPE), 'arm/controller_state')
    client.publish('arm/joint_command', JointState(name=['robot0_joint1'], position=[0.3]))
    client.spin_until(lambda: states and abs(wanted(states[-1])['error'].velocities[0]) < 1e-3
                      and wanted(states[-1])['feedback'].positions[0] > 0.29999)
    last = wanted(states[-1])
    assert list(states[-1].joint_names) == ARM
    np.testing.assert_allclose(last['reference'].positions[0], 0.3, atol=1e-4)
    np.testing.assert_allclose(
        np.subtract(last['reference'].positions, last['feedback'].positions),
        last['error'].positions, atol=1e-12)
    moving = [wanted(state)['reference'].velocities[0] for state in states]
    assert 0.5 < max(moving) <= 2.175
    assert len(last['output'].effort) == len(node.simulation.robot.parts['arm'].joints)


def wanted(message):
    """Return the points of a controller state by name, with control_msgs or without."""
    names = ('reference', 'feedback', 'error', 'output')
    if hasattr(message, 'points'):
        return dict(zip(names, message.points))
    return {name: getattr(message, name) for name in names}


@pytest.mark.full
@pytest.mark.parametrize('message', [
    JointState(), JointState(name=ARM), JointState(name=ARM, position=[math.nan] * 7),
    JointState(position=[math.nan])], ids=['empty', 'names', 'NaN', 'NaN of none'])
def test_a_message_without_a_number_is_taken_silently(message, serve, client):
    log = client.log()
    node = serve()
    for topic in ('arm/joint_command', 'joint_command'):
        client.publish(topic, message)
    client.publish('arm/joint_command', JointState(name=ARM[:1], position=[0.05]))
    client.spin_until(lambda: node.commands.robots[0].statistics['arm'].accepted == 1)
    assert not any(s.rejected for s in node.commands.robots[0].statistics.values())
    assert not any('rejected' in line for line in log)


def test_commands_of_an_arm_are_counted_under_one_name_whichever_they_come_by(serve, client):
    statistics = serve().commands.robots[0].statistics
    for name in ('arm', 'right'):
        client.publish(f'{name}/command', Float64MultiArray(data=[0.0] * 7))
    client.spin_until(lambda: statistics['arm'].accepted == 2)
    assert 'right' not in statistics
