# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Repeat records: equal to the last bit, or where they first differ and why."""

import dataclasses
import json

import numpy as np
import pytest

from manip_sim.cli.main import main
from manip_sim.errors import RecordError
from manip_sim.simulation import Simulation
from manip_sim.tasks import create_task, Episode

for needed in ('mcap', 'mcap_ros2'):
    pytest.importorskip(needed, reason='needs the extra records')

from manip_sim.records import EpisodeRecorder  # noqa: E402
from manip_sim.records.record_file import encoder  # noqa: E402
from manip_sim.records.recorded import Record  # noqa: E402
from manip_sim.records.recorder import ACTION, FORMAT  # noqa: E402
from manip_sim.records.replay import Replay  # noqa: E402

_SIZE_ARRAY = 'std_msgs/Float64MultiArray'


@pytest.fixture
def first(recording):
    """Return the first episode of a record."""
    return next(Record(recording).episodes())


def with_action(recorded, period, change):
    """Return an episode in which an action is changed."""
    encode = encoder(_SIZE_ARRAY)
    messages = dict(recorded.messages)
    action = recorded.actions[period - 1] + change
    found = list(messages[ACTION])
    found[period - 1] = found[period - 1][0], encode({'data': action.tolist()})
    return dataclasses.replace(recorded, messages={**messages, ACTION: found})


@pytest.mark.full
def test_episodes_are_repeated_to_the_last_bit_in_any_order(recording):
    episodes = list(Record(recording).episodes())
    replay = Replay()
    for recorded in (episodes[1], episodes[0], episodes[1]):
        found = replay.repeat(recorded)
        assert found.difference is None and found.success == recorded.success
        assert found.periods == len(recorded.actions) > 1


@pytest.mark.full
@pytest.mark.parametrize('period', [1, 3])
def test_the_period_of_an_action_that_is_another_one_is_found(first, period):
    found = Replay().repeat(with_action(first, period, 1e-12))
    assert found.difference_period == period
    assert f'the state first differs in period {period} of {len(first.actions)}; both are ' \
        'manip_sim' in found.difference


def test_an_action_that_cannot_be_applied_is_a_difference(first):
    found = Replay().repeat(with_action(first, 2, np.nan))
    assert found.difference_period == 2 and 'finite' in found.difference


def test_another_seed_differs_at_the_start(first):
    other = dataclasses.replace(first, about={**first.about, 'seed': '999'})
    found = Replay().repeat(other)
    assert found.difference_period == 0 and 'the state first differs at the start' in \
        found.difference


def test_a_difference_in_control_alone_is_found_by_the_digest(first):
    other = dataclasses.replace(first, result={**first.result, 'digest': 'mujoco-4:0'})
    found = Replay().repeat(other)
    assert found.difference.startswith('the digest first differs in period')


def test_other_versions_are_named_where_they_differ(first):
    other = dataclasses.replace(first, about={**first.about, 'seed': '999', 'mujoco': '3.9.9'})
    found = Replay().repeat(other)
    assert 'it was recorded by manip_sim' in found.difference
    assert 'with MuJoCo 3.9.9, this is manip_sim' in found.difference


def test_another_model_is_named_where_it_differs(first):
    other = dataclasses.replace(first, about={**first.about, 'seed': '999'}, model=b'no zip')
    assert Replay().repeat(other).difference.endswith(
        ': the model is another one than that of the record')


@pytest.mark.parametrize('change, message', [
    ({'task': 'juggle'}, "cannot be repeated here: unknown task 'juggle'"),
    ({'arguments': json.dumps({'robot': 'Pandora'})}, "unknown robot 'Pandora'"),
    ({'arguments': json.dumps({'wheels': 4})}, 'cannot be repeated here: .*wheels'),
    ({'arguments': json.dumps({'robot': 5})}, 'cannot be repeated here: robot must be a name'),
    ({'period_s': '0.0123'}, 'a control period must be a whole number of timesteps'),
    ({'action': 'telepathy'}, 'telepathy')])
