# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What the page knows of robots and topics, and what it says of them."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

pytestmark = pytest.mark.full

pytest.importorskip('viser', reason='the viewer needs the extra viewer')

from manip_sim.errors import ManipSimError  # noqa: E402
from manip_sim.models import compose, urdf_of  # noqa: E402
from manip_sim.viewer.discovery import layout_of, RobotTopics  # noqa: E402
from manip_sim.viewer.page import latest  # noqa: E402
from manip_sim.viewer.page.interaction import Aiming, Events, Following  # noqa: E402
from manip_sim.viewer.page.latest import (  # noqa: E402
    command_fields, commanded_joints, declared_limits, in_words, Latest, Line, PoseInWorld,
    RealTimeFactor, Robot, short_labels, ShownJoint, ShownPart, ShownStatus)
from manip_sim.viewer.page.model_scene import first_view, Kinematics  # noqa: E402
from manip_sim.viewer.page.page import _UNFOLDED, DrivePanel, JointPanel, Page  # noqa: E402
from manip_sim.viewer.page.server import Access, close_server, open_server  # noqa: E402
from manip_sim.viewer.page.timeline import History  # noqa: E402


@pytest.mark.parametrize(('names', 'labels'), [
    (['robot0_joint1', 'robot0_joint2'], ['joint1', 'joint2']),
    (['gripper0_right_R_thumb_joint', 'gripper0_right_R_index_joint'], ['thumb', 'index']),
    (['robot0_j2s7s300_joint_1', 'robot0_j2s7s300_joint_2'], ['joint 1', 'joint 2']),
    (['mobilebase0_joint_torso_height'], ['joint torso height']), ([], [])])
def test_labels_leave_out_what_all_names_begin_with(names, labels):
    assert short_labels(names) == labels


@pytest.mark.parametrize('robot', ['Panda', 'PandaOmron', 'GR1', 'Jaco'])
def test_each_joint_with_an_actuator_has_a_slider_over_its_range(robot):
    world = compose(robot)
    model = world.compile()
    own = world.robots[0].all_joints
    found = {joint.name: joint for joint in commanded_joints(
        model, own, declared_limits(urdf_of(world).xml), gripper=False)}
    driven = {model.joint(int(model.actuator_trnid[i, 0])).name for i in range(model.nu)}
    assert set(found) == driven & set(own)
    for name, joint in found.items():
        if model.joint(name).limited[0] if hasattr(model.joint(name), 'limited') else True:
            low, high = joint.ranges['position']
            if np.ptp(model.joint(name).range) > 0.0:
                np.testing.assert_allclose([low, high], model.joint(name).range, atol=1e-5)
        assert joint.ranges['velocity'][1] > 0.0
        slides = int(model.joint(name).type[0]) == int(mujoco.mjtJoint.mjJNT_SLIDE)
        assert joint.unit('effort') == ('N' if slides else 'N m')


def test_fingers_have_sliders_where_they_take_positions():
    def fingers(robot, gripper):
        world = compose(robot, gripper=gripper)
        names = [joint for hand in world.robots[0].grippers.values() for joint in hand.joints]
        return [joint.label for joint in commanded_joints(
            world.compile(), names, declared_limits(urdf_of(world).xml), gripper=True)]
    assert fingers('Panda', 'PandaGripper') == ['joint1', 'joint2']
    assert fingers('UR5e', 'Robotiq85Gripper') != []


def topics(space, parts, arms=()):
    subscribed = [f'{space}joint_command', *(f'{space}{part}/joint_command' for part in parts),
                  *(f'{space}{arm}/target_pose' for arm in arms)]
    return [f'{space}robot_description'], subscribed


def test_a_layout_is_found_in_names_of_topics():
    published, subscribed = topics('/', ['arm', 'right', 'right/gripper', 'base'], ['right'])
    published += ['/objects/cube/pose', '/objects/cube/twist', '/birdview/color/image_raw']
    layout = layout_of('/', published, [*subscribed, '/base/cmd_vel'])
    assert layout.robots == (
        RobotTopics('/', ('arm', 'right/gripper', 'base'), ('right',), True),)
    assert (layout.objects, layout.cameras) == (('cube',), ('birdview',))


