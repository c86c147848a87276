# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Images over topics: what they show, when they come, and what cannot be asked for."""

from collections import Counter
import io
import json
import os
import signal
import subprocess
import sys
import threading
from types import SimpleNamespace
from xml.etree import ElementTree

from diagnostic_msgs.msg import DiagnosticArray
import mujoco
import numpy as np
from PIL.Image import open as open_image
import pytest
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data, QoSDurabilityPolicy, QoSProfile
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, JointState, PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger

from manip_sim.errors import ManipSimError
from manip_sim.physics.object_spawning import plan_without
from manip_sim.rendering import OffscreenRenderer
from manip_sim.ros.camera_publishers import Cameras
from manip_sim.ros.feature import Output
from manip_sim.sensing.images import ImageNoise

#: It looks along x, so that in its optical frame z is x, x is -y and y is -z.
FRONT = '{name: front, position: [-0.5, 1.0, 1.2], fovy: 50}'
#: 2 m ahead, 0.4 m to the right and 0.2 m above the camera.
BALL = ('{name: ball, shape: sphere, size: 0.03, mass: 0.1, position: [1.5, 0.6, 1.4], '
        'rgba: [0.0, 1.0, 0.0]}')
LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
SMALL = {'camera__front__width': 160, 'camera__front__height': 120}


@pytest.fixture
def serve_seen(serve, renderer, monkeypatch):
    """Return a function that starts a node that can render."""
    monkeypatch.setenv('MUJOCO_GL', os.environ.get('MUJOCO_GL', 'egl'))
    return serve


@pytest.fixture
def renderings(monkeypatch):
    """Return a list of what is rendered: camera, colours, depth and labels."""
    found, render = [], OffscreenRenderer.render

    def count(self, data, camera, width, height, rgb=True, depth=True, labels=False):
        found.append((camera, rgb, depth, labels))
        return render(self, data, camera, width, height, rgb, depth, labels)
    monkeypatch.setattr(OffscreenRenderer, 'render', count)
    return found


