# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Environments of gymnasium: they pass its own checkers, and are what an episode is."""

import functools
import time

import numpy as np
import pytest

gymnasium = pytest.importorskip('gymnasium', reason='gymnasium is not installed')
from gymnasium.utils.env_checker import check_env, data_equivalence  # noqa: E402
from gymnasium.vector import AutoresetMode  # noqa: E402

import manip_sim.env  # noqa: E402
from manip_sim.env import TaskEnv, TaskVectorEnv  # noqa: E402
from manip_sim.errors import (  # noqa: E402
    CommandError, ManipSimError, ModelError, UnknownNameError)
from manip_sim.simulation import Simulation  # noqa: E402
from manip_sim.tasks import create_task, Episode, Setting, task_names  # noqa: E402

#: What the checker dislikes, and why it is so: states have no bounds, and actions have units.
WARNINGS = [pytest.mark.filterwarnings(f'ignore:.*{text}') for text in (
    'observation space m..imum value is -?infinity', 'we recommend using a symmetric')]


def checked(**arguments):
    env = gymnasium.make('manip_sim/Reach-v0', **arguments)
    check_env(env.unwrapped)
    return env


@pytest.fixture
def reach():
    env = gymnasium.make('manip_sim/Reach-v0').unwrapped
    yield env
    env.close()


@pytest.mark.full
@WARNINGS[0]
@WARNINGS[1]
@pytest.mark.parametrize('arguments', [
    {}, {'action': 'joint_position'}, {'action': 'joint_velocity', 'latency': 0.03},
    {'action': 'joint_effort', 'latency': {'command': 0.01, 'state': 0.07}}])
def test_gymnasiums_checker_finds_nothing_wrong(arguments, gl):
    env = checked(**arguments)
    env.close()
    env.close()