def test_two_arms_are_parts_of_their_own_and_robots_have_spaces():
    parts = ['arm', 'right', 'left', 'right/gripper', 'left/gripper', 'torso']
    published, subscribed = [], []
    for space in ('/cell/a/', '/cell/b/'):
        for names, more in zip((published, subscribed), topics(space, parts, ['left', 'right'])):
            names += more
    layout = layout_of('/cell/', published, subscribed)
    assert [robot.space for robot in layout.robots] == ['/cell/a/', '/cell/b/']
    assert layout.robots[1].parts == (
        'right', 'right/gripper', 'left', 'left/gripper', 'torso')
    assert layout.robots[1].end_effectors == ('right', 'left')


def test_an_input_keeps_what_was_asked_for_until_all_is_still():
    following = Following()
    assert following.follows(0.0, moving=True)
    following.asked(5.0)
    assert not following.follows(5.9, moving=False)
    assert following.follows(6.1, moving=False)
    following.asked(10.0)
    # A long motion goes on to hold it.
    for tenth in range(109, 150):
        assert not following.follows(tenth / 10.0, moving=True)
    assert following.follows(15.5, moving=False)
    assert following.follows(15.6, moving=True)


def test_the_history_goes_ten_seconds_back_and_begins_anew_with_the_time():
    history = History()
    for hundredth in range(3000):
        history.add(hundredth / 100.0, np.array([hundredth / 100.0, 1.0]))
    times, rows = history.columns()
    assert times[-1] == 0.0
    assert times[0] == pytest.approx(-10.0, abs=0.06)
    assert len(times) <= 201
    assert np.median(np.diff(times)) == pytest.approx(0.05)
    np.testing.assert_allclose(rows[:, 0] - rows[-1, 0], times)
    history.add(0.0, np.array([5.0, 1.0]))
    assert history.columns()[1].tolist() == [[5.0, 1.0]]
    assert len(History().columns()[0]) == 0


def test_the_real_time_factor_is_that_of_the_last_two_seconds():
    real_time_factor = RealTimeFactor()
    assert real_time_factor.factor is None
    for tenth in range(50):
        real_time_factor.add(tenth / 10.0, min(tenth, 20) / 10.0 + max(0, tenth - 20) / 20.0)
    assert real_time_factor.factor == pytest.approx(0.5)
    real_time_factor.add(5.0, 0.0)  # Simulation time began anew.
    assert real_time_factor.factor is None


SIMULATION = ShownStatus(0, 'simulation', 'running', {
    'state': 'realtime', 'real_time_factor': '1.0000', 'missed_deadlines': '3',
    'mjWARN_BADQPOS': '0', 'start_defects': 'none', 'failed_callbacks': '2'})
ARM = ShownStatus(0, 'left/arm', 'commands', {
    'rate': '12.0', 'age': '0.310', 'accepted': '120', 'dropped': '2', 'clamped': '0',
    'control_mode': 'admittance', 'command_interface': 'velocity'})


def test_levels_of_diagnostics_are_those_of_ros():
    status = pytest.importorskip('diagnostic_msgs.msg', reason='needs ROS 2').DiagnosticStatus
    assert [bytes([level]) for level in (latest.OK, latest.WARN, latest.ERROR)] == [
        status.OK, status.WARN, status.ERROR]


def test_diagnostics_are_told_in_words_with_trouble_first():
    slow = ShownStatus(1, 'other nodes', '/clock is also published by x')
    first, second, third = in_words([SIMULATION, ARM, slow])
    assert first == Line('/clock is also published by x', 'Warning: other nodes')
    assert second == Line('realtime at 1.0000 times real time; 3 deadlines missed; '
                          '2 failed callbacks', 'simulation')
    assert third == Line('admittance mode; 120 commands, 12.0 per second, the last 0.3 s ago; '
                         '2 rejected', 'left/arm')
    cameras = ShownStatus(0, 'cameras', '', {'birdview.rate': '29.9', 'birdview.late': '3'})
    others = [ShownStatus(0, name, 'fine', {'a': '1', 'b': '2'}) for name in ('brakes', 'disk')]
    assert in_words([cameras, *others]) == [Line('birdview 29.9 images per second', 'cameras'), *(
        Line('fine; a 1, b 2', status.name) for status in others)]
    assert in_words([]) == [Line('No diagnostics yet.')]
    assert command_fields([SIMULATION, ARM]) == {'left/arm': 'velocity'}


class Browsers:
    """A server whose browsers report their cameras."""

    def __init__(self):
        self.initial_camera = SimpleNamespace(fov=0.0, position=np.ones(3), look_at=np.zeros(3))
        self.clients = {}

    def get_clients(self):
        return dict(self.clients)

    def come(self, number, width=800, height=400):
        first = self.initial_camera
        self.clients[number] = SimpleNamespace(camera=SimpleNamespace(
            image_width=width, image_height=height, fov=first.fov, position=first.position,
            look_at=first.look_at))
        return self.clients[number].camera


