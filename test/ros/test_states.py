# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What the node publishes."""

from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
import mujoco
import numpy as np
import pytest
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String

ARM = [f'robot0_joint{n}' for n in range(1, 8)]
FINGERS = ['gripper0_right_finger_joint1', 'gripper0_right_finger_joint2']
GRIPPER = 'gripper0_right_'
START = [0.0, np.pi / 16, 0.0, -5 * np.pi / 6, 0.0, np.pi - 0.2, np.pi / 4]


def nanoseconds(stamp):
    return stamp.sec * 10**9 + stamp.nanosec


def test_joint_states_are_complete_finite_and_of_equal_length(serve, client):
    serve()
    state = client.state()
    assert list(state.name) == ARM + FINGERS
    for values in (state.position, state.velocity, state.effort):
        assert len(values) == 9
        assert np.isfinite(values).all()
    np.testing.assert_allclose(state.position[:7], START, atol=1e-3)


def test_each_part_has_its_own_topic(serve, client):
    serve()
    assert list(client.state('arm/joint_states').name) == ARM
    assert list(client.state('right/gripper/joint_states').name) == FINGERS
    topics = dict(client.node.get_topic_names_and_types())
    assert '/head/joint_states' not in topics


@pytest.mark.full
def test_all_messages_of_a_period_carry_the_stamp_of_the_clock(serve, client):
    serve(publish_rate=50.0)
    received = {topic: client.listen(kind, topic) for topic, kind in (
        ('joint_states', JointState), ('arm/joint_states', JointState),
        ('right/gripper/joint_states', JointState), ('right/wrench', WrenchStamped),
        ('right/external_wrench', WrenchStamped), ('right/eef_pose', PoseStamped),
        ('right/eef_twist', TwistStamped))}
    clock = client.listen(Clock, '/clock')
    client.spin_until(lambda: len(clock) > 20)
    stamps = {topic: [nanoseconds(m.header.stamp) for m in messages]
              for topic, messages in received.items()}
    ticks = [nanoseconds(m.clock) for m in clock]
    assert (np.diff(ticks) == 20_000_000).all()
    for topic, own in stamps.items():
        assert len(own) > 15, topic
        assert set(own) & set(ticks), topic
        assert (np.diff(own) == 20_000_000).all(), topic
        assert all(stamp % 20_000_000 == 0 for stamp in own), topic


def test_the_wrench_at_rest_is_the_weight_of_the_gripper_in_the_sensor_frame(serve, client):
    serve()
    wrenches = client.listen(WrenchStamped, 'right/wrench')
    client.spin_until(lambda: len(wrenches) > 5)
    message = wrenches[-1]
    assert message.header.frame_id == 'gripper0_right_ft_frame'
    force = np.array([message.wrench.force.x, message.wrench.force.y, message.wrench.force.z])
    # 0.73 kg of hand and two fingers of 0.015 kg; the sensor's z points down.
    assert abs(np.linalg.norm(force) - 0.76 * 9.81) < 0.01
    assert force[2] < -7.0


def of_stamp(client, received, stamp_ns):
    """Return the message of each topic that carries a stamp."""
    def found():
        return {topic: [m for m in heard if nanoseconds(m.header.stamp) == stamp_ns]
                for topic, heard in received.items()}
    client.spin_until(lambda: all(found().values()))
    return {topic: heard[0] for topic, heard in found().items()}


def three(vector):
    return [vector.x, vector.y, vector.z]


