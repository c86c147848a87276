# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``robot_description``: latched, of every robot, in agreement with what the node publishes."""

from dataclasses import dataclass
import json
import math
from types import SimpleNamespace
from xml.etree import ElementTree

from geometry_msgs.msg import PoseStamped
from harness import Client, Served
import mujoco
import numpy as np
import pytest
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from test_model_files import write_arm

from manip_sim.interface.topics import Scope
from manip_sim.ros import world_publishers

LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture(scope='module')
def node():
    """Return a node with two robots that runs for all tests of this module."""
    served = Served({'robots': ['left', 'right'], 'right.robot': 'UR5e', 'ros2_control_tag': True,
                     'right.prefix': 'ur_', 'right.control_mode.arm': 'velocity'})
    yield served.node
    served.close()


def description(client, topic):
    """Return the only message that comes to one who joins now."""
    messages = client.listen(String, topic, LATCHED)
    client.spin_until(lambda: messages)
    assert len(messages) == 1
    return ElementTree.fromstring(messages[0].data)


def scalar(urdf):
    return {joint.get('name') for joint in urdf.findall('joint')
            if joint.find('limit') is not None}


@pytest.mark.full
def test_each_robot_has_its_own_and_who_joins_later_gets_it_too(node, client):
    assert description(client, 'left/robot_description').get('name') == 'Panda'
    later = Client()
    try:
        urdf = description(later, 'right/robot_description')
    finally:
        later.close()
    assert urdf.get('name') == 'UR5e'
    assert all(link.get('name').startswith('ur_') or link.get('name') == 'world'
               for link in urdf.findall('link'))


@pytest.mark.full
@pytest.mark.parametrize('robot', ['left', 'right'])
def test_its_joints_are_those_of_the_joint_states(robot, node, client):
    assert scalar(description(client, f'{robot}/robot_description')) == set(
        client.state(f'{robot}/joint_states').name)


@pytest.mark.full
def test_it_puts_the_tool_where_the_node_does(node, client):
    urdf = description(client, 'right/robot_description')
    compiler = ElementTree.SubElement(ElementTree.SubElement(urdf, 'mujoco'), 'compiler')
    compiler.attrib.update(fusestatic='false', discardvisual='true', inertiafromgeom='false',
                           boundmass='1e-9', boundinertia='1e-9')
    model = mujoco.MjModel.from_xml_string(ElementTree.tostring(urdf, encoding='unicode'))
    data = mujoco.MjData(model)
    poses = client.listen(PoseStamped, 'right/right/eef_pose')
    states = client.listen(JointState, 'right/joint_states')

    def pair():
        stamps = {str(pose.header.stamp): pose for pose in poses}
        return next(((state, stamps[str(state.header.stamp)]) for state in states
                     if str(state.header.stamp) in stamps), None)
    client.spin_until(lambda: pair() is not None)
    state, pose = pair()
    for name, position in zip(state.name, state.position):
        data.joint(name).qpos[0] = position
    mujoco.mj_kinematics(model, data)
    place = pose.pose.position
    np.testing.assert_allclose(data.body('ur_gripper_grip_site').xpos,
                               [place.x, place.y, place.z], atol=1e-9)


def test_the_tag_of_ros2_control_is_that_of_this_node(node, client):
    for robot, kind in (('left', 'position'), ('right', 'velocity')):
        tag = description(client, f'{robot}/robot_description').find('ros2_control')
        first = tag.find('joint')
        assert [c.get('name') for c in first.findall('command_interface')] == [kind]
        assert {p.text for p in tag.findall('hardware/param')} - {'-1'} == {
            f'/{robot}/joint_states', f'/{robot}/joint_command'}


