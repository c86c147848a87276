# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim demonstrate``: by a file, by keys in a terminal, and events of the kernel."""

import csv
import importlib.util
import os
import pty
import struct
import time
from types import SimpleNamespace

import numpy as np
import pytest

from manip_sim.errors import CommandError, ModelError, UnknownNameError
from manip_sim.experiments.demonstrations import (
    Demonstrator, Device, DISCARD, DONE, EventDevice, is_spacemouse, Keyboard, LeaderArm,
    open_leader, QUIT, Reading)
from manip_sim.tasks import Setting

pytest.importorskip('mcap_ros2', reason='needs the extra records')
from manip_sim.records.recorded import Record  # noqa: E402


@pytest.fixture(scope='module')
def expert(tmp_path_factory):
    """Return a file of actions that reach from the start of seed 0, then of seed 1, and more."""
    episode = Setting('reach').create_episode()
    expert = episode.task.expert(episode.simulation)
    path = tmp_path_factory.mktemp('actions') / 'reach.csv'
    with path.open('w', newline='') as file:
        writer = csv.writer(file)
        writer.writerow([*episode.actions.names, 'event'])
        for seed in (0, 1):
            episode.reset(seed)
            expert.reset(seed)
            while not episode.over:
                action = expert.act()
                episode.step(action)
                writer.writerow([*map(repr, action.tolist()), ''])
            # The task is done before these.
            writer.writerow([*[0.0] * len(action), ''])
            writer.writerow([*[0.0] * len(action), DONE])
        for event in ('', DISCARD, '', '', DONE):
            writer.writerow([*[0.0] * len(action), event])
    return path


def test_a_file_demonstrates_to_success_and_each_record_repeats(here, expert, tmp_path):
    code, output, errors = here('demonstrate', 'reach', '--device', f'file:{expert}', '--out',
                                tmp_path / 'out', '--episodes', 3)
    assert code == 0
    assert output == f'{tmp_path / "out"}: 3 demonstrations, 2 with success; 3 of 3 repeat\n'
    lines = errors.splitlines()
    assert [line.partition(' after')[0] for line in lines] == [
        'seed 0: success', 'seed 1: success', 'seed 2: no success', 'seed 2: no success']
    assert 'repeats to success' in lines[0] and lines[2].endswith(', discarded')
    files = sorted((tmp_path / 'out').iterdir())
    assert [file.name for file in files] == ['0.mcap', '1.mcap', '2.mcap']
    (recorded,) = Record(files[1]).episodes()
    assert recorded.seed == 1 and recorded.success
    assert recorded.json('settings') == {'device': f'file:{expert}'}
    assert here('replay', '--verify', tmp_path / 'out')[0] == 0
    # The folder has these seeds, and the actions belong to other starts.
    before = files[0].read_bytes()
    code, _, errors = here('demonstrate', 'reach', '--device', f'file:{expert}', '--out',
                           tmp_path / 'out')
    assert code == 0 and errors.startswith('seed 3: ') and files[0].read_bytes() == before


@pytest.mark.parametrize(('text', 'message'), [
    ('', 'has no column'), ('x,y\n1,2\n', 'unknown column of'),
    ('{names}\n1,2\n', 'row 2 has 2 cells, and the header has 7'),
    ('{names}\n1,2,3,4,5,6,nan\n', 'row 2 has a number that is not finite'),
    ('{names}\n1,2,3,4,5,6,b\n', 'row 2: could not convert'),
    ('{names},event\n1,2,3,4,5,6,7,stop\n', 'unknown event in'),
    ('{names}\n', 'no demonstration')], ids=range(7))
def test_files_of_actions_that_cannot_be_used_are_told(here, tmp_path, text, message):
    names = ','.join(Setting('reach').create_episode().actions.names)
    (tmp_path / 'actions.csv').write_text(text.format(names=names))
    code, output, errors = here('demonstrate', 'reach', '--device',
                                f'file:{tmp_path / "actions.csv"}', '--out', tmp_path / 'out')
    assert code == 1 and message in errors + output.replace('0 demonstr', 'no demonstr')
    assert not list(tmp_path.glob('out/*'))


@pytest.mark.parametrize(('arguments', 'message'), [
    (('reach', '--device', 'file:no.csv'), 'no.csv: No such file'),
    (('reach', '--device', 'keybord'), "unknown device 'keybord': did you mean 'keyboard'"),
    (('reach', '--device', 'keyboard'), 'the keyboard needs a terminal'),
    (('reech', '--device', 'keyboard'), "did you mean 'reach'"),
    (('reach', '--device', 'gamepad'), 'gamepad')])
def test_wrong_arguments_end_before_anything_is_written(here, tmp_path, arguments, message):
    code, _, errors = here('demonstrate', *arguments, '--out', tmp_path / 'out')
    assert code == 1 and message in errors and not (tmp_path / 'out').exists()


@pytest.fixture
def typed(monkeypatch):
    """Return a function that types on the terminal that is the input of this process."""
    outer, inner = pty.openpty()
    with os.fdopen(inner) as terminal:
        monkeypatch.setattr('sys.stdin', terminal)
        yield lambda text: os.write(outer, text.encode())
    os.close(outer)


