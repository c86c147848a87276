# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Latency of an episode, in simulated time."""

import contextlib

import mujoco
import numpy as np
import pytest

from manip_sim.errors import ModelError
from manip_sim.simulation import Simulation
from manip_sim.tasks import ACTIONS, create_task, Episode, Setting
from manip_sim.tasks.episode import start
from manip_sim.tasks.episode_actions import create_actions

TASK = create_task('reach', initialization_noise=None)


def positions(latency, actions, read=lambda episode: episode.simulation.data.qpos[:7].copy(),
              seed=1):
    episode = Episode(TASK, Simulation(TASK.world), latency=latency)
    episode.reset(seed)
    found = [read(episode)]
    for action in actions:
        episode.step(action)
        found.append(read(episode))
    return np.array(found)


def actions(count=12):
    found = np.zeros((count, 7))
    found[:, 1] = np.linspace(0.2, 1.0, count)
    return found


@pytest.mark.full
@pytest.mark.parametrize('periods', [1, 3])
def test_commands_that_are_late_by_whole_periods_are_those_of_later_periods(periods):
    given = actions()
    late = positions(0.05 * periods, given)
    # Until the first command there is none: the robot holds still.
    by_hand = Episode(TASK, Simulation(TASK.world))
    by_hand.reset(1)
    expected = [by_hand.simulation.data.qpos[:7].copy()]
    for number in range(len(given)):
        if number < periods:
            by_hand.advance()
        else:
            by_hand.step(given[number - periods])
        expected.append(by_hand.simulation.data.qpos[:7].copy())
    np.testing.assert_array_equal(late, expected)


def test_commands_that_are_late_by_a_part_of_a_period_take_effect_within_it():
    given = np.zeros((3, 7))
    given[:, 1] = 1.0
    begins = {}
    for latency in (0.0, 0.02, 0.06):
        episode = Episode(TASK, Simulation(TASK.world), latency=latency)
        episode.reset(1)
        start, moved = episode.simulation.data.qpos[:7].copy(), []
        for action in given:
            episode.take(action)
            for _ in range(episode.steps):
                episode.simulation.advance(1)
                moved.append(np.abs(episode.simulation.data.qpos[:7] - start).max() > 1e-4)
            episode.end_period()
        begins[latency] = moved.index(True)
    assert begins[0.02] == begins[0.0] + 10
    assert begins[0.06] == begins[0.0] + 30


@contextlib.contextmanager
def sampling():
    """Collect positions by time [steps of 2 ms], as MuJoCo steps."""
    samples = {}

    def sample(model, data):
        samples[round(data.time / 0.002)] = data.qpos[:7].copy()
    mujoco.set_mjcb_control(sample)
    try:
        yield samples
    finally:
        mujoco.set_mjcb_control(None)


@pytest.mark.full
@pytest.mark.parametrize('state_s', [0.05, 0.12, 0.15, 0.048, 0.002])
def test_an_observation_is_as_old_as_the_latency_of_states(state_s):
    given = actions()
    episode = Episode(TASK, Simulation(TASK.world))
    episode.reset(1)
    data = episode.simulation.data
    begin, start_positions = round(data.time / 0.002), data.qpos[:7].copy()
    with sampling() as samples:
        for action in given:
            episode.step(action)
    samples[begin] = start_positions  # What the first step begins with was computed before.
    assert {begin + step for step in range(301)} == samples.keys()

    def observed(episode):
        return episode.observation['joint_position'][:7]
    late = positions({'state': state_s}, given, observed)
    back = round(state_s / 0.002)
    for period in range(len(given) + 1):
        np.testing.assert_array_equal(
            late[period], samples[begin + max(0, 25 * period - back)])


@pytest.mark.parametrize('state_s', [
    0.048, *(pytest.param(late_s, marks=pytest.mark.full) for late_s in (0.1, 0.002))])
def test_the_age_of_states_does_not_change_what_happens(state_s):
    given = actions()
    np.testing.assert_array_equal(positions({'state': state_s}, given), positions(0.0, given))


@pytest.mark.full
@pytest.mark.parametrize('late', [
    {'state': 0.014}, {'state': 0.066}, {'state': 0.05, 'state_jitter': 0.02}])
