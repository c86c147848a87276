# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Data sets of LeRobot and robomimic, read by pyarrow, av, pandas' rules and h5py."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from manip_sim.cli.main import main
from manip_sim.errors import RecordError

for needed in ('mcap', 'mcap_ros2', 'pyarrow', 'av', 'h5py'):
    pytest.importorskip(needed, reason='needs the extra records')

import av  # noqa: E402
import h5py  # noqa: E402
import pyarrow.parquet as parquet  # noqa: E402

from manip_sim.records import EpisodeRecorder  # noqa: E402
from manip_sim.records.converting import Frames, write_lerobot  # noqa: E402
from manip_sim.records.recorded import Record  # noqa: E402
from manip_sim.tasks import Setting  # noqa: E402


@pytest.fixture(scope='module')
def episodes(recording):
    """Return the episodes of a record as arrays."""
    return [Frames(recorded) for recorded in Record(recording).episodes()]


@pytest.fixture(scope='module')
def lerobot(recording, tmp_path_factory):
    """Return the folder of a data set of LeRobot."""
    folder = tmp_path_factory.mktemp('sets') / 'reach'
    assert main(['convert', str(recording), '--to', 'lerobot', str(folder)]) == 0
    return folder


def test_an_action_has_the_row_of_the_state_that_it_was_for(episodes, recording):
    frames = episodes[0]
    count = len(frames.actions)
    states = frames.recorded.states
    (joints,) = frames.observed.positions.values()
    assert joints.values.shape[0] == states.shape[0] == count + 1
    np.testing.assert_array_equal(joints.values[:, :7], states[:, :7])
    (poses,) = frames.observed.end_effectors.values()
    np.testing.assert_allclose(np.linalg.norm(poses.values[:, 3:], axis=1), 1.0)
    assert frames.done[-1] and not frames.done[:-1].any()


def test_the_parquet_files_hold_every_number(lerobot, episodes):
    table = parquet.read_table(lerobot / 'data/chunk-000/file-000.parquet')
    actions = np.array(table['action'].to_pylist())
    np.testing.assert_array_equal(actions, np.concatenate([f.actions for f in episodes]))
    assert str(table.schema.field('action').type) == 'fixed_size_list<element: double>[7]'
    lengths = [len(frames.actions) for frames in episodes]
    assert table['episode_index'].to_pylist() == [0] * lengths[0] + [1] * lengths[1]
    assert table['frame_index'].to_pylist() == [*range(lengths[0]), *range(lengths[1])]
    assert table['index'].to_pylist() == list(range(sum(lengths)))
    states = np.array(table['observation.state'].to_pylist())
    seen = episodes[0].observed
    (joints,), (poses,) = seen.positions.values(), seen.end_effectors.values()
    np.testing.assert_array_equal(
        states[:lengths[0]], np.hstack([joints.values, poses.values])[:-1])
    done = table['next.done'].to_pylist()
    assert [index for index, value in enumerate(done) if value] == [
        lengths[0] - 1, sum(lengths) - 1]


def test_each_episode_begins_with_a_key_frame_and_shows_its_images(lerobot, episodes):
    rows = parquet.read_table(lerobot / 'meta/episodes/chunk-000/file-000.parquet').to_pylist()
    key = 'videos/observation.images.front'
    with av.open(str(lerobot / f'{key}/chunk-000/file-000.mp4')) as file:
        frames = [(frame.time, frame.key_frame, frame.to_ndarray(format='rgb24'))
                  for frame in file.decode(video=0)]
    wanted = np.concatenate([np.stack([*item.images('front')]) for item in episodes])
    assert len(frames) == len(wanted)
    for row, item in zip(rows, episodes, strict=True):
        begin = row[f'{key}/from_timestamp']
        (found,) = [frame for frame in frames if abs(frame[0] - begin) < 1e-3]
        assert found[1], 'no key frame'
        assert row[f'{key}/to_timestamp'] - begin == pytest.approx(len(item.actions) / 20)
    for (_, _, image), other in zip(frames, wanted):
        assert np.abs(image.astype(int) - other).mean() < 8


