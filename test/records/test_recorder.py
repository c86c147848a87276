# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Records of episodes, as rosbags and mcap read them."""

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from manip_sim import resources
from manip_sim.errors import RecordError
from manip_sim.simulation import Simulation
from manip_sim.tasks import create_task, Episode

for needed in ('mcap', 'mcap_ros2', 'rosbags'):
    pytest.importorskip(needed, reason='needs the extras records and test')

from mcap.reader import make_reader  # noqa: E402
from rosbags.highlevel import AnyReader  # noqa: E402

from manip_sim.models.archive import load_archive  # noqa: E402
from manip_sim.records import EpisodeRecorder  # noqa: E402
from manip_sim.records.converting import Frames  # noqa: E402
from manip_sim.records.recorded import Record  # noqa: E402

_IMAGE = np.zeros((48, 64, 3), np.uint8)
_IMAGE[:, :32, 0] = 255


@pytest.fixture(scope='module')
def recorded(tmp_path_factory):
    """Return the file of two episodes with pick_cube, its simulation, and what happened."""
    task = create_task('pick_cube', 'UR5e')
    episode = Episode(task, Simulation(task.world))
    expert = task.expert(episode.simulation)
    path = tmp_path_factory.mktemp('records') / 'run.mcap'
    seen = []
    with EpisodeRecorder(path, episode, settings={'policy': 'expert'}, digest_every=5) as recorder:
        for seed in (3, 11):
            episode.reset(seed)
            expert.reset(seed)
            recorder.begin(seed)
            for _ in range(12):
                action = expert.act()
                episode.step(action)
                recorder.period(action, images={'front': _IMAGE})
                seen.append((episode.simulation.time_ns, action,
                             episode.simulation.robot.measured(), episode.reward,
                             episode.simulation.entities.pose(episode.simulation.data, 'cube')))
            recorder.end()
            seen.append(episode.digest)
    return path, episode, seen


def messages(path, topic):
    """Return the messages of a topic, as rosbags reads them by the types in the file."""
    with AnyReader([path]) as reader:
        connections = [item for item in reader.connections if item.topic == topic]
        return [reader.deserialize(content, item.msgtype)
                for item, _, content in reader.messages(connections)]


@pytest.mark.full
def test_rosbags_reads_states_and_actions_to_the_last_bit(recorded):
    path, episode, seen = recorded
    periods = [item for item in seen if isinstance(item, tuple)]
    states = messages(path, '/joint_states')
    assert len(states) == 26 and tuple(states[0].name) == episode.simulation.robot.joint_names
    states = states[1:13] + states[14:]
    actions = messages(path, '/episode/action')
    rewards = messages(path, '/episode/reward')
    cubes = messages(path, '/objects/cube/pose')
    cubes = cubes[1:13] + cubes[14:]
    for (time_ns, action, measured, reward, cube), state, sent, given, pose in zip(
            periods, states, actions, rewards, cubes, strict=True):
        assert state.header.stamp.sec * 10**9 + state.header.stamp.nanosec == time_ns
        found = np.concatenate([state.position, state.velocity, state.effort])
        np.testing.assert_array_equal(found, measured)
        np.testing.assert_array_equal(sent.data, action)
        assert given.data == reward
        place, turn = pose.pose.position, pose.pose.orientation
        assert [place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w] == cube.tolist()
        assert pose.header.frame_id == 'world'


def test_every_topic_has_a_type_and_messages(recorded):
    with AnyReader([recorded[0]]) as reader:
        topics = {topic: info.msgtype for topic, info in reader.topics.items()}
        for item, _, content in reader.messages():
            reader.deserialize(content, item.msgtype)
    assert topics == {
        '/clock': 'rosgraph_msgs/msg/Clock',
        '/episode/action': 'std_msgs/msg/Float64MultiArray',
        '/episode/digest': 'std_msgs/msg/String',
        '/episode/reward': 'std_msgs/msg/Float64',
        '/episode/state': 'std_msgs/msg/Float64MultiArray',
        '/episode/success': 'std_msgs/msg/Bool',
        '/front/color/image_raw/compressed': 'sensor_msgs/msg/CompressedImage',
        '/joint_states': 'sensor_msgs/msg/JointState',
        '/objects/cube/pose': 'geometry_msgs/msg/PoseStamped',
        '/right/eef_pose': 'geometry_msgs/msg/PoseStamped',
        '/right/external_wrench': 'geometry_msgs/msg/WrenchStamped',
        '/right/wrench': 'geometry_msgs/msg/WrenchStamped'}