@pytest.fixture
def arm_posture():
    posture = Kinematics(compose('Panda', arena='table').compile())
    posture.compute()
    return posture


def test_cameras_at_the_view_that_the_server_gives_to_all_are_aimed_whenever_they_come_there(
        arm_posture):
    browsers = Browsers()
    early = browsers.come(1)
    aiming = Aiming(browsers)
    aiming.begin(arm_posture)
    late = browsers.come(2)
    aiming.update(arm_posture)
    aimed = late.position.copy()
    np.testing.assert_array_equal(early.position, aimed)
    assert np.linalg.norm(aimed - browsers.initial_camera.position) > 0.3
    # A slow browser takes over the first view only now, and reports it in single precision.
    first = browsers.initial_camera
    late.position, late.look_at = (np.float32(v).astype(float)
                                   for v in (first.position, first.look_at))
    aiming.update(arm_posture)
    np.testing.assert_array_equal(late.position, aimed)


def test_cameras_that_people_have_moved_stay(arm_posture):
    browsers = Browsers()
    aiming = Aiming(browsers)
    aiming.begin(arm_posture)
    camera = browsers.come(1)
    aiming.update(arm_posture)
    first = browsers.initial_camera
    # The first view but for where it is from, or for where it looks to.
    for position, look_at in ((first.position + [0.0, 0.02, 0.0], first.look_at),
                              (first.position, first.look_at + [0.0, 0.0, 0.02])):
        camera.position, camera.look_at = position, look_at
        aiming.update(arm_posture)
        np.testing.assert_array_equal(camera.position, position)
    # Its number may be that of another browser after it has gone.
    browsers.clients.clear()
    aiming.update(arm_posture)
    other = browsers.come(1)
    other.position = np.zeros(3)
    aiming.update(arm_posture)
    assert np.linalg.norm(other.position) > 0.5


def test_a_window_of_another_size_is_framed_again_until_somebody_moves_the_camera(arm_posture):
    def aimed_at(width, height, view='Home'):
        browsers = Browsers()
        aiming = Aiming(browsers)
        aiming.begin(arm_posture)
        camera = browsers.come(1, width, height)
        aiming.update(arm_posture)
        aiming.look(1, view, arm_posture)
        return aiming, camera
    for view in ('Home', 'Front'):
        aiming, camera = aimed_at(844, 390, view)
        camera.image_width, camera.image_height = 390, 844
        aiming.update(arm_posture)
        _, upright = aimed_at(390, 844, view)
        np.testing.assert_array_equal(camera.position, upright.position)
        np.testing.assert_array_equal(camera.look_at, upright.look_at)
        moved = camera.position = camera.position + [0.0, 0.1, 0.0]
        camera.image_width, camera.image_height = 844, 390
        aiming.update(arm_posture)
        np.testing.assert_array_equal(camera.position, moved)


def test_another_world_is_framed_in_the_browsers_that_are_open(arm_posture):
    browsers = Browsers()
    aiming = Aiming(browsers)
    camera = browsers.come(1)
    aiming.begin(arm_posture)
    aiming.update(arm_posture)
    moved = np.array([9.0, 9.0, 9.0])
    camera.position = moved
    # The same world with another object.
    ball = {'name': 'ball', 'shape': 'sphere', 'size': 0.03, 'position': [0.1, 0.0, 1.0]}
    aiming.begin(Kinematics(compose('Panda', arena='table', objects=[ball]).compile()))
    aiming.update(arm_posture)
    np.testing.assert_array_equal(camera.position, moved)
    # Other robots; another arena; the robot at another place.
    for world in (compose('GR1', arena='table'), compose('GR1'),
                  compose('GR1', position=[0.0, 1.0, 0.0])):
        other = Kinematics(world.compile())
        camera.position = moved
        aiming.begin(other)
        aiming.update(other)
        framed = first_view(other.model, other.data, 2.0, 400 / 800)
        np.testing.assert_allclose([camera.position, camera.look_at], framed)