def test_keys_move_grip_and_end_a_demonstration(typed, here, tmp_path):
    keyboard = Keyboard()
    typed('wj ')
    found = keyboard.read()
    assert found.motion.tolist() == [1.0, 0.0, 0.0, 0.0, 0.0, 1.0] and found.toggles
    typed('s')
    assert keyboard.read().motion[0] == -1.0
    for key, event in (('\r', DONE), ('\x7f', DISCARD), ('q', QUIT)):
        typed(key)
        assert keyboard.read().event == event
    keyboard.close()
    typed('wwq')
    code, output, errors = here('demonstrate', 'reach', '--device', 'keyboard', '--out',
                                tmp_path)
    assert code == 1 and output.endswith('0 demonstrations, 0 with success; 0 of 0 repeat\n')
    assert 'discarded' in errors and not list(tmp_path.iterdir())


def test_a_demonstration_begins_with_the_first_key(typed, tmp_path):
    shown = []

    def show(time_s, success, force):
        shown.append(time_s)
        if len(shown) == 5:
            typed('w')
        elif time_s > 0.25:
            typed('q')
    keyboard = Keyboard()
    found = Demonstrator(Setting('reach').create_episode(), keyboard, tmp_path, {}, show).run(0)
    keyboard.close()
    assert shown[:5] == [0.0] * 5 and shown[5] == 0.05
    assert found.quits and found.periods == len(shown) - 5 <= 8


class Deflected(Device):
    """A stick that is deflected along y for a second."""

    is_live = False

    def __init__(self):
        self.readings = [Reading(np.eye(6)[1]) for _ in range(20)] + [
            Reading(np.zeros(6), event=DISCARD)]

    def read(self):
        return self.readings.pop(0)


@pytest.mark.parametrize('robot', ['Panda', 'UR5e'])
def test_full_deflection_moves_at_the_speed_that_the_page_tells(robot, tmp_path):
    episode = Setting('pick_cube', robot).create_episode()
    episode.reset(0)
    before = episode.observation['eef_pose'][0, :3]
    Demonstrator(episode, Deflected(), tmp_path, {}).run(0)
    np.testing.assert_allclose(episode.observation['eef_pose'][0, :3] - before, [0.0, 0.2, 0.0],
                               atol=0.015)


class Stalling(Deflected):
    """A stick that a busy machine reads late once."""

    is_live = True

    def read(self):
        if len(self.readings) == 15:
            time.sleep(0.5)
        return super().read()


def test_what_a_busy_machine_has_lost_is_not_made_up_for(tmp_path):
    shown = []
    Demonstrator(Setting('reach').create_episode(), Stalling(), tmp_path, {},
                 lambda *_: shown.append(time.monotonic())).run(0)
    # The 13 periods after that take as long as without it, but for one of them.
    assert len(shown) == 20 and shown[-1] - shown[6] > 11.9 * 0.05


@pytest.mark.full
def test_the_world_is_shown_on_a_page_beside_another_device(here, expert, tmp_path, monkeypatch):
    task_page = pytest.importorskip('manip_sim.viewer.task_page', reason='needs the extra viewer')
    texts, close = [], task_page.TaskPage.close

    def note(page):
        texts.append(page._text._shown)
        close(page)
    monkeypatch.setattr(task_page.TaskPage, 'close', note)
    code, _, errors = here('demonstrate', 'reach', '--device', f'file:{expert}', '--view',
                           '--port', 0, '--out', tmp_path / 'out')
    assert code == 0 and 'the world is shown on http://127.0.0.1:' in errors
    (text,) = texts
    assert 'Move the end effector to the green point.' in text and ' s of 3.0' in text
    assert '0.0 s of' not in text


class Events:
    """A device of the kernel that reports events."""

    def __init__(self, *events):
        self.events = []
        self.report(*events)

    def report(self, *events):
        self.events += [SimpleNamespace(type=t, code=c, value=v) for t, c, v in events]

    def absinfo(self, code):
        return SimpleNamespace(min=0, max=255)

    def read(self):
        if not self.events:
            raise BlockingIOError
        events, self.events = self.events, []
        return events

    def close(self):
        self.events = None


def test_events_of_the_kernel_move_along_and_about_axes():
    pad = EventDevice('gamepad', Events((3, 1, 0), (3, 0, 128), (1, 304, 1), (0, 0, 0)))
    found = pad.read()
    assert found.motion.tolist() == [1.0, 0.0, 0.0, 0.0, 0.0, 0.0] and found.toggles
    assert pad.read().motion[0] == 1.0  # A stick that is held reports nothing.


def events_of(*reports):
    """
    Yield the events that Linux makes of the reports of a SpaceMouse Compact.

    Report 1 has where its cap is moved to, report 2 about what it is turned, report 3 the buttons:
    whole numbers of 16 bits. A relative axis makes no event if it is 0.
    """
    for report in reports:
        number, *values = struct.unpack(f'<B{(len(report) - 1) // 2}h', report)
        if number == 3:
            yield from ((1, 256 + button, values[0] >> button & 1) for button in range(2))
        else:
            yield from ((2, 3 * (number - 1) + axis, value)
                        for axis, value in enumerate(values) if value)
        yield 0, 0, 0