@pytest.mark.full
@WARNINGS[0]
@WARNINGS[1]
def test_gymnasiums_checker_finds_nothing_wrong_with_images(gl):
    env = checked(cameras=['agentview'], image_size=(40, 30), render_mode='rgb_array')
    observation, _ = env.reset(seed=2)
    assert observation['image/agentview'].shape == (30, 40, 3)
    before = observation['image/agentview'].copy()
    for _ in range(8):
        observation, *_ = env.step(np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    assert np.abs(observation['image/agentview'].astype(int) - before).max() > 30
    assert env.render().shape == (360, 480, 3)
    env.close()


@pytest.mark.full
@pytest.mark.parametrize('task', task_names())
def test_each_task_is_an_environment_whose_episodes_are_those_of_the_task(task):
    env = gymnasium.make(manip_sim.env.env_id(task)).unwrapped
    own = create_task(task)
    episode = Episode(own, Simulation(own.world))
    expert = own.expert(env.episode.simulation)
    observation, info = env.reset(seed=4)
    episode.reset(4)
    expert.reset(4)
    assert info['digest'] == episode.digest and info['seed'] == 4
    for _ in range(5):
        action = expert.act()
        episode.step(action)
        observation, reward, terminated, truncated, info = env.step(action)
        assert (reward, terminated, truncated) == (episode.reward, False, False)
    assert env.digest() == episode.digest and 'digest' not in info
    for key, value in episode.observation.items():
        np.testing.assert_array_equal(observation[key], value)
    env.close()


def test_success_terminates_and_the_end_of_the_time_truncates(reach):
    expert = reach.episode.task.expert(reach.episode.simulation)
    for idle, ends in ((False, (True, False)), (True, (False, True))):
        reach.reset(seed=1)
        expert.reset(1)
        for period in range(1, 61):  # noqa: B007
            action = np.zeros(7) if idle else expert.act()
            _, reward, terminated, truncated, info = reach.step(action)
            if terminated or truncated:
                break
        assert (terminated, truncated) == ends and (period == 60) == idle
        assert info['success'] == terminated and info['digest'] == reach.digest()
        assert (reward == 1.0) == terminated


def test_without_a_seed_the_next_start_follows_from_the_last_seed(reach):
    seeds = []
    for _ in range(2):
        reach.reset(seed=8)
        seeds.append([reach.reset()[1]['seed'] for _ in range(3)])
    assert seeds[0] == seeds[1] and len(set(seeds[0])) == 3
    digest = reach.reset()[1]
    assert reach.reset(seed=digest['seed'])[1]['digest'] == digest['digest']


def test_what_observations_are_is_what_the_simulation_has(reach):
    observation, _ = reach.reset(seed=3)
    simulation = reach.episode.simulation
    robot, state = simulation.robot, simulation.robot.state()
    np.testing.assert_array_equal(observation['joint_position'], state.position)
    np.testing.assert_array_equal(observation['joint_velocity'], state.velocity)
    np.testing.assert_array_equal(observation['joint_effort'], state.effort)
    site = simulation.data.site(robot.end_effectors['right'].grip_site)
    np.testing.assert_array_equal(observation['eef_pose'][0, :3], site.xpos)
    np.testing.assert_array_equal(
        observation['goal'], simulation.data.body('goal').xpos)
    assert reach.episode.observer.names['joint_position'] == list(robot.joint_names)
    assert reach.episode.observer.names['eef_pose'] == ['robot0/right']


def test_actions_of_joints_are_goals_in_si_units():
    env = gymnasium.make('manip_sim/Reach-v0', action='joint_position').unwrapped
    observation, _ = env.reset(seed=3)
    goal = observation['joint_position'][:7] + [0.1, 0.0, -0.05, 0.0, 0.0, 0.08, 0.0]
    for _ in range(12):
        observation, *_ = env.step(np.array([*goal, 1.0]))
    np.testing.assert_allclose(observation['joint_position'][:7], goal, atol=1e-3)
    np.testing.assert_array_equal(
        env.action_space.high[:7], env.episode.simulation.robot.limits('arm')[:, 1])
    env.close()
    env = gymnasium.make('manip_sim/Reach-v0', action='joint_velocity').unwrapped
    env.reset(seed=3)
    for _ in range(10):
        observation, *_ = env.step(np.array([0.2, *np.zeros(6), 0.0]))
    assert observation['joint_velocity'][0] == pytest.approx(0.2, abs=0.005)
    env.close()


def test_what_cannot_be_used_is_said(reach):
    with pytest.raises(gymnasium.error.ResetNeeded, match='call reset'):
        reach.step(np.zeros(7))
    reach.reset(seed=1)
    before = reach.digest()
    for action, text in ((np.zeros(6), 'an action must have 7 numbers, got 6'),
                         (np.full(7, np.nan), 'must be finite'), ('left', 'must be numbers')):
        with pytest.raises(CommandError, match=text):
            reach.step(action)
    assert reach.digest() == before
    for seed in (-1, 1.5):
        with pytest.raises((ModelError, gymnasium.error.Error)):
            reach.reset(seed=seed)
    with pytest.raises(UnknownNameError, match="option of reset 'start'"):
        reach.reset(options={'start': 1})


@pytest.mark.parametrize('arguments, text', [
    ({'robot': 'Pandda'}, "unknown robot 'Pandda': did you mean 'Panda'"),
    ({'action': 'osc'}, "unknown action 'osc': did you mean 'osc_pose'"),
    ({'cameras': ['agent']}, "unknown camera 'agent': did you mean 'agentview'"),
    ({'cameras': ['agentview'], 'image_size': (0, 3)}, 'image_size must be width and height'),
    ({'image_size': 64}, 'image_size must be width and height .*, got 64$'),
    ({'cameras': 5}, '^cameras must be a list, got 5'),
    ({'cameras': 'agentview'}, "^cameras must be a list, got 'agentview'"),
    ({'cameras': [5]}, '^each of the cameras must be a name or a description, got 5'),
    ({'cameras': [{'name': 'top', 'position': np.zeros(2)}]}, "'position'"),
    ({'noise': 0.1}, '^noise must be a mapping, such as .*, got 0.1'),
    ({'image_kinds': iter([5])}, '^unknown kind of images .5.'),
    ({'image_kinds': np.zeros((2, 2))}, '^unknown kind of images'),
    ({'gripper': np.zeros(2)}, '^gripper must be a name, a file, a gripper, None or a mapping'),
    ({'image_kinds': None}, '^image_kinds must be a list, got None'),
    ({'objects': 5}, '^objects must be a list, got 5'),
    ({'control_hz': 1e30}, 'got 1e-30 s; the nearest rates are 500 Hz'),
    ({'image_kinds': ['rgb', 'dept']}, "unknown kind of images 'dept': did you mean 'depth'"),
    ({'image_kinds': 'depth'}, "image_kinds must be one or several .*, in a list, got 'depth'"),
    ({'image_kinds': ()}, 'image_kinds must be one or several of rgb, depth, labels'),
    ({'image_kinds': ['rgb', 'rgb']}, r'each once, in a list, got ..rgb., .rgb.'),
    ({'latency': -0.1}, 'latency of a command must be from 0 to 10 s, got -0.1'),
    ({'latency': {'states': 0.1}}, "unknown key of latency 'states': did you mean 'state'"),
    ({'noise': {'noise.joint_positon': 0.1}}, "did you mean 'noise.joint_position'"),
    ({'noise': {'latency.image': 0.1}}, "give latency={'state': ...}"),
    ({'latency': 0.1, 'noise': {'latency.command': 0.1}},
     'both latency= and noise set latency.command: give one of them'),
    ({'noise': {'noise.joint_position': -0.1}}, 'noise.joint_position must be a number from 0'),
    ({'latency': 0.0011}, 'latency of a command must be a whole number of timesteps'),
    ({'control_hz': 0}, 'control_hz must be above 0 Hz'),
    ({'control_hz': 30, 'timestep_s': 0.002},
     r'a control period must be a whole number of timesteps of 0\.002 s, got 0\.0333333 s; the '
     r'nearest rates are 29\.41176471, 31\.25 Hz; or use timestep_s=0\.001960784$'),
    ({'gripper': 'none'}, 'reach needs 1 arm with grippers, Panda has 0'),
    ({'render_mode': np.zeros(2)}, '^unknown render_mode'),
    ({'render_mode': 'ascii'}, "unknown render_mode 'ascii': available: rgb_array")])
def test_arguments_that_cannot_be_used_are_said(arguments, text):
    with pytest.raises(ManipSimError, match=text):
        manip_sim.env.TaskEnv('reach', **arguments)


@pytest.mark.full
def test_an_episode_whose_physics_diverges_is_truncated(reach):
    reach.reset(seed=1)
    reach.episode.simulation.data.qvel[0] = np.nan
    _, reward, terminated, truncated, info = reach.step(np.zeros(7))
    assert (reward, terminated, truncated) == (0.0, False, True)
    assert 'the physics diverged' in info['diverged']
    _, info = reach.reset(seed=1)
    assert 'diverged' not in info and not reach.step(np.zeros(7))[3]


@pytest.mark.full
@pytest.mark.parametrize('task, arguments', [
    ('Reach', {'latency': {'command': 0.03, 'state': 0.04}}),
    ('Reach', {'noise': {'noise.joint_velocity': 0.01, 'latency.state': 0.06}}),
    ('Reach', {'latency': {'command': 0.05, 'command_jitter': 0.03, 'state_jitter': 0.02}}),
    ('PickCube', {'robot': 'UR5e', 'action': 'joint_velocity'}),
    ('StackCubes', {'robot': 'Baxter', 'noise': {'noise.wrench_force': 0.1}}),
    ('HandOver', {}),
    ('OpenDrawer', {'robot': 'PandaOmron', 'action': 'joint_effort'})])
def test_a_vector_environment_equals_as_many_environments(task, arguments, monkeypatch):
    vector, single = (gymnasium.make_vec(f'manip_sim/{task}-v0', 3, vectorization_mode=mode,
                                         control_hz=10, **arguments)
                      for mode in (None, 'sync'))
    assert isinstance(vector, manip_sim.env.TaskVectorEnv)
    monkeypatch.setattr(type(vector.episodes[0].task), 'horizon_s', 0.7)
    assert vector.observation_space == single.observation_space
    assert vector.action_space == single.action_space
    assert data_equivalence(vector.reset(seed=5), single.reset(seed=5), exact=True)
    assert data_equivalence(vector.reset(), single.reset(), exact=True)
    single.action_space.seed(1)
    ended = 0
    for _ in range(17):
        actions = single.action_space.sample()
        mine, theirs = vector.step(actions), single.step(actions)
        assert data_equivalence(mine, theirs, exact=True)
        assert mine[0] in vector.observation_space
        ended += int(mine[3].sum())
    assert ended >= 6
    vector.close()
    vector.close()
    single.close()


def vectors(mode, **arguments):
    """Return our vector environment of three, and gymnasium's of as many single ones."""
    arguments = {'control_hz': 10, **arguments}
    return (gymnasium.make_vec('manip_sim/Reach-v0', 3, autoreset_mode=mode, **arguments),
            gymnasium.vector.SyncVectorEnv(
                [lambda: gymnasium.make('manip_sim/Reach-v0', **arguments)] * 3,
                autoreset_mode=mode))


@pytest.mark.full
@pytest.mark.parametrize('mode', AutoresetMode)
@pytest.mark.parametrize('arguments', [
    {}, {'noise': {'noise.joint_velocity': 0.01}, 'latency': {'command': 0.03, 'state': 0.04}}])
def test_each_autoreset_mode_is_that_of_gymnasium(mode, arguments, monkeypatch):
    vector, single = vectors(mode, **arguments)
    monkeypatch.setattr(type(vector.episodes[0].task), 'horizon_s', 0.6)
    assert vector.metadata['autoreset_mode'] == single.metadata['autoreset_mode'] == mode
    assert data_equivalence(vector.reset(seed=5), single.reset(seed=5), exact=True)
    single.action_space.seed(1)
    random = np.random.default_rng(2)
    ended = partial = 0
    for step in range(24):
        actions = single.action_space.sample()
        mine, theirs = vector.step(actions), single.step(actions)
        assert data_equivalence(mine, theirs, exact=True)
        ended += int((mine[2] | mine[3]).sum())
        mask = mine[2] | mine[3] if mode == AutoresetMode.DISABLED else np.zeros(3, dtype=bool)
        mask |= random.random(3) < 0.15
        if mask.any():
            seeds = [None, int(random.integers(9)), None]
            given = {'reset_mask': mask}
            mine = vector.reset(seed=seeds, options=given)
            assert list(given) == ['reset_mask']
            assert data_equivalence(mine, single.reset(seed=seeds, options=given), exact=True)
            partial += 1
        assert step % 5 or vector.call('digest') == single.call('digest')
    assert ended >= 6 and partial >= 6
    vector.close()
    single.close()


def test_a_partial_reset_leaves_the_other_environments_as_they_are():
    vector = gymnasium.make_vec('manip_sim/Reach-v0', 3)
    vector.reset(seed=1)
    for _ in range(3):
        before, *_ = vector.step(np.ones((3, 7)))
    digests, periods = vector.digest(), [episode.periods for episode in vector.episodes]
    after, infos = vector.reset(seed=40, options={'reset_mask': np.array([False, True, False])})
    assert infos['seed'].tolist() == [0, 41, 0] and infos['_seed'].tolist() == [0, 1, 0]
    for key, value in after.items():
        np.testing.assert_array_equal(value[[0, 2]], before[key][[0, 2]])
    assert np.abs(after['goal'][1] - before['goal'][1]).max() > 1e-3
    assert [digest == old for digest, old in zip(vector.digest(), digests)] == [1, 0, 1]
    assert periods == [3] * 3 and [episode.periods for episode in vector.episodes] == [3, 0, 3]
    vector.close()


@pytest.mark.parametrize('mask, text', [
    (np.ones(3, dtype=bool), r'must be an array of booleans of shape \(2,\), got bool of shape'),
    (np.ones(2), r'reset_mask must be an array of booleans of shape \(2,\), got float64 of shape'),
    (np.ones((2, 1), dtype=bool), r'got bool of shape \(2, 1\)'),
    ([True, False], r'got \[True, False\]'), (None, 'got None'), (1, 'got 1'),
    (np.zeros(2, dtype=bool), 'reset_mask chooses no environment')])
def test_a_mask_that_cannot_be_used_resets_nothing(mask, text, pair):
    pair.reset(seed=1)
    before = pair.digest()
    with pytest.raises(ModelError, match=text):
        pair.reset(seed=7, options={'reset_mask': mask})
    assert pair.digest() == before


@pytest.fixture
def pair():
    vector = gymnasium.make_vec('manip_sim/Reach-v0', 2)
    yield vector
    vector.close()


def test_bad_options_and_seeds_reset_nothing(pair):
    one = {'reset_mask': np.array([True, False])}
    with pytest.raises(gymnasium.error.ResetNeeded, match='call reset.. without reset_mask first'):
        pair.reset(seed=1, options=one)
    pair.reset(seed=1)
    before = pair.digest()
    with pytest.raises(UnknownNameError, match="option of reset 'reset_msk': did you mean"):
        pair.reset(options={'reset_msk': np.ones(2, dtype=bool)})
    for seed in ([3, -1], [3, 1.5], [3, '4'], -2):
        with pytest.raises(ModelError, match='seed must be a whole number from 0'):
            pair.reset(seed=seed)
    with pytest.raises(ModelError, match='expected 2 seeds'):
        pair.reset(seed=[1], options=one)
    assert pair.digest() == before
    pair.reset(seed=[3, -1], options=one)  # The seed of one that goes on does not count.
    assert pair.digest()[1] == before[1] and pair.digest()[0] != before[0]


def test_success_is_asked_once_in_each_period(monkeypatch, pair):
    times = []

    def success(self, simulation):
        times.append(simulation.time_s)
        return simulation.time_s > 0.07

    monkeypatch.setattr(type(create_task('reach')), 'success', success)
    monkeypatch.setattr(type(create_task('reach')), 'reward', lambda *_: 0.0)
    pair.reset(seed=0)
    times.clear()
    for action in np.zeros((2, 2, 7)):
        _, _, terminated, *_ = pair.step(action)
    assert [round(time, 2) for time in times] == [0.05, 0.05, 0.1, 0.1] and terminated.all()


def test_without_autoreset_a_step_after_an_end_is_rejected(monkeypatch):
    vector = gymnasium.make_vec('manip_sim/Reach-v0', 2, autoreset_mode='Disabled')
    vector.reset(seed=1)
    monkeypatch.setattr(type(vector.episodes[0].task), 'horizon_s', 0.1)
    vector.episodes[0].periods = 1
    _, _, terminated, truncated, _ = vector.step(np.zeros((2, 7)))
    assert truncated.tolist() == [True, False] and not terminated.any()
    before = vector.digest()
    with pytest.raises(gymnasium.error.ResetNeeded, match='episode of environment 0 has ended'):
        vector.step(np.zeros((2, 7)))
    assert vector.digest() == before
    vector.reset(options={'reset_mask': truncated})
    vector.step(np.zeros((2, 7)))
    vector.close()


def test_an_unknown_autoreset_mode_is_told_with_those_there_are():
    with pytest.raises(UnknownNameError, match="'SameSetp': did you mean 'SameStep'"):
        gymnasium.make_vec('manip_sim/Reach-v0', 2, autoreset_mode='SameSetp')
    with pytest.raises(UnknownNameError, match='unknown autoreset_mode'):
        gymnasium.make_vec('manip_sim/Reach-v0', 2, autoreset_mode=None)


def test_environments_of_a_vector_are_asked_and_changed_as_gymnasiums(pair):
    assert pair.call('task') == ('reach',) * 2
    assert all(isinstance(text, str) and text for text in pair.call('task_description'))
    assert pair.call('_max_episode_steps') == (60,) * 2
    pair.reset(seed=1)
    assert pair.get_attr('episode') == pair.episodes and list(pair.call('digest')) == pair.digest()
    assert pair.get_attr('action_space') == (pair.single_action_space,) * 2
    assert pair.call('render') == (None, None)
    pair.set_attr('np_random', [np.random.default_rng(4), np.random.default_rng(4)])
    seeds = pair.reset()[1]['seed']
    assert seeds[0] == seeds[1]
    pair.set_attr('label', 'one')
    assert pair.get_attr('label') == ('one', 'one')
    pair.set_attr('task', ['left', 'right'])
    assert pair.get_attr('task') == ('left', 'right')
    with pytest.raises(AttributeError, match="no 'task_descripton': did you mean 'task_descript"):
        pair.call('task_descripton')
    with pytest.raises(AttributeError, match="'episode' of environments cannot be changed"):
        pair.set_attr('episode', None)
    with pytest.raises(ValueError, match="expected 2 values of 'label'"):
        pair.set_attr('label', [1, 2, 3])


@pytest.mark.full
def test_the_vector_environment_shows_each_world(gl):
    vector = gymnasium.make_vec('manip_sim/Reach-v0', 2, render_mode='rgb_array',
                                cameras=['frontview'], image_size=(32, 24))
    observation, _ = vector.reset(seed=[1, 2])
    images = vector.render()
    for image, called in zip(images, vector.call('render')):
        np.testing.assert_array_equal(image, called)
    assert [image.shape for image in images] == [(360, 480, 3)] * 2
    assert observation['image/frontview'].shape == (2, 24, 32, 3)
    assert not np.array_equal(*images)
    vector.close()


@pytest.mark.full
def test_depth_and_labels_are_observed_beside_colours_or_alone(gl):
    arguments = {'cameras': ['frontview'], 'image_size': (64, 48)}
    env = gymnasium.make('manip_sim/PickCube-v0', image_kinds=['labels', 'depth'], **arguments)
    observation, _ = env.reset(seed=2)
    assert observation in env.observation_space and 'image/frontview' not in observation
    depth, labels = observation['depth/frontview'], observation['labels/frontview']
    assert depth.shape == labels.shape == (48, 64)
    assert (depth.dtype, labels.dtype) == (np.float32, np.int32)
    data = env.unwrapped.episode.simulation.data
    cube, camera = data.body('cube'), data.camera('frontview')
    away = camera.xmat.reshape(3, 3)[:, 2] @ (camera.xpos - cube.xpos)
    seen = labels == cube.id
    assert 2 <= seen.sum() < 100
    np.testing.assert_allclose(depth[seen], away, atol=0.05)
    env.close()
    vector, single = (gymnasium.make_vec(
        'manip_sim/PickCube-v0', 2, vectorization_mode=mode, **arguments,
        image_kinds=('rgb', 'depth', 'labels'),
        noise={'noise.pixel': 3.0, 'noise.depth': 0.01}) for mode in (None, 'sync'))
    assert vector.observation_space == single.observation_space
    assert data_equivalence(vector.reset(seed=2), single.reset(seed=2), exact=True)
    actions = np.ones((2, 7))
    mine, theirs = vector.step(actions), single.step(actions)
    assert data_equivalence(mine, theirs, exact=True) and mine[0] in vector.observation_space
    noisy, clean = vector.reset(seed=2)[0]['depth/frontview'][0], depth
    assert 0.001 < np.abs(noisy - clean)[seen].max() < 0.2
    vector.close()
    single.close()


def test_a_bad_action_of_one_world_changes_none():
    vector = gymnasium.make_vec('manip_sim/Reach-v0', 2)
    with pytest.raises(gymnasium.error.ResetNeeded):
        vector.step(np.zeros((2, 7)))
    vector.reset(seed=1)
    before = vector.digest()
    bad = np.zeros((2, 7))
    bad[1, 3] = np.inf
    with pytest.raises(CommandError, match='the action of environment 1 must be finite'):
        vector.step(bad)
    with pytest.raises(CommandError, match=r'must have the shape \(2, 7\), got \(7,\)'):
        vector.step(np.zeros(7))
    with pytest.raises(ModelError, match='expected 2 seeds'):
        vector.reset(seed=[1])
    assert vector.digest() == before
    vector.close()
    with pytest.raises(ManipSimError, match='num_envs must be a whole number from 1, got 0'):
        manip_sim.env.TaskVectorEnv('reach', 0)


@pytest.mark.parametrize(
    'make', [gymnasium.make, functools.partial(gymnasium.make_vec, num_envs=2)])
def test_an_unknown_keyword_is_told_with_the_nearest_ones(make):
    with pytest.raises(UnknownNameError, match="unknown keyword 'contol_hz'.*'control_hz'"):
        make('manip_sim/Reach-v0', contol_hz=10)
    with pytest.raises(UnknownNameError, match="unknown keyword 'timstep_s'.*'timestep_s'"):
        make('manip_sim/Reach-v0', timstep_s=0.001)
    with pytest.raises(UnknownNameError, match="unknown keyword 'arena'"):  # It is the task's.
        make('manip_sim/Reach-v0', arena='bins')


# ---------------------------------------------------------------------- late answers


def test_a_step_lasts_until_the_policy_is_asked_again():
    env = TaskEnv('reach', answer_time=0.12)
    setting = Setting('reach', answer_time=0.12)
    episode = setting.create_episode()
    answers = setting.create_answers(episode)
    action = np.array([1.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0])
    env.reset(seed=5)
    episode.reset(5)
    answers.reset(5)
    for _ in range(3):
        _, reward, _, _, _ = env.step(action)
        answers.answer(action)
        expected = 0.0
        for _ in range(3):
            answers.advance()
            expected += episode.reward
        assert reward == expected and env.digest() == episode.digest
    assert env.episode.periods == 9
    env.close()


@pytest.mark.full
def test_actions_that_are_late_are_those_that_were_given_whatever_becomes_of_their_array():
    digests = []
    for changes in (False, True):
        vector = gymnasium.make_vec('manip_sim/Reach-v0', 2, answer_time={
            'time': 0.1, 'ask_ahead': 1}, chunk=3)
        vector.reset(seed=4)
        for value in (0.9, -0.7):
            actions = np.full((2, 3, 7), value)
            vector.step(actions)
            if changes:
                actions[:] = np.nan
        digests.append(vector.call('digest'))
        vector.close()
    assert digests[0] == digests[1]


def test_a_chunk_is_taken_in_one_step():
    env, single = TaskEnv('reach', chunk=4), TaskEnv('reach')
    assert env.action_space.shape == (4, 7)
    env.action_space.seed(1)
    chunk = env.action_space.sample()
    env.reset(seed=5)
    single.reset(seed=5)
    _, reward, _, _, _ = env.step(chunk)
    rewards = [single.step(action)[1] for action in chunk]
    assert reward == pytest.approx(sum(rewards)) and env.digest() == single.digest()
    for each in (env, single):
        each.close()


def test_measured_answer_times_are_the_wall_time_between_two_steps():
    env = TaskEnv('reach', answer_time='measured')
    env.reset(seed=5)
    time.sleep(0.12)
    env.step(np.zeros(7))
    assert env.episode.periods >= 3
    env.close()


@pytest.mark.full
@pytest.mark.parametrize('keywords', [
    {'answer_time': {'time': 0.1, 'jitter': 0.05}}, {'chunk': 3},
    {'answer_time': {'time': 0.04, 'ask_ahead': 1, 'chunk_hz': 10.0}, 'chunk': 3}])
def test_many_with_late_answers_are_each_as_a_single_one(keywords):
    many = TaskVectorEnv('reach', 3, threads=1, **keywords)
    singles = [TaskEnv('reach', **keywords) for _ in range(3)]
    many.action_space.seed(1)
    many.reset(seed=5)
    for index, env in enumerate(singles):
        env.reset(seed=5 + index)
    for _ in range(4):
        actions = many.action_space.sample()
        _, rewards, _, _, _ = many.step(actions)
        for index, env in enumerate(singles):
            _, reward, _, _, _ = env.step(actions[index])
            assert reward == rewards[index]
        assert many.digest() == [env.digest() for env in singles]
    for env in (*singles, many):
        env.close()


@pytest.mark.parametrize('keywords, text', [
    ({'answer_time': 'soon'}, "answer_time must be 'measured' or from 0 to 10 s"),
    ({'answer_time': {'chunk_hz': 40.0}}, 'whole number of timesteps'),
    ({'chunk': 0}, 'chunk'), ({'chunk': 1.5}, 'chunk')])
def test_answer_times_and_chunks_that_cannot_be_used_are_rejected(keywords, text):
    with pytest.raises(ManipSimError) as raised:
        TaskEnv('reach', **keywords)
    assert text in str(raised.value)


@pytest.mark.full
def test_a_wrapper_of_an_environment_observes_a_sensor_of_another_package(
        install_example, monkeypatch):
    from pages import blocks, PAGES
    monkeypatch.syspath_prepend(install_example('end_effector_imu'))
    (code,) = [block.text for page in PAGES for block in blocks(page)
               if 'class WithImu' in block.text]
    names = {}
    exec(code, names)  # It prints what the page says.
    env = names['env']
    assert env.observation_space.contains(env.reset(seed=1)[0])

    def read(seed):
        start = env.reset(seed=seed)[0]['imu']
        return np.array([start, env.step(np.zeros(7))[0]['imu']])

    assert (read(7) == read(7)).all() and (read(7) != read(8)).any()
    noise = []
    for seed in range(30):
        measured = env.reset(seed=seed)[0]['imu']
        assert np.linalg.norm(measured[3:]) == pytest.approx(9.81, abs=0.3)
        noise.append(measured - env.imu.read(env.imu.simulation))
    np.testing.assert_allclose(np.std(noise, axis=0), np.repeat([0.002, 0.05], 3), rtol=0.5)
    env.close()
