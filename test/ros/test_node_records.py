# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Records of running nodes, by the command in a process of its own."""

import resource
import signal
import subprocess
import sys
from unittest.mock import Mock

from harness import END_SIGNALS, START_S
import pytest
from rclpy.duration import Duration
from std_msgs.msg import Float64MultiArray
import yaml

for needed in ('mcap', 'rosbags'):
    pytest.importorskip(needed, reason='needs the extras records and test')

from mcap.reader import make_reader  # noqa: E402
from mcap.stream_reader import StreamReader  # noqa: E402
from rosbags.highlevel import AnyReader  # noqa: E402

from manip_sim.models.archive import load_archive  # noqa: E402
from manip_sim.records import node_recorder  # noqa: E402
from manip_sim.records.recorded import Record  # noqa: E402

WAIT_S = 300.0


@pytest.fixture
def record(process):
    """Return a function that starts the command."""
    return lambda *arguments: process('record', *map(str, arguments), module='manip_sim.cli')


def grown(client, path, size):
    """Wait until a file has a size [bytes]."""
    client.spin_until(lambda: path.exists() and path.stat().st_size > size)


def typed(path, topic):
    """Return the messages of a topic, as rosbags reads them by the types in the file."""
    with AnyReader([path]) as reader:
        connections = [found for found in reader.connections if found.topic == topic]
        return [reader.deserialize(content, found.msgtype)
                for found, _, content in reader.messages(connections)]


def assert_shown(path, state):
    """Check that the viewer shows the last state of a record."""
    pytest.importorskip('viser', reason='needs the extra viewer')
    from manip_sim.viewer.page.model_scene import Kinematics
    from manip_sim.viewer.playback import ShownWorld
    (world,) = Record(path).contents()
    shown, kinematics = ShownWorld(world), Kinematics(load_archive(world.model))
    shown.check(kinematics.model)
    shown.place(kinematics, len(shown.times) - 1)
    # At rest, and the topics of the record do not all end with the same state.
    assert [kinematics.data.joint(name).qpos[0] for name in state.name] == pytest.approx(
        list(state.position), abs=1e-6)
    assert kinematics.data.body('cube').xpos[2] == pytest.approx(0.82, abs=0.01)
    assert len(shown.lines(0)) == 2  # All joints and bodies are recorded.


@pytest.mark.full
@pytest.mark.parametrize('number', END_SIGNALS[-1:])  # SIGINT ends those of test_journal.py.
def test_all_topics_of_a_node_are_recorded_until_a_signal(
        number, sim_process, record, client, tmp_path):
    sim_process('arena:=table', 'robot:=UR5e')
    names = list(client.state().name)
    path = tmp_path / 'all.mcap'
    command = record(path)
    grown(client, path, 100_000)
    command.send_signal(number)
    out, errors = command.communicate(timeout=WAIT_S)
    assert (command.returncode, errors) == (0, '')
    assert out.startswith(f'{path} (') and ' messages of ' in out
    with path.open('rb') as file:
        for _ in StreamReader(file, validate_crcs=True).records:
            pass
        file.seek(0)
        reader = make_reader(file)
        topics = {channel.topic for channel in reader.get_summary().channels.values()}
        (about,) = [item.metadata for item in reader.iter_metadata()]
        attached = [item for item in reader.iter_attachments()]
    assert {'/joint_states', '/objects/cube/pose', '/right/wrench', '/clock', '/joint_command',
            '/manip_sim/mjcf'} <= topics
    parameters = yaml.safe_load(about['parameters'])
    assert (parameters['robot'], parameters['arena']) == ('UR5e', 'table')
    assert load_archive(attached[-1].data).body('cube').id
    with AnyReader([path]) as reader:
        for connection, _, content in reader.messages():
            reader.deserialize(content, connection.msgtype)
    states = typed(path, '/joint_states')
    assert len(states) > 5 and list(states[0].name) == names
    stamps = [state.header.stamp.sec * 10**9 + state.header.stamp.nanosec for state in states]
    assert stamps == sorted(stamps)
    (model,) = typed(path, '/manip_sim/mjcf')
    assert '<mujoco' in model.data
    assert_shown(path, states[-1])