def test_metadata_and_attachment_say_what_it_takes_to_repeat_it(recorded):
    path, episode, seen = recorded
    with path.open('rb') as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == 'ros2'
        metadata = [(item.name, item.metadata) for item in reader.iter_metadata()]
        (attached,) = reader.iter_attachments()
    assert [name for name, _ in metadata] == ['manip_sim/episode', 'manip_sim/result'] * 2
    begin, end = metadata[2][1], metadata[3][1]
    assert (begin['task'], begin['seed'], begin['number']) == ('pick_cube', '11', '1')
    assert json.loads(begin['arguments']) == {'robot': 'UR5e', 'gripper': 'default'}
    assert json.loads(begin['settings']) == {'policy': 'expert'}
    assert end['digest'] == seen[-1] and end['periods'] == '12' and end['success'] == 'false'
    assert attached.name == 'model.mjz'
    model = load_archive(attached.data)
    assert model.nq == episode.simulation.model.nq


def test_digests_are_recorded_at_the_start_and_every_so_many_periods(recorded):
    digests = messages(recorded[0], '/episode/digest')
    assert len(digests) == 2 * 3
    assert len({digest.data for digest in digests}) == 6


def test_images_are_jpeg(recorded):
    import io

    from PIL import Image
    images = messages(recorded[0], '/front/color/image_raw/compressed')
    assert len(images) == 24 and images[0].header.frame_id == 'front_optical_frame'
    found = np.asarray(Image.open(io.BytesIO(images[0].data.tobytes())))
    assert found.shape == _IMAGE.shape and abs(found.astype(int) - _IMAGE).mean() < 3


def test_a_file_that_is_there_is_overwritten_only_if_asked(tmp_path, episode):
    path = tmp_path / 'a.mcap'
    path.write_bytes(b'precious')
    with pytest.raises(RecordError, match='a.mcap already exists and is not overwritten'):
        EpisodeRecorder(path, episode)
    assert path.read_bytes() == b'precious'
    EpisodeRecorder(path, episode, overwrite=True).close()
    assert path.read_bytes()[1:5] == b'MCAP'


def test_a_folder_that_is_not_there_is_an_error(tmp_path, episode):
    with pytest.raises(RecordError, match='a.mcap: No such file or directory'):
        EpisodeRecorder(tmp_path / 'none/a.mcap', episode)


def test_arguments_that_are_no_json_are_an_error(tmp_path):
    task = create_task('reach', 'Panda', objects=[
        {'name': 'ball', 'shape': 'sphere', 'size': [0.02], 'position': np.array([1.0, 0, 1])}])
    with pytest.raises(RecordError, match='arguments of reach cannot be recorded: .*ndarray'):
        EpisodeRecorder(tmp_path / 'a.mcap', Episode(task, Simulation(task.world)))
    assert not list(tmp_path.iterdir())


