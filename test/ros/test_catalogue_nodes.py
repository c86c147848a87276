# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Every robot of the catalogue, served by name with its default gripper and base."""

from geometry_msgs.msg import Twist, Vector3
import numpy as np
import pytest

from manip_sim.models.robots import create_robot, ManipulatorModel, robot_names

ROBOTS = [name for name in robot_names()
          if type(create_robot(name)).__module__.startswith('manip_sim.')]
OTHER_PARTS = {'PandaOmron': {'base', 'torso'}, 'Tiago': {'base', 'torso', 'head'},
               'GR1': {'torso', 'head', 'legs'}}


@pytest.mark.full
@pytest.mark.parametrize('name', ROBOTS)
def test_a_robot_is_served_with_the_topics_of_its_parts(name, serve, client):
    serve(robot=name)
    robot = create_robot(name)
    assert isinstance(robot, ManipulatorModel)
    expected = {'arm', *robot.arms, *OTHER_PARTS.get(name, set()),
                *(f'{arm}/gripper' for arm in robot.arms)}
    client.state()
    topics = {topic.strip('/') for topic, _ in client.node.get_topic_names_and_types()}
    served = {topic[:-len('/joint_states')] for topic in topics
              if topic.endswith('/joint_states')}
    assert served == expected
    for arm in robot.arms:
        assert f'{arm}/wrench' in topics
        assert f'{arm}/gripper/command' in topics
        assert f'{arm}/joint_trajectory' in topics
    assert ('base/cmd_vel' in topics) == ('base' in expected)
    arm = client.state('arm/joint_states')
    assert list(arm.name) == robot.arm_joints
    np.testing.assert_allclose(
        arm.position, [dict(zip(robot.joints, robot.init_qpos))[j] for j in arm.name], atol=2e-3)


def place(client):
    """Return where the base is [m], shape (2,)."""
    return np.array(client.state('base/joint_states').position[:2])


@pytest.mark.full
def test_a_mobile_base_drives_along_its_own_axes(serve, client):
    node = serve(robot='PandaOmron', command_timeout__base=0.0)
    turn = Twist()
    turn.angular.z = 1.0
    client.publish('base/cmd_vel', turn)
    client.spin_until(lambda: client.state('base/joint_states').position[2] > np.pi / 2)
    client.publish('base/cmd_vel', Twist())
    client.spin_until(lambda: abs(client.state('base/joint_states').velocity[2]) < 1e-3)
    yaw = client.state('base/joint_states').position[2]
    # Forward, and to the left (REP 103).
    for twist, heading in ((Vector3(x=0.5), yaw), (Vector3(y=0.5), yaw + np.pi / 2)):
        start = place(client)
        client.publish('base/cmd_vel', Twist(linear=twist))
        client.spin_until(lambda s=start: np.linalg.norm(place(client) - s) > 0.3)
        client.publish('base/cmd_vel', Twist())
        client.spin_until(lambda: np.abs(client.state('base/joint_states').velocity).max() < 1e-3)
        x, y = place(client) - start
        error = np.arctan2(y, x) - heading
        assert abs(np.arctan2(np.sin(error), np.cos(error))) < 0.05
    assert node.simulation.robot.joints.mode_of('mobilebase0_joint_mobile_yaw') == 'velocity'


@pytest.mark.full
def test_the_base_stops_without_fresh_commands(serve, client):
    serve(robot='PandaOmron')
    ahead = Twist()
    ahead.linear.x = 0.5
    client.publish('base/cmd_vel', ahead)
    client.spin_until(lambda: client.state('base/joint_states').velocity[0] > 0.3)
    client.spin_until(lambda: abs(client.state('base/joint_states').velocity[0]) < 1e-3)


def test_a_twist_that_a_base_cannot_follow_is_rejected(serve, client):
    log = client.log()
    serve(robot='PandaOmron')
    for field, value, reason in (('z', 0.1, 'leave linear.z'), ('x', np.nan, 'must be finite')):
        twist = Twist()
        setattr(twist.linear, field, value)
        client.publish('base/cmd_vel', twist)
        client.spin_until(lambda r=reason: any(r in line for line in log))
