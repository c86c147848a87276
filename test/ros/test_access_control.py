# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The recipe for SROS2: node, controller and strangers as processes, with the policy enforced."""

import importlib.metadata
import json
import os
from pathlib import Path
import signal
import subprocess
import sys

from enclave_client import GOAL
import pytest
from rclpy.utilities import get_rmw_implementation_identifier

from manip_sim.resources import share_directory

keystores = pytest.importorskip('sros2.keystore', reason='the package sros2 is not installed')

pytestmark = [pytest.mark.filterwarnings('ignore'), pytest.mark.skipif(
    get_rmw_implementation_identifier() == 'rmw_fastrtps_cpp'
    and bool(list(importlib.metadata.distributions(name='ros-fastrtps'))),
    reason='Fast DDS of the wheels has no security')]

NODE, CONTROLLER = '/manip_sim/sim_node', '/manip_sim/controller'


def create_keystore(folder):
    """Return the variables of processes in the enclaves of a new keystore."""
    keystores.create_keystore(folder)
    for enclave in (NODE, CONTROLLER):
        keystores.create_enclave(folder, enclave)
        keystores.create_permission(folder, enclave,
                                    share_directory() / 'config/security_policy.xml')
    return {**os.environ, 'ROS_SECURITY_KEYSTORE': str(folder), 'ROS_SECURITY_ENABLE': 'true',
            'ROS_SECURITY_STRATEGY': 'Enforce'}


@pytest.fixture(scope='module')
def secured(tmp_path_factory):
    return create_keystore(tmp_path_factory.mktemp('keystore'))


@pytest.fixture(scope='module')
def node(secured):
    """Run the node in its enclave, and check how it ends."""
    started = subprocess.Popen(
        [sys.executable, '-m', 'manip_sim', '--ros-args', '--enclave', NODE], env=secured,
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    yield
    started.send_signal(signal.SIGINT)
    _, errors = started.communicate(timeout=300.0)
    assert started.returncode == 0, errors


def client(what, environment, *enclave):
    """Return what a client finds."""
    done = subprocess.run(
        [sys.executable, str(Path(__file__).with_name('enclave_client.py')), what, '--ros-args',
         *enclave], env=environment, capture_output=True, text=True, timeout=300.0)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_a_controller_commands_and_observes_and_is_denied_the_rest(node, secured):
    assert client('control', secured, '--enclave', CONTROLLER) == {
        'joint': GOAL, 'reset': True, 'beyond': []}
    # Who sees nothing does so although the node is there.
    assert 'manip_sim' in client('look', secured, '--enclave', CONTROLLER)['nodes']


def test_who_has_no_identity_or_one_of_another_authority_does_not_see_the_node(
        node, tmp_path):
    assert client('look', dict(os.environ)) == {'nodes': ['controller', 'controller']}
    assert client('look', create_keystore(tmp_path), '--enclave', CONTROLLER) == {
        'nodes': ['controller', 'controller']}


def test_a_node_beyond_the_policy_does_not_start_and_says_so_in_one_line(secured):
    done = subprocess.run(
        [sys.executable, '-m', 'manip_sim', '--ros-args', '--enclave', NODE, '-r', '__ns:=/left'],
        env=secured, capture_output=True, text=True, timeout=300.0)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith('sim_node: ')
    assert 'Traceback' not in done.stderr
