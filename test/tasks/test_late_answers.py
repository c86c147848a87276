# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The simulation goes on while the policy thinks: when its actions take effect, and bad input."""

import numpy as np
import pytest

from manip_sim.errors import CommandError, ModelError
from manip_sim.tasks import AnswerTime, LateAnswers, Setting


def towards(episode):
    seen = episode.observation
    way = (seen['goal'] - seen['eef_pose'][0, :3]) / 0.05
    return np.array([*np.clip(way, -1.0, 1.0), 0.0, 0.0, 0.0, 0.0])


def run(setting, seed=3, periods=12, act=towards):
    """Return the states after each period, in which periods the policy was asked, and when."""
    episode = setting.create_episode()
    answers = setting.create_answers(episode)
    episode.reset(seed)
    answers.reset(seed)
    states, asked, effects = [], [], []
    for period in range(periods):
        if answers.asks:
            asked.append(period)
            answers.answer(act(episode))
        effects += [period * episode.steps + steps for steps, _ in answers.advance()]
        data = episode.simulation.data
        states.append(np.concatenate([data.qpos, data.qvel]))
    return np.array(states), asked, effects


@pytest.mark.parametrize('late_s', [0.0, 0.002, 0.034])
def test_thinking_for_less_than_a_period_is_a_latency_of_commands(late_s):
    expected, asked, _ = run(Setting('reach', latency=late_s))
    found, also, effects = run(Setting('reach', answer_time=late_s))
    np.testing.assert_array_equal(found, expected)
    assert asked == also == [*range(12)]
    assert effects == [25 * period + round(late_s / 0.002) for period in range(12)]


def test_nothing_is_commanded_while_the_policy_thinks():
    """Compare with latent commands that are given in every third period by hand."""
    found, asked, effects = run(Setting('reach', answer_time=0.12))
    assert asked == [0, 3, 6, 9] and effects == [60, 135, 210, 285]
    episode = Setting('reach', latency=0.12).create_episode()
    episode.reset(3)
    states = []
    for period in range(12):
        if period % 3 == 0:
            episode.take(towards(episode))
        episode.advance()
        data = episode.simulation.data
        states.append(np.concatenate([data.qpos, data.qvel]))
    np.testing.assert_array_equal(found, states)
    still, _, _ = run(Setting('reach'), act=lambda episode: np.zeros(7))
    moved = np.abs(found - still)[:, :7].max(axis=1)
    assert moved[1] < 1e-3 < 1e-2 < moved[4]


def test_drawn_times_depend_on_the_seed_alone():
    setting = Setting('reach', answer_time={'time': 0.1, 'jitter': 0.05})
    states, asked, effects = run(setting, periods=40)
    again, _, same = run(setting, periods=40)
    np.testing.assert_array_equal(states, again)
    assert effects == same
    assert run(setting, seed=4, periods=40)[2] != effects
    thought = np.array(effects) - 25 * np.array(asked[:len(effects)])
    assert (thought >= 0).all() and 30 < thought.mean() < 70 and len({*thought.tolist()}) > 4


def test_measured_times_are_those_of_the_wall_clock():
    setting = Setting('reach', answer_time='measured')
    episode = setting.create_episode()
    answers = setting.create_answers(episode)
    episode.reset(0)
    answers.reset(0)
    answers.answer(np.zeros(7), 0.0611)  # 31 steps of 0.002 s: rounded up.
    assert not answers.asks and answers.advance() == []
    assert not answers.asks
    ((steps, _),) = answers.advance()
    assert steps == 31 - 25 and answers.asks


def chunk(count):
    return lambda episode: np.tile(np.zeros(7), (count, 1))


@pytest.mark.parametrize('time, count, asked, effects', [
    # All at once: the policy is asked when the chunk is over.
    ({}, 4, [0, 4, 8], [0, 25, 50, 75, 100, 125, 150, 175, 200, 225, 250, 275]),
    # Half as fast, and five times as fast as the control rate.
    ({'chunk_hz': 10.0}, 3, [0, 6], [0, 50, 100, 150, 200, 250]),
    ({'chunk_hz': 100.0}, 10, [0, 2, 4, 6, 8, 10], [*range(0, 300, 5)]),
    # Late: the first action when it arrives, the others on the grid of the observation.
    ({'time': 0.03}, 4, [0, 4, 8], [15, 25, 50, 75, 115, 125, 150, 175, 215, 225, 250, 275]),
    ({'time': 0.12}, 3, [0, 5, 10], [60, 75, 100, 185, 200, 225]),
    # Asked when two are left: those go on meanwhile, and as many of the next chunk are left out.
    ({'time': 0.1, 'ask_ahead': 2}, 6, [0, 6, 10], [50, *range(75, 300, 25)]),
    # Late although it was asked ahead: back to the grid.
    ({'time': 0.12, 'ask_ahead': 2}, 6, [0, 6, 10],
     [60, 75, 100, 125, 150, 175, 210, 225, 250, 275])])