def test_what_noise_and_latency_change_is_recorded_as_it_is_measured(tmp_path):
    task = create_task('reach', 'UR5e')
    episode = Episode(task, Simulation(task.world))
    robot, expert = episode.simulation.robot, task.expert(episode.simulation)
    for name, value in (('noise.wrench_force', 1.0), ('latency.state', 0.04)):
        robot.sensing.set(name, value)
    path, measured, exact = tmp_path / 'noisy.mcap', [], []
    with EpisodeRecorder(path, episode) as recorder:
        episode.reset(3)
        expert.reset(3)
        recorder.begin(3)
        for _ in range(5):
            action = expert.act()
            episode.step(action)
            recorder.period(action)
            for found, read in ((measured, robot.sensing.measured), (exact, robot.sensing.exact)):
                found.append(np.concatenate([read('right/wrench')[:3], read('right/pose')[:3]]))
        recorder.end()
    recorded = [[w.wrench.force.x, w.wrench.force.y, w.wrench.force.z,
                 p.pose.position.x, p.pose.position.y, p.pose.position.z]
                for w, p in zip(messages(path, '/right/wrench'),
                                messages(path, '/right/eef_pose'))]
    np.testing.assert_array_equal(recorded[1:], measured)
    assert not np.isclose(measured, exact).any()


@pytest.mark.full
@pytest.mark.parametrize(('name', 'robot', 'more'), [
    ('reach', 'UR5e', {'idn': 3}), ('hand_over', 'IIWA', {}),
    ('reach', 'Panda', {'prefix': 'p_'})])
def test_a_record_names_the_type_of_the_robot_without_its_number(tmp_path, name, robot, more):
    task = create_task(name, robot, **more)
    episode = Episode(task, Simulation(task.world))
    path = tmp_path / 'one.mcap'
    with EpisodeRecorder(path, episode) as recorder:
        episode.reset(1)
        recorder.begin(1)
        action = task.expert(episode.simulation).act()
        episode.step(action)
        recorder.period(action)
        recorder.end()
    (recorded,) = Record(path).episodes()
    assert recorded.about['robot'] == robot


@pytest.mark.full
def test_each_of_two_arms_has_its_own_pose_and_wrench(tmp_path):
    task = create_task('hand_over', 'Baxter')
    episode = Episode(task, Simulation(task.world))
    with EpisodeRecorder(tmp_path / 'a.mcap', episode) as recorder:
        episode.reset(3)
        recorder.begin(3)
        recorder.end()
    sensing = episode.simulation.robot.sensing
    for arm in ('right', 'left'):
        for topic, channel in (('eef_pose', 'pose'), ('external_wrench', 'external_wrench')):
            (message,) = messages(tmp_path / 'a.mcap', f'/{arm}/{topic}')
            found = message.pose.position if channel == 'pose' else message.wrench.force
            assert [found.x, found.y, found.z] == sensing.measured(f'{arm}/{channel}')[:3].tolist()


class Run(NamedTuple):
    """The record of an episode, and its end."""

    path: Path
    digest: str
    positions: list
    lines: list


@pytest.fixture
def record(tmp_path, caplog):
    """Return a function that records five periods of reach for each seed."""
    task = create_task('reach', 'Panda')
    simulation = Simulation(task.world)
    episode = Episode(task, simulation)

    def run(name, *seeds):
        heights = []
        with EpisodeRecorder(tmp_path / name, episode) as recorder:
            for seed in seeds:
                episode.reset(seed)
                recorder.begin(seed)
                for _ in range(5):
                    episode.step(np.full(episode.actions.size, 0.3))
                    recorder.period(np.full(episode.actions.size, 0.3))
                    heights.append(
                        simulation.data.site('gripper0_right_grip_site').xpos[2].item())
                recorder.end()
        return Run(tmp_path / name, episode.digest, heights,
                   [line.getMessage() for line in caplog.records])
    return run