def test_a_view_is_chosen_in_one_browser(arm_posture):
    browsers = Browsers()
    aiming = Aiming(browsers)
    aiming.begin(arm_posture)
    mine, other = browsers.come(1), browsers.come(2)
    aiming.update(arm_posture)
    before = other.position.copy()
    for view, axis in (('Front', 0), ('Left', 1), ('Top', 2)):
        aiming.look(1, view, arm_posture)
        way = mine.position - mine.look_at
        assert way[axis] > 0.9 * np.linalg.norm(way)
    last = mine.position.copy()
    for number, view in ((3, 'Top'), (None, 'Front'), (1, 'nowhere')):
        aiming.look(number, view, arm_posture)
    np.testing.assert_array_equal(mine.position, last)
    np.testing.assert_array_equal(other.position, before)
    aiming.look(1, 'Home', arm_posture)
    np.testing.assert_array_equal(mine.position, before)


def test_events_run_in_their_order_and_those_that_they_add_later():
    events, done = Events(), []
    events.add(lambda: (done.append(1), events.add(lambda: done.append(3))))
    events.add(lambda: done.append(2))
    events.run()
    assert done == [1, 2]
    events.run()
    assert done == [1, 2, 3]


def test_a_server_listens_where_it_is_told_and_rejects_a_port_that_is_taken():
    server = open_server('127.0.0.1', 0, Access.of({}))
    try:
        with pytest.raises(ManipSimError, match=r'cannot listen on 127\.0\.0\.1:\d+: Address'):
            open_server('127.0.0.1', server.get_port(), Access.of({}))
    finally:
        close_server(server)
    with pytest.raises(ManipSimError, match='cannot listen on no.such.host:'):
        open_server('no.such.host', 8080, Access.of({}))
    with pytest.raises(ManipSimError, match='there is no port 99999999: choose one'):
        open_server('127.0.0.1', 99999999, Access.of({}))


@pytest.fixture
def server():
    opened = open_server('127.0.0.1', 0, Access.of({}, []))
    yield opened
    close_server(opened)


def box():
    return mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body name="b"><freejoint/><geom size="0.1"/></body></worldbody>'
        '</mujoco>')


def test_a_camera_is_aimed_when_there_is_something_to_look_at(server):
    page, aimed = Page(server, None, lambda *_: None), []
    page._aiming.look = lambda *told: aimed.append(told)
    page._look(1, 'Front')
    page.update(1.0, Latest(), False)
    assert aimed == []
    page.show_model(box(), Latest())
    page._look(1, 'Front')
    assert aimed == [(1, 'Front', page._posture)]


def test_a_model_that_cannot_be_drawn_leaves_the_rest_of_the_page(server, monkeypatch):
    page = Page(server, None, lambda *_: None)
    with monkeypatch.context() as patch, pytest.raises(ValueError):
        patch.setattr('manip_sim.viewer.page.page.Scene', lambda *_: int('no'))
        page.show_model(box(), Latest())
    page.update(1.0, Latest(), False)
    page.show_model(box(), Latest())
    page.update(2.0, Latest(objects={'b': PoseInWorld(
        np.array([0.0, 0.0, 3.0]), np.array([1.0, 0.0, 0.0, 0.0]))}), False)
    assert page._posture.data.body('b').xpos[2] == pytest.approx(3.0)


def test_markers_are_wanted_while_one_of_their_boxes_is_ticked(server):
    page = Page(server, None, lambda *_: None)
    contacts, wrenches = page._view._contacts, page._view._wrenches
    seen = []
    for contacts.value, wrenches.value in ((False, False), (True, False), (False, True)):
        seen.append(page.wants_markers)
    assert seen == [False, True, True]


def test_contacts_and_wrenches_are_drawn_while_their_boxes_are_ticked(server):
    page = Page(server, None, lambda *_: None)
    page.show_model(box(), Latest())
    latest = Latest(contacts=np.ones((2, 3)), arrows={
        what: np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]])
        for what in ('contact_forces', 'force', 'torque')})
    contacts, wrenches, drawn = page._view._contacts, page._view._wrenches, []
    for contacts.value, wrenches.value in ((True, True), (True, False), (False, True),
                                           (False, False)):
        page.update(1.0, latest, False)
        shown = {*page._overlays._shown}
        drawn.append(('contacts' in shown, sorted(shown - {'contacts'})))
    assert drawn == [
        (True, ['contact_forces', 'force', 'torque']), (True, ['contact_forces']),
        (False, ['force', 'torque']), (False, [])]


