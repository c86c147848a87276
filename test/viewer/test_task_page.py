# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Demonstrations by dragging end effectors on a page, with the messages that a browser sends."""

import asyncio
import socket
import threading
import time

import mujoco
import numpy as np
import pytest

viser = pytest.importorskip('viser', reason='the viewer needs the extra viewer')
pytest.importorskip('mcap_ros2', reason='needs the extra records')
import msgspec  # noqa: E402
import websockets  # noqa: E402

from manip_sim.cli.main import main  # noqa: E402
from manip_sim.errors import ManipSimError  # noqa: E402
from manip_sim.experiments.demonstrations import DISCARD, DONE  # noqa: E402
from manip_sim.records.recorded import Record  # noqa: E402
from manip_sim.tasks import Setting  # noqa: E402
from manip_sim.viewer.task_page import PageDevice  # noqa: E402
from manip_sim.viewer.page.model_scene import body_meshes  # noqa: E402

TOKEN = 'a-token-that-is-long-enough'


@pytest.fixture
def port():
    with socket.socket() as free:
        free.bind(('127.0.0.1', 0))
        return free.getsockname()[1]


async def drag(port, name, position, wxyz, ends):
    """Drag a target to a pose, as a person does who tries again until an episode has ended."""
    own = f'127.0.0.1:{port}'
    pose = {'position': [*map(float, position)], 'wxyz': [*map(float, wxyz)]}
    async with websockets.connect(
            f'ws://{own}/{TOKEN}', origin=f'http://{own}', proxy=None, max_size=None,
            subprotocols=[f'viser-v{viser.__version__}']) as opened:
        while not ends():
            for kind, more in (('DragStart', {}), ('DragEnd', {}), ('Update', pose)):
                await opened.send(msgspec.msgpack.encode({
                    'type': f'TransformControls{kind}Message', 'name': name, 'owner': '', **more}))
            await asyncio.sleep(0.1)


@pytest.mark.full
def test_a_person_drags_the_end_effector_to_success_and_each_record_repeats(
        port, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv('SIM_VIEW_TOKEN', TOKEN)
    episode = Setting('reach').create_episode()
    (item,), goals = episode.actions.arms, []
    for seed in (0, 1):
        episode.reset(seed)
        goals.append(episode.observation['goal'])
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, item.chain.tip.pose(episode.simulation.data)[1].ravel())
    begin_s, files = time.monotonic(), [tmp_path / f'{seed}.mcap' for seed in (0, 1)]

    def person():
        for goal, file in zip(goals, files):
            while time.monotonic() < begin_s + 100.0 and not file.exists():
                try:
                    asyncio.run(drag(port, '/targets/robot0/right', goal, quat, file.exists))
                except OSError:  # The page is not yet there.
                    time.sleep(0.1)
    thread = threading.Thread(target=person)
    thread.start()
    code = main(['demonstrate', 'reach', '--device', 'browser', '--port', str(port), '--episodes',
                 '2', '--out', str(tmp_path)])
    thread.join()
    output, errors = capsys.readouterr()
    assert f'drag the end effector on http://127.0.0.1:{port}/{TOKEN}/' in errors
    assert (code, output) == (0, f'{tmp_path}: 2 demonstrations, 2 with success; 2 of 2 repeat\n')
    for seed, file in enumerate(files):
        (recorded,) = Record(file).episodes()
        assert recorded.seed == seed and recorded.success


@pytest.fixture(scope='module')
def episode():
    """Return an episode of a task of two arms, in which each test resets."""
    return Setting('hand_over').create_episode()


@pytest.fixture
def device(episode):
    device = PageDevice(episode, '127.0.0.1', 0)
    episode.reset(0)
    yield device
    device.close()


def after(seconds, act):
    timer = threading.Timer(seconds, act)
    timer.start()
    return timer


def test_an_episode_waits_for_a_person_and_each_arm_goes_to_its_target(device, episode):
    begin_s = time.monotonic()
    timer = after(0.3, lambda: device._events.add(device._begin))
    first = device.read()
    timer.join()
    assert time.monotonic() - begin_s >= 0.3
    # The targets are where the end effectors are, and the grippers are open.
    np.testing.assert_allclose(first.motion, np.repeat([0.0, -1.0, 0.0, -1.0], [6, 1, 6, 1]),
                               atol=1e-6)
    before = [np.array(target.position) for target in device._targets]
    device._targets[1].position = before[1] + [0.0, 0.0, 0.1]
    device._grippers[0].value = True
    for _ in range(30):
        reading = device.read() if episode.periods else first
        episode.step(reading.motion)
    moved = [item.chain.tip.pose(episode.simulation.data)[0] - position
             for item, position in zip(episode.actions.arms, before)]
    np.testing.assert_allclose(moved, [[0.0, 0.0, 0.0], [0.0, 0.0, 0.1]], atol=0.01)
    assert reading.motion[6] == 1.0 and reading.motion[13] == -1.0
    text = device._page._text._shown
    assert 'External force' in text and '1.5 s of' in text


def test_robots_and_objects_are_on_the_page(device, episode):
    model = device._page._posture.model
    seen = {model.body(mesh.body).name for mesh in body_meshes(model) if not mesh.collides}
    assert {'robot0_link7', 'robot1_link7', 'table'} <= seen
    assert len(device._page._scene._visual) >= len(seen)


def test_buttons_end_a_demonstration(device, episode):
    for button, event in (('Discard', DISCARD), ('Done', DONE)):
        episode.reset(0)
        timer = after(0.2, lambda name=button: setattr(device._buttons, 'value', name))
        assert device.read().event == event
        timer.join()
        episode.step(np.zeros(episode.actions.size))
        assert device.read().event == ''


def test_pages_that_cannot_be_are_rejected(episode, port):
    with pytest.raises(ManipSimError, match='the actions must be osc_pose'):
        PageDevice(Setting('reach', action='joint_position').create_episode(), '127.0.0.1', 0)
    with socket.socket() as taken:
        taken.bind(('127.0.0.1', port))
        taken.listen()
        with pytest.raises(ManipSimError, match=f'cannot listen on 127.0.0.1:{port}'):
            PageDevice(episode, '127.0.0.1', port)
