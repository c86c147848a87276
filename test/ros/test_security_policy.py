# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The policy for SROS2 allows what the node has, and nothing else."""

from fnmatch import fnmatch
import importlib.metadata
import os
from pathlib import Path
import re
import subprocess
import sys
from xml.etree import ElementTree

from harness import Served
import pytest
from rclpy.node import Node

from manip_sim.interface.topics import actions_of, PUBLISHED, SERVICES, TOPICS
from manip_sim.resources import share_directory
from manip_sim.ros import standard_services, visualization_topics

FILES = Path(__file__).parents[1] / 'data/files'
#: Together they have all parts that there are, objects, what an arena moves, and tendons.
WORLDS = ({'robot': 'PandaOmron', 'arena': 'table', 'cameras': ['birdview']},
          {'robot': 'GR1', 'arena': 'table', 'cameras': ['birdview']},
          {'task': 'open_drawer', 'cameras': ['birdview']},
          {'arena': str(FILES / 'room.xml'), 'cameras': ['overview']},
          *({'robot': str(FILES / f'{name}.xml'), 'arena': 'table', 'cameras': ['birdview']}
            for name in ('differential_wrist', 'turning_laser')))
#: With or without the package in this environment.
STANDARD_SERVICES = {f'/manip_sim/{name}' for name in (
    'get_simulator_features', 'get_simulation_state', 'set_simulation_state', 'step_simulation',
    'reset_simulation', 'get_entities', 'get_entities_states', 'get_entity_info',
    'set_entity_info', 'get_entity_bounds', 'get_entity_state', 'set_entity_state',
    'spawn_entity', 'spawn_entities', 'delete_entity', 'get_spawnables', 'get_named_poses',
    'get_named_pose_bounds', 'get_available_worlds', 'get_current_world', 'load_world',
    'unload_world')}

#: With or without tf2_msgs in this environment.
FRAMES = {'/tf', '/tf_static'}
#: With or without moveit_msgs in this environment.
SCENE = {f'/{name}' for name in visualization_topics.PLANNING_SCENE_TOPICS}


def granted(enclave, kind, permission):
    """Return the full names that an enclave of the policy allows."""
    (profile,) = ElementTree.parse(share_directory() / 'config/security_policy.xml').findall(
        f'./enclaves/enclave[@path="{enclave}"]/profiles/profile')
    names = [element.text for element in
             profile.findall(f'./{kind}s[@{permission}="ALLOW"]/{kind}')]
    assert len(set(names)) == len(names)
    own = f'/{profile.get("node")}'
    return {name if name[0] == '/' else own + name[1:] if name[0] == '~' else f'/{name}'
            for name in names}


@pytest.fixture(scope='module')
def graph():
    """Return what the node publishes, subscribes to and serves, over several robots."""
    names = {'publish': set(), 'subscribe': set(), 'reply': set(), 'execute': set()}
    for world in WORLDS:
        served = Served({**world, 'lidars': ['{name: flat}', '{name: round, rings: 2}'],
                         'noise.wrench_force': 1.0})
        try:
            node: Node = served.node
            for permission, entities in (
                    ('publish', node.get_publisher_names_and_types_by_node),
                    ('subscribe', node.get_subscriber_names_and_types_by_node),
                    ('reply', node.get_service_names_and_types_by_node)):
                names[permission] |= {re.sub('^/(birdview|overview|flat|round)/', '/*/', re.sub(
                    '^/(objects|sensors|truth)/.*', r'/\1/*', name) if permission == 'publish'
                    else re.sub('^/objects/.*/', '/objects/*/', name))
                    for name, _ in entities('manip_sim', '/') if '/_action/' not in name}
            # With or without control_msgs in this environment.
            names['execute'] |= {'/manip_sim/simulate_steps', *(
                f'/{action.name}' for action in actions_of(served.node.simulation.robot.parts))}
        finally:
            served.close()
    return names


@pytest.mark.full
@pytest.mark.parametrize('kind, permission', [
    ('topic', 'publish'), ('topic', 'subscribe'), ('service', 'reply'), ('action', 'execute')])
def test_the_node_may_do_what_it_does_and_nothing_else(kind, permission, graph):
    allowed = granted('/manip_sim/sim_node', kind, permission)
    if kind == 'service':
        assert allowed >= STANDARD_SERVICES
        if not standard_services.AVAILABLE:
            allowed -= STANDARD_SERVICES
    if permission == 'publish':
        assert allowed >= FRAMES
        if visualization_topics.TFMessage is None:
            allowed -= FRAMES
        assert allowed >= SCENE
        if visualization_topics.moveit_msgs is None:
            allowed -= SCENE
    assert allowed == graph[permission]


