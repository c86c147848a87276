# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Environments as LeRobot's evaluator uses them: what it asks for, and what it counts."""

import types

import numpy as np
import pytest

gymnasium = pytest.importorskip('gymnasium', reason='gymnasium is not installed')

from lerobot_env_manip_sim import make_env  # noqa: E402
from manip_sim.env import TaskEnv, TaskVectorEnv  # noqa: E402
from manip_sim.env.lerobot_env import LeRobotEnv  # noqa: E402
from manip_sim.errors import ManipSimError, UnknownNameError  # noqa: E402

REACH = {'task': 'reach', 'cameras': (), 'image_size': None}


def towards(observation):
    """Return actions of several environments, from what LeRobot hands to a policy."""
    # Nine joints, then the pose; the goal is all that reach has around it.
    way = observation['environment_state'][:, :3] - observation['agent_pos'][:, 9:12]
    return np.concatenate([np.clip(way / 0.05, -1.0, 1.0), np.zeros((len(way), 4))], axis=1)


def rollout(env, seeds, policy):
    """Run episodes as LeRobot 0.6.1's evaluator does, and return which succeed."""
    observation, _ = env.reset(seed=seeds, options={'lerobot_new_rollout': True})
    done, succeeded = np.zeros(env.num_envs, bool), np.zeros(env.num_envs, bool)
    for _ in range(env.call('_max_episode_steps')[0]):
        observation, _, terminated, truncated, info = env.step(policy(observation))
        if 'final_info' in info:
            succeeded |= ~done & np.asarray(info['final_info']['is_success'], bool)
        done |= terminated | truncated
        if done.all():
            break
    assert done.all()
    return succeeded.tolist()


@pytest.mark.parametrize('asynchronous', [False, pytest.param(True, marks=pytest.mark.full)])
def test_the_evaluator_counts_the_successes_of_single_episodes(asynchronous):
    env = make_env(n_envs=3, use_async_envs=asynchronous, **REACH)['reach'][0]
    assert type(env).__name__ == ('AsyncVectorEnv' if asynchronous else 'SyncVectorEnv')
    assert env.call('task') == ('reach',) * 3
    assert set(env.call('task_description')) == {'Move the end effector to the green point.'}
    assert env.call('_max_episode_steps') == (60,) * 3
    assert rollout(env, [0, 1, 2], towards) == [True] * 3
    assert rollout(env, [0, 1, 2], lambda seen: np.zeros((3, 7))) == [False] * 3
    env.close()


@pytest.mark.full
def test_observations_have_lerobots_names_and_the_order_of_our_data_sets():
    env = make_env(task='pick_cube', cameras=('agentview',), image_size=(64, 48))['pick_cube'][0]
    observation, _ = env.reset(seed=[4])
    plain = TaskEnv('pick_cube')
    expected, _ = plain.reset(seed=4)
    np.testing.assert_array_equal(
        observation['agent_pos'][0],
        [*expected['joint_position'], *expected['eef_pose'].ravel()])
    np.testing.assert_array_equal(
        observation['environment_state'][0], expected['object_pose'].ravel())
    assert observation['pixels']['agentview'].shape == (1, 48, 64, 3)
    assert observation['pixels']['agentview'].dtype == np.uint8
    assert env.observation_space.contains(observation)
    assert env.call('render')[0].shape == (360, 480, 3)
    env.close()
    plain.close()


def test_the_task_of_a_configuration_counts():
    env = make_env(cfg=types.SimpleNamespace(task='reach', fps=20), cameras=())
    assert list(env) == ['reach']
    env['reach'][0].close()


@pytest.mark.parametrize('keywords, text', [
    ({'task': 'pick_cub'}, "unknown task 'pick_cub': did you mean 'pick_cube'"),
    ({'n_envs': 0}, 'n_envs'), ({'robott': 'UR5e'}, 'robott'),
    ({'cameras': ('agentvieu',)}, "did you mean 'agentview'")])
def test_what_cannot_be_used_is_said_at_once(keywords, text):
    with pytest.raises(ManipSimError) as raised:
        make_env(**keywords)
    assert text in str(raised.value)


def test_options_of_others_are_rejected():
    env = LeRobotEnv(TaskEnv('reach'))
    with pytest.raises(UnknownNameError, match="option of reset 'start'"):
        env.reset(options={'start': 1})
    env.close()


def test_many_worlds_in_one_process_have_the_same_keys():
    env = TaskVectorEnv('reach', 2, threads=1)
    assert env.call('_max_episode_steps') == env.get_attr('_max_episode_steps') == (60, 60)
    assert env.call('task') == ('reach', 'reach')
    _, infos = env.reset(seed=0)
    assert env.call('digest') == tuple(env.digest())
    np.testing.assert_array_equal(infos['is_success'], infos['success'])
    _, _, _, _, infos = env.step(np.zeros((2, 7)))
    np.testing.assert_array_equal(infos['is_success'], infos['success'])
    with pytest.raises(AttributeError):
        env.call('no_such_thing')
    env.close()


def test_the_most_steps_of_an_episode_are_those_until_its_time_is_up():
    env = TaskEnv('reach', control_hz=15.0)
    env.reset(seed=0)
    steps, truncated = 0, False
    while not truncated:
        _, _, _, truncated, info = env.step(np.zeros(7))
        assert info['is_success'] is info['success'] is False
        steps += 1
    assert steps == env._max_episode_steps == 45
    env.close()


def test_lerobot_knows_the_environments_by_type_with_the_shapes_of_their_observations():
    pytest.importorskip('lerobot.envs', reason='LeRobot is not installed')
    from lerobot.configs.parser import load_plugin
    from lerobot.envs import EnvConfig, env_to_policy_features, make_env as make_lerobots_env
    load_plugin('lerobot_env_manip_sim')
    config = EnvConfig.get_choice_class('manip_sim')(image_size=(64, 48))
    shapes = {key: feature.shape for key, feature in env_to_policy_features(config).items()}
    assert shapes == {'action': (7,), 'observation.state': (16,),
                      'observation.environment_state': (7,),
                      'observation.images.agentview': (3, 48, 64)}
    env = make_lerobots_env(config, n_envs=2)['pick_cube'][0]
    observation, _ = env.reset(seed=[0, 1])
    assert observation['pixels']['agentview'].shape == (2, 48, 64, 3)
    assert env.call('_max_episode_steps') == (120,) * 2
    env.close()