def test_chunks_have_a_rate_of_their_own(time, count, asked, effects):
    _, found, taken = run(Setting('reach', answer_time=time), act=chunk(count))
    assert found == asked
    assert taken == effects


def test_a_rate_of_chunks_that_does_not_fit_the_timestep_is_rejected():
    setting = Setting('reach', answer_time={'chunk_hz': 40.0})
    with pytest.raises(ModelError, match='whole number of timesteps of 0.002 s, got 40 Hz'):
        setting.create_answers(setting.create_episode())


def numbered(count):
    """Return a policy whose actions say when they were asked for, and which they are."""
    asked = []

    def act(episode):
        asked.append(episode.periods)
        return np.array([[episode.periods / 100.0, i / 100.0, 0, 0, 0, 0, 0]
                         for i in range(count)])
    return act


def test_asked_ahead_actions_that_are_over_are_left_out():
    setting = Setting('reach', answer_time={'time': 0.1, 'ask_ahead': 3})
    episode = setting.create_episode()
    answers, act, taken = setting.create_answers(episode), numbered(8), []
    episode.reset(0)
    answers.reset(0)
    for _ in range(14):
        if answers.asks:
            answers.answer(act(episode))
        taken += [(round(100 * action[0]), round(100 * action[1]))
                  for _, action in answers.advance()]
    # The first chunk begins late, all of it; asked again in period 7 with three left, of which two
    # are taken until the answer comes.
    assert taken[:5] == [(0, i) for i in range(5)]
    assert taken[5:8] == [(0, 5), (0, 6), (7, 2)] and taken[8:10] == [(7, 3), (7, 4)]


def test_an_answer_that_never_comes_in_time_moves_nothing():
    found, asked, effects = run(Setting('reach', answer_time=10.0))
    assert asked == [0] and effects == []
    still, _, _ = run(Setting('reach'), act=lambda episode: np.zeros(7))
    assert np.abs(found - still)[:, :7].max() < 2e-3


@pytest.mark.parametrize('time, text', [
    (-0.1, "answer_time must be 'measured' or from 0 to 10 s, got -0.1"),
    (float('nan'), 'from 0 to 10 s, got nan'), (11.0, 'from 0 to 10 s'), (True, 'got True'),
    ('measurd', "got 'measurd'"), ({'tim': 1.0}, "unknown key of answer_time 'tim'"),
    ({'time': 'measured', 'jitter': 0.1}, 'a measured answer_time has no jitter'),
    ({'jitter': -1.0}, 'jitter of answer_time must be from 0'),
    ({'chunk_hz': 0.0}, 'chunk_hz must be above 0 Hz'), ({'chunk_hz': 'fast'}, 'chunk_hz must'),
    ({'ask_ahead': -1}, 'ask_ahead'), ({'ask_ahead': 1.5}, 'ask_ahead')])
def test_answer_times_that_cannot_be_used_are_rejected(time, text):
    with pytest.raises(ModelError) as raised:
        Setting('reach', answer_time=time)
    assert text in str(raised.value)


@pytest.mark.parametrize('answer, text', [
    (np.zeros(6), 'an action must have 7 numbers, got 6'), ([], 'an action must have 7'),
    (np.zeros((3, 6)), 'action 0 of a chunk must have 7 numbers, got 6'),
    (np.zeros((0, 7)), 'a chunk of actions must have the shape (actions, 7)'),
    (np.zeros((1, 1, 7)), 'a chunk of actions must have the shape (actions, 7)'),
    ([[0.0] * 7, [0.0] * 6 + [np.nan]], 'finite'), (None, 'an action'), ([['a'] * 7], 'chunk')])
def test_answers_that_cannot_be_used_change_nothing(answer, text):
    episode = Setting('reach').create_episode()
    answers = LateAnswers(episode, AnswerTime(0.1))
    episode.reset(0)
    answers.reset(0)
    with pytest.raises(CommandError) as raised:
        answers.answer(answer)
    assert text in str(raised.value)
    assert answers.asks and answers.advance() == []