@pytest.fixture
def waiting(client, tmp_path):
    """Return a recorder, and its file, for which 200 messages have come that it has not taken."""
    publisher = client.node.create_publisher(Float64MultiArray, 'waiting', 1000)
    recorder = node_recorder._NodeRecorder(client.node, client.executor, '/client', ['waiting'])
    recorder.open(tmp_path / 'waiting.mcap')
    client.spin_until(lambda: publisher.get_subscription_count() == 1)
    for number in range(200):
        publisher.publish(Float64MultiArray(data=[number]))
    assert publisher.wait_for_all_acked(Duration(seconds=START_S))
    return recorder, tmp_path / 'waiting.mcap'


def end(recorder):
    """Let a recorder end at once."""
    recorder.run(Mock(wait=lambda timeout_s: True), None, print)
    recorder.close()


def test_what_has_come_before_the_end_and_waits_is_recorded(waiting):
    recorder, path = waiting
    end(recorder)
    assert [message.data[0] for message in typed(path, '/waiting')] == list(range(200))


def test_what_comes_after_the_end_is_not_waited_for(waiting, monkeypatch):
    recorder, path = waiting
    monkeypatch.setattr(node_recorder.time, 'time_ns', lambda: 0)
    end(recorder)
    assert [message.data[0] for message in typed(path, '/waiting')] == [0.0]


@pytest.mark.full
def test_named_topics_are_recorded_for_a_time(sim_process, record, client, tmp_path):
    sim_process()
    client.state()
    path = tmp_path / 'some.mcap'
    command = record(path, 'joint_states', '~/dynamics', '--duration', 2)
    out, errors = command.communicate(timeout=WAIT_S)
    assert (command.returncode, errors) == (0, '')
    assert ' messages of 2 topics, 2.' in out
    with AnyReader([path]) as reader:
        assert set(reader.topics) == {'/joint_states', '/manip_sim/dynamics'}
        assert reader.topics['/manip_sim/dynamics'].msgcount == 1
    again = record(path)
    out, errors = again.communicate(timeout=WAIT_S)
    assert (again.returncode, out) == (1, '')
    assert errors == f'manip_sim: {path} already exists and is not overwritten\n'


@pytest.mark.full
def test_a_record_without_a_node_says_what_to_check(record, tmp_path):
    command = record(tmp_path / 'none.mcap')
    # Kilted warns of the profile for discovery before.
    assert ("manip_sim: there is no node '/manip_sim': no other node in ROS domain "
            in command.communicate(timeout=WAIT_S)[1])
    assert command.returncode == 1


@pytest.mark.full
def test_what_is_not_there_is_one_line_and_no_file(sim_process, record, client, tmp_path):
    sim_process()
    client.state()
    path = tmp_path / 'none.mcap'
    commands = [record(path, '--node', 'manip_simm'), record(path, 'joint_stats')]
    (_, no_node), (_, no_topic) = (command.communicate(timeout=WAIT_S) for command in commands)
    assert [command.returncode for command in commands] == [1, 1]
    assert no_node.startswith(
        "manip_sim: there is no node '/manip_simm': did you mean '/manip_sim'? available: ")
    assert no_topic.startswith("manip_sim: the node /manip_sim has no topic '/joint_stats': did "
                               "you mean '/joint_states' or ")
    assert (no_node + no_topic).count('\n') == 2 and not path.exists()


@pytest.mark.full
def test_a_killed_recorder_and_a_full_disk_leave_what_came_before(
        sim_process, record, client, tmp_path):
    sim_process()
    client.state()
    killed, full = tmp_path / 'killed.mcap', tmp_path / 'full.mcap'
    command = record(killed)
    with subprocess.Popen(
            [sys.executable, '-m', 'manip_sim.cli', 'record', str(full)], text=True,
            stderr=subprocess.PIPE, preexec_fn=lambda: resource.setrlimit(
                resource.RLIMIT_FSIZE, (120_000, 120_000))) as limited:
        _, errors = limited.communicate(timeout=WAIT_S)
    assert limited.returncode == 1
    # Before it, Fast DDS 3 says that the limit is too small for its shared memory.
    assert errors.splitlines()[-1] == (
        f'manip_sim: {full}: File too large; what was recorded before can be read')
    grown(client, killed, 60_000)
    command.send_signal(signal.SIGKILL)
    command.wait(WAIT_S)
    for path in (killed, full):
        kinds, cut_off = [], False
        with path.open('rb') as file:
            try:
                for item in StreamReader(file).records:
                    kinds.append(type(item).__name__)
            except Exception:  # It raises whatever it comes upon at the end.
                cut_off = True
        assert cut_off and kinds.count('Message') > 50
