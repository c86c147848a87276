# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Where the camera of MuJoCo's own window looks."""

from contextlib import contextmanager, nullcontext
import io
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

pytest.importorskip('rclpy', reason='the window needs ROS 2')
pytest.importorskip('viser', reason='the viewer needs the extra viewer')

from manip_sim.viewer import session  # noqa: E402
from manip_sim.viewer.page.latest import Latest  # noqa: E402
from manip_sim.viewer.session import aim  # noqa: E402


@pytest.mark.parametrize('position, target', [
    ((2.0, 1.0, 1.5), (0.1, -0.2, 0.8)), ((-1.0, 3.0, 0.2), (0.0, 0.0, 1.0))])
def test_the_camera_looks_from_the_position_to_the_target(position, target):
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><geom size="0.1"/></worldbody></mujoco>')
    data, camera = mujoco.MjData(model), mujoco.MjvCamera()
    position, target = np.array(position), np.array(target)
    aim(camera, position, target)
    scene = mujoco.MjvScene(model, maxgeom=10)
    mujoco.mj_forward(model, data)
    mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, camera,
                           mujoco.mjtCatBit.mjCAT_ALL, scene)
    # The two eyes stand beside each other.
    eyes = np.mean([eye.pos for eye in scene.camera], axis=0)
    assert eyes == pytest.approx(position, abs=1e-6)
    way = target - position
    assert scene.camera[0].forward == pytest.approx(way / np.linalg.norm(way), abs=1e-6)


def test_who_reads_the_output_knows_at_once_that_a_window_is_there(monkeypatch):
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><geom size="0.1"/></worldbody></mujoco>')
    written, seen = io.BytesIO(), []
    monkeypatch.setattr('sys.stdout', io.TextIOWrapper(written))

    def is_running():
        seen.append(written.getvalue().decode().splitlines())
        return False

    @contextmanager
    def window(posture):
        yield SimpleNamespace(cam=mujoco.MjvCamera(), is_running=is_running, lock=nullcontext)
    monkeypatch.setattr(session, '_open_window', window)
    monkeypatch.setattr(session, 'States', lambda *_: None)
    monkeypatch.setattr(session, 'Discovery', lambda *_: SimpleNamespace(
        base='/', model=model, models=1))
    session.show_native(None, None, 'sim', lambda: None, SimpleNamespace(wait=lambda _: False))
    assert seen[0] == ['sim_view: waiting for the node /sim', 'sim_view: a window shows /sim']


def test_a_window_looks_for_what_has_changed_twice_a_second(monkeypatch):
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><geom size="0.1"/></worldbody></mujoco>')
    looks, now_s, frames = [], [100.0], []

    def is_running():
        now_s[0] += 0.1
        frames.append(now_s[0])
        return len(frames) < 22

    @contextmanager
    def window(posture):
        yield SimpleNamespace(cam=mujoco.MjvCamera(), is_running=is_running, lock=nullcontext,
                              sync=lambda: None)
    monkeypatch.setattr(session, 'time', SimpleNamespace(monotonic=lambda: now_s[0]))
    monkeypatch.setattr(session, '_open_window', window)
    monkeypatch.setattr(session, 'States', lambda *_: SimpleNamespace(latest=Latest()))
    monkeypatch.setattr(session, 'Discovery', lambda *_: SimpleNamespace(
        base='/', model=model, models=1, layout=None, look=lambda: looks.append(now_s[0])))
    session.show_native(None, None, 'sim', lambda: None, SimpleNamespace(wait=lambda _: False))
    assert len(looks) in (4, 5)
    assert np.diff(looks) == pytest.approx(0.55, abs=0.06)
