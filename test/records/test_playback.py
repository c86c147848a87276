# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Records in the browser: what the page shows of which period."""

import os
import signal
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

for needed in ('mcap', 'mcap_ros2', 'viser'):
    pytest.importorskip(needed, reason='needs the extras records and viewer')

from hostile_records import about, content, model, rewrite  # noqa: E402
from mcap_ros2._dynamic import serialize_dynamic  # noqa: E402

from manip_sim.cli.main import main as manip_sim  # noqa: E402
from manip_sim.errors import RecordError  # noqa: E402
from manip_sim.models import compose  # noqa: E402
from manip_sim.records.converting import Frames  # noqa: E402
from manip_sim.records.record_file import definition, full_name, RecordFile  # noqa: E402
from manip_sim.records.recorded import Record  # noqa: E402
from manip_sim.records.recorder import MODEL, NODE  # noqa: E402
from manip_sim.viewer.page.model_scene import first_view  # noqa: E402
from manip_sim.viewer.page.server import Access, close_server, open_server  # noqa: E402
from manip_sim.viewer.playback import described, entries_in, Entry, Player  # noqa: E402

#: Runs the program as if ROS were not installed.
WITHOUT_ROS = """
import sys
sys.modules['rclpy'] = None
from manip_sim.viewer.__main__ import main
sys.exit(main())
"""


@pytest.fixture
def player(recording):
    """Return a page with the episodes of a record, of which the second one failed."""
    server = open_server('127.0.0.1', 0, Access.of({}, ()))
    entries = [Entry(recording, found.number, found.seed, found.success)
               for found in Record(recording).episodes()]
    yield Player(server, entries)
    close_server(server)


@pytest.fixture
def frames(recording):
    return [Frames(recorded) for recorded in Record(recording).episodes()]


def slider_of(player):
    return player._timeline._slider


def end_effector_of(player):
    """Return where the end effector is in the scene."""
    model, data = player._kinematics.model, player._kinematics.data
    (site,) = (i for i in range(model.nsite) if model.site(i).name.endswith('grip_site'))
    # Of the body, as kinematics alone is computed for the page.
    body = model.site_bodyid[site]
    return data.xpos[body] + data.xmat[body].reshape(3, 3) @ model.site_pos[site]


@pytest.mark.full
def test_the_scene_shows_the_period_of_the_slider(player, frames):
    (poses,) = frames[0].observed.end_effectors.values()
    for period in (0, 5, 2, len(frames[0].actions)):
        slider_of(player).value = period
        player.update(0.0)
        np.testing.assert_allclose(end_effector_of(player), poses.values[period, :3], atol=1e-6)
    assert 'period' in player._text._shown and slider_of(player).max == len(frames[0].actions)
    assert player._text._shown.endswith(f', reward {frames[0].rewards[-1]:.3f}</div>')
    slider_of(player).value = 0
    player.update(0.0)
    assert 'reward' not in player._text._shown  # There is none at the start.


@pytest.mark.full
def test_failure_leads_to_the_end_of_the_next_episode_that_failed(player, frames):
    player._jump('Failure')
    player.update(0.0)
    assert player._choice.value.endswith('#1, seed 11: FAILED')
    assert slider_of(player).value == slider_of(player).max == len(frames[1].actions)
    (poses,) = frames[1].observed.end_effectors.values()
    np.testing.assert_allclose(end_effector_of(player), poses.values[-1, :3], atol=1e-6)
    player._jump('Failure')  # There is no other one.
    assert player._choice.value.endswith('#1, seed 11: FAILED')
    player._jump('Previous')
    assert player._choice.value.endswith('#0, seed 3: done') and slider_of(player).value == 0


@pytest.mark.full
def test_plots_show_the_numbers_of_the_record_and_the_present_instant(player, frames):
    player._quantity.value = 'joint position'
    slider_of(player).value = 4
    player.update(0.0)
    times, *columns, now = player._plot.data
    (joints,) = frames[0].observed.positions.values()
    at = np.searchsorted(times, np.arange(len(joints.values)) * 0.05 - 1e-9)
    np.testing.assert_allclose(np.array(columns)[:, at].T, joints.values, atol=1e-6)
    assert (times[0], times[-1]) == pytest.approx((0.0, 0.05 * (len(joints.values) - 1)), abs=1e-3)
    assert times[np.argmax(now)] == pytest.approx(0.2)
    assert player._plot.scales == {'x': {'time': False}}  # Seconds, not dates.
    assert {'reward', 'action', 'right position', 'right external force'} <= set(
        player._quantity.options)