def nanoseconds(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def pixels(message):
    """Return an image as an array, as cv_bridge does."""
    assert not message.is_bigendian
    if message.encoding == 'rgb8':
        assert message.step == 3 * message.width
        return np.frombuffer(message.data, np.uint8).reshape(message.height, message.width, 3)
    kind = {'32FC1': np.float32, '32SC1': np.int32}[message.encoding]
    assert message.step == 4 * message.width
    return np.frombuffer(message.data, kind).reshape(message.height, message.width)


def listen(client, topic):
    kind = {'image_raw': Image, 'compressed': CompressedImage, 'camera_info': CameraInfo,
            'points': PointCloud2}
    return client.listen(kind[topic.split('/')[-1]], topic, qos_profile_sensor_data)


@pytest.mark.full
def test_a_ball_is_where_its_image_its_depth_and_the_intrinsics_say(serve_seen, client):
    serve_seen(objects=[BALL], cameras=[FRONT], start_paused=True)
    color, depth, info = (listen(client, f'front/{topic}') for topic in (
        'color/image_raw', 'depth/image_raw', 'color/camera_info'))
    client.spin_until(lambda: color and depth and info)
    assert {m.header.frame_id for m in (color[-1], depth[-1], info[-1])} == {
        'front_optical_frame'}
    assert nanoseconds(color[-1]) == nanoseconds(depth[-1]) == nanoseconds(info[-1]) == 10**7
    rgb, metres = pixels(color[-1]).astype(int), pixels(depth[-1])
    assert rgb.shape == (480, 640, 3)
    assert (info[-1].width, info[-1].height, info[-1].distortion_model) == (640, 480, 'plumb_bob')
    green = (rgb[..., 1] > 1.5 * rgb[..., 0]) & (rgb[..., 1] > 1.5 * rgb[..., 2])
    x, y, z = 0.4, -0.2, 2.0  # In the optical frame [m].
    k = info[-1].k
    seen = [axis.mean() for axis in np.nonzero(green)]
    assert seen == pytest.approx([k[4] * y / z + k[5], k[0] * x / z + k[2]], abs=1.0)
    row, column = np.round(seen).astype(int)
    assert metres[row, column] == pytest.approx(z - 0.03, rel=2e-3)
    # The way of depth_image_proc, from a pixel back to a point.
    assert (column - k[2]) / k[0] * z == pytest.approx(x, abs=5e-3)
    assert info[-1].p[0] == k[0]
    assert info[-1].p[2] == k[2]


@pytest.mark.full
def test_images_and_clouds_name_their_own_optical_frame_if_a_link_has_its_usual_name(
        serve_seen, client, tmp_path):
    file = tmp_path / 'arm.xml'
    file.write_text("""<mujoco><worldbody><body name="base"><geom size="0.05"/>
      <body name="arm" pos="0 0 0.1"><joint name="j" axis="0 1 0"/><geom size="0.05" mass="1"/>
        <camera name="eye"/><body name="eye_optical_frame" pos="0.1 0 0"><geom size="0.01"/></body>
      </body></body></worldbody><actuator><motor joint="j" ctrlrange="-9 9"/></actuator>
      </mujoco>""")
    serve_seen(robot=str(file), cameras=['robot0_eye'], start_paused=True)
    images = [listen(client, f'robot0_eye/{topic}') for topic in (
        'color/image_raw', 'depth/points', 'color/camera_info')]
    described = client.listen(String, 'robot_description', LATCHED)
    client.spin_until(lambda: all(images) and described)
    (frame,) = {messages[-1].header.frame_id for messages in images}
    joints = ElementTree.fromstring(described[-1].data).findall('joint')
    parents = {joint.find('child').get('link'): joint.find('parent').get('link')
               for joint in joints}
    assert parents[frame] == 'robot0_eye'
    assert parents['robot0_eye_optical_frame'] == 'robot0_arm'


@pytest.mark.full
def test_it_is_rendered_only_while_somebody_listens_and_only_what_they_hear(serve_seen, client,
                                                                            renderings):
    serve_seen(cameras=['robot0_eye_in_hand', FRONT], **SMALL)
    infos = listen(client, 'front/depth/camera_info')
    client.spin_until(lambda: len(infos) > 5)
    assert not renderings
    subscription = client.node.create_subscription(Image, 'front/depth/image_raw', lambda _: None,
                                                   qos_profile_sensor_data)
    client.spin_until(lambda: len(renderings) > 3)
    assert set(renderings) == {('front', False, True, False)}
    client.node.destroy_subscription(subscription)
    color = listen(client, 'front/color/image_raw')
    client.spin_until(lambda: ('front', True, False, False) in renderings)
    count = len(color)
    client.spin_until(lambda: len(color) > count)


@pytest.mark.full
@pytest.mark.parametrize('topic, what', [
    ('color/image_raw', (True, False, False)), ('depth/image_raw', (False, True, False)),
    ('color/image_raw/compressed', (True, False, False)), ('depth/points', (True, True, False))])
def test_of_a_camera_only_the_topic_with_a_reader_is_published(topic, what, serve_seen, client,
                                                               renderings):
    node = serve_seen(cameras=[FRONT], start_paused=True, **SMALL)
    published, publish = Counter(), Output.publish

    def count(self, message):
        published[self._publisher.topic_name] += 1
        return publish(self, message)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Output, 'publish', count)
        heard = listen(client, f'front/{topic}')
        client.spin_until(lambda: len(heard) > 2)
    assert set(renderings) == {('front', *what)}
    assert {name for name in published if '/front/' in name} == {f'/front/{topic}'}
    assert node.cameras.failed is None


