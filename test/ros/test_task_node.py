# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A node that does a task: starts, success and reward, and its environment over topics."""

import contextlib
import json

from harness import DOMAIN
import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String
from std_srvs.srv import Trigger

from manip_sim.errors import CommandError, ManipSimError, ParameterError, UnknownNameError
from manip_sim.interface.composition import compose_world
from manip_sim.interface.parameter_spec import GivenParameters
from manip_sim.tasks import create_task
from manip_sim.tasks.task import TASKS

gymnasium = pytest.importorskip('gymnasium', reason='gymnasium is not installed')
from manip_sim.env import TaskEnv  # noqa: E402
from manip_sim.env.ros import NodeEnv  # noqa: E402

LOCKSTEP = {'stepping': 'lockstep', 'publish_rate': 20.0}
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture
def pick_cube(serve):
    """Return an environment over topics, and one in this process."""
    serve(task='pick_cube', lockstep_parts=['arm', 'right/gripper'], **LOCKSTEP)
    over_topics, here = NodeEnv('pick_cube', domain_id=DOMAIN), TaskEnv('pick_cube')
    yield over_topics, here
    over_topics.close()
    here.close()


def equal(one, other):
    assert one.keys() == other.keys()
    for key, value in one.items():
        np.testing.assert_array_equal(value, other[key], err_msg=key)


@pytest.mark.full
def test_an_episode_in_a_node_is_that_in_this_process_to_the_last_bit(pick_cube):
    over_topics, here = pick_cube
    assert over_topics.observation_space == here.observation_space
    assert over_topics.action_space == here.action_space
    expert = here.episode.task.expert(here.episode.simulation)
    for seed in (3, 5):
        (seen, info), (expected, its_info) = over_topics.reset(seed=seed), here.reset(seed=seed)
        equal(seen, expected)
        assert info == its_info
        expert.reset(seed)
        ended = False
        while not ended:
            action = expert.act()
            seen, *rest = over_topics.step(action)
            expected, *its_rest = here.step(action)
            equal(seen, expected)
            assert rest == its_rest
            ended = rest[1] or rest[2]
        assert rest[1] and rest[3]['digest'] == here.digest()


@pytest.mark.full
def test_an_episode_with_noise_in_a_node_is_that_in_this_process(serve):
    noise = {'noise.joint_position': 0.001, 'noise.wrench_bias': 0.5}
    serve(task='reach', lockstep_parts=['arm', 'right/gripper'], **noise, **LOCKSTEP)
    over_topics, here = NodeEnv('reach', domain_id=DOMAIN), TaskEnv('reach', noise=noise)
    (seen, info), (expected, its_info) = over_topics.reset(seed=3), here.reset(seed=3)
    assert info == its_info
    for number in range(4):
        equal(seen, expected)
        action = 0.3 * np.cos(np.arange(over_topics.action_space.shape[0]) + number)
        (seen, *_), (expected, *_) = over_topics.step(action), here.step(action)
    assert over_topics.digest() == here.digest()
    exact = here.episode.simulation.robot.reader.exact()[:len(seen['joint_position'])]
    assert 0.0 < np.abs(seen['joint_position'] - exact).max() < 0.01
    over_topics.close()
    here.close()


@pytest.mark.full
@pytest.mark.parametrize('latency', [
    {'command': 0.034, 'state': 0.15}, {'command': 0.05, 'command_jitter': 0.02}])
def test_late_episodes_with_noisy_images_in_a_node_are_those_in_this_process(serve, gl, latency):
    top = {'name': 'top', 'position': [0.0, 0.0, 2.0], 'look_at': [0.0, 0.0, 0.8]}
    alike = {'latency': latency, 'cameras': ['agentview', top], 'image_size': (40, 30),
             'noise': {'noise.joint_velocity': 0.01, 'noise.pixel': 8.0}}
    serve(task='pick_cube', lockstep_parts=['arm', 'right/gripper'], **LOCKSTEP,
          cameras=['agentview', json.dumps({**top, 'width': 40, 'height': 30})],
          camera__agentview__width=40, camera__agentview__height=30)
    over_topics, here = (NodeEnv('pick_cube', domain_id=DOMAIN, **alike),
                         TaskEnv('pick_cube', **alike))
    assert over_topics.observation_space == here.observation_space
    for seed in (3, 4):
        (seen, info), (expected, its_info) = over_topics.reset(seed=seed), here.reset(seed=seed)
        equal(seen, expected)
        assert info == its_info
        for number in range(6):
            action = np.cos(np.arange(7.0) + number)
            (seen, *rest), (expected, *its_rest) = over_topics.step(action), here.step(action)
            equal(seen, expected)
            assert rest == its_rest
            assert over_topics.digest() == here.digest()
    over_topics.close()
    here.close()


@pytest.mark.full
def test_an_option_of_a_reset_is_unknown_as_in_this_process(pick_cube):
    for env in pick_cube:
        with pytest.raises(UnknownNameError, match="option of reset 'start'"):
            env.reset(options={'start': 1})


@pytest.mark.parametrize('given, text', [
    ({'latency': {'state': 0.02}}, 'latency of a state with a node must be a whole number of'),
    ({'latency': {'command': 0.1, 'state_jitter': 0.01}},
     'latency of states with jitter cannot be used'),
    ({'render_mode': 'rgb_array'}, 'render_mode cannot be used')])