def test_an_episode_without_numbers_has_no_plot_but_the_next_one_has(player, monkeypatch):
    read = Entry.read

    def bare(entry):
        shown = read(entry)
        if entry.number == 1:
            shown.plots = {}
        return shown
    monkeypatch.setattr(Entry, 'read', bare)
    for _ in range(2):
        player._jump('Next')
        assert player._plot is None and player._quantity.options == ('nothing',)
        player.update(0.0)
        player._jump('Previous')
        assert player._plot is not None and 'reward' in player._quantity.options
        player.update(0.0)


def test_playing_goes_on_to_the_end_at_its_speed(player, frames):
    player._timeline._speed.value = '4'
    player._timeline._play.value = True
    player.update(100.0)
    player._timeline.go(0)
    player.update(100.1)
    assert slider_of(player).value == 8  # 0.1 s four times as fast, in periods of 0.05 s.
    for tenth in range(2, 60):
        player.update(100.0 + tenth / 10.0)
    assert slider_of(player).value == len(frames[0].actions)
    assert not player._timeline._play.value


def test_images_are_those_of_the_period(player, frames):
    wanted = list(frames[0].images('front'))
    for period in (0, 3):
        player._timeline.go(period)
        np.testing.assert_array_equal(player._images['front'].image, wanted[period])


@pytest.mark.full
def test_it_runs_without_ros_and_ends_with_a_signal(recording):
    with subprocess.Popen(
            [sys.executable, '-c', WITHOUT_ROS, '--record', str(recording.parent), '--port', '0'],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            env={**os.environ, 'PYTHONUNBUFFERED': '1'}) as viewer:
        line = viewer.stdout.readline()
        assert line.startswith('sim_view: http://127.0.0.1:')
        assert line.endswith(' shows 2 episodes, 1 of them failed\n')
        viewer.send_signal(signal.SIGINT)
        _, errors = viewer.communicate(timeout=300.0)
        assert (viewer.returncode, errors) == (0, '')


@pytest.mark.full
def test_a_file_that_is_no_record_is_one_line(tmp_path):
    path = tmp_path / 'a.mcap'
    path.write_text('no record')
    done = subprocess.run([sys.executable, '-m', 'manip_sim.viewer', '--record', str(path)],
                          capture_output=True, text=True, timeout=300.0)
    assert (done.returncode, done.stderr) == (1, f'sim_view: {path}: no MCAP file\n')


class NodeRecord:
    """Writes what a node sends as ``manip_sim record`` does."""

    def __init__(self, path, *archives):
        self._file = RecordFile(path)
        self._file.describe(NODE, {'node': '/cell/manip_sim', 'manip_sim': '0.1.0'})
        for archive in archives:
            self.attach(archive)

    def attach(self, archive):
        self._file.attach(MODEL, 'application/zip', archive)

    def write(self, topic, kind, time_s, **content):
        name, text = full_name(kind), definition(kind)
        content['header'] = {'stamp': {'sec': int(time_s), 'nanosec': round(time_s % 1 * 1e9)},
                             'frame_id': 'world'}
        self._file.write(self._file.channel(topic, name, text), 5,
                         serialize_dynamic(name, text)[name](content))

    def joints(self, time_s, *positions, topic='/cell/joint_states'):
        self.write(topic, 'sensor_msgs/JointState', time_s, position=list(positions), effort=[],
                   name=['robot0_joint1', 'robot0_joint4'], velocity=[0.0, 0.0])

    def close(self):
        self._file.close()


@pytest.fixture
def show():
    """Return a function that opens records on a page."""
    servers = []

    def show(*paths):
        servers.append(open_server('127.0.0.1', 0, Access.of({}, ())))
        return Player(servers[-1], entries_in(paths))
    yield show
    for server in servers:
        close_server(server)


