# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What the viewer takes from messages: any message is rejected, or can be drawn."""

import itertools

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='messages need ROS 2')
pytest.importorskip('viser', reason='the viewer needs the extra viewer')
pytest.importorskip('hypothesis', reason='needs hypothesis')

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue  # noqa: E402
from geometry_msgs.msg import Point, PoseStamped, WrenchStamped  # noqa: E402
from hypothesis import given, strategies as st  # noqa: E402
from sensor_msgs.msg import Image, JointState  # noqa: E402
from visualization_msgs.msg import Marker, MarkerArray  # noqa: E402

from manip_sim.errors import MessageError  # noqa: E402
from manip_sim.viewer.page.latest import (  # noqa: E402
    command_fields, commanded_joints, declared_limits, in_words, limit_of, ShownStatus)
from manip_sim.viewer import discovery as readers  # noqa: E402
from manip_sim.viewer.discovery import layout_of  # noqa: E402

TEXTS = st.text(st.characters(codec='utf-8', exclude_characters='\0'), max_size=8)
NUMBERS = st.lists(st.floats(), max_size=3)
NAN, INF = float('nan'), float('inf')


def read(function, *arguments):
    """Return what was read, or None if it was rejected with one line."""
    try:
        return function(*arguments)
    except MessageError as error:
        assert str(error).isprintable()
        return None


@given(st.lists(TEXTS, max_size=3), NUMBERS, NUMBERS, NUMBERS)
def test_joint_states_have_a_finite_number_for_each_name_or_are_rejected(names, p, v, e):
    found = read(readers.joint_states, JointState(name=names, position=p, velocity=v, effort=e))
    fits = len(set(names)) == len(names) == len(p) > 0 and all(
        len(values) in (0, len(names)) for values in (v, e))
    fits = fits and all(abs(x) <= 1e9 for x in (*p, *v, *e))
    assert (found is not None) == fits
    if found is not None:
        assert [list(found.position), found.velocity.shape, found.effort.shape] == [
            p, (len(p),), (len(p),)]


def test_what_a_message_of_joints_leaves_empty_is_zero():
    found = readers.joint_states(JointState(name=['a', 'b'], position=[1.0, 2.0]))
    assert [*found.velocity, *found.effort] == [0.0] * 4
    with pytest.raises(MessageError, match=r'^velocity: 1 number for 2 joints$'):
        readers.joint_states(JointState(name=['a', 'b'], position=[1.0, 2.0], velocity=[1.0]))


@given(st.lists(st.floats(), min_size=7, max_size=7))
def test_a_pose_has_a_unit_quaternion_or_is_rejected(numbers):
    message = PoseStamped()
    at, turn = message.pose.position, message.pose.orientation
    at.x, at.y, at.z, turn.w, turn.x, turn.y, turn.z = numbers
    found = read(readers.pose, message)
    if found is not None:
        assert found.position.tolist() == numbers[:3]
        assert np.linalg.norm(found.quat_wxyz) == pytest.approx(1.0)
    else:
        assert not all(abs(x) <= 1e9 for x in numbers) or np.linalg.norm(numbers[3:]) < 1e-3


@pytest.mark.parametrize('bad', [NAN, INF, -INF, 1e300])
def test_a_wrench_that_cannot_be_drawn_is_rejected(bad):
    message = WrenchStamped()
    message.wrench.torque.y = 3.0
    assert readers.wrench(message).tolist() == [0.0, 0.0, 0.0, 0.0, 3.0, 0.0]
    message.wrench.force.z = bad
    with pytest.raises(MessageError, match='wrench: .* cannot be drawn'):
        readers.wrench(message)


def test_an_image_is_shown_if_its_data_is_that_of_its_size():
    good = {'height': 2, 'width': 1, 'step': 4, 'encoding': 'rgb8'}
    pixels = readers.image(Image(data=bytes(range(8)), **good))
    assert pixels.tolist() == [[[0, 1, 2]], [[4, 5, 6]]]
    for wrong in ({'height': 0}, {'height': 3}, {'width': 2}, {'width': 0}, {'step': 2},
                  {'step': 2**32 - 1}, {'encoding': 'rgba8'}, {'height': 2**31, 'step': 0}):
        with pytest.raises(MessageError):
            readers.image(Image(data=bytes(range(8)), **{**good, **wrong}))
    with pytest.raises(MessageError):
        readers.image(Image(data=b'', height=4097, width=1, step=3, encoding='rgb8'))


def test_markers_are_taken_by_their_namespace_and_rejected_if_one_is_not_finite():
    def marker(namespace, count, x=0.5, kind=Marker.ARROW):
        return Marker(ns=namespace, type=kind, points=[Point(x=x, y=1.0)] * count)
    points, arrows = readers.markers(MarkerArray(markers=[
        marker('contact_points', 3, kind=Marker.SPHERE_LIST), marker('right/external_force', 2),
        marker('contact_forces', 2), marker('contact_forces', 1), marker('x', 2, kind=99)]))
    assert points.shape == (3, 3)
    assert {what: found.shape for what, found in arrows.items()} == {
        'force': (1, 2, 3), 'contact_forces': (1, 2, 3)}
    for bad in ([marker('contact_points', 1, NAN)], [marker('contact_forces', 2, INF)],
                [marker('contact_points', 5001)], [Marker()] * 5001):
        with pytest.raises(MessageError):
            readers.markers(MarkerArray(markers=bad))