def test_what_an_environment_over_topics_cannot_do_is_said(given, text):
    with pytest.raises(ManipSimError, match=text):
        NodeEnv('reach', domain_id=DOMAIN, **given)


@pytest.mark.full
def test_images_of_another_size_than_the_nodes_are_said(serve, gl):
    serve(task='reach', lockstep_parts=['arm', 'right/gripper'], cameras=['agentview'], **LOCKSTEP)
    # An image may come while it connects, or only when it observes.
    with (pytest.raises(ManipSimError, match='640 x 480 pixels, not 40 x 30; see image_size'),
          contextlib.closing(NodeEnv('reach', domain_id=DOMAIN, cameras=['agentview'],
                                     image_size=(40, 30))) as env):
        env.reset(seed=1)


@pytest.mark.full
@pytest.mark.parametrize('action', ['joint_position', 'joint_velocity', 'joint_effort'])
def test_actions_of_joints_do_the_same_in_a_node_as_in_this_process(serve, action):
    serve(task='reach', lockstep_parts=['arm', 'right/gripper'], **LOCKSTEP)
    over_topics = NodeEnv('reach', domain_id=DOMAIN, action=action)
    here = TaskEnv('reach', action=action)
    assert over_topics.action_space == here.action_space
    (seen, info), (expected, its_info) = over_topics.reset(seed=3), here.reset(seed=3)
    start = expected['joint_position'][:7] if action == 'joint_position' else 0.0
    assert info == its_info
    for number in range(6):
        equal(seen, expected)
        goals = start + 0.1 * np.cos(np.arange(7) + number)
        (seen, *_), (expected, *_) = (env.step([*goals, -0.5]) for env in (over_topics, here))
    assert over_topics.digest() == here.digest()
    assert np.abs(expected['joint_velocity']).max() > 0.01
    over_topics.close()
    here.close()


@pytest.mark.full
def test_bad_actions_over_topics_change_nothing(pick_cube):
    over_topics, _ = pick_cube
    with pytest.raises(gymnasium.error.ResetNeeded):
        over_topics.step(np.zeros(7))
    over_topics.reset(seed=1)
    before = over_topics.digest()
    for action in (np.zeros(6), np.full(7, np.nan)):
        with pytest.raises(CommandError, match='an action'):
            over_topics.step(action)
    assert over_topics.digest() == before
    with pytest.raises(ManipSimError, match='seed 2147483648: '):
        over_topics.reset(seed=2**31)
    with pytest.raises(ManipSimError, match='does pick_cube with Panda, not reach with Panda'):
        NodeEnv('reach', domain_id=DOMAIN)


def test_success_and_reward_are_on_a_latched_topic(serve, client):
    node = serve(task='reach', seed=4, start_paused=True)
    found = []
    client.node.create_subscription(
        String, '/manip_sim/task', lambda message: found.append(json.loads(message.data)), LATCHED)
    client.spin_until(lambda: bool(found))
    simulation = node.simulation
    assert found[0]['task'] == 'reach' and found[0]['seed'] == 4
    assert found[0]['goal'] == simulation.data.body('goal').xpos.tolist()
    assert found[0]['success'] is False and 0.0 < found[0]['reward'] < 1.0
    # A point that is where the end effector is has been reached.
    node.thread.call(lambda: simulation.data.mocap_pos.__setitem__(
        slice(None), simulation.data.site('gripper0_right_grip_site').xpos))
    step = client.node.create_client(Trigger, '/manip_sim/step')
    client.spin_until(step.service_is_ready)
    done = step.call_async(Trigger.Request())
    client.spin_until(lambda: done.done() and found[-1]['stamp_ns'] > found[0]['stamp_ns'])
    assert found[-1]['success'] is True and found[-1]['reward'] == 1.0


def test_numbers_of_numpy_that_a_task_returns_are_published(serve, client):
    class Numbers(type(create_task('reach'))):
        name = 'numbers'

        def success(self, simulation):
            return np.bool_(True)

        def reward(self, simulation):
            return np.float32(0.5)

    found = []
    client.node.create_subscription(
        String, '/manip_sim/task', lambda message: found.append(json.loads(message.data)), LATCHED)
    try:
        serve(task='numbers', start_paused=True)
        client.spin_until(lambda: bool(found))
    finally:
        del TASKS._classes['numbers']
    assert found[0]['success'] is True and found[0]['reward'] == 0.5


@pytest.mark.parametrize('given, error, text', [
    ({'task': 'pick_cub'}, UnknownNameError, "did you mean 'pick_cube'"),
    ({'task': 'pick_cube', 'arena': 'table'}, ParameterError, "'arena' cannot be combined"),
    ({'task': 'pick_cube', 'objects': ['{name: a}']}, ParameterError, "'objects' cannot be"),
    ({'task': 'pick_cube', 'robots': ['left', 'right']}, ParameterError, "'robots' cannot be"),
    ({'task': 'pick_cube', 'gripper': 'none'}, ManipSimError, 'pick_cube needs 1 arm')])
def test_what_does_not_go_with_a_task_is_said(given, error, text):
    with pytest.raises(error, match=text):
        compose_world(GivenParameters(given))


def test_a_task_with_two_robots_has_a_namespace_for_each():
    composition = compose_world(GivenParameters({'task': 'hand_over'}))
    assert [scope.name for scope in composition.scopes] == ['robot0', 'robot1']