@pytest.mark.full
def test_the_tag_for_the_own_plugin_names_parameters_and_sensors_of_this_node(serve, client):
    # Other names than those of the node of this module, which goes on.
    serve(robots=['front', 'back'], stepping='lockstep', ros2_control_tag=True,
          ros2_control_plugin='manip_sim_hardware/ManipSimSystem',
          sensors=['{name: front_right_imu, rate: 30.0}', '{name: back_right_imu, rate: 100.0}'])
    tag = description(client, 'front/robot_description').find('ros2_control')
    assert {p.text for p in tag.findall('hardware/param')} == {
        '/front/joint_states', '/front/joint_command', '/manip_sim', 'true'}
    assert {p.text for p in tag.findall('joint/param')} == {'front.control_mode.arm'}
    assert {s.get('name'): s.find('param').text for s in tag.findall('sensor')} == {
        'right_wrench': '/front/right/wrench',
        'right_external_wrench': '/front/right/external_wrench',
        'front_base_imu': '/front/sensors/front_base_imu/imu',
        'front_right_imu': '/front/sensors/front_right_imu/imu'}
    assert {s.get('name'): p.text for s in tag.findall('sensor')
            for p in s.findall('param') if p.get('name') == 'rate'} == {
                'front_right_imu': str(1.0 / 0.03)}
    # What the tag names exists.
    known = {name for name, _ in client.node.get_topic_names_and_types()}
    client.spin_until(lambda: known.update(
        name for name, _ in client.node.get_topic_names_and_types()) or known >= {
            '/front/right/wrench', '/front/right/external_wrench', '/front/joint_command'})


def test_a_robot_of_a_file_has_one_without_the_tag_unless_it_is_asked_for(serve, client, tmp_path):
    file = write_arm(tmp_path / 'arm')
    serve(robot=str(file))
    urdf = description(client, 'robot_description')
    assert scalar(urdf) == {'robot0_swing'} and urdf.find('ros2_control') is None
    meshes = {mesh.get('filename') for mesh in urdf.iter('mesh')}
    assert meshes == {f'file://{file.resolve().parent}/link.stl'}


def test_the_dynamics_of_all_robots_are_latched_as_json(node, client):
    messages = client.listen(String, 'manip_sim/dynamics', LATCHED)
    client.spin_until(lambda: bool(messages))
    told = json.loads(messages[-1].data)
    assert (told['timestep'], told['gravity_compensation']) == (0.002, True)
    robots = node.simulation.robots.values()
    assert list(told['joints']) == [name for robot in robots for name in robot.joint_names]
    model = node.simulation.model
    for name, joint in told['joints'].items():
        dof = model.joint(name).dofadr[0]
        assert joint['armature'] == model.dof_armature[dof]
        assert joint['position_range'] == (
            model.joint(name).range.tolist() if model.joint(name).limited[0] else None)
    assert told['joints']['ur_elbow_joint']['velocity_limit'] == pytest.approx(np.pi, abs=0.01)


def test_dynamics_that_json_cannot_say_are_never_published():
    @dataclass
    class Joint:
        damping: float
    robot = SimpleNamespace(dynamics=lambda: {'elbow': Joint(math.inf)})
    published = []
    publisher = world_publishers.DynamicsPublisher(SimpleNamespace(
        node=SimpleNamespace(
            create_publisher=lambda *_: SimpleNamespace(publish=published.append)),
        simulation=SimpleNamespace(timestep_s=0.002, robots={'robot0': robot}),
        parameters=SimpleNamespace(value=lambda _: False)))
    with pytest.raises(ValueError, match='not JSON compliant'):
        publisher.publish()
    assert not published


@pytest.mark.parametrize(('scope', 'note'), [
    ('left', 'left: robot_description: no a; no b'), ('', 'robot_description: no a; no b')])
def test_what_a_urdf_leaves_out_is_said_with_the_name_of_the_robot(scope, note, monkeypatch):
    monkeypatch.setattr(world_publishers, 'urdfs_of', lambda *_: {
        'robot0': SimpleNamespace(xml='<robot/>', notes=['no a', 'no b'])})
    published, notes = [], []
    context = SimpleNamespace(
        notes=notes, simulation=None, composition=SimpleNamespace(world=None),
        robots={Scope(scope): SimpleNamespace(name='robot0')},
        parameters=SimpleNamespace(value=lambda name: False),
        node=SimpleNamespace(create_publisher=lambda kind, topic, qos: SimpleNamespace(
            publish=lambda message: published.append((topic, message.data)))))
    world_publishers.DescriptionPublisher(context, None).started()
    assert notes == [note]
    assert published == [(f'{scope}/robot_description'.lstrip('/'), '<robot/>')]
