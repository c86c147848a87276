# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Frames on /tf and /tf_static: with plain messages anywhere, over DDS where tf2_msgs is there."""

import copy
import importlib.util

from geometry_msgs.msg import PoseStamped, WrenchStamped
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from scipy.spatial.transform import Rotation
from std_msgs.msg import String
from std_srvs.srv import Trigger

from manip_sim.errors import ManipSimError
from manip_sim.interface.parameters import periods_per_message
from manip_sim.models.object_creation import create_object
from manip_sim.physics.object_spawning import plan_with, plan_without
from manip_sim.ros import visualization_topics
from manip_sim.ros.messages import nanoseconds_of, SerializedMessage, stamp_of

BALL = {'name': 'ball', 'shape': 'sphere', 'size': 0.05, 'mass': 0.1, 'position': [1.5, 0.0, 0.5]}


class PlainMessage:
    """What ``tf2_msgs/TFMessage`` has."""

    def __init__(self):
        self.transforms = []


class Record:
    """Takes messages in place of a publisher."""

    def __init__(self):
        self.messages = []
        self.has_subscribers = True

    def publish(self, message):
        self.messages.append(copy.deepcopy(message))

    @property
    def time_ns(self):
        """The stamp of the last message."""
        return nanoseconds_of(self.messages[-1].transforms[0].header.stamp)

    @property
    def latest(self):
        """The transforms of the last message by frame."""
        return {t.child_frame_id: t for t in self.messages[-1].transforms}


@pytest.fixture
def records(monkeypatch):
    """Return what takes the messages of /tf and /tf_static of nodes that are served."""
    found = Record(), Record()

    def serialized(make, count):
        # As plain messages have no bytes, look at what those of tf2_msgs are made of.
        found[0].frames = [t.child_frame_id for t in make(stamp_of(0), np.zeros(count)).transforms]
        return SerializedMessage(make, count)
    monkeypatch.setattr(visualization_topics, 'SerializedMessage', serialized)
    monkeypatch.setattr(visualization_topics, 'TFMessage', PlainMessage)
    create, outputs = visualization_topics.create_output, dict(zip(('/tf', '/tf_static'), found))
    monkeypatch.setattr(visualization_topics, 'create_output', lambda context, row, *others: (
        outputs.get(row.name) or create(context, row, *others)))
    return found


def in_world(moving, static, root='world'):
    """Return position and rotation of each frame in the root, composed along the tree."""
    found = {root: (np.zeros(3), Rotation.identity())}
    left = [*moving.transforms, *static.transforms]
    assert len({t.child_frame_id for t in left}) == len(left), 'a frame has two parents'
    while left:
        ready = [t for t in left if t.header.frame_id in found]
        assert ready, f'these do not hang on {root}: {left}'
        for transform in ready:
            left.remove(transform)
            position, rotation = found[transform.header.frame_id]
            place, turn = transform.transform.translation, transform.transform.rotation
            found[transform.child_frame_id] = (
                position + rotation.apply([place.x, place.y, place.z]),
                rotation * Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]))
    return found


def assert_bodies_are_there(model, data, found, prefix=''):
    for body in range(1, model.nbody):
        position, rotation = found[prefix + model.body(body).name]
        np.testing.assert_allclose(position, data.xpos[body], atol=1e-9)
        np.testing.assert_allclose(rotation.as_matrix().ravel(), data.xmat[body], atol=1e-9)