@pytest.mark.full
def test_an_installed_sensor_is_recorded_with_the_noise_of_the_seed(
        install_example, monkeypatch, record):
    without = record('without.mcap', 3)
    monkeypatch.syspath_prepend(install_example('end_effector_imu'))
    once, again, other = (record(f'{name}.mcap', seed) for name, seed in (
        ('once', 3), ('again', 3), ('other', 4)))
    assert once.digest == again.digest == without.digest
    readings = [[[v.x, v.y, v.z] for m in messages(run.path, '/right/imu')
                 for v in (m.angular_velocity, m.linear_acceleration)]
                for run in (once, again, other)]
    assert len(readings[0]) == 2 * 6
    # At rest at the start: gravity, and the noise of two seeds.
    assert np.linalg.norm(readings[0][1]) == pytest.approx(9.81, abs=0.3)
    assert readings[0] == readings[1], 'the noise is another one after other episodes'
    assert readings[0] != readings[2] and np.allclose(readings[0][0], readings[2][0], atol=0.02)
    first = messages(once.path, '/right/imu')[0]
    assert first.header.frame_id == 'gripper0_right_grip_site'
    assert first.angular_velocity_covariance[4] == pytest.approx(0.002**2)
    (clock, *_) = messages(once.path, '/clock')
    assert first.header.stamp == clock.clock
    (recorded,) = Record(once.path).episodes()
    assert Frames(recorded).observed.positions.keys() == {'robot0'}, 'cannot be converted'


@pytest.mark.full
def test_a_sensor_with_messages_of_its_own_begins_anew_in_each_episode(
        install_example, monkeypatch, record):
    monkeypatch.syspath_prepend(install_example('touched_bodies'))
    path = record('a.mcap', 3, 4).path
    texts = messages(path, '/manip_sim/touched')
    assert [text.data for text in texts] == ['', '']


SENSORS = """
from dataclasses import replace
from manip_sim.interface.offered_sensors import Sensor, TopicSource
from manip_sim.interface.topics import PUBLISHED, Topic
TOPIC = Topic('<arm>/height', 'std_msgs/Float64', PUBLISHED, 'of grip_site [m]')

class Height(Sensor):
    topic = TOPIC
    def read(self, simulation):
        return [simulation.data.site(self.robot.end_effectors[self.of].grip_site).xpos[2]]
    def fill(self, message, values):
        message.data = values[0]

class Late(Sensor):
    topic = replace(TOPIC, name='~/late')
    def read(self, simulation):
        return [1.0 if simulation.data.qvel[0] == 0.0 else float('nan')]
    def fill(self, message, values):
        message.data = values[0]

class Field(TopicSource):
    topic = replace(TOPIC, name='~/field')
    def write(self, message, simulation):
        message.datum = 1.0

class Typeless(TopicSource):
    topic = replace(TOPIC, name='~/typeless', type='no_msgs/None')
    def write(self, message, simulation):
        pass

class Broken(TopicSource):
    topic = replace(TOPIC, name='~/broken')
    def __init__(self):
        pass
    def write(self, message, simulation):
        pass

class Taken(TopicSource):
    topic = replace(TOPIC, name='<arm>/eef_pose')
    def write(self, message, simulation):
        pass
"""


def test_sensors_that_fail_are_named_once_and_the_others_and_the_episode_go_on(
        package_on_path, monkeypatch, record):
    monkeypatch.setattr(resources, '_all_offers', resources._all_offers.__wrapped__)
    digest = record('without.mcap', 3, 4).digest
    points = ['Height', 'Late', 'Field', 'Typeless', 'Broken', 'Taken']
    package_on_path('manip_sim.sensors', 'recorded_sensors', SENSORS, dict(zip(points, points)))
    run = record('with.mcap', 3, 4)
    assert run.digest == digest
    heights = [message.data for message in messages(run.path, '/right/height')]
    assert heights[1:6] + heights[7:] == run.positions
    assert [message.data for message in messages(run.path, '/manip_sim/late')] == [1.0]
    for name, text in (('Late', 'finite'), ('Field', "Float64 has no field 'datum'"),
                       ('Typeless', 'no_msgs/msg/None is not installed'),
                       ('Broken', 'TypeError'), ('Taken', 'is that of manip_sim')):
        (line,) = [line for line in run.lines
                   if f"'{name}' of the package recorded_sensors" in line]
        assert text in line and '1.2' in line
    with AnyReader([run.path]) as reader:
        assert not {'/manip_sim/field', '/manip_sim/typeless', '/manip_sim/broken'
                    } & reader.topics.keys()
