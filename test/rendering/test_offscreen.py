# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Images against geometry: where points are seen, how far planes are, and nothing at all."""

import os
from pathlib import Path
import threading

import mujoco
import numpy as np
import pytest

from manip_sim.errors import ManipSimError, ModelError
from manip_sim.models import compose
from manip_sim.rendering import choose_gl, create_context, intrinsics_of, OffscreenRenderer

SENSOR = 'sensorsize="0.004 0.003" focal="0.003 0.0035" principal="0.0002 0.0001"'
#: By optics: attributes of a camera in MJCF, and size of its images.
OPTICS = {
    'field of view': ('fovy="50"', 640, 480),
    'tall': ('fovy="50"', 200, 300),
    'sensor': (f'{SENSOR} resolution="640 480"', 640, 480),
    'sensor, stretched': (f'{SENSOR} resolution="640 480"', 400, 400)}
#: Of the camera in the world: its place, its x and its y axis.
PLACE, X, Y = np.array([0.4, -0.3, 0.7]), np.array([0.0, 1.0, 0.0]), np.array([-0.6, 0.0, 0.8])
#: In the optical frame, x to the right, y down and z along the view [m].
POINTS = [(0.0, 0.0, 1.0), (0.25, 0.1, 1.1), (-0.2, 0.15, 0.9), (0.1, -0.22, 1.0)]


def a_model(optics, shapes=''):
    axes = ' '.join(map(str, [*X, *Y]))
    return mujoco.MjModel.from_xml_string(f"""
        <mujoco>
          <statistic extent="2"/>
          <visual><headlight ambient="1 1 1" diffuse="0 0 0" specular="0 0 0"/></visual>
          <worldbody>
            <body name="ball" mocap="true"><geom size="0.012" rgba="1 0 0 1"/></body>
            <camera name="eye" pos="{' '.join(map(str, PLACE))}" xyaxes="{axes}" {optics}/>
            {shapes}
          </worldbody>
        </mujoco>""")


def in_world(point):
    """Return a point of the optical frame in the world."""
    return PLACE + point[0] * X - point[1] * Y - point[2] * np.cross(X, Y)


def look(model, ball, width, height):
    data = mujoco.MjData(model)
    data.mocap_pos[0] = ball
    mujoco.mj_forward(model, data)
    renderer = OffscreenRenderer(model, width, height)
    try:
        return renderer.render(data, 'eye', width, height)
    finally:
        renderer.close()


def middle(mask):
    rows, columns = np.nonzero(mask)
    return columns.mean(), rows.mean()


@pytest.mark.full
@pytest.mark.parametrize('optics', OPTICS)
def test_a_ball_is_seen_where_the_intrinsics_say_in_colour_and_in_depth(optics, gl):
    attributes, width, height = OPTICS[optics]
    model = a_model(attributes)
    camera = intrinsics_of(model, 'eye', width, height)
    for point in POINTS:
        picture = look(model, in_world(point), width, height)
        red = picture.rgb[..., 0].astype(int) - picture.rgb[..., 1]
        expected = (camera.fx * point[0] / point[2] + camera.cx,
                    camera.fy * point[1] / point[2] + camera.cy)
        # A ball is seen as an ellipse, whose middle is a little beside its projected middle.
        np.testing.assert_allclose(middle(red > 60), expected, atol=0.3)
        np.testing.assert_allclose(middle(np.isfinite(picture.depth)), expected, atol=0.3)
        np.testing.assert_allclose(picture.depth.min(), point[2] - 0.012, rtol=2e-3)


def test_the_intrinsics_are_those_of_a_pinhole():
    found = intrinsics_of(a_model('fovy="90"'), 'eye', 320, 240)
    assert (found.width, found.height) == (320, 240)
    np.testing.assert_allclose([found.fx, found.fy, found.cx, found.cy],
                               [120.0, 120.0, 159.5, 119.5], rtol=1e-6)


@pytest.mark.full
def test_the_depth_of_a_urdf_link_is_that_of_its_visual_shape(tmp_path, gl):
    file = tmp_path / 'shown.urdf'
    file.write_text("""<robot name="shown"><link name="base"/><link name="arm">
      <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>
      </inertial><visual><origin xyz="0 0 0.2"/>
      <geometry><sphere radius="0.03"/></geometry></visual>
      <collision><origin xyz="0 0 0.2"/><geometry><box size="0.2 0.2 0.2"/></geometry>
      </collision>
      </link><joint name="turn" type="revolute"><parent link="base"/><child link="arm"/>
      <axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="20" velocity="2"/></joint></robot>""")
    model = compose(str(file), position=[0, 0, 0], cameras=[
        {'name': 'front', 'position': [1.0, 0.0, 0.2], 'look_at': [0.0, 0.0, 0.2]}]).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    renderer = OffscreenRenderer(model, 101, 101)
    try:
        depth = renderer.render(data, 'front', 101, 101).depth
    finally:
        renderer.close()
    assert depth[50, 50] == pytest.approx(0.97, abs=0.002)