@pytest.mark.full
def test_the_messages_make_one_tree_in_which_all_bodies_are_where_they_are(
        serve, client, records):
    node = serve(robot='PandaOmron', arena='table', start_paused=True,
                 control_mode__base='position', position=[0.5, 0.2, 0.0],
                 orientation=[0.0, 0.0, 0.7], noise__odom_slip=0.1, noise__odom_drift=0.01)
    odometry, truth = (client.listen(Odometry, topic) for topic in ('odom', 'truth/odom'))
    goals = {'mobilebase0_joint_mobile_forward': 0.3, 'mobilebase0_joint_mobile_yaw': 0.5,
             'robot0_joint2': 0.4, 'mobilebase0_joint_torso_height': 0.1}
    robot, sim = node.simulation.robot, node.simulation
    sim.step_count = 1_000_000  # Of 2 ms.
    node.thread.call(lambda: robot.apply(*robot.parse.joint_command(
        list(goals), list(goals.values()))))
    start = {name: sim.data.joint(name).qpos[0] for name in goals}
    for _ in range(40):
        assert client.call(Trigger, 'manip_sim/step').success
    moving, static = records
    client.spin_until(lambda: moving.time_ns == sim.time_ns)
    message = moving.messages[-1]
    assert {nanoseconds_of(t.header.stamp) for t in message.transforms} == {sim.time_ns}
    assert moving.frames == [t.child_frame_id for t in message.transforms]
    assert all(abs(sim.data.joint(n).qpos[0] - start[n]) > 0.01 for n in goals)
    found = in_world(message, static.messages[-1])
    assert_bodies_are_there(sim.model, sim.data, found)
    for site in ('gripper0_right_ft_frame', 'gripper0_right_grip_site'):
        np.testing.assert_allclose(found[site][0], sim.data.site(site).xpos, atol=1e-9)
    # Where the base was put is where odom was. Now it is where the base seems to be as measured.
    start, turn = np.array([0.5, 0.2]), Rotation.from_rotvec([0.0, 0.0, 0.7])
    place, axes = found['mobilebase0_base']
    for messages, frame in ((truth, (start, turn)), (odometry, found['odom'])):
        client.spin_until(lambda messages=messages: messages[-1:] and nanoseconds_of(
            messages[-1].header.stamp) == sim.time_ns)
        seen = messages[-1].pose.pose
        np.testing.assert_allclose(
            frame[1].apply([seen.position.x, seen.position.y, 0.0])[:2] + frame[0][:2],
            place[:2], atol=1e-9)
        to_base = frame[1] * Rotation.from_quat([getattr(seen.orientation, x) for x in 'xyzw'])
        assert (to_base.inv() * axes).magnitude() < 1e-9
    assert 0.005 < np.linalg.norm(found['odom'][0][:2] - start) < 0.2
    assert {'robot0_eye_in_hand_optical_frame', 'cube', 'table'} < found.keys()


@pytest.mark.full
def test_frames_of_several_robots_have_their_prefix_and_frames_of_messages_that_of_all(
        serve, client, records):
    node = serve(robots=['left', 'right'], right__robot='PandaOmron', frame_prefix='sim/',
                 start_paused=True, arena='table')
    wrenches = client.listen(WrenchStamped, 'left/right/wrench')
    poses = client.listen(PoseStamped, 'right/right/eef_pose')
    cubes = client.listen(PoseStamped, 'objects/cube/pose')
    client.spin_until(lambda: wrenches and poses and cubes and records[0].messages)
    found = in_world(records[0].messages[-1], records[1].messages[-1], 'sim/world')
    assert_bodies_are_there(node.simulation.model, node.simulation.data, found, 'sim/')
    assert {'sim/left_link3', 'sim/right_link3', 'sim/right_odom'} < found.keys()
    assert all(name.startswith('sim/') for name in found)
    assert poses[0].header.frame_id == cubes[0].header.frame_id == 'sim/world'
    assert wrenches[0].header.frame_id == 'sim/left_gripper_ft_frame'
    assert wrenches[0].header.frame_id in found


@pytest.mark.full
def test_frames_of_objects_come_and_go(serve, records):
    node = serve(arena='table', cube=False)
    moving, static = records
    sim, thread = node.simulation, node.thread
    thread.call(lambda: sim.change_objects(plan_with(sim.plan, create_object(BALL))))
    count, before = len(moving.messages), sim.step_count
    wait_for(thread, lambda: sim.step_count > before + 50)
    # The old tree does not fit any more; the thread waits for the new one, and lives.
    assert len(moving.messages) == count and thread.error is None
    node.shared.world_changed()
    wait_for(thread, lambda: len(moving.messages) > count)
    ball = moving.latest['ball']
    assert ball.header.frame_id == 'world' and ball.transform.translation.x == 1.5
    assert len(static.messages) == 2
    thread.call(lambda: sim.change_objects(plan_without(sim.plan, 'ball')))
    count = len(moving.messages)
    node.shared.world_changed()
    wait_for(thread, lambda: len(moving.messages) > count)
    assert 'ball' not in moving.latest and 'robot0_link1' in moving.latest