def angles(player):
    return [player._kinematics.data.joint(name).qpos[0]
            for name in ('robot0_joint1', 'robot0_joint4')]


def test_a_record_of_a_node_is_shown_as_its_messages_say(show, episode, recording, tmp_path):
    archive = episode.task.world.to_archive()
    record = NodeRecord(tmp_path / 'node.mcap', archive)
    record.joints(7.0, 0.1, -2.0)
    record.joints(7.0, 0.9, -0.9)  # A paused node repeats its state.
    record.joints(7.5, np.nan, -2.1)
    record.joints(8.0, 0.3, -2.2)
    record.attach(archive)  # It begins another world.
    record.joints(2.0, 0.4, -2.3)
    record.joints(2.1, 0.7, -2.3, topic='/cell/truth/joint_states')
    record.joints(2.1, 0.5, -2.4)
    record.close()
    player = show(tmp_path / 'node.mcap', recording)
    assert described(player._entries) == (
        '2 episodes, 1 of them failed and 2 worlds of nodes')
    assert slider_of(player).max == 1 and angles(player) == [0.1, -2.0]
    assert '7.00 s of the simulation, state 0 of 1' in player._text._shown
    assert 'Not recorded, and so at their start: gripper0_right_finger_joint1' in (
        player._text._shown)
    slider_of(player).value = 1
    player._quantity.value = 'cell joint position'
    player.update(0.0)
    assert angles(player) == [0.3, -2.2]
    times, one, four, now = player._plot.data
    assert (times.min(), times.max()) == pytest.approx((0.0, 1.0), abs=1e-3)
    assert (one.min(), one.max(), four.min()) == pytest.approx((0.1, 0.3, -2.2))
    assert times[np.argmax(now)] == pytest.approx(1.0)
    player._jump('Next')
    player._timeline.go(1)
    assert player._choice.value == 'node #1, node /cell/manip_sim'
    assert angles(player) == [0.7, -2.3]  # The exact state, in place of the measured one.
    player._jump('Failure')
    assert player._choice.value.endswith('#1, seed 11: FAILED')


def test_a_body_is_at_its_newest_pose_and_at_its_first_one_before(show, tmp_path):
    record = NodeRecord(tmp_path / 'node.mcap', compose('Panda', arena='table').to_archive())
    for second in range(5):
        record.joints(float(second), 0.1, -2.0)
        if second > 1:
            record.write('/cell/objects/cube/pose', 'geometry_msgs/PoseStamped', second + 0.5,
                         pose={'position': {'x': float(second), 'y': 0.0, 'z': 1.0},
                               'orientation': {'x': 0.0, 'y': 0.0, 'z': 0.0, 'w': 1.0}})
    record.close()
    player = show(tmp_path / 'node.mcap')
    seen = []
    for instant in range(5):
        player._timeline.go(instant)
        seen.append(player._kinematics.data.body('cube').xpos[0])
    assert seen == [2.0, 2.0, 2.0, 2.0, 3.0]


def test_the_wrench_at_an_end_effector_and_its_pose_are_plotted(show, tmp_path):
    record = NodeRecord(tmp_path / 'node.mcap', compose('Panda').to_archive())
    for second in (1.0, 2.0):
        record.joints(second, 0.1, -2.0)
        for topic, force in (('external_wrench', 20.0), ('desired_wrench', 7.0)):
            record.write(f'/cell/right/{topic}', 'geometry_msgs/WrenchStamped', second, wrench={
                'force': {'x': second, 'y': force, 'z': 30.0},
                'torque': dict.fromkeys('xyz', 0.0)})
        record.write('/cell/right/eef_pose', 'geometry_msgs/PoseStamped', second, pose={
            'position': {'x': second, 'y': 0.2, 'z': 0.3},
            'orientation': dict.fromkeys('xyzw', 0.5)})
    record.close()
    plots = show(tmp_path / 'node.mcap')._shown.plots
    assert [name for name in plots if 'joint' not in name] == [
        'cell right external force', 'cell right position']
    assert plots['cell right external force'].values.tolist() == [
        [1.0, 20.0, 30.0], [2.0, 20.0, 30.0]]
    assert plots['cell right position'].values.tolist() == [[1.0, 0.2, 0.3], [2.0, 0.2, 0.3]]