def test_every_number_is_that_of_the_physics_at_its_stamp(serve, client):
    node = serve(start_paused=True)
    received = {topic: client.listen(kind, topic) for topic, kind in (
        ('joint_states', JointState), ('right/wrench', WrenchStamped),
        ('right/external_wrench', WrenchStamped), ('right/eef_pose', PoseStamped),
        ('right/eef_twist', TwistStamped))}
    model, data = node.simulation.model, node.simulation.data
    gripper = data.body('gripper0_right_right_gripper')
    force, torque = np.array([3.0, -4.0, 5.0]), np.array([0.3, 0.2, -0.1])
    gripper.xfrc_applied[:] = [*force, *torque]
    goal = np.array(START) + [0.3, 0.2, -0.25, 0.35, 0.4, -0.2, 0.5]
    client.publish('joint_command', JointState(
        name=[*ARM, FINGERS[0]], position=[*goal, 0.0]))
    client.spin_until(lambda: node.commands.robots[0].statistics['joint_command'].accepted == 1)
    for _ in range(10):
        node.thread.step()
    told = of_stamp(client, received, node.simulation.time_ns)
    states, pose = told['joint_states'], told['right/eef_pose'].pose
    joints = [data.joint(name) for name in states.name]
    np.testing.assert_array_equal(states.position, [j.qpos[0] for j in joints])
    np.testing.assert_array_equal(states.velocity, [j.qvel[0] for j in joints])
    np.testing.assert_array_equal(
        states.effort, node.simulation.efforts.values[[model.joint(n).dofadr[0]
                                                       for n in states.name]])
    wrench, external = (told[f'right/{name}'].wrench for name in ('wrench', 'external_wrench'))
    np.testing.assert_array_equal(three(wrench.force), data.sensor(f'{GRIPPER}force_ee').data)
    np.testing.assert_array_equal(three(wrench.torque), data.sensor(f'{GRIPPER}torque_ee').data)
    frame = data.site(f'{GRIPPER}ft_frame')
    to_frame = frame.xmat.reshape(3, 3).T
    np.testing.assert_allclose(three(external.force), to_frame @ force, atol=1e-9)
    # The torque is the mean over the period, in which the gripper moves by less than 5 mm.
    np.testing.assert_allclose(three(external.torque), to_frame @ (
        torque + np.cross(gripper.xipos - frame.xpos, force)), atol=0.005 * 7.1)
    site = data.site(f'{GRIPPER}grip_site')
    np.testing.assert_array_equal(three(pose.position), site.xpos)
    jacobian = np.zeros((2, 3, model.nv))
    mujoco.mj_jacSite(model, data, *jacobian, site.id)
    twist = told['right/eef_twist'].twist
    np.testing.assert_allclose(three(twist.linear), jacobian[0] @ data.qvel, atol=1e-9)
    np.testing.assert_allclose(three(twist.angular), jacobian[1] @ data.qvel, atol=1e-9)
    # None of these is zero, or like another one, by chance.
    for vector in (wrench.force, wrench.torque, external.force, external.torque, twist.linear,
                   twist.angular, pose.position):
        values = np.sort(np.abs(three(vector)))
        assert values[0] > 1e-3 and np.diff(values).min() > 1e-3, vector
    assert np.abs(states.velocity).min() > 1e-3 and np.abs(states.effort).min() > 1e-3


def test_the_pose_of_the_end_effector_is_that_of_the_published_model(serve, client):
    serve()
    poses = client.listen(PoseStamped, 'right/eef_pose')
    latched = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
    xml = client.listen(String, '/manip_sim/mjcf', latched)
    client.spin_until(lambda: bool(xml) and len(poses) > 2)
    model = mujoco.MjModel.from_xml_string(xml[0].data)
    data = mujoco.MjData(model)
    state = client.state()
    for name, position in zip(state.name, state.position):
        data.joint(name).qpos[0] = position
    mujoco.mj_forward(model, data)
    pose = poses[-1].pose
    assert poses[-1].header.frame_id == 'world'
    np.testing.assert_allclose([pose.position.x, pose.position.y, pose.position.z],
                               data.site('gripper0_right_grip_site').xpos, atol=1e-4)
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, np.array([pose.orientation.w, pose.orientation.x,
                                            pose.orientation.y, pose.orientation.z]))
    np.testing.assert_allclose(rotation, data.site('gripper0_right_grip_site').xmat, atol=1e-3)


def test_states_are_reliable_and_keep_ten(serve, client):
    node = serve()
    client.spin_until(lambda: client.node.count_publishers('joint_states') > 0)
    qos = client.node.get_publishers_info_by_topic('/joint_states')[0].qos_profile
    assert qos.reliability == QoSReliabilityPolicy.RELIABLE
    assert qos.durability == QoSDurabilityPolicy.VOLATILE
    # The depth is not told to other nodes.
    depths = {publisher.topic_name: publisher.qos_profile.depth for publisher in node.publishers}
    states = {topic for topic in depths if topic.endswith(('states', 'wrench', 'pose', 'twist'))}
    assert len(states) == 8
    assert {depths[topic] for topic in states} == {10}
    assert depths['/clock'] == 1