def wait_for(thread, condition):
    """Let the simulation go on until a condition holds."""
    for _ in range(100000):
        if thread.call(condition):
            return
    raise AssertionError('timed out')


@pytest.mark.full
@pytest.mark.parametrize(('tf_rate', 'period_ms', 'told'), [
    (50.0, 20, None), (30.0, 30, '33.3333 Hz'), (1000.0, 10, '100 Hz')])
def test_frames_come_with_the_nearest_rate_there_is(serve, records, tf_rate, period_ms, told):
    node = serve(tf_rate=tf_rate)
    moving = records[0]
    wait_for(node.thread, lambda: len(moving.messages) > 10)
    stamps = [nanoseconds_of(m.transforms[0].header.stamp) for m in moving.messages]
    # The first one is that of the start.
    assert set(np.diff(stamps[1:])) == {period_ms * 1_000_000}
    notes = [note for note in node.shared.notes if note.startswith('tf_rate')]
    assert bool(notes) == bool(told) and all(told in note for note in notes)


@pytest.mark.parametrize(('publish_rate', 'tf_rate', 'periods'), [
    (100.0, 50.0, 2), (100.0, 40.0, 3), (100.0, 30.0, 3), (100.0, 70.0, 2), (30.0, 50.0, 1),
    (500.0, 0.1, 5000), (1000.0, 999.0, 1)])
def test_the_nearest_rate_is_that_of_the_smallest_difference(publish_rate, tf_rate, periods):
    assert periods_per_message(publish_rate, tf_rate) == periods
    assert abs(publish_rate / periods - tf_rate) == min(
        abs(publish_rate / n - tf_rate) for n in range(1, 6000))


def test_while_nobody_listens_no_frames_are_made(serve, client, records):
    moving = records[0]
    moving.has_subscribers = False
    serve()
    client.state()
    assert moving.messages == [] and len(records[1].messages) == 1


def test_without_tf2_msgs_one_line_says_so_and_all_else_works(serve, client, monkeypatch):
    monkeypatch.setattr(visualization_topics, 'TFMessage', None)
    log = client.log()
    node = serve(tf_rate=50.0)
    client.state()
    assert not {'/tf', '/tf_static'} & {name for name, _ in node.get_topic_names_and_types()}
    client.spin_until(lambda: any('tf2_msgs' in line for line in log))
    (line,) = [line for line in log if 'tf2_msgs' in line]
    assert '/tf and /tf_static (tf2_msgs)' in line and '-tf2-msgs' in line


def test_publish_tf_off_publishes_no_frames_and_says_nothing(serve, client, records):
    log = client.log()
    serve(publish_tf=False)
    client.spin_until(lambda: any('joints robot0' in line for line in log))
    assert not any('tf2_msgs' in line for line in log)
    assert records[0].messages == records[1].messages == []


@pytest.mark.parametrize('prefix', ['/left', 'a b', 'tab\t'])
def test_a_prefix_that_tf2_does_not_take_ends_the_start(serve, prefix):
    with pytest.raises(ManipSimError, match=r"'frame_prefix': .* cannot begin the name of a fra"):
        serve(frame_prefix=prefix)


@pytest.mark.skipif(importlib.util.find_spec('tf2_msgs') is None, reason='needs tf2_msgs')
def test_over_dds_one_who_comes_late_gets_the_whole_tree(serve, client):
    from tf2_msgs.msg import TFMessage
    node = serve(arena='table', start_paused=True)
    client.state()
    moving = client.listen(TFMessage, '/tf')
    static = client.listen(TFMessage, '/tf_static', QoSProfile(
        depth=100, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL))
    client.spin_until(lambda: moving and static)
    assert_bodies_are_there(node.simulation.model, node.simulation.data,
                            in_world(moving[-1], static[-1]))