def test_what_is_not_known_here_is_an_error_in_one_line(first, change, message):
    other = dataclasses.replace(first, about={**first.about, **change})
    with pytest.raises(RecordError, match=message):
        Replay().repeat(other)


def test_a_record_without_actions_cannot_be_repeated(first):
    messages = {topic: found for topic, found in first.messages.items() if topic != ACTION}
    with pytest.raises(RecordError, match='episode 0 has no actions that could be repeated'):
        Replay().repeat(dataclasses.replace(first, messages=messages))


def test_a_record_in_the_format_of_another_version_is_one_line(recording, tmp_path, capsys):
    def entry(value):
        """Return the format as metadata of MCAP hold it: texts behind their lengths."""
        return b''.join(len(text).to_bytes(4, 'little') + text for text in (b'format', value))
    content, now = recording.read_bytes(), entry(FORMAT.encode())
    assert content.count(now) == 2  # Once for each episode.
    path = tmp_path / 'later.mcap'
    path.write_bytes(content.replace(now, entry(b'9')))
    assert main(['replay', str(path)]) == 1
    assert capsys.readouterr().err == (
        f"manip_sim: {path}: the record has the format '9', and manip_sim reads "
        f'{FORMAT}\n')


@pytest.mark.full
def test_the_command_verifies_files_and_folders(recording, capsys):
    assert main(['replay', '--verify', str(recording), str(recording.parent)]) == 0
    assert capsys.readouterr().out == '4 of 4 equal\n'
    assert main(['replay', str(recording)]) == 0
    assert capsys.readouterr().out == '1 of 2 succeed, 1 did when they were recorded\n'


def test_the_command_says_what_differs_and_ends_with_one(recording, tmp_path, capsys):
    content, seed = recording.read_bytes(), b'\x04\0\0\0seed\x01\0\0\x00'
    assert content.count(seed + b'3') == 1
    other = tmp_path / 'other.mcap'
    # Without the end of the last episode, as when its writer was killed.
    end = content.rindex(b'manip_sim/result', 0, content.index(b'\x0f\x04\0\0\0\0\0\0\0'))
    other.write_bytes(content.replace(seed + b'3', seed + b'4')[:end])
    assert main(['replay', '--verify', str(other)]) == 1
    out = capsys.readouterr().out
    assert f'{other}: episode 0 (seed 4): the state first differs at the start; both are' in out
    assert f'{other}: the file ends early, and was read up to there\n1 of 2 equal\n' in out


def test_a_file_that_is_not_there_is_one_line(tmp_path, capsys):
    assert main(['replay', str(tmp_path / 'none.mcap')]) == 1
    assert capsys.readouterr().err == (
        f'manip_sim: {tmp_path}/none.mcap: No such file or directory\n')
    assert main(['replay', str(tmp_path)]) == 1
    assert 'this folder has no *.mcap file' in capsys.readouterr().err


@pytest.mark.full
@pytest.mark.parametrize('kind', ['joint_position', 'joint_velocity', 'joint_effort'])
def test_actions_of_joints_with_latency_are_repeated_to_the_last_bit(tmp_path, kind):
    task = create_task('push_cube', 'UR5e', initialization_noise=None)
    episode = Episode(task, Simulation(task.world), 0.02, kind, {'command': 0.03, 'state': 0.01})
    path = tmp_path / 'joints.mcap'
    random = np.random.default_rng(1)
    low, high = episode.actions.bounds.T
    with EpisodeRecorder(path, episode) as recorder:
        for seed in (5, 6):
            episode.reset(seed)
            recorder.begin(seed)
            for _ in range(15):
                action = (low + high) / 2 + 0.05 * random.uniform(-1, 1, len(low)) * (high - low)
                episode.step(action)
                recorder.period(action)
            recorder.end()
    for recorded in Record(path).episodes():
        found = Replay().repeat(recorded)
        assert found.difference is None and found.periods == 15
