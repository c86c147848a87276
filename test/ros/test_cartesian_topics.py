# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Cartesian commands over topics, with one node for most tests."""

import copy
import math

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TwistStamped
from harness import Client, Served
import numpy as np
import pytest
from rcl_interfaces.srv import DescribeParameters, SetParameters
from rclpy.parameter import Parameter
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger


@pytest.fixture(scope='module')
def served():
    """Return a node that runs as fast as it can, for all tests of this module."""
    served = Served({'stepping': 'free', 'robot': 'UR5e'})
    yield served.node
    served.close()


@pytest.fixture(scope='module')
def arm(served):
    """Return a client of the node that sees where the end effector is."""
    arm = ArmClient()
    yield arm
    arm.client.close()


class ArmClient:
    """What a client sees and commands of the right arm."""

    def __init__(self):
        self.client = Client()
        self.log = self.client.log()
        self.poses = self.client.listen(PoseStamped, 'right/eef_pose')
        self.twists = self.client.listen(TwistStamped, 'right/eef_twist')
        self.diagnostics = self.client.listen(DiagnosticArray, '/diagnostics')
        self.client.spin_until(lambda: self.poses and self.twists and self.diagnostics)

    @property
    def position(self):
        point = self.poses[-1].pose.position
        return np.array([point.x, point.y, point.z])

    @property
    def velocity(self):
        linear = self.twists[-1].twist.linear
        return np.array([linear.x, linear.y, linear.z])

    def wait_until_still(self):
        """Wait until the end effector has rested for 0.5 s: a late command has come by then."""
        def rests():
            recent = [message.twist.linear for message in self.twists[begin:][-50:]]
            return len(recent) == 50 and all(
                max(abs(v.x), abs(v.y), abs(v.z)) < 1e-4 for v in recent)
        begin = len(self.twists)
        self.client.spin_until(rests)

    def pose(self, offset=(0.0, 0.0, 0.0), frame='world', like=None):
        """Return a message for a pose beside one of the end effector."""
        pose = PoseStamped(pose=copy.deepcopy((like or self.poses[-1]).pose))
        point = pose.pose.position
        point.x, point.y, point.z = (
            float(value) for value in np.array([point.x, point.y, point.z]) + offset)
        pose.header.frame_id = frame
        return pose

    def status(self):
        """Return the diagnostic values of the arm."""
        return {pair.key: pair.value for status in self.diagnostics[-1].status
                if status.name == 'manip_sim: arm' for pair in status.values}


def twist(x=0.0, y=0.0, z=0.0, frame=''):
    message = TwistStamped()
    message.header.frame_id = frame
    message.twist.linear.x, message.twist.linear.y, message.twist.linear.z = x, y, z
    return message


def test_a_target_pose_is_reached(arm):
    goal = arm.position + [0.05, 0.08, 0.05]
    arm.client.publish('right/target_pose', arm.pose((0.05, 0.08, 0.05)))
    arm.client.spin_until(lambda: np.abs(arm.position - goal).max() < 1e-3)


def test_target_twists_move_the_end_effector_until_they_stop(arm):
    def streams():
        arm.client.publish('right/target_twist', twist(z=-0.03))
        return abs(arm.velocity[2] + 0.03) < 1e-3 and np.abs(arm.velocity[:2]).max() < 1e-3
    arm.client.spin_until(streams)
    arm.wait_until_still()


def test_a_pose_action_moves_the_end_effector_by_five_centimetres(arm):
    arm.wait_until_still()
    start = arm.position
    arm.client.publish('right/pose_command',
                       Float64MultiArray(data=[0.0, -1.0, 0.0, 0.0, 0.0, 0.0]))
    arm.client.spin_until(
        lambda: np.abs(arm.position - start - [0.0, -0.05, 0.0]).max() < 1e-3)