#: Has a body that is called as the node calls the frame of the odometry of a robot ``left_``.
WITH_ODOM = ('<mujoco><worldbody><body name="base"><geom size="0.05" mass="1"/><body name="odom" '
             'pos="0.1 0.2 0.3"><joint name="j" axis="0 1 0"/><geom size="0.05" mass="1"/></body>'
             '</body></worldbody><actuator><motor joint="j" ctrlrange="-9 9"/></actuator>'
             '</mujoco>')
ODOM_CAMERA = '{name: odom, position: [1.0, 1.0, 1.0], look_at: [0.0, 0.0, 0.0]}'
ODOM_LIDAR = '{name: odom, position: [0.5, 0.0, 2.0], samples: 4}'
ODOM_BOX = '{name: odom, shape: box, size: [0.1, 0.1, 0.1], mass: 0.1, position: [3.0, 1.0, 0.1]}'


@pytest.mark.full
@pytest.mark.parametrize(('given', 'frame', 'other', 'other_place'), [
    ({}, 'odom', 'world', [0.0, 0.0, 0.0]),
    ({'robot': 'arm.xml', 'base': 'OmronMobileBase', 'prefix': 'left_'},
     'left_odom_frame', 'left_odom', None),
    ({'cameras': [ODOM_CAMERA]}, 'odom_frame', 'odom', [1.0, 1.0, 1.0]),
    ({'lidars': [ODOM_LIDAR]}, 'odom_frame', 'odom', [0.5, 0.0, 2.0]),
    ({'objects': [ODOM_BOX]}, 'odom', 'odom_body', [3.0, 1.0, 0.1])],
    ids=['none', 'body', 'camera', 'lidar', 'object'])
def test_the_odometry_names_its_frame_as_tf_does_whatever_else_has_that_name(
        given, frame, other, other_place, serve, client, records, tmp_path):
    (tmp_path / 'arm.xml').write_text(WITH_ODOM)
    given = {'robot': 'PandaOmron', **given}
    if given['robot'] == 'arm.xml':
        given['robot'] = str(tmp_path / 'arm.xml')
    node = serve(start_paused=True, position=[0.5, 0.2, 0.0], orientation=[0.0, 0.0, 0.7], **given)
    odometry = client.listen(Odometry, 'odom')
    urdf = client.listen(String, 'robot_description', QoSProfile(
        depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL))
    moving, static = records
    client.spin_until(lambda: odometry and urdf and moving.messages)
    found = in_world(moving.messages[-1], static.messages[-1])
    assert odometry[-1].header.frame_id == frame
    np.testing.assert_allclose(found[frame][0][:2], [0.5, 0.2], atol=1e-9)
    np.testing.assert_allclose(found[frame][1].as_rotvec(), [0.0, 0.0, 0.7], atol=1e-9)
    assert odometry[-1].child_frame_id in found
    if other_place is None:  # A link, which is where the body is.
        assert f'<link name="{other}">' in urdf[-1].data
        other_place = node.simulation.data.body(other).xpos
    np.testing.assert_allclose(found[other][0], other_place, atol=1e-2)
    assert f'"{frame}"' not in urdf[-1].data


def test_an_object_that_comes_does_not_rename_the_frame_of_the_odometry(serve, client, records):
    node = serve(robot='PandaOmron', start_paused=True)
    moving, static = records
    client.spin_until(lambda: moving.messages and static.messages)
    box = create_object({**BALL, 'name': 'odom'})
    node.thread.call(lambda: node.thread.change(
        'spawn', 'odom', None, BALL['position'], [1.0, 0.0, 0.0, 0.0],
        using=plan_with(node.simulation.plan, box)))
    node.shared.world_changed()
    count = len(moving.messages)
    assert client.call(Trigger, 'manip_sim/step').success
    client.spin_until(lambda: len(moving.messages) > count)
    found = in_world(moving.messages[-1], static.messages[-1])
    np.testing.assert_allclose(found['odom_body'][0], BALL['position'], atol=0.01)
    assert 'odom' in found and 'odom_frame' not in found
