# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What a node draws for its episodes, and what it publishes about them on ``~/episode``."""

import json
import subprocess
import sys

import mujoco
import numpy as np
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String
from std_srvs.srv import Trigger

from manip_sim.errors import ModelError
from manip_sim.interface.composition import compose_world
from manip_sim.interface.parameter_spec import GivenParameters

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
FILE = """
bodies:
  cube:
    mass: {scale: {uniform: [0.5, 2.0]}}
    position: {offset: {uniform: [[-0.02, -0.02, 0.0], [0.02, 0.02, 0.0]]}}
geoms:
  "cube*": {friction: {uniform: [0.5, 1.5]}, size: {scale: {uniform: [0.9, 1.0]}}}
joints:
  "robot0_joint*": {damping: {uniform: [0.5, 2.0]}}
parameters:
  noise.joint_position: {log_uniform: [1.0e-5, 1.0e-3]}
"""
CODE = """
import json, sys
from manip_sim.simulation import Simulation
from manip_sim.tasks import create_task, start
told = json.load(sys.stdin)
task = create_task('pick_cube')
simulation = Simulation(task.world)
start(task, simulation, told['seed'], told['drawn'])
print(simulation.digest())
"""


@pytest.fixture
def randomization(tmp_path):
    file = tmp_path / 'randomization.yaml'
    file.write_text(FILE)
    return str(file)


@pytest.fixture
def episodes(client):
    found = []
    client.node.create_subscription(
        String, '/manip_sim/episode', lambda message: found.append(json.loads(message.data)),
        LATCHED)
    return found


def call(client, name, kind=Trigger, request=None):
    service = client.node.create_client(kind, f'/manip_sim/{name}')
    client.spin_until(service.service_is_ready)
    done = service.call_async(request or kind.Request())
    client.spin_until(done.done)
    return done.result()


@pytest.mark.full
def test_episodes_are_drawn_from_the_seed_and_can_be_repeated_from_what_was_told(
        serve, client, episodes, randomization):
    node = serve(task='pick_cube', seed=4, start_paused=True, randomization=randomization)
    client.spin_until(lambda: bool(episodes))
    assert episodes[0]['seed'] == 4 and set(episodes[0]) == {
        'seed', 'drawn', 'versions', 'digest', 'stamp_ns'}
    assert episodes[0]['versions']['mujoco'] == mujoco.mj_versionString()
    assert episodes[0]['versions']['numpy'] == np.__version__
    assert node.simulation.model.body('cube').mass[0] == episodes[0]['drawn']['bodies/cube/mass']
    save = call(client, 'save_state')
    call(client, 'set_parameters', SetParameters, SetParameters.Request(
        parameters=[Parameter('seed', value=9).to_parameter_msg()]))
    call(client, 'reset')
    client.spin_until(lambda: len(episodes) == 2)
    assert episodes[1]['seed'] == 9
    assert all(episodes[1]['drawn'][name] != value for name, value in episodes[0]['drawn'].items())
    # The state of the first episode brings back what was drawn for it.
    assert call(client, 'restore_state').message == save.message
    client.spin_until(lambda: len(episodes) == 3)
    assert {**episodes[2], 'stamp_ns': 0} == {**episodes[0], 'stamp_ns': 0}
    for told in episodes[:2]:
        done = subprocess.run([sys.executable, '-c', CODE], input=json.dumps(told), text=True,
                              capture_output=True, check=True)
        assert done.stdout.strip() == told['digest']


def test_without_randomization_the_episode_has_a_seed_and_a_digest(serve, client, episodes):
    node = serve(robot='Panda', seed=3, start_paused=True)
    client.spin_until(lambda: bool(episodes))
    assert episodes[0]['drawn'] == {} and episodes[0]['seed'] == 3
    assert episodes[0]['digest'] == node.thread.call(node.simulation.digest)


def test_each_episode_has_the_stamp_of_its_first_states(serve, client, episodes):
    node = serve(start_paused=True)
    client.spin_until(lambda: bool(episodes))
    for count in range(2, 5):
        call(client, 'step')
        call(client, 'reset')
        client.spin_until(lambda expected=count: len(episodes) == expected)
        assert episodes[-1]['stamp_ns'] == node.simulation.time_ns
    stamps = [episode['stamp_ns'] for episode in episodes]
    assert stamps == [10_000_000, 30_000_000, 50_000_000, 70_000_000]


@pytest.mark.full
@pytest.mark.parametrize('parameters', [
    {}, {'control_mode.arm': 'effort'},
    {'robot': 'PandaOmron', 'control_mode.base': 'position', 'stream_interval.arm': 0.2}])
def test_the_first_episode_begins_and_ends_as_all_others(serve, client, episodes, parameters):
    serve(start_paused=True, seed=3, **parameters)
    client.spin_until(lambda: bool(episodes))
    digests = []
    for count in range(2, 4):
        digests.append([call(client, 'step') and call(client, 'save_state').message
                        for _ in range(3)])
        call(client, 'reset')
        client.spin_until(lambda expected=count: len(episodes) == expected)
    assert len({episode['digest'] for episode in episodes}) == 1
    assert digests[0] == digests[1]


def test_a_file_that_cannot_be_used_ends_the_start(tmp_path):
    file = tmp_path / 'file.yaml'
    file.write_text('bodies:\n  cube:\n    mas: {uniform: [1, 2]}')
    with pytest.raises(ModelError, match="line 3: unknown quantity of bodies 'mas'"):
        compose_world(GivenParameters({'randomization': str(file)}))