@pytest.mark.full
def test_a_rendering_that_fails_later_is_told_once_and_intrinsics_and_states_go_on(
        serve_seen, client, monkeypatch):
    fails, render = threading.Event(), OffscreenRenderer.render

    def fail(*arguments, **options):
        if fails.is_set():
            raise RuntimeError('the driver is gone')
        return render(*arguments, **options)
    monkeypatch.setattr(OffscreenRenderer, 'render', fail)
    lines = client.log()
    node = serve_seen(cameras=[FRONT], **SMALL)
    color, infos = (listen(client, f'front/color/{topic}') for topic in (
        'image_raw', 'camera_info'))
    client.spin_until(lambda: len(color) > 1 and len(infos) > 1)
    assert node.cameras.failed is None
    fails.set()
    client.spin_until(lambda: any('the driver is gone' in line for line in lines))
    images, before = len(color), nanoseconds(infos[-1])
    client.spin_until(lambda: nanoseconds(infos[-1]) > before + 10**9)
    assert len(color) <= images + 1
    assert len([line for line in lines if 'no images: ' in line]) == 1
    assert 'the driver is gone' in str(node.cameras.failed)
    assert nanoseconds(client.state()) > before


@pytest.mark.full
def test_a_point_cloud_has_the_ball_where_it_is_in_its_colour(serve_seen, client, renderings):
    serve_seen(start_paused=True, objects=[BALL], cameras=[FRONT], **SMALL)
    clouds = listen(client, 'front/depth/points')
    client.spin_until(lambda: clouds != [])
    cloud = clouds[-1]
    assert (cloud.header.frame_id, cloud.height, cloud.width) == ('front_optical_frame', 120, 160)
    assert [(f.name, f.offset) for f in cloud.fields] == [
        ('x', 0), ('y', 4), ('z', 8), ('rgb', 12)]
    assert len(cloud.data) == cloud.row_step * cloud.height == 16 * 120 * 160
    assert (cloud.is_bigendian, cloud.is_dense) == (sys.byteorder == 'big', False)
    raw = np.frombuffer(cloud.data, np.float32).reshape(120, 160, 4)
    packed = np.frombuffer(cloud.data, np.uint32).reshape(120, 160, 4)[..., 3]
    red, green, blue = (packed >> shift & 255 for shift in (16, 8, 0))
    ball = (green > 60) & (red < green // 2) & (blue < green // 2)
    assert ball.sum() > 5
    # 2 m ahead, 0.4 m to the right, 0.2 m up; a camera sees the near side of the sphere.
    np.testing.assert_allclose(np.nanmedian(raw[ball][:, :3], axis=0), [0.4, -0.2, 1.98],
                               atol=0.02)
    assert np.isnan(raw[..., :3]).any(axis=-1).sum() == np.isnan(raw[..., 2]).sum()
    assert set(renderings) == {('front', True, True, False)}


@pytest.mark.full
def test_labels_are_the_bodies_of_the_model_that_is_published_beside_their_names(
        serve_seen, client, renderings):
    node = serve_seen(start_paused=True, objects=[BALL], cameras=[FRONT], **SMALL)
    labels = listen(client, 'front/labels/image_raw')
    depth = listen(client, 'front/depth/image_raw')
    names = client.listen(String, 'front/labels/names', LATCHED)
    models = client.listen(String, 'manip_sim/mjcf', LATCHED)
    client.spin_until(lambda: labels and depth and names and models)
    seen, by_id = pixels(labels[-1]), json.loads(names[-1].data)
    model = mujoco.MjModel.from_xml_string(models[-1].data)
    assert by_id == {'-1': 'background', **{
        str(body): model.body(body).name for body in range(model.nbody)}}
    ball = next(int(body) for body, name in by_id.items() if name == 'ball')
    rows, columns = np.nonzero(seen == ball)
    # 0.4 m to the right and 0.2 m up at 2 m, in an image of 160 x 120 pixels.
    focal = 60.0 / np.tan(np.radians(25.0))
    assert [columns.mean(), rows.mean()] == pytest.approx(
        [79.5 + 0.2 * focal, 59.5 - 0.1 * focal], abs=0.5)
    assert np.abs(pixels(depth[-1])[rows, columns] - 1.98).max() < 0.035
    assert (seen[-1] == 0).all()  # The floor is the world's.
    assert (np.isinf(pixels(depth[-1])) <= (seen == -1)).all()
    assert ('front', False, False, True) in renderings or (
        'front', False, True, True) in renderings
    plan = plan_without(node.simulation.plan, 'ball')
    node.thread.call(lambda: node.simulation.change_objects(plan))
    node.shared.world_changed()
    client.spin_until(lambda: 'ball' not in names[-1].data)
    client.spin_until(lambda: ball not in pixels(labels[-1]))


@pytest.mark.full
def test_images_come_at_their_rate_of_simulation_time_with_one_stamp(serve_seen, client):
    # A busy machine without a graphics card renders five images a second or a few more.
    serve_seen(cameras=[FRONT], camera__front__rate=25.0, real_time_factor=0.25, **SMALL)
    topics = ('color/image_raw', 'depth/image_raw', 'color/camera_info', 'depth/camera_info')
    heard = [listen(client, f'front/{topic}') for topic in topics]
    client.spin_until(lambda: all(len(messages) > 15 for messages in heard))
    for messages in heard:
        stamps = [nanoseconds(message) for message in messages][2:]
        assert {stamp % 40_000_000 for stamp in stamps} == {0}
        assert min(np.diff(stamps)) == 40_000_000
    common = set.intersection(*({nanoseconds(m) for m in messages} for messages in heard))
    assert len(common) > 10


@pytest.mark.full
def test_a_compressed_image_is_a_jpeg_of_the_same(serve_seen, client):
    serve_seen(cameras=['agentview'], arena='table', start_paused=True,
               camera__agentview__depth=False)
    color = listen(client, 'agentview/color/image_raw')
    small = listen(client, 'agentview/color/image_raw/compressed')
    client.spin_until(lambda: color and small)
    assert small[0].format == 'rgb8; jpeg compressed bgr8'
    decoded = np.asarray(open_image(io.BytesIO(bytes(small[0].data)))).astype(int)
    rgb = pixels(color[0]).astype(int)
    assert np.abs(decoded - rgb).mean() < 3.0
    assert np.abs(rgb - rgb[..., ::-1]).mean() > 3.0  # It would be seen if they were swapped.
    assert len(small[0].data) < rgb.size / 10
    assert client.node.count_publishers('agentview/depth/image_raw') == 0


@pytest.mark.full
def test_a_pause_shows_the_present_state_again_and_a_step_the_next(serve_seen, client):
    serve_seen(cameras=[FRONT], camera__front__rate=100.0, start_paused=True, **SMALL)
    color = listen(client, 'front/color/image_raw')
    client.spin_until(lambda: len(color) > 2)
    assert {nanoseconds(message) for message in color} == {10_000_000}
    assert client.call(Trigger, 'manip_sim/step').success
    client.spin_until(lambda: nanoseconds(color[-1]) == 20_000_000)
    assert client.call(Trigger, 'manip_sim/reset').success
    client.spin_until(lambda: nanoseconds(color[-1]) == 30_000_000)


@pytest.mark.full
def test_in_lockstep_images_are_of_due_states_only(serve_seen, client):
    serve_seen(cameras=[FRONT], camera__front__rate=50.0, stepping='lockstep', **SMALL)
    color = listen(client, 'front/color/image_raw')
    states = client.listen(JointState, 'joint_states')
    name = client.state().name[0]
    for period in range(1, 8):
        wanted = 10_000_000 * period
        client.spin_until(lambda t=wanted: nanoseconds(states[-1]) == t)
        if period % 2 == 0:
            client.spin_until(lambda t=wanted: color and nanoseconds(color[-1]) == t)
        else:  # States are repeated while the node waits, images of this one are not.
            count = len(states)
            client.spin_until(lambda n=count: len(states) > n + 2)
        client.publish('joint_command', JointState(name=[name], position=[0.1]))
    assert {nanoseconds(message) // 10_000_000 for message in color} == {1, 2, 4, 6}


@pytest.mark.full
def test_cameras_of_several_robots_have_their_names(serve_seen, client):
    serve_seen(robots=['left', 'right'], cameras=['left_eye_in_hand', 'right_eye_in_hand'],
               **{f'camera__{side}_eye_in_hand__{edge}': 64
                  for side in ('left', 'right') for edge in ('width', 'height')})
    for side in ('left', 'right'):
        color = listen(client, f'{side}_eye_in_hand/color/image_raw')
        client.spin_until(lambda heard=color: bool(heard))
        assert color[0].header.frame_id == f'{side}_eye_in_hand_optical_frame'


@pytest.mark.full
def test_diagnostics_tell_rate_and_cost(serve_seen, client):
    serve_seen(cameras=[FRONT], **SMALL)
    listen(client, 'front/color/image_raw')
    arrays = client.listen(DiagnosticArray, '/diagnostics')

    def values():
        found = [s for s in arrays[-1].status if s.name == 'manip_sim: cameras'] if arrays else []
        return {pair.key: pair.value for pair in found[0].values} if found else {}
    client.spin_until(lambda: values().get('front.milliseconds', '-') != '-')
    assert 0.0 < float(values()['front.rate']) < 30.0
    assert 0.0 < float(values()['front.milliseconds']) < 1000.0
    assert int(values()['front.left_out']) >= 0


def test_rate_and_cost_are_those_of_the_measured_images_since_the_last_look():
    def shot(exact, took_s):
        return SimpleNamespace(view=SimpleNamespace(camera='front', exact=exact), took_s=took_s)
    cameras = Cameras(SimpleNamespace(
        simulation=SimpleNamespace(model=None), thread=SimpleNamespace(period_s=0.01),
        composition=SimpleNamespace(cameras={})))
    cameras.names.append('front')
    cameras._publishers['front'] = SimpleNamespace(publish=lambda shot: None)
    for _ in range(5):
        cameras._publish(shot(False, 0.02))
        cameras._publish(shot(True, 5.0))
    told = cameras.statistics(2.0)
    assert told['front.rate'] == '2.5'
    assert 20.0 <= float(told['front.milliseconds']) < 1000.0
    assert cameras.statistics(2.0) == {
        'front.rate': '0.0', 'front.milliseconds': '-', 'front.left_out': 0}


@pytest.mark.parametrize('parameters, what', [
    ({'cameras': ['eye_in_hand']}, "unknown camera 'eye_in_hand': did you mean "
     "'robot0_eye_in_hand'"),
    ({'cameras': ['birdview', 'birdview']}, "the camera 'birdview' is chosen twice"),
    ({'cameras': ['{name: front']}, "one of 'cameras' is invalid or unsafe YAML"),
    ({'cameras': ['{name: front, fovi: 45}']}, "unknown key 'fovi': did you mean 'fovy'"),
    ({'cameras': ['{name: front, body: hand}']}, "unknown body of the camera 'front' 'hand'"),
    ({'cameras': ['{name: birdview}']}, 'there is a camera of this name already; '
     'write its name alone to take that one'),
    ({'cameras': ['birdview'], 'camera__birdview__width': 0},
     r"'camera\.birdview\.width' must be from 1 to 4096 pixels, got 0"),
    ({'cameras': ['birdview'], 'camera__birdview__height': 5000}, 'to 4096 pixels, got 5000'),
    ({'cameras': ['birdview'], 'camera__birdview__width': 640.5}, 'must be of type integer'),
    ({'cameras': ['birdview'], 'camera__birdview__rate': float('nan')}, 'Hz, got nan'),
    ({'cameras': ['birdview'], 'camera__birdview__rate': 0.0}, 'must be from 0.01 to'),
    ({'cameras': ['birdview'], 'camera__birdview__rate': 200.0},
     "'camera.birdview.rate': 200 Hz is not possible, because publish_rate is 100 Hz"),
    ({'cameras': ['birdview'], 'camera__birdview__depth': 1}, 'must be of type bool, got 1'),
    ({'cameras': ['birdview'], 'camera__birdview__fps': 5},
     r"unknown parameter 'camera\.birdview\.fps': did you mean"),
    ({'camera__birdview__rate': 5.0}, r"unknown parameter 'camera\.birdview\.rate'"),
    ({'robots': ['camera']}, "'camera' cannot be the name of a robot")], ids=str)
def test_what_cannot_be_is_told_on_one_line(serve, parameters, what):
    with pytest.raises(ManipSimError, match=what) as error:
        serve(**parameters)
    assert '\n' not in str(error.value)


@pytest.mark.full
@pytest.mark.parametrize('value', ['disable', 'nonsense'])
def test_a_node_that_cannot_render_says_so_once_and_does_all_else(value, sim_process, client,
                                                                  monkeypatch):
    monkeypatch.setenv('MUJOCO_GL', value)
    node = sim_process('cameras:=[robot0_eye_in_hand]')
    info = listen(client, 'robot0_eye_in_hand/color/camera_info')
    color = listen(client, 'robot0_eye_in_hand/color/image_raw')
    client.spin_until(lambda: len(info) > 10)
    client.publish('arm/joint_command', JointState(name=['robot0_joint1'], position=[0.3]))
    client.spin_until(lambda: client.state().position[0] > 0.29)
    assert not color
    node.send_signal(signal.SIGINT)
    _, errors = node.communicate(timeout=300.0)
    assert node.returncode == 0, errors
    told = [line for line in errors.splitlines() if 'render' in line]
    assert len(told) == 1, errors
    assert f'no images: cannot render with MUJOCO_GL={value}: ' in told[0]
    assert told[0].endswith('; everything else works')


#: The node, with renderings that never end, and a driver whose end waits for them.
HANGS = """
import atexit, sys, threading
atexit.register(lambda: threading.Event().wait())
from manip_sim.rendering import OffscreenRenderer
from manip_sim.ros.camera_publishers import Cameras
from manip_sim.ros.feature import Output

def render(*_, **__):
    print('rendering', flush=True)
    threading.Event().wait()

OffscreenRenderer.render = render
from manip_sim.ros import process
sys.exit(process.run(['--ros-args', '-p', 'cameras:=[birdview]']))
"""


@pytest.mark.full
def test_a_process_with_a_rendering_that_hangs_ends_cleanly(client, renderer):
    node = subprocess.Popen([sys.executable, '-c', HANGS], text=True, stdout=subprocess.PIPE,
                            stderr=subprocess.PIPE, env={'MUJOCO_GL': 'egl', **os.environ})
    try:
        listen(client, 'birdview/color/image_raw')
        assert node.stdout is not None
        # The middleware may write lines of its own before.
        assert 'rendering\n' in iter(node.stdout.readline, '')
        node.send_signal(signal.SIGINT)
        _, errors = node.communicate(timeout=300.0)
    finally:
        node.kill()
        node.communicate()
    assert node.returncode == 0, errors
    assert 'rendering hangs; its thread is abandoned' in errors
    assert 'Traceback' not in errors


#: The ball falls from here, before the camera.
LATE = {'objects': [BALL], 'cameras': [FRONT], 'stepping': 'lockstep',
        'camera__front__rate': 50.0, **SMALL}


def in_lockstep(client, periods, *topics):
    """Run some periods, and return the images of each topic by their stamps in periods."""
    heard = [listen(client, topic) for topic in topics]
    states = client.listen(JointState, 'joint_states')
    name = client.state().name[0]
    for period in range(1, periods + 1):
        wanted = 10_000_000 * period
        client.spin_until(lambda t=wanted: nanoseconds(states[-1]) == t)
        if period % 2 == 0:
            client.spin_until(lambda t=wanted: all(
                images and nanoseconds(images[-1]) == t for images in heard))
        client.publish('joint_command', JointState(name=[name], position=[0.1]))
    return [{nanoseconds(image) // 10_000_000: pixels(image) for image in images}
            for images in heard]


@pytest.mark.full
def test_late_images_show_what_was_there_beside_the_present_ones(serve_seen, client):
    serve_seen(latency__image=0.04, **LATE)
    late, present = in_lockstep(
        client, 14, 'front/color/image_raw', 'truth/front/color/image_raw')
    assert set(late) >= {2, 4, 6, 8, 10, 12, 14}
    for period in (8, 10, 12, 14):
        np.testing.assert_array_equal(late[period], present[period - 4])
    assert (present[14] != present[10]).any()


@pytest.mark.full
def test_the_first_image_of_a_reader_that_comes_later_is_as_late_as_others(serve_seen, client):
    serve_seen(latency__image=0.04, **LATE)
    exact = listen(client, 'truth/front/color/image_raw')
    states, name, late = client.listen(JointState, 'joint_states'), client.state().name[0], []
    for period in range(1, 60):
        wanted = 10_000_000 * period
        client.spin_until(lambda t=wanted: nanoseconds(states[-1]) == t)
        if period % 2 == 0:
            client.spin_until(lambda t=wanted: exact and nanoseconds(exact[-1]) == t)
        if period == 9:
            client.node.create_subscription(Image, 'front/color/image_raw', late.append,
                                            qos_profile_sensor_data)
        if late:
            break
        client.publish('joint_command', JointState(name=[name], position=[0.1]))
    present = {nanoseconds(image): pixels(image) for image in exact}
    stamp = nanoseconds(late[0])
    np.testing.assert_array_equal(pixels(late[0]), present[stamp - 40_000_000])
    assert (present[stamp] != present[stamp - 40_000_000]).any()


@pytest.mark.full
def test_noisy_images_are_the_exact_ones_with_the_noise_of_their_instant(serve_seen, client):
    serve_seen(noise__pixel=8.0, noise__depth=0.005, seed=6, **LATE)
    color, depth, exact_color, exact_depth = in_lockstep(
        client, 4, 'front/color/image_raw', 'front/depth/image_raw',
        'truth/front/color/image_raw', 'truth/front/depth/image_raw')
    for period in (2, 4):
        # Steps since the reset are those since the first state, which has the stamp of a period.
        noise = ImageNoise('front', 6, 5 * (period - 1), 8.0, 0.005)
        np.testing.assert_array_equal(color[period], noise.on_colours(exact_color[period]))
        np.testing.assert_array_equal(depth[period], noise.on_depth(exact_depth[period]))
        assert (color[period] != exact_color[period]).mean() > 0.9


@pytest.mark.full
def test_exact_images_come_when_noise_is_set_and_states_have_none_beside_them(serve_seen, client):
    node = serve_seen(cameras=[FRONT], start_paused=True, **SMALL)
    assert client.node.count_publishers('truth/front/color/image_raw') == 0
    node.set_parameters([Parameter('noise.pixel', value=3.0)])
    exact = listen(client, 'truth/front/color/image_raw')
    client.spin_until(lambda: exact != [])
    assert node.count_publishers('truth/joint_states') == 0


@pytest.mark.full
def test_noise_is_the_same_whatever_the_pace(serve_seen, client):
    serve_seen(noise__pixel=8.0, seed=6, **{**LATE, 'stepping': 'free'})
    color, exact = (listen(client, f'{begin}front/color/image_raw') for begin in ('', 'truth/'))

    def common():
        return ({nanoseconds(image) for image in color} & {nanoseconds(image) for image in exact})
    client.spin_until(lambda: len(common()) > 2)
    for stamp in sorted(common())[-3:]:
        noise = ImageNoise('front', 6, 5 * (stamp // 10_000_000 - 1), 8.0, 0.0)
        noisy, clean = (next(pixels(image) for image in images if nanoseconds(image) == stamp)
                        for images in (color, exact))
        np.testing.assert_array_equal(noisy, noise.on_colours(clean))
