# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Odometry of a mobile base against its joints, and twists with a stamp."""

from geometry_msgs.msg import TwistStamped, Vector3
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState

from manip_sim.ros.messages import nanoseconds_of

#: What the base turns about, in its frame [m].
AXIS = np.array([-0.21, 0.0, 0.0])


def stamped(stamp=None, **linear_and_yaw):
    message = TwistStamped()
    message.twist.angular.z = linear_and_yaw.pop('yaw', 0.0)
    message.twist.linear = Vector3(**linear_and_yaw)
    if stamp is not None:
        message.header.stamp = stamp
    return message


def vector(message):
    return np.array([message.x, message.y, message.z])


@pytest.mark.full
def test_odometry_is_what_the_joints_of_the_base_say(serve, client):
    serve(robot='PandaOmron', position=[1.0, -2.0, 0.3], orientation=[0.0, 0.0, 2.0],
          command_timeout__base=0.0)
    odometry = client.listen(Odometry, 'odom')
    states = client.listen(JointState, 'base/joint_states')
    # A curve to the left, sideways at the same time.
    client.publish('base/cmd_vel_stamped', stamped(x=0.3, y=0.1, yaw=0.8))
    client.spin_until(lambda: states and states[-1].position[2] > 1.2)
    by_stamp = {nanoseconds_of(s.header.stamp): s for s in states}
    pairs = [(o, by_stamp[nanoseconds_of(o.header.stamp)]) for o in odometry
             if nanoseconds_of(o.header.stamp) in by_stamp]
    assert len(pairs) > 50
    for seen, joints in pairs:
        assert seen.header.frame_id == 'odom' and seen.child_frame_id == 'mobilebase0_base'
        x, y, yaw = joints.position
        turn = seen.pose.pose.orientation
        rotation = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w])
        place = [x, y, 0.0] + AXIS - rotation.apply(AXIS)
        np.testing.assert_allclose(vector(seen.pose.pose.position), place, atol=1e-9)
        assert (rotation * Rotation.from_rotvec([0.0, 0.0, -yaw])).magnitude() < 1e-9
        vx, vy, rate = joints.velocity
        twist = seen.twist.twist
        velocity = rotation.inv().apply([vx, vy, 0.0]) - np.cross([0.0, 0.0, rate], AXIS)
        np.testing.assert_allclose(vector(twist.linear), velocity, atol=1e-9)
        np.testing.assert_allclose(vector(twist.angular), [0.0, 0.0, rate], atol=1e-9)
    # At its axis the base goes as it was told, however it is turned.
    last = odometry[-1].twist.twist
    assert last.angular.z == pytest.approx(0.8, abs=0.02)
    np.testing.assert_allclose(
        vector(last.linear) + np.cross(vector(last.angular), AXIS), [0.3, 0.1, 0.0], atol=0.02)


def test_in_lockstep_a_twist_counts_only_if_it_answers_the_present_state(serve, client):
    log = client.log()
    serve(robot='PandaOmron', stepping='lockstep', lockstep_parts=['base'])
    states = client.listen(JointState, 'base/joint_states')
    client.spin_until(lambda: states)
    first = states[-1].header.stamp
    client.publish('base/cmd_vel_stamped', stamped(first, x=0.2))
    client.spin_until(lambda: states[-1].header.stamp != first)
    second = states[-1].header.stamp
    assert nanoseconds_of(second) - nanoseconds_of(first) == 10_000_000
    client.publish('base/cmd_vel_stamped', stamped(first, x=0.2))
    client.spin_until(lambda: any('cmd_vel_stamped: lockstep: the command answers' in line
                                  for line in log))
    assert states[-1].header.stamp == second
    client.publish('base/cmd_vel_stamped', stamped(x=0.2))  # Without a stamp it counts always.
    client.spin_until(lambda: states[-1].header.stamp != second)


def test_a_twist_that_a_base_cannot_follow_is_rejected_with_a_stamp_too(serve, client):
    log = client.log()
    node = serve(robot='PandaOmron')
    client.publish('base/cmd_vel_stamped', stamped(z=0.1))
    client.spin_until(lambda: any('base/cmd_vel_stamped: base: moves along' in t for t in log))
    assert node.commands.robots[0].statistics['base'].rejected == 1
