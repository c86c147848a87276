# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Free bodies over topics and parameters, arenas of another size, starts with noise."""

import io

import mujoco
import numpy as np
import pytest
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from std_msgs.msg import String, UInt8MultiArray
import yaml

from manip_sim.errors import ManipSimError
from manip_sim.models.object_creation import create_object
from manip_sim.physics.object_spawning import plan_with

BALL = '{name: ball, shape: sphere, size: 0.1, mass: 0.2, position: [1.5, 0.0, 2.0]}'


def numbers(vector):
    return np.array([vector.x, vector.y, vector.z])


def test_a_falling_ball_is_published_where_it_is_and_as_fast_as_it_falls(sim_node):
    sim = sim_node(objects=[BALL])
    sim.run_for(0.2)
    poses, twists = sim.messages('objects/ball/pose'), sim.messages('objects/ball/twist')
    assert poses[0].header.frame_id == twists[0].header.frame_id == 'world'
    np.testing.assert_allclose(numbers(poses[0].pose.position), [1.5, 0.0, 2.0])
    # The integrator takes the new velocity for each step.
    assert numbers(twists[-1].twist.linear)[2] == pytest.approx(-9.81 * 0.2, rel=1e-6)
    assert numbers(poses[-1].pose.position)[2] == pytest.approx(
        2.0 - 9.81 * 0.2 * (0.2 + 0.002) / 2.0, rel=1e-6)


def test_the_cube_of_the_table_is_published(sim_node):
    sim = sim_node(arena='table', arena__table_height=0.6)
    sim.run_for(0.1)
    height = numbers(sim.messages('objects/cube/pose')[-1].pose.position)[2]
    assert height == pytest.approx(0.625, abs=1e-3)


@pytest.mark.full
def test_the_latched_model_is_published_again_with_objects_that_come_and_go(serve, client):
    node = serve(arena='table')
    latched = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
    archives = client.listen(UInt8MultiArray, 'manip_sim/mjcf_archive', latched)
    texts = client.listen(String, 'manip_sim/mjcf', latched)

    def bodies():
        model = mujoco.MjSpec.from_zip(io.BytesIO(bytes(archives[-1].data))).compile()
        assert model.nbody == mujoco.MjModel.from_xml_string(texts[-1].data).nbody
        return {model.body(i).name for i in range(model.nbody)}

    client.spin_until(lambda: archives and texts)
    start = bodies()
    assert 'cube' in start
    simulation = node.simulation
    for plan, difference in (
            (plan_with(simulation.plan, create_object(yaml.safe_load(BALL))), {'ball'}),
            (simulation.plan, set())):
        count = len(texts)
        node.thread.call(lambda plan=plan: simulation.change_objects(plan))
        node.executor.create_task(node.shared.world_changed)
        client.spin_until(lambda n=count: len(texts) == len(archives) == n + 1)
        assert bodies() - start == difference


@pytest.mark.full
def test_noise_of_the_start_is_that_of_the_seed(serve, client):
    noisy = {'initialization_noise__magnitude': 0.05, 'start_paused': True}
    starts = [np.array(serve(seed=seed, **noisy).simulation.robot.state().position)
              for seed in (1, 1, 2)]
    np.testing.assert_array_equal(starts[0], starts[1])
    assert (starts[0][:7] != starts[2][:7]).all()
    assert np.abs(starts[0][:7] - starts[2][:7]).max() < 0.5


@pytest.mark.parametrize(('parameters', 'what'), [
    ({'objects': ['{name: ball, shape: sfere, size: 0.1, mass: 1.0}']}, 'sphere'),
    ({'objects': [BALL, BALL]}, "two objects have the name 'ball'"),
    ({'objects': ['missing.yaml']}, 'no such YAML file: missing.yaml'),
    ({'objects': ['{']}, "parameter 'objects' is invalid or unsafe YAML"),
    ({'arena': 'table', 'arena__table_height': 9.0}, 'must be from 0.1 to 2 m, got 9'),
    ({'arena__table_height': 0.7}, r"unknown parameter 'arena\.table_height'"),
    ({'seed': -1}, "parameter 'seed' must be from 0")])
def test_what_cannot_be_is_told(serve, parameters, what):
    with pytest.raises(ManipSimError, match=what) as error:
        serve(**parameters)
    assert '\n' not in str(error.value)