def test_reports_of_a_cap_that_is_moved_and_turned_at_once(monkeypatch):
    now_s = [10.0]
    monkeypatch.setattr('manip_sim.experiments.demonstrations.time',
                        SimpleNamespace(monotonic=lambda: now_s[0]))
    moved, turned = struct.pack('<B3h', 1, 0, -350, 70), struct.pack('<B3h', 2, 0, 0, 175)
    device = Events(*events_of(moved, turned, moved, turned, moved))
    mouse = EventDevice('spacemouse', device)
    np.testing.assert_allclose(mouse.read().motion, [1.0, 0.0, -0.2, 0.0, 0.0, -0.5])
    # The cap is turned on, but moved no longer.
    for _ in range(20):
        now_s[0] += 0.016
        device.report(*events_of(struct.pack('<B3h', 1, 0, 0, 0), turned))
        found = mouse.read()
    assert found.motion.tolist() == [0.0, 0.0, 0.0, 0.0, 0.0, -0.5]
    now_s[0] += 0.2
    assert not mouse.read().motion.any()
    for pressed, toggles, event in ((1, True, ''), (0, False, ''), (2, False, DONE)):
        device.report(*events_of(struct.pack('<Bh', 3, pressed)))
        found = mouse.read()
        assert (found.toggles, found.event) == (toggles, event)


@pytest.mark.parametrize(('name', 'expected'), [
    ('3Dconnexion SpaceNavigator', True), ('3Dconnexion SpaceMouse Compact', True),
    ('3Dconnexion Universal Receiver', True), ('Microsoft X-Box 360 pad', False)])
def test_a_spacemouse_is_known_by_its_name(name, expected):
    assert is_spacemouse(name) == expected


class Leader:
    """A leader arm of LeRobot whose joints were somewhere else in each period."""

    def __init__(self, names, *positions):
        self.positions = list(positions)
        self.action_features = {f'{name}.pos': float for name in (*names, 'gripper')}

    def get_action(self):
        if not self.positions:
            raise ConnectionError('it has no power')
        return dict(zip(self.action_features, self.positions.pop(0)))

    def disconnect(self):
        self.positions = None


def test_a_leader_arm_leads_to_success_and_the_record_repeats(here, tmp_path, monkeypatch):
    episode = Setting('pick_cube').create_episode()
    expert, positions = episode.task.expert(episode.simulation), []
    episode.reset(0)
    expert.reset(0)
    while not episode.over:
        action = expert.act()
        episode.step(action)
        arm = episode.observation['joint_position'][:7]
        positions.append([*np.degrees(arm), 50.0 - 50.0 * action[-1]])
    assert episode.success
    names = [f'joint{number}' for number in range(1, 8)]
    leader = Leader(names, *positions, *[positions[-1]] * 40)
    monkeypatch.setattr('manip_sim.experiments.demonstrations.open_leader', lambda text: leader)
    code, output, errors = here('demonstrate', 'pick_cube', '--device', 'lerobot:gello',
                                '--out', tmp_path)
    assert code == 0, errors
    assert output.endswith('1 demonstration, 1 with success; 1 of 1 repeat\n')
    assert leader.positions is None


def test_a_leader_arm_says_angles_in_degrees_and_its_opening_in_percent(typed):
    arm = LeaderArm(Leader(['pan', 'lift'], [10.0, 20.0, 25.0]),
                    ['robot0_lift', 'robot0_pan', 'robot0/right/gripper'])
    typed('\r')
    found = arm.read()
    assert found.event == DONE
    np.testing.assert_allclose(found.motion, [*np.radians([20.0, 10.0]), 0.5])
    with pytest.raises(CommandError, match='the leader arm is gone: it has no power'):
        arm.read()
    arm.close()


def test_a_leader_arm_with_other_joints_is_rejected():
    with pytest.raises(ModelError, match="the leader has 0 joints for 'robot0_joint2': it has "
                                         "'joint1', 'gripper'"):
        LeaderArm(Leader(['joint1']), ['robot0_joint1', 'robot0_joint2', 'robot0/right/gripper'])


@pytest.mark.skipif(importlib.util.find_spec('lerobot') is not None,
                    reason='LeRobot is installed')
def test_a_leader_arm_without_lerobot_is_told(here, tmp_path):
    code, _, errors = here('demonstrate', 'reach', '--device', 'lerobot:so101_leader', '--out',
                           tmp_path / 'out')
    assert code == 1 and 'a leader arm needs LeRobot' in errors


def test_types_and_options_of_leader_arms_that_lerobot_rejects_are_told():
    pytest.importorskip('lerobot.teleoperators', reason='LeRobot is not installed')
    with pytest.raises(UnknownNameError, match="unknown leader arm of LeRobot 'so101_leder': did "
                                               "you mean 'so101_leader'"):
        open_leader('so101_leder')
    for options in ('port=none,colour=red', 'port=none'):
        with pytest.raises(ModelError, match='so101_leader,port=none'):
            open_leader(f'so101_leader,{options}')