VALUES = st.dictionaries(
    st.sampled_from(['accepted', 'age', 'rate', 'command_interface', 'real_time_factor',
                     'action_size', 'state', 'start_defects', 'mjWARN_X', 'failed_x',
                     'a.rate']) | TEXTS,
    st.sampled_from(['0', '1', 'never', 'position', 'nan', '-1', '1e999', '<b>']) | TEXTS,
    max_size=6)


@given(st.lists(st.tuples(st.integers(0, 255), st.sampled_from(['cameras', 'arm', '']) | TEXTS,
                          TEXTS, VALUES), max_size=3))
def test_any_diagnostics_are_put_in_words(found):
    message = DiagnosticArray(status=[
        DiagnosticStatus(level=bytes([level]), name=f'cell/sim: {name}', message=text,
                         values=[KeyValue(key=k, value=v) for k, v in values.items()])
        for level, name, text, values in found] + [DiagnosticStatus(name='other: x')])
    statuses = readers.statuses(message, 'cell/sim')
    assert [(s.level, s.name, s.message, s.values) for s in statuses] == found
    assert in_words(statuses)
    assert set(command_fields(statuses).values()) <= {'position', 'velocity', 'effort'}


def test_too_many_statuses_are_rejected():
    with pytest.raises(MessageError, match='101 statuses'):
        readers.statuses(DiagnosticArray(status=[DiagnosticStatus(name='n: x')] * 101), 'n')


def test_a_value_is_a_number_only_if_it_is_finite():
    status = ShownStatus(0, 'x', '', {'a': '1.5', 'b': 'nan', 'c': 'inf', 'd': 'many'})
    assert [status.number(key) for key in 'abcde'] == [1.5, None, None, None, None]


@pytest.mark.parametrize('urdf', [
    '', 'no xml', '<robot>', '<robot><joint><limit lower="x"/></joint></robot>',
    '<robot><joint name="j"><limit upper="inf"/></joint></robot>',
    '<robot><joint name="j"><limit effort="nan"/></joint></robot>'])
def test_limits_that_cannot_be_used_are_rejected(urdf):
    with pytest.raises(ValueError):
        declared_limits(urdf)


def test_limits_are_read_from_a_urdf_and_great_ones_are_none():
    limits = declared_limits('<robot><joint name="j"><limit lower="-1" effort="5" other="x"/>'
                             '</joint><joint name="k"/></robot>')
    assert limits == {'j': {'lower': -1.0, 'effort': 5.0}}
    for declared, expected in ((0.0, 7.0), (-1.0, 7.0), (2.0, 2.0), (1e6, 1e6), (1.1e6, 7.0)):
        assert limit_of({'velocity': declared}, 'velocity', 7.0) == expected
    assert limit_of({}, 'velocity', 7.0) == 7.0


@pytest.mark.parametrize(('declared', 'expected'), [
    ((-1.0, 2.0), (-1.0, 2.0)), ((2.0, -1.0), (-np.pi, np.pi)), ((0.0, 320.0), (-np.pi, np.pi)),
    ((1e300, 1e300), (-np.pi, np.pi)), ((-1e308, 1e308), (-np.pi, np.pi)),
    ((0.0, 314.0), (0.0, 314.0)), ((-315.0, -314.5), (-np.pi, np.pi))])
def test_the_range_of_a_slider_is_declared_or_a_turn(arm, declared, expected):
    joint, = commanded_joints(arm, ['j'], {'j': dict(zip(('lower', 'upper'), declared))}, False)
    assert joint.ranges['position'] == pytest.approx(expected)


@pytest.mark.parametrize('actuator', ['motor', 'velocity'])
def test_a_gripper_takes_positions_where_its_actuator_is_a_position_servo(actuator, arm):
    import mujoco
    assert commanded_joints(arm, ['j'], {}, gripper=True)
    other = mujoco.MjModel.from_xml_string(ARM.replace('position', actuator))
    assert not commanded_joints(other, ['j'], {}, gripper=True)
    assert commanded_joints(other, ['j'], {}, gripper=False)


ARM = ('<mujoco><worldbody><body><joint name="j"/><geom size="0.1"/></body></worldbody>'
       '<actuator><position joint="j"/></actuator></mujoco>')


@pytest.fixture
def arm():
    import mujoco
    return mujoco.MjModel.from_xml_string(ARM)


@given(st.lists(TEXTS | st.sampled_from([
    '/robot_description', '/a/robot_description', '/a b/robot_description', '/arm/joint_command',
    '/objects/x/pose', '/objects/<b>/pose', '/c/color/image_raw', '//color/image_raw']),
    max_size=8), st.lists(TEXTS, max_size=3))
def test_a_layout_has_names_of_ros_only(published, subscribed):
    layout = layout_of('/', published, subscribed)
    spaces = [robot.space.strip('/') for robot in layout.robots]
    for name in itertools.chain(spaces, layout.objects, layout.cameras):
        assert all(word.isidentifier() and word.isascii() for word in name.split('/')) or not name