def test_a_data_set_has_the_rate_of_the_episodes(tmp_path):
    # 30 Hz, as LeRobot's own data sets have, whose period is no whole number of nanoseconds.
    episode, path = Setting('reach', control_hz=30.0).create_episode(), tmp_path / 'reach.mcap'
    with EpisodeRecorder(path, episode) as recorder:
        episode.reset(0)
        recorder.begin(0)
        for _ in range(4):
            episode.step(np.zeros(7))
            recorder.period(np.zeros(7))
        recorder.end()
    assert main(['replay', '--verify', str(path)]) == 0
    assert main(['convert', str(path), '--to', 'lerobot', str(tmp_path / 'set')]) == 0
    assert json.loads((tmp_path / 'set/meta/info.json').read_text())['fps'] == 30
    table = parquet.read_table(tmp_path / 'set/data/chunk-000/file-000.parquet')
    np.testing.assert_allclose(table['timestamp'].to_pylist(), np.arange(4) / 30.0, rtol=1e-6)


def test_an_object_may_have_any_name(tmp_path):
    episode = Setting('reach', composition={'objects': [{
        'name': 'truth', 'shape': 'box', 'size': [0.02, 0.02, 0.02]}]}).create_episode()
    episode.reset(1)
    with EpisodeRecorder(tmp_path / 'record.mcap', episode) as recorder:
        recorder.begin(1)
        episode.step(np.zeros(episode.actions.size))
        recorder.period(np.zeros(episode.actions.size))
        recorder.end()
    (recorded,) = Record(tmp_path / 'record.mcap').episodes()
    frames = Frames(recorded)
    assert list(frames.observed.objects) == ['truth'] and frames.truth is None


def test_the_description_fits_the_files(lerobot, episodes):
    info = json.loads((lerobot / 'meta/info.json').read_text())
    total = sum(len(frames.actions) for frames in episodes)
    assert (info['codebase_version'], info['fps'], info['total_frames'],
            info['total_episodes']) == ('v3.0', 20, total, 2)
    assert info['robot_type'] == 'Panda'
    assert info['features']['action']['dtype'] == 'float64'
    assert info['features']['observation.images.front']['shape'] == [48, 64, 3]
    stats = json.loads((lerobot / 'meta/stats.json').read_text())
    actions = np.concatenate([frames.actions for frames in episodes])
    np.testing.assert_allclose(stats['action']['mean'], actions.mean(axis=0))
    np.testing.assert_allclose(stats['action']['q90'], np.quantile(actions, 0.9, axis=0))
    images = np.concatenate([np.stack([*f.images('front')])[:, ::4, ::4] for f in episodes]) / 255
    for name in ('mean', 'std', 'max'):
        np.testing.assert_allclose(np.ravel(stats['observation.images.front'][name]),
                                   getattr(images, name)(axis=(0, 1, 2)), atol=1e-9)
    tasks = parquet.read_table(lerobot / 'meta/tasks.parquet')
    assert tasks.to_pylist() == [
        {'task_index': 0, 'task': 'Move the end effector to the green point.'}]
    assert json.loads(tasks.schema.metadata[b'pandas'])['index_columns'] == ['task']


def test_hdf5_has_the_structure_of_robomimic(recording, episodes, tmp_path, capsys):
    path = tmp_path / 'reach.hdf5'
    assert main(['convert', str(recording), '--to', 'hdf5', str(path)]) == 0
    total = sum(len(frames.actions) for frames in episodes)
    assert capsys.readouterr().out == f'{path} (2 episodes, {total} control periods)\n'
    with h5py.File(path) as file:
        assert file['data'].attrs['total'] == total
        assert json.loads(file['data'].attrs['env_args'])['env_name'] == 'manip_sim/Reach-v0'
        assert [name.decode() for name in file['mask/success']] == ['demo_0']
        for number, frames in enumerate(episodes):
            demo, count = file[f'data/demo_{number}'], len(frames.actions)
            assert demo.attrs['num_samples'] == count
            assert '<mujoco' in demo.attrs['model_file']
            np.testing.assert_array_equal(demo['actions'], frames.actions)
            np.testing.assert_array_equal(demo['rewards'], frames.rewards)
            np.testing.assert_array_equal(demo['dones'], frames.done)
            np.testing.assert_array_equal(demo['states'], frames.recorded.states[:-1])
            seen = frames.observed
            (joints,), (poses,) = seen.positions.values(), seen.end_effectors.values()
            for group, rows in (('obs', slice(None, -1)), ('next_obs', slice(1, None))):
                np.testing.assert_array_equal(
                    demo[f'{group}/robot0_joint_pos'], joints.values[rows, :7])
                np.testing.assert_array_equal(
                    demo[f'{group}/robot0_gripper_qpos'], joints.values[rows, 7:])
                np.testing.assert_array_equal(
                    demo[f'{group}/robot0_eef_quat'], poses.values[rows, 3:])
            np.testing.assert_array_equal(
                demo['obs/front_image'], np.stack([*frames.images('front')]))