@pytest.mark.parametrize(('topic', 'message', 'what'), [
    ('right/pose_command', Float64MultiArray(data=[0.0] * 5), 'must have 6 numbers, got 5'),
    ('right/pose_command', Float64MultiArray(data=[math.nan] + [0.0] * 5), 'must be finite'),
    ('right/target_twist', twist(frame='tool0'), "unknown frame 'tool0'"),
    ('right/target_twist', twist(x=math.inf), 'linear velocity must be finite'),
    ('right/target_pose', PoseStamped(), None),
    ('right/target_pose', 'zero', 'of length 0'),
    ('right/target_pose', 'nan', 'position must be finite')])
def test_what_is_rejected_changes_nothing_and_is_told(topic, message, what, arm, served):
    if isinstance(message, str):
        kind, message = message, arm.pose()
        if kind == 'zero':
            turn = message.pose.orientation
            turn.x = turn.y = turn.z = turn.w = 0.0
        else:
            message.pose.position.y = math.nan
    statistics = served.commands.robots[0].statistics['arm']
    rejected, accepted = statistics.rejected, statistics.accepted
    arm.client.publish(topic, message)
    if what is None:
        # A message of zeros has the unit quaternion and is the origin of the world.
        arm.client.spin_until(lambda: statistics.accepted == accepted + 1)
        arm.client.call(Trigger, 'manip_sim/reset')
        return
    arm.client.spin_until(lambda: statistics.rejected == rejected + 1)
    assert statistics.accepted == accepted
    arm.client.spin_until(lambda: any(what in line and topic in line for line in arm.log))


@pytest.mark.full
def test_clamps_and_targets_out_of_reach_are_counted_and_told(arm, served):
    statistics = served.commands.robots[0].statistics['arm']
    clamped, accepted = statistics.clamped, statistics.accepted
    arm.client.publish('right/target_twist', twist(x=3.0))
    arm.client.spin_until(lambda: statistics.clamped == clamped + 1)
    arm.client.publish('right/target_pose', arm.pose((3.0, 0.0, 0.0)))
    arm.client.spin_until(lambda: statistics.accepted == accepted + 2)
    arm.client.spin_until(lambda: int(arm.status()['cartesian_unreachable']) >= 1)
    arm.client.spin_until(lambda: any('right: the target is not reached' in line
                                      for line in arm.log))
    assert int(arm.status()['clamped']) == clamped + 1
    arm.client.call(Trigger, 'manip_sim/reset')


def test_stiffness_and_limits_are_live_parameters_with_unit_and_range(arm, served):
    name = 'cartesian.right.stiffness'
    (descriptor,) = arm.client.call(DescribeParameters, 'manip_sim/describe_parameters',
                                    DescribeParameters.Request(names=[name])).descriptors
    assert '[1/s^2]' in descriptor.description and not descriptor.read_only
    assert (descriptor.floating_point_range[0].from_value,
            descriptor.floating_point_range[0].to_value) == (1.0, 1000.0)

    def set_to(value):
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()])
        return arm.client.call(SetParameters, 'manip_sim/set_parameters', request).results[0]
    assert set_to(300.0).successful
    assert served.simulation.robot.joints.cartesian.settings['right'].stiffness == 300.0
    assert 'out of range' in set_to(0.0).reason
    assert served.simulation.robot.joints.cartesian.settings['right'].stiffness == 300.0


def test_stamps_and_the_parameters_of_streams_count_for_target_poses_too(arm, served):
    request = SetParameters.Request(parameters=[
        Parameter(name, value=value).to_parameter_msg()
        for name, value in (('stream_interval.arm', 4.0), ('stream_hold.right', 0.5))])
    results = arm.client.call(SetParameters, 'manip_sim/set_parameters', request).results
    assert all(result.successful for result in results)
    pose = arm.pose((0.0, 0.02, 0.0))
    pose.header.stamp.sec, pose.header.stamp.nanosec = 1234, 50_000_000
    arm.client.publish('right/target_pose', pose)
    targets = served.simulation.robot.joints.cartesian._targets
    arm.client.spin_until(lambda: 'right' in targets and targets['right'].stream is not None)
    joints = targets['right'].stream._joints
    arm.client.spin_until(lambda: np.allclose(joints['stamp'], 1234.05))
    assert (joints['longest'] == 4.0).all() and (joints['hold'] == 0.5).all()
