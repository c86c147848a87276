# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The reference of topics and services against the running node; the README's example, pasted."""

from pathlib import Path
import re
import subprocess
import sys

import pytest
from rclpy.qos import QoSDurabilityPolicy

from manip_sim.interface.topics import ACTIONS, SERVICES
from manip_sim.ros import visualization_topics

ROOT = Path(__file__).resolve().parents[2]
TABLES = '\n'.join((ROOT / 'docs' / 'reference' / page).read_text()
                   for page in ('topics.md', 'services.md'))
PARTS = ('arm', 'base', 'torso', 'head', 'legs')


def documented(kinds):
    """Return (name, type) of the table rows whose type is of some packages."""
    return {(name, kind) for name, kind in re.findall(
        r'^\| `([^`]+)` \| (\w+/\w+) \|', TABLES, re.MULTILINE)
        if kind.split('/')[0] in kinds}


def general(name):
    """Turn the name of a topic into the form that the tables have."""
    name = re.sub(r'^/manip_sim/', '~/', name)
    if name not in ('/clock', '/diagnostics', '/tf', '/tf_static'):
        name = name.lstrip('/')
    name = re.sub(r'^objects/\w+/', 'objects/<name>/', name)
    name = re.sub(r'^sensors/\w+/', 'sensors/<sensor>/', name)
    name = re.sub(r'^\w+/(color|depth|labels)/', r'<camera>/\1/', name)
    name = re.sub(r'^\w+/(scan|points)$', r'<lidar>/\1', name)
    of_part = ('joint_states|command|joint_command|impedance_command|joint_trajectory|'
               'controller_state')
    if re.fullmatch(rf'(arm|base|torso|head|legs|right|left)/({of_part})', name):
        return re.sub(r'^\w+/', '<part>/', name)
    return re.sub(r'^(right|left)/', '<arm>/', name)


def without_control_msgs(kind):
    """Return the type that a topic has where control_msgs is not installed."""
    return kind.replace('control_msgs/JointTrajectoryControllerState',
                        'trajectory_msgs/JointTrajectory')


OF_ROS = {'/rosout', '/parameter_events'}


@pytest.mark.full
def test_topics_are_documented_with_their_types(serve, client):
    robots = [serve(arena='table', cameras=['birdview'],
                    lidars=['{name: flat}', '{name: round, rings: 2}'])]
    client.state()
    found = set()
    for node in robots:
        name, namespace = node.get_name(), node.get_namespace()
        # Another node discovers some of them later than the first state.
        for topics in (node.get_publisher_names_and_types_by_node(name, namespace),
                       node.get_subscriber_names_and_types_by_node(name, namespace)):
            found |= {(general(topic), without_control_msgs(kinds[0].replace('/msg/', '/')))
                      for topic, kinds in topics
                      if topic not in OF_ROS and '/_action/' not in topic}
    table = documented({'sensor_msgs', 'geometry_msgs', 'std_msgs', 'rosgraph_msgs',
                        'diagnostic_msgs', 'trajectory_msgs', 'nav_msgs', 'visualization_msgs'})
    table -= {(service.name, service.type) for service in SERVICES}
    frames = documented({'tf2_msgs'})
    assert {name for name, _ in frames} == {'/tf', '/tf_static'}
    if visualization_topics.TFMessage is not None:
        table |= frames
    if visualization_topics.moveit_msgs is not None:
        table |= documented({'moveit_msgs'})
    assert found <= table
    # A Panda has no mobile base, and none of these sensors; this node has no task, and its arena
    # no joints and no mocap bodies; no actuator is of no part.
    assert table - found == {
        ('arena/joint_states', 'sensor_msgs/JointState'),
        ('arena/joint_command', 'sensor_msgs/JointState'),
        ('actuators/states', 'sensor_msgs/JointState'),
        ('actuators/command', 'sensor_msgs/JointState'),
        ('objects/<name>/target_pose', 'geometry_msgs/PoseStamped'),
        ('~/task', 'std_msgs/String'),
        ('sensors/<sensor>/wrench', 'geometry_msgs/WrenchStamped'),
        ('sensors/<sensor>/range', 'sensor_msgs/Range'),
        ('sensors/<sensor>/magnetic_field', 'sensor_msgs/MagneticField'),
        ('base/cmd_vel', 'geometry_msgs/Twist'),
        ('base/cmd_vel_stamped', 'geometry_msgs/TwistStamped'),
        ('odom', 'nav_msgs/Odometry')}


def test_services_are_documented_with_their_types(serve, client):
    node = serve()
    client.state()
    services = node.get_service_names_and_types_by_node('manip_sim', '/')
    found = {(general(name), kinds[0].replace('/srv/', '/')) for name, kinds in services
             if kinds[0].startswith(('std_srvs', 'diagnostic_msgs'))}
    assert found == {(service.name, service.type) for service in SERVICES} <= documented(
        {'std_srvs', 'diagnostic_msgs'})


def test_actions_are_documented_with_their_types():
    assert documented({'control_msgs'}) == {(action.name, action.type) for action in ACTIONS}


def test_the_model_is_latched(serve, client):
    serve()
    client.spin_until(lambda: client.node.count_publishers('/manip_sim/mjcf') > 0)
    info = client.node.get_publishers_info_by_topic('/manip_sim/mjcf')[0]
    assert info.qos_profile.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL


@pytest.mark.full
def test_the_pasted_controller_moves_the_robot(serve, client):
    serve()
    example = next(block for block in re.findall(
        r'```python\n(.*?)```', (ROOT / 'README.md').read_text(), re.DOTALL)
                   if 'rclpy.spin' in block)
    assert len([line for line in example.splitlines() if line]) == 10
    # A terminal ends a block at an empty line, and only there.
    controller = subprocess.Popen([sys.executable, '-i'], stdin=subprocess.PIPE, text=True)
    try:
        controller.stdin.write(example)
        controller.stdin.close()
        client.spin_until(lambda: abs(client.state().position[0]) > 0.1)
    finally:
        controller.terminate()
        controller.wait(timeout=300.0)