@pytest.mark.parametrize('last', ['--to', 'OUT'])
def test_several_files_make_one_data_set(recording, tmp_path, capsys, last):
    files, out = [str(recording)] * 3, str(tmp_path / 'set.hdf5')
    words = [*files, '--to', 'hdf5', out] if last == 'OUT' else [*files, out, '--to', 'hdf5']
    assert main(['convert', *words]) == 0
    assert '(6 episodes, ' in capsys.readouterr().out


def test_episodes_without_success_are_left_out_if_asked(recording, tmp_path, capsys):
    folder = tmp_path / 'set'
    assert main(['convert', str(recording), '--to', 'lerobot', '--only-success',
                 str(folder)]) == 0
    assert '(1 episode, ' in capsys.readouterr().out


def test_what_is_there_is_kept(recording, tmp_path, capsys):
    path = tmp_path / 'set'
    path.write_text('precious')
    assert main(['convert', str(recording), '--to', 'hdf5', str(path)]) == 1
    assert capsys.readouterr().err == (
        f'manip_sim: {path} already exists and is not overwritten\n')
    assert path.read_text() == 'precious'
    assert main(['convert', str(recording), '--to', 'hdf5', str(tmp_path / 'no/set')]) == 1
    assert f'no such folder: {tmp_path}/no' in capsys.readouterr().err