@pytest.mark.full
def test_browsers_look_at_the_robot_of_the_record_that_is_shown(show, tmp_path, monkeypatch):
    for robot in ('Panda', 'GR1'):
        record = NodeRecord(tmp_path / f'{robot}.mcap', compose(robot).to_archive())
        record.joints(1.0, 0.1, -2.0)
        record.joints(2.0, 0.1, -2.0)
        record.close()
    player = show(tmp_path / 'Panda.mcap', tmp_path / 'GR1.mcap')
    first = player._server.initial_camera
    camera = SimpleNamespace(image_width=800, image_height=400, fov=first.fov,
                             position=first.position, look_at=first.look_at)
    monkeypatch.setattr(player._server, 'get_clients', lambda: {
        1: SimpleNamespace(camera=camera)})
    for robot in range(2):
        player._open(robot)
        player.update(float(robot))
        seen = first_view(player._kinematics.model, player._kinematics.data, 2.0, 0.5)
        np.testing.assert_allclose([camera.position, camera.look_at], seen)
    camera.position = moved = np.array([9.0, 9.0, 9.0])
    player._timeline.go(1)
    player.update(3.0)
    assert camera.position is moved


def test_what_a_record_of_a_node_lacks_is_one_line(episode, tmp_path, capsys):
    archive, path = episode.task.world.to_archive(), tmp_path / 'no_model.mcap'
    record = NodeRecord(path)
    record.joints(1.0, 0.1, -2.0)
    record.close()
    with pytest.raises(RecordError, match='of /cell/manip_sim cannot be shown: it has no model'):
        entries_in([path])
    for verb, reason in (
            (['replay', str(path)], 'is the record of a node without the beginning of its '
             'journal, so it cannot be repeated: record ~/journal too'),
            (['convert', str(path), '--to', 'hdf5', f'{path}.hdf5'],
             "is a record of the node '/cell/manip_sim', which has no episodes; manip_sim replay "
             'repeats it, and sim_view --record shows it')):
        assert manip_sim(verb) == 1
        error = capsys.readouterr().err
        assert error.count('\n') == 1 and reason in error
    record = NodeRecord(tmp_path / 'no_joints.mcap', archive)
    record.write('/objects/cube/pose', 'geometry_msgs/PoseStamped', 1.0, pose={
        'position': dict.fromkeys('xyz', 0.0), 'orientation': dict.fromkeys('xyzw', 0.5)})
    record.close()
    with pytest.raises(RecordError, match='cannot be shown: it has no joint_states'):
        entries_in([tmp_path / 'no_joints.mcap'])


def test_an_entry_that_is_not_in_the_record_any_more_is_told(recording):
    for entry in (Entry(recording, 99), Entry(recording, 0, node='sim'), Entry(recording, 5)):
        with pytest.raises(RecordError, match='the record has changed$'):
            entry.read()
    assert len(Entry(recording, 1).read().times) > 1


def test_records_of_one_name_in_two_folders_can_both_be_chosen(show, recording, tmp_path):
    for folder in 'ab':
        (tmp_path / folder).mkdir()
        rewrite(recording, tmp_path / folder / 'reach.mcap', about(instruction=f'In {folder}.'))
    player = show(tmp_path)
    labels = player._choice.options
    assert len({*labels}) == len(labels) == 4
    player._choice.value = labels[2]
    player.update(0.0)
    assert 'In b.' in player._text._shown and player._choice.value == labels[2]


@pytest.mark.parametrize('change', [
    content('/episode/state', b''), content('/episode/action', b'\0'), model(b'no zip')])
def test_an_episode_that_cannot_be_shown_is_a_line_on_the_page(
        show, recording, tmp_path, change):
    rewrite(recording, tmp_path / 'a.mcap', change)
    player = show(tmp_path)
    assert player._text._shown and player._scene is None
    player.update(0.0)
