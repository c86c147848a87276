# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Robots of files and texts that come and go while a node runs."""

from pathlib import Path
import re
import sys
import threading

from harness import START_S
import numpy as np
import pytest
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from spawning_node import ask, SpawningByParameters
from std_msgs.msg import Float64MultiArray, String
from test_spawned_robots import entities_of, go

from manip_sim.models.files import requested_robot

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'models'))
from files_rig import ARM, ARM_WITH_HAND  # noqa: E402
from requested_rig import urdf, write_package  # noqa: E402

LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
TEXT = re.sub('<visual>.*?</visual>', '', urdf())


@pytest.fixture
def roots(tmp_path):
    folder = tmp_path / 'roots'
    write_package(folder)
    (folder / 'hand.xml').write_text(ARM_WITH_HAND)
    (folder / 'left.yaml').write_text('{robot: lab_arm/arm.urdf, name: lab}')
    (folder / 'arm.urdf.xacro').write_text('<robot name="r"/>')
    (tmp_path / 'private.xml').write_text(ARM)
    return folder


@pytest.fixture
def spawning(serve, roots):
    """Return a function that starts a node with the services of spawning."""
    def start(**parameters):
        node = serve(**{'real_time_factor': 2.0, 'arena': 'table', **parameters})
        SpawningByParameters(node, roots)
        return node
    return start


def come(client, **fields):
    answer = ask(client, 'spawn_entity', **{'name': 'left', 'position': [0.0, 2.0, 0.0], **fields})
    assert answer.successful, answer.reason
    return answer.reason


@pytest.mark.full
@pytest.mark.parametrize('fields', [
    {'resource_string': '{robot: lab_arm/arm.urdf}'}, {'uri': 'lab_arm/arm.urdf'},
    {'resource_string': TEXT}, {'resource_string': '{robot: hand.xml}'}])
def test_a_robot_of_a_file_has_all_that_one_of_the_catalogue_has_and_goes(
        spawning, client, fields):
    node = spawning()
    own = client.listen(JointState, 'joint_states')
    client.spin_until(lambda: own)
    before = entities_of(node)
    for _ in range(2):
        assert come(client, **fields) == 'left'
        states = client.listen(JointState, 'left/joint_states')
        client.spin_until(lambda: states)  # noqa: B023
        names = [name for name in states[-1].name if 'finger' not in name]
        start = np.array([states[-1].position[states[-1].name.index(name)] for name in names])
        goal = start + 0.2
        client.publish('left/arm/joint_command', JointState(name=names, position=goal.tolist()))

        def near(states=states, goal=goal):
            return np.abs(np.array(states[-1].position[:len(goal)]) - goal).max() < 0.01
        client.spin_until(near)
        if 'hand' in str(fields):
            client.publish('left/right/gripper/command', Float64MultiArray(data=[1.0]))
            client.spin_until(
                lambda: np.abs(states[-1].position[3:]).max() < 0.005)  # noqa: B023
        parameters = client.call(ListParameters, 'manip_sim/list_parameters').result.names
        assert {'left.control_mode.arm', 'left.noise.joint_position'} <= set(parameters)
        (mode,) = client.call(GetParameters, 'manip_sim/get_parameters', GetParameters.Request(
            names=['left.control_mode.arm'])).values
        assert mode.string_value == 'position'
        go(client)
        client.spin_until(lambda: not client.node.count_publishers('left/joint_states'))
        assert entities_of(node) == before


@pytest.mark.full
def test_its_description_names_its_meshes(spawning, client, roots):
    spawning()
    come(client, resource_string='{robot: lab_arm/arm.urdf}')
    texts = []
    client.node.create_subscription(String, 'left/robot_description', texts.append, LATCHED)
    client.spin_until(lambda: texts)
    assert f'file://{(roots / "lab_arm/meshes/link.stl").resolve()}' in texts[0].data
    assert 'left_shoulder' in texts[0].data


@pytest.mark.full
def test_a_file_names_a_robot_beside_it_with_a_gripper_of_the_catalogue(spawning, client, roots):
    node = spawning()
    assert come(client, name='', uri='left.yaml') == 'lab'
    (roots / 'left.yaml').write_text(
        '{robot: lab_arm/arm.urdf, gripper: PandaGripper, name: held}')
    assert come(client, name='', uri='left.yaml', position=[0.0, -2.0, 0.0]) == 'held'
    assert list(node.simulation.robots['held'].grippers) == ['right/gripper']
    answer = ask(client, 'spawn_entity', uri='lab_arm/arm.urdf')
    assert not answer.successful and "'arm' is taken" in answer.reason
    assert come(client, name='', uri='lab_arm/arm.urdf', allow_renaming=True) == 'arm_1'


REJECTED = [
    ('{robot: ../private.xml}', '', 'must not be read: only files below spawn_roots may be'),
    ('{robot: /etc/passwd.xml}', '', 'must not be read: only files below spawn_roots may be'),
    ('{robot: missing.urdf}', '', 'no such file'), ('', 'missing.urdf', 'no such file'),
    ('{robot: arm.urdf.xacro}', '', 'xacro evaluates Python'),
    ('{robot: arm.urdf.xacro a:=1}', '', 'xacro evaluates Python'),
    ('', 'arm.urdf.xacro', 'xacro evaluates Python'),
    ('{robot: "menagerie:../private"}', '', "unknown robot 'menagerie:../private'"),
    ('{robot: hand.xml, gripper: hand.xml}', '', "unknown gripper 'hand.xml'"),
    ('{robot: hand.xml', '', 'YAML')]


@pytest.mark.full
def test_what_may_not_be_read_is_told_and_changes_nothing(spawning, client):
    node = spawning()
    before = entities_of(node)
    for text, uri, problem in REJECTED:
        answer = ask(client, 'spawn_entity', name='left', resource_string=text, uri=uri)
        assert not answer.successful and problem in answer.reason, (text, uri)
        assert '\n' not in answer.reason
        assert entities_of(node) == before and list(node.simulation.robots) == ['robot0']


@pytest.mark.full
def test_the_physics_and_other_services_go_on_while_a_robot_is_loaded(
        spawning, client, monkeypatch):
    begun, seen = threading.Event(), threading.Event()
    tried = requested_robot.run_limited

    def wait(*work, **limits):
        begun.set()
        assert seen.wait(START_S)
        tried(*work, **limits)
    monkeypatch.setattr(requested_robot, 'run_limited', wait)
    node = spawning()
    states = client.listen(JointState, 'joint_states')
    client.spin_until(lambda: states)
    answers = []

    def spawn():
        answers.append(ask(other, 'spawn_entity', name='left', position=[0.0, 2.0, 0.0],
                           resource_string='{robot: hand.xml}'))
    other = type(client)()
    asking = threading.Thread(target=spawn)
    asking.start()
    client.spin_until(begun.is_set)
    count, begin = len(states), node.simulation.time_ns
    client.spin_until(lambda: len(states) > count + 20)
    assert node.simulation.time_ns > begin and not answers
    seen.set()
    asking.join()
    other.close()
    assert answers[0].successful and 'left' in node.simulation.robots