@pytest.mark.parametrize('row', TOPICS, ids=lambda row: f'{row.direction} {row.name}')
def test_each_topic_of_the_interface_is_allowed(row):
    name = re.sub('<(arm|part)>', 'left', row.name)
    if row.per not in ('<arm>', '<part>'):
        name = re.sub('<.*>', 'anything', name)
    name = name if name[0] == '/' else f'/manip_sim{name[1:]}' if name[0] == '~' else f'/{name}'
    to_node, to_controller = (('publish', 'subscribe') if row.direction == PUBLISHED else
                              ('subscribe', 'publish'))
    for enclave, permission in ('sim_node', to_node), ('controller', to_controller):
        assert any(fnmatch(name, pattern)
                   for pattern in granted(f'/manip_sim/{enclave}', 'topic', permission))


def test_each_service_of_the_interface_is_allowed():
    names = {service.name.replace('~', '/manip_sim') for service in SERVICES}
    assert names <= granted('/manip_sim/sim_node', 'service', 'reply')
    assert names <= granted('/manip_sim/controller', 'service', 'request')


@pytest.mark.parametrize('enclave', ['/manip_sim/sim_node', '/manip_sim/controller'])
@pytest.mark.filterwarnings('ignore')
def test_sros2_makes_signed_permissions_of_it(enclave, tmp_path):
    keystore = pytest.importorskip('sros2.keystore', reason='the package sros2 is not installed')
    keystore.create_keystore(tmp_path)
    keystore.create_enclave(tmp_path, enclave)
    keystore.create_permission(tmp_path, enclave,
                               share_directory() / 'config/security_policy.xml')
    folder = tmp_path / 'enclaves' / enclave[1:]
    grant = ElementTree.parse(folder / 'permissions.xml').find('permissions/grant')
    assert grant.findtext('subject_name') == f'CN={enclave}'
    assert grant.findtext('default') == 'DENY'
    for kind, permission, way, form in (
            ('topic', 'publish', 'publish', 'rt{}'), ('topic', 'subscribe', 'subscribe', 'rt{}'),
            ('service', 'reply', 'subscribe', 'rq{}Request'),
            ('service', 'reply', 'publish', 'rr{}Reply')):
        permitted = {topic.text for topic in grant.iterfind(f'allow_rule/{way}/topics/topic')}
        assert {form.format(name) for name in granted(enclave, kind, permission)} <= permitted
    assert (folder / 'permissions.p7s').read_bytes().startswith(b'MIME-Version')


def test_a_controller_may_command_and_observe_but_not_change_parameters():
    def node(kind, permission):
        return granted('/manip_sim/sim_node', kind, permission)

    def controller(kind, permission):
        return granted('/manip_sim/controller', kind, permission)
    assert controller('topic', 'publish') == node('topic', 'subscribe') | {
        '/parameter_events', '/rosout'}
    assert controller('topic', 'subscribe') == node('topic', 'publish') - {'/rosout'}
    assert controller('action', 'call') == node('action', 'execute')
    assert node('service', 'reply') - controller('service', 'request') == {
        '/manip_sim/set_parameters', '/manip_sim/set_parameters_atomically'}


@pytest.mark.full
@pytest.mark.skipif(not list(importlib.metadata.distributions(name='ros-fastrtps')),
                    reason='ROS 2 does not come from wheels')
@pytest.mark.parametrize('strategy', ['Enforce', 'Permissive'])
def test_ros_from_wheels_has_no_security_and_a_node_that_needs_it_does_not_start(strategy,
                                                                                 tmp_path):
    enclave = tmp_path / 'enclaves' / 'manip_sim'
    enclave.mkdir(parents=True)
    for name in ('identity_ca.cert.pem', 'cert.pem', 'key.pem', 'permissions_ca.cert.pem',
                 'governance.p7s', 'permissions.p7s'):
        (enclave / name).touch()
    done = subprocess.run(
        [sys.executable, '-m', 'manip_sim', '--ros-args', '--enclave', '/manip_sim'], env={
            **os.environ, 'ROS_SECURITY_ENABLE': 'true', 'ROS_SECURITY_STRATEGY': strategy,
            'ROS_SECURITY_KEYSTORE': str(tmp_path)}, capture_output=True, text=True, timeout=300.0)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == (
        "sim_node: error creating node: This Fast DDS version doesn't have the security libraries")