@pytest.mark.full
@pytest.mark.parametrize('distance', [0.1, 1.0, 10.0, 60.0])
def test_the_depth_of_a_tilted_plane_is_along_the_view_within_a_thousandth(distance, gl):
    # A plane with a normal between the view and the image's x axis.
    view, tilt = -np.cross(X, Y), np.radians(20.0)
    normal = -view * np.cos(tilt) + X * np.sin(tilt)
    place = PLACE + distance * view
    model = a_model('fovy="50"', f'<geom type="plane" size="100 100 1" '
                    f'pos="{" ".join(map(str, place))}" zaxis="{" ".join(map(str, normal))}"/>')
    picture = look(model, PLACE - view, 160, 120)
    camera = intrinsics_of(model, 'eye', 160, 120)
    columns = np.arange(160)
    # On the ray (x, y, 1) z the plane is where z (n . ray) = n . place.
    expected = distance * np.cos(tilt) / (
        np.cos(tilt) - np.sin(tilt) * (columns - camera.cx) / camera.fx)
    np.testing.assert_allclose(picture.depth, np.tile(expected, (120, 1)), rtol=1e-3)
    assert picture.depth.dtype == np.float32


def test_nothing_and_what_is_too_far_is_infinitely_far(gl):
    picture = look(a_model('fovy="50"'), PLACE + np.cross(X, Y), 64, 48)
    assert np.isposinf(picture.depth).all()
    far = 50.0 * 2.0  # MuJoCo's zfar and the extent of the model.
    ball = ' '.join(map(str, in_world((0.0, 0.0, far + 30.0))))
    picture = look(a_model('fovy="50"', f'<geom size="20" pos="{ball}"/>'),
                   PLACE + np.cross(X, Y), 64, 48)
    assert np.isposinf(picture.depth).all()


def test_only_what_is_asked_for_is_read(gl):
    model = a_model('fovy="50"')
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    renderer = OffscreenRenderer(model, 64, 48)
    assert renderer.render(data, 'eye', 32, 24, depth=False).depth is None
    colours = renderer.render(data, 'eye', 32, 24, depth=False).rgb
    assert (colours.shape, colours.dtype) == ((24, 32, 3), np.uint8)
    assert renderer.render(data, 'eye', 64, 48, rgb=False).rgb is None
    renderer.close()


def test_an_orthographic_camera_has_no_intrinsics():
    try:
        model = a_model('orthographic="true" fovy="1"')
    except ValueError:
        model = a_model('projection="orthographic" fovy="1"')
    with pytest.raises(ModelError, match="'eye' is orthographic: no camera_info can describe it"):
        intrinsics_of(model, 'eye', 64, 48)


@pytest.mark.parametrize('value, what', [
    ('disable', '^cannot render with MUJOCO_GL=disable: this value switches rendering off$'),
    ('nonsense', '^cannot render with MUJOCO_GL=nonsense: it must be one of ')])
def test_rendering_that_is_switched_off_or_unknown_is_told(value, what, monkeypatch):
    monkeypatch.setenv('MUJOCO_GL', value)
    with pytest.raises(ManipSimError, match=what):
        choose_gl()


def test_the_default_is_a_way_that_needs_no_screen(monkeypatch):
    monkeypatch.setattr('sys.platform', 'linux')
    monkeypatch.setenv('DISPLAY', ':0')
    monkeypatch.delenv('MUJOCO_GL', raising=False)
    assert choose_gl() == 'egl'
    monkeypatch.setenv('MUJOCO_GL', 'OSMesa')
    assert choose_gl() == 'osmesa'


@pytest.mark.skipif(not Path('/proc/self/task').is_dir(), reason='needs the /proc of Linux')
def test_threads_of_the_driver_are_nice_and_the_one_that_renders_is_not(gl):
    renderer = OffscreenRenderer(a_model('fovy="50"'), 64, 48)
    nice = {Path(f'/proc/self/task/{task}/comm').read_text().strip():
            os.getpriority(os.PRIO_PROCESS, int(task)) for task in os.listdir('/proc/self/task')}
    usual = os.getpriority(os.PRIO_PROCESS, os.getpid())
    assert os.getpriority(os.PRIO_PROCESS, threading.get_native_id()) == usual
    for name, niceness in nice.items():
        assert not name.startswith('llvmpipe') or niceness == min(usual + 10, 19)
    renderer.close()


def test_what_a_driver_says_is_told(monkeypatch):
    monkeypatch.setenv('MUJOCO_GL', 'egl')
    with pytest.raises(ManipSimError, match='cannot render with MUJOCO_GL=egl: No module named'):
        create_context('missing', 64, 48)
