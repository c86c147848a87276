# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What commands do."""

from builtin_interfaces.msg import Duration
import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

ARM = [f'robot0_joint{n}' for n in range(1, 8)]
LOWER = np.array([-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973])
UPPER = np.array([2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973])


def arm_position(client):
    return np.array(client.state('arm/joint_states').position)


def test_the_robot_holds_its_start_before_the_first_command(serve, client):
    serve()
    start = arm_position(client)
    states = client.listen(JointState, 'arm/joint_states')
    client.spin_until(lambda: len(states) > 100)
    np.testing.assert_allclose(states[-1].position, start, atol=1e-3)


def test_an_abstract_action_spans_the_joint_ranges(serve, client):
    serve()
    action = [0.1, 0.2, -0.1, 0.0, 0.1, 0.2, 0.1]
    client.publish('arm/command', Float64MultiArray(data=action))
    goal = LOWER + (np.array(action) + 1.0) / 2.0 * (UPPER - LOWER)
    client.spin_until(lambda: np.abs(arm_position(client) - goal).max() < 2e-3)


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


def test_a_trajectory_with_times_out_of_order_is_refused_as_a_whole(serve, client):
    log = client.log()
    serve()
    start = arm_position(client)
    client.publish('arm/joint_trajectory', JointTrajectory(
        joint_names=['robot0_joint1'], points=[point([0.4], 1.0), point([0.8], 0.5)]))
    client.spin_until(lambda: any('must increase' in line for line in log))
    np.testing.assert_allclose(arm_position(client), start, atol=1e-3)


def test_a_trajectory_in_the_past_is_refused(serve, client):
    log = client.log()
    serve()
    states = client.listen(JointState, 'joint_states')
    client.spin_until(lambda: len(states) > 60)
    message = JointTrajectory(joint_names=['robot0_joint1'], points=[point([0.4], 0.1)])
    message.header.stamp = states[0].header.stamp
    message.header.stamp.nanosec += 1
    client.publish('arm/joint_trajectory', message)
    client.spin_until(lambda: any('must not be negative' in line for line in log))


def test_a_position_past_its_limit_is_clamped_and_told(serve, client):
    log = client.log()
    node = serve()
    client.publish('arm/joint_command', JointState(name=['robot0_joint6'], position=[9.0]))
    client.spin_until(lambda: abs(arm_position(client)[5] - UPPER[5]) < 2e-3)
    assert node.commands.statistics['arm'].clamped == 1
    client.spin_until(lambda: any('clamped' in line for line in log))


def test_effort_and_velocity_modes_take_their_own_fields(serve, client):
    serve(control_mode__arm='velocity')
    client.publish('arm/joint_command', JointState(name=['robot0_joint1'], velocity=[0.2]))
    client.spin_until(lambda: abs(client.state().velocity[0] - 0.2) < 0.004)


def test_without_fresh_commands_velocity_goes_to_zero_and_comes_back(serve, client):
    serve(control_mode__arm='velocity', command_timeout__arm=0.3)
    command = JointState(name=['robot0_joint1'], velocity=[0.3])
    for _ in range(2):
        client.publish('arm/joint_command', command)
        client.spin_until(lambda: client.state().velocity[0] > 0.25)
        client.spin_until(lambda: abs(client.state().velocity[0]) < 1e-3)