def test_qos_can_be_overridden_by_parameters(serve, client):
    serve(**{'qos_overrides./joint_states.publisher.reliability': 'best_effort'})
    client.spin_until(lambda: client.node.count_publishers('joint_states') > 0)
    qos = client.node.get_publishers_info_by_topic('/joint_states')[0].qos_profile
    assert qos.reliability == QoSReliabilityPolicy.BEST_EFFORT


def test_a_prefix_begins_the_names_in_states_frames_model_log_and_errors(serve, client):
    log = client.log()
    serve(prefix='left_')
    names = [f'left_joint{n}' for n in range(1, 8)] + [
        'left_gripper_finger_joint1', 'left_gripper_finger_joint2']
    assert list(client.state().name) == names
    assert list(client.state('arm/joint_states').name) == names[:7]
    assert list(client.state('right/gripper/joint_states').name) == names[7:]
    for topic in ('right/wrench', 'right/external_wrench'):
        wrenches = client.listen(WrenchStamped, topic)
        client.spin_until(lambda heard=wrenches: bool(heard))
        assert wrenches[-1].header.frame_id == 'left_gripper_ft_frame'
    latched = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
    xml = client.listen(String, '/manip_sim/mjcf', latched)
    client.spin_until(lambda: bool(xml))
    model = mujoco.MjModel.from_xml_string(xml[0].data)
    assert [model.joint(i).name for i in range(model.njnt)] == names
    bodies = {model.body(i).name for i in range(1, model.nbody)}
    assert {'left_base', 'left_right_hand', 'left_base_pedestal', 'left_gripper_eef'} <= bodies
    assert all(body.startswith('left_') for body in bodies)
    client.publish('joint_command', JointState(name=['joint1'], position=[0.2]))
    client.spin_until(lambda: any("did you mean 'left_joint1' or" in line for line in log))
    client.spin_until(lambda: any('  arm: position mode, joints left_joint1, ' in line
                                  for line in log))
    assert not any(old in line for line in log for old in ('robot0_', 'gripper0_'))


@pytest.mark.full
def test_commands_name_joints_as_the_states_do(serve, client):
    serve(prefix='left_')
    client.publish('joint_command', JointState(
        name=['left_joint1', *(f'left_gripper_finger_joint{n}' for n in (1, 2))],
        position=[0.2, 0.03, -0.03]))
    client.spin_until(lambda: abs(client.state().position[0] - 0.2) < 1e-3)
    client.spin_until(lambda: abs(client.state().position[7] - 0.03) < 1e-3)


def test_a_prefix_tells_the_grippers_of_two_arms_apart_and_names_the_base(serve, client):
    serve(robot='Baxter', prefix='b_')
    names = list(client.state().name)
    assert names[0] == 'b_right_s0'
    assert list(client.state('left/gripper/joint_states').name) == [
        'b_gripper_left_l_finger_joint', 'b_gripper_left_r_finger_joint']


def test_the_joints_of_a_mobile_base_bear_the_prefix(serve, client):
    serve(robot='PandaOmron', prefix='m_')
    assert all(name.startswith('m_base_joint_mobile') for name in
               client.state('base/joint_states').name)


def test_idn_numbers_the_names(serve, client):
    serve(idn=3)
    names = list(client.state().name)
    assert names[0] == 'robot3_joint1'
    assert names[-1] == 'gripper3_right_finger_joint2'


def test_without_a_gripper_there_is_no_wrench(serve, client):
    serve(gripper='none', base='none')
    assert list(client.state().name) == ARM
    assert '/right/wrench' not in dict(client.node.get_topic_names_and_types())


def test_the_clock_can_be_left_to_others(serve, client):
    serve(publish_clock=False)
    client.state()
    assert client.node.count_publishers('/clock') == 0