def test_an_episode_observes_what_a_robot_with_these_settings_measures(late):
    noise = {'noise.joint_velocity': 0.01, 'noise.wrench_force': 1.0}
    given = actions(6)
    ways = [Episode(TASK, Simulation(TASK.world), latency=late, noise=noise)]
    in_noise = {f'latency.{name}': value for name, value in late.items()}
    ways.append(Episode(TASK, Simulation(TASK.world), noise={**noise, **in_noise}))
    simulation = Simulation(TASK.world)
    for name, value in {**noise, **in_noise}.items():
        simulation.robot.sensing.set(name, value)
    for episode in ways:
        episode.reset(7)
    start(TASK, simulation, 7)
    by_hand = create_actions('osc_pose', simulation)
    for action in given:
        for episode in ways:
            episode.step(action)
        by_hand.apply(action, 0.05)
        simulation.advance(25)
        state = simulation.robot.state()
        end = state.end_effectors['right']
        for seen in (episode.observation for episode in ways):
            for kind in ('position', 'velocity', 'effort'):
                np.testing.assert_array_equal(seen[f'joint_{kind}'], getattr(state, kind))
            np.testing.assert_array_equal(seen['eef_pose'][0, :3], end.pose.position)
            np.testing.assert_array_equal(
                seen['external_wrench'][0, :3], end.external_wrench.force)
    assert len({episode.digest for episode in ways} | {simulation.digest()}) == 1


def test_what_is_older_than_an_episode_is_its_start():
    episode = Setting('push_cube', latency={'state': 0.07}).create_episode()
    for seed in (3, 4):
        episode.reset(seed)
        name = episode.simulation.entities.free_names[0]
        start_pose = episode.simulation.entities.pose(episode.simulation.data, name)
        positions_at_start = episode.simulation.robot.reader.exact()[:9]
        episode.step(np.ones(7))
        np.testing.assert_array_equal(episode.observation['object_pose'][0], start_pose)
        np.testing.assert_array_equal(
            episode.observation['joint_position'][:9], positions_at_start)


@pytest.mark.full
def test_objects_and_images_are_as_old_as_the_states_of_the_robot(renderer):
    seen = {}
    for late_s in (0.0, 0.012, 0.05, 0.062):
        episode = Setting('push_cube', cameras=('agentview',), image_size=(64, 48),
                          latency={'state': late_s}).create_episode()
        episode.reset(3)
        entities, data = episode.simulation.entities, episode.simulation.data
        name = entities.free_names[0]
        data.joint(episode.simulation.model.body(name).jntadr[0]).qvel[:2] = 2.0
        episode.begin()
        for _ in range(2):
            episode.step(np.zeros(7))
        seen[late_s] = episode.observation
    cubes = [found['object_pose'][0, 0] for found in seen.values()]
    assert (np.diff(cubes) < -1e-3).all()
    images = [found['image/agentview'].astype(int) for found in seen.values()]
    for one, other in zip(images, images[1:]):
        assert np.abs(one - other).max() > 20


@pytest.mark.full
@pytest.mark.parametrize(('robot', 'rate_hz'), [('Panda', 20), ('UR5e', 10)])
@pytest.mark.parametrize('action', ACTIONS)
def test_a_delayed_action_never_moves_an_arm_farther_than_one_without_delay(
        action, rate_hz, robot):
    ways = []
    for latency in (0.0, 0.002, 0.004, 0.01, 0.03):
        episode = Setting('reach', robot, action=action, control_hz=rate_hz,
                          latency=latency).create_episode()
        episode.reset(7)
        read = episode.simulation.data
        start, bias = read.qpos[:6].copy(), read.qfrc_bias[:6].copy()
        given = np.zeros(episode.actions.size)
        if action == 'osc_pose':
            given[2] = 1.0
        else:
            given[:6] = {'position': start, 'velocity': 0.0, 'effort': bias}[
                action.removeprefix('joint_')]
            given[1] += {'effort': 20.0}.get(action.removeprefix('joint_'), 0.3)
        moved = []
        for _ in range(4):
            episode.step(given)
            moved.append(abs(read.qpos[1] - start[1]))
        ways.append(moved)
    assert (np.array(ways[1:]) < ways[0]).all()