@pytest.mark.parametrize('name', ['lerobot', 'hdf5'])
def test_a_damaged_record_leaves_no_data_set(recording, tmp_path, capsys, name):
    content = bytearray(recording.read_bytes())
    content[content.rindex(b'manip_sim/result', 0, len(content) // 2 * 2 - 2000) - 2000] ^= 255
    path = Path(tmp_path, 'bad.mcap')
    path.write_bytes(content)
    assert main(['convert', str(path), '--to', name, str(tmp_path / 'set')]) == 1
    assert capsys.readouterr().err.count('\n') == 1
    assert [item.name for item in tmp_path.iterdir()] == ['bad.mcap']


def test_episodes_that_do_not_fit_together_are_an_error(episodes, tmp_path):
    other = dataclasses.replace(
        episodes[1].recorded, about={**episodes[1].recorded.about, 'period_s': '0.1'})
    with pytest.raises(RecordError, match='episode 1 has other joints, objects or cameras'):
        write_lerobot([episodes[0], Frames(other)], tmp_path / 'a')
    slow = dataclasses.replace(other, about={**other.about, 'period_s': '0.3'})
    with pytest.raises(RecordError, match='a whole number of control periods in a second'):
        write_lerobot([Frames(slow)], tmp_path / 'b')
    with pytest.raises(RecordError, match='there are no episodes'):
        write_lerobot([], tmp_path / 'c')


def test_a_missing_image_is_an_error(episodes, tmp_path):
    recorded = episodes[0].recorded
    topic = '/front/color/image_raw/compressed'
    other = dataclasses.replace(recorded, messages={
        **recorded.messages, topic: recorded.messages[topic][1:]})
    with pytest.raises(RecordError, match=f'{len(episodes[0].actions)} messages of {topic} for'):
        write_lerobot([Frames(other)], tmp_path / 'a')


CASES = {'exact': ({}, {}), 'late': ({}, {'state': 0.2}),
         'noisy': ({'noise.joint_position': 0.01, 'noise.wrench_force': 1.0}, {}),
         'both': ({'noise.joint_position': 0.01}, {'state': 0.13})}


@pytest.mark.full
@pytest.mark.parametrize('case', CASES)
def test_each_row_has_what_the_policy_was_given_and_what_is_true(renderer, case, tmp_path):
    noise, latency = CASES[case]
    setting = Setting('pick_cube', 'UR5e', 'default', 'osc_pose', 20.0, latency, ('agentview',),
                      (64, 48), {}, noise)
    episode, given, true = setting.create_episode(), [], []
    path, robot = tmp_path / 'run.mcap', episode.simulation.robot
    rng = np.random.default_rng(0)
    with EpisodeRecorder(path, episode) as recorder:
        episode.reset(5)
        recorder.begin(5)
        for _ in range(9):
            given.append(episode.observation)
            true.append(np.concatenate([robot.sensing.exact('joints'), robot.sensing.exact(
                'right/pose'), episode.simulation.entities.pose(episode.simulation.data, 'cube')]))
            action = rng.uniform(-1.0, 1.0, 7)
            episode.step(action)
            recorder.period(action)
        recorder.end()
    assert main(['convert', str(path), '--to', 'hdf5', str(tmp_path / 'a.hdf5')]) == 0
    assert main(['convert', str(path), '--to', 'lerobot', str(tmp_path / 'set')]) == 0
    seen = {key: np.stack([observation[key] for observation in given]) for key in given[0]}
    joints = len(robot.joint_names)
    with h5py.File(tmp_path / 'a.hdf5') as file:
        demo = file['data/demo_0']

        def together(group, *names):
            return np.concatenate([demo[f'{group}/{name}'] for name in names], axis=1)
        names = (('robot0_joint_pos', 'robot0_gripper_qpos'),
                 ('robot0_joint_vel', 'robot0_gripper_qvel'),
                 ('robot0_eef_pos', 'robot0_eef_quat'), ('object',))
        keys = ('joint_position', 'joint_velocity', 'eef_pose', 'object_pose')
        for some, key in zip(names, keys):
            np.testing.assert_array_equal(together('obs', *some), seen[key].reshape(9, -1))
        # JPEG changes colours a little; another period shows the arm elsewhere.
        assert np.abs(demo['obs/agentview_image'][:].astype(int) - seen['image/agentview']).mean(
            ) < 3.0
        assert ('truth' in demo) == (case != 'exact')
        if 'truth' in demo:
            exact = np.concatenate([together('truth', *some) for some in names], axis=1)
            np.testing.assert_array_equal(exact, np.delete(
                true, np.s_[2 * joints:3 * joints], axis=1))
        env = json.loads(file['data'].attrs['env_args'])['env_kwargs']
        assert env['control_hz'] == 20.0 and env['latency']['state'] == latency.get('state', 0.0)
        assert env['noise'] == noise and env['cameras'] == ['agentview']
        made = Setting(env.pop('task', 'pick_cube'), env.pop('robot', 'UR5e'), **{
            key: env[key] for key in ('action', 'control_hz', 'latency', 'noise')}, cameras=tuple(
                env['cameras']), image_size=tuple(env['image_size'])).create_episode()
        made.reset(5)
        np.testing.assert_array_equal(made.observation['image/agentview'],
                                      given[0]['image/agentview'])
    table = parquet.read_table(tmp_path / 'set/data/chunk-000/file-000.parquet')
    state = np.array(table['observation.state'].to_pylist())
    np.testing.assert_array_equal(state, np.concatenate(
        [seen['joint_position'], seen['eef_pose'][:, 0]], axis=1))
    np.testing.assert_array_equal(np.array(table['observation.environment_state'].to_pylist()),
                                  seen['object_pose'][:, 0])
    if case != 'exact':
        np.testing.assert_array_equal(
            np.array(table['truth.state'].to_pylist()),
            np.delete(true, np.s_[joints:3 * joints], axis=1)[:, :-7])


def test_a_record_that_was_cut_off_says_how_many_episodes_are_incomplete(
        recording, tmp_path, capsys):
    with open(recording, 'rb') as file:
        content = file.read()
    cut, alone = tmp_path / 'cut.mcap', tmp_path / 'alone.mcap'
    cut.write_bytes(content[:content.rindex(b'manip_sim/result', 0, len(content) - 3000) - 30])
    assert main(['convert', str(cut), '--to', 'hdf5', str(tmp_path / 'a.hdf5')]) == 0
    assert 'episode 1 is not complete' in (out := capsys.readouterr().out)
    assert out.endswith('; 1 incomplete)\n') and '(1 episode, ' in out
    episodes = content.index(b'manip_sim/result')
    alone.write_bytes(content[:episodes - 30])
    assert main(['convert', str(alone), '--to', 'hdf5', str(tmp_path / 'b.hdf5')]) == 1
    assert 'there are no episodes; 1 incomplete' in capsys.readouterr().err


def test_an_episode_of_which_nothing_was_written_is_incomplete_too(recording, tmp_path, capsys):
    with open(recording, 'rb') as file:
        content = file.read()
    end = content.rindex(b'manip_sim/result', 0, len(content) - 3000)
    cut = tmp_path / 'cut.mcap'
    cut.write_bytes(content[:(content.rindex(b'manip_sim/episode', 0, end) + end) // 2])
    assert main(['convert', str(cut), '--to', 'hdf5', str(tmp_path / 'a.hdf5')]) == 0
    out = capsys.readouterr().out
    assert f'{cut}: episode 1 is not complete' in out
    assert out.endswith('; 1 incomplete)\n') and '(1 episode, ' in out