def test_names_of_bodies_go_with_their_tick(server):
    page = Page(server, None, lambda *_: None)
    page.show_model(box(), Latest())
    drawn = []
    scene = SimpleNamespace(add_label=lambda name, text, **_: drawn.append(SimpleNamespace(
        text=text, remove=lambda: drawn.clear())) or drawn[-1])
    camera = SimpleNamespace(position=np.array([2.0, 0.0, 0.0]), fov=1.0, image_height=400,
                             wxyz=np.array([0.5, -0.5, -0.5, 0.5]))
    server_of_labels = page._labels._server = SimpleNamespace(
        get_clients=lambda: {1: SimpleNamespace(scene=scene, camera=camera)})
    assert server_of_labels
    for shown, texts in ((True, ['b']), (False, [])):
        page._view._names.value = shown
        page._view._apply()
        page._labels.update(1.0, page._posture)
        assert [label.text for label in drawn] == texts


class Ignored:
    """Takes all commands."""

    switchable = ()

    def __getattr__(self, command):
        return lambda *_: None

    def modes(self, space, part):
        return ('position', 'velocity') if part in self.switchable else ()


def test_panels_have_the_order_of_the_parts_and_all_but_the_first_ones_are_folded(
        server, monkeypatch):
    made = []

    class Panel:
        def __init__(self, gui, robot, part, field, commands, events, folded, order):
            made.append((robot.space, part.name, folded, order))

        def remove(self):
            made.append('removed')

        show = update = remove
    monkeypatch.setattr('manip_sim.viewer.page.page.JointPanel', Panel)
    page = Page(server, Ignored(), lambda *_: None)
    joint = ShownJoint('j', 'j', False, {'position': (-1.0, 1.0)})
    robots = [Robot(f'/{name}/', name, (ShownPart('arm', (joint,)), ShownPart('head', (joint,))),
                    (), (0.0, 0.0, 0.0)) for name in ('a', 'b', 'c')]
    page.show_robots(robots, [])
    page._fields = {'a/arm': 'position'}
    page._follow(1.0, Latest(), False)
    assert [one[:2] for one in made] == [
        (robot.space, part.name) for robot in robots for part in robot.parts]
    assert [one[3] for one in made] == [float(n) for n in range(6)]
    assert [one[2] for one in made] == [n >= _UNFOLDED for n in range(6)]


def test_what_cannot_be_done_is_shown_in_each_browser_on_one_line(server, monkeypatch):
    told = []
    browsers = {number: SimpleNamespace(add_notification=lambda title, text, of=number, **_: (
        told.append((of, title, text)))) for number in (3, 7)}
    page = Page(server, Ignored(), lambda *_: None)
    monkeypatch.setattr(server, 'get_clients', lambda: browsers)
    page.notify('two\nlines')
    page.notify('a file', True)
    assert told == [(number, *shown) for shown in (
        ('Command failed', r'two\nlines'), ('Done', 'a file')) for number in (3, 7)]


def test_a_base_is_driven_by_its_velocity_and_has_sliders_in_another_mode(server):
    joint = ShownJoint('j', 'j', False, {
        field: (-1.0, 1.0) for field in ('position', 'velocity', 'effort')})
    page = Page(server, Ignored(), lambda *_: None)
    page.show_robots([Robot('/', '', tuple(
        ShownPart(name, (joint,)) for name in ('arm', 'base', 'zip')), (), (0.5, 0.5, 1.0))], [])

    def panels(field, now_s):
        page.show_diagnostics([ShownStatus(0, part, '', {'command_interface': mode}) for part, mode
                               in (('arm', 'velocity'), ('base', field), ('zip', 'velocity'))])
        page.update(now_s, Latest(), False)
        return [page._panels['/', part][1] for part in ('arm', 'base', 'zip')]
    arm, drive, other = panels('velocity', 1.0)
    assert isinstance(drive, DrivePanel) and isinstance(arm, JointPanel)
    assert panels('velocity', 2.0) == [arm, drive, other]
    same, base, _ = panels('position', 3.0)
    assert same is arm and isinstance(base, JointPanel) and base.field == 'position'
    assert panels('position', 4.0) == [arm, base, other]
    _, again, _ = panels('velocity', 5.0)
    assert isinstance(again, DrivePanel) and again is not drive
    assert drive.folder._impl.removed and base.folder._impl.removed
    # The node says later what modes it has.
    page._commands.switchable = {'arm', 'base'}
    with_modes, drive, same = panels('velocity', 6.0)
    assert list(with_modes.mode._choice.options) == ['position', 'velocity']
    assert list(drive.mode._choice.options) == ['position', 'velocity']
    assert arm.folder._impl.removed and again.folder._impl.removed and same is other