def test_a_reset_forgets_commands_that_are_under_way():
    episode = Episode(TASK, Simulation(TASK.world), latency=0.2)
    episode.reset(1)
    for action in actions(3):
        episode.step(action)
    episode.reset(1)
    start = episode.simulation.data.qpos[:7].copy()
    for _ in range(4):
        episode.step(np.zeros(7))
    np.testing.assert_allclose(episode.simulation.data.qpos[:7], start, atol=1e-4)


@pytest.mark.full
def test_an_end_effector_moves_the_less_the_later_its_commands_are():
    up = np.zeros((6, 7))
    up[:, 2] = 1.0
    heights = [positions(latency, up, lambda episode: episode.simulation.data.site(
        episode.simulation.robot.end_effectors['right'].grip_site).xpos[2])
        for latency in (0.0, 0.002, 0.004, 0.006, 0.01, 0.02, 0.03)]
    assert (np.diff(np.array(heights)[:, 1:], axis=0) < 0.0).all()


@pytest.mark.full
def test_success_falls_with_latency():
    successes = []
    for latency in (0.0, 0.3):
        episode = Setting('pick_cube', latency=latency).create_episode()
        expert = episode.task.expert(episode.simulation)
        successes.append(sum(episode.run(expert, seed) for seed in range(4)))
    assert successes[0] == 4 and successes[1] < 4


@pytest.mark.full
def test_jitter_is_drawn_from_the_seed_and_kept_in_order():
    late = {'command': 0.06, 'command_jitter': 0.03, 'state': 0.05, 'state_jitter': 0.03}

    def observed(episode):
        return episode.observation['joint_position'][:7]
    first, again, other = (positions(late, actions(20), observed, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, positions({**late, 'command_jitter': 0.0}, actions(20),
                                               observed))
    assert not np.array_equal(first, other)


def test_jitter_delays_actions_as_the_sensing_of_the_robot_draws_it():
    late = {'command': 0.06, 'command_jitter': 0.03}
    episode = Episode(TASK, Simulation(TASK.world), latency=late)
    robot = Simulation(TASK.world).robot
    for name, value in late.items():
        robot.sensing.set(f'latency.{name}', value)
    robot.sensing.reset(5)
    delays = [robot.sensing.delays['command'].steps(25 * period) for period in range(30)]
    assert abs(np.mean(delays) - 30) < 10 and np.std(delays) > 5  # Steps of 2 ms.
    expected = np.maximum.accumulate([25 * n + delay for n, delay in enumerate(delays)])
    effects = []
    episode.simulation.robot._apply = lambda command: effects.append(
        episode.simulation._clock.control_steps)
    episode.reset(5)
    for _ in range(30):
        episode.step(np.zeros(7))
    # An action is a command for the arm and one for the gripper.
    assert effects == [due for due in expected.tolist() if due < 750 for _ in range(2)]


@pytest.mark.full
def test_a_drawn_latency_acts_to_the_timestep_and_not_besides_a_given_one(tmp_path):
    ways = []
    for seconds in (0.0, 0.002, 0.02, 0.048, 0.052):
        file = tmp_path / 'drawn.yaml'
        file.write_text(f'parameters:\n  latency.command: {{choice: [{seconds}]}}\n')
        drawn = {'composition': {'randomization': str(file)}}
        episode = Setting('reach', **drawn).create_episode()
        episode.reset(1)
        start = episode.simulation.data.qpos[1]
        for _ in range(2):
            episode.step([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
        ways.append(abs(episode.simulation.data.qpos[1] - start))
        with pytest.raises(ModelError, match='both latency= and the randomization set latency'):
            Setting('reach', latency=0.1, **drawn).create_episode()
    # Each step later, the joint has come a little less far; 52 ms are one step after a period.
    assert (np.diff(ways) < -5e-4).all()


@pytest.mark.full
@pytest.mark.parametrize(('rate_hz', 'timestep_s'), [
    (20, 0.002), (20, 0.001), (25, 0.002), (10, 0.002)])
def test_a_later_command_moves_the_end_effector_less_far(rate_hz, timestep_s):
    heights = []
    task = create_task('reach', timestep_s=timestep_s)
    for steps in range(8):
        episode = Episode(task, Simulation(task.world), 1.0 / rate_hz, latency=steps * timestep_s)
        episode.reset(7)
        heights.append([])
        for _ in range(6):
            episode.step([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
            heights[-1].append(episode.observation['eef_pose'][0, 2])
    assert (np.diff(heights, axis=0) < 0.0).all()
