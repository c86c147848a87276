# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What panels send when people use them, and when they follow the robot."""

import math
import time
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip('hypothesis', reason='needs hypothesis')

from hypothesis import given, strategies as st  # noqa: E402

from manip_sim.errors import ManipSimError  # noqa: E402
from manip_sim.viewer.page.interaction import (  # noqa: E402
    EndEffectorTarget, Events, PosePanel, Poses)
from manip_sim.viewer.page.latest import (  # noqa: E402
    JointStates, Latest, Robot, ShownJoint, ShownPart)
from manip_sim.viewer.page.page import (  # noqa: E402
    _marks, CameraPanel, DrivePanel, JointPanel, rounded_inward, SavePanel, SimulationPanel)
from manip_sim.viewer.page.timeline import PlotPanel  # noqa: E402

RANGES = {'position': (-1.0, 2.0), 'velocity': (-0.5, 0.5), 'effort': (-8.0, 8.0)}
ARM = ShownPart('arm', (ShownJoint('robot0_a', 'a', False, RANGES),
                        ShownJoint('robot0_b', 'b', False, RANGES)))
ROBOT = Robot('/left/', 'left', (ARM,), ('right',), (1.0, 0.5, 2.0))


class Handle:
    """An element of the page; what is done to it by :meth:`use` is done by a person."""

    def __init__(self, **properties):
        self.callbacks, self.removed = [], False
        self.__dict__.update(properties)

    def on_update(self, callback):
        self.callbacks.append(callback)

    on_click = on_update

    def use(self, **properties):
        self.__dict__.update(properties)
        phase = properties.get('phase', 'update')
        for callback in self.callbacks:
            callback(SimpleNamespace(client_id=1, target=self, phase=phase))

    def remove(self):
        self.removed = True

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None


class Gui:
    """Makes elements, and keeps them by their label."""

    def __init__(self):
        self.found = {}

    def _add(self, label='', **properties):
        self.found[label] = Handle(**properties)
        return self.found[label]

    def add_slider(self, label, min, max, step, initial_value, **_):
        return self._add(label, min=min, max=max, step=step, value=initial_value)

    def add_checkbox(self, label, value, **_):
        return self._add(label, value=value)

    def add_button_group(self, label, options, **_):
        return self._add(label, options=options, value=options[0])

    def add_dropdown(self, label, options, **_):
        return self._add(label, options=options, value=options[0])

    def add_text(self, label, value, **_):
        return self._add(label, value=value)

    def add_uplot(self, data, series, title, **properties):
        return self._add(title, data=data, labels=[one['label'] for one in series], **properties)

    def add_folder(self, label, **_):
        return self._add(label)

    def add_button(self, label, **_):
        return self._add(label)

    def add_image(self, image, **_):
        return self._add('image', image=image)

    def add_html(self, content):
        return self._add('text', content=content)

    def add_transform_controls(self, name, **_):
        return self._add(name, visible=False, position=np.zeros(3),
                         wxyz=np.array([1.0, 0.0, 0.0, 0.0]))


class Sent:
    """Keeps what is asked of it, as (method, arguments)."""

    def __init__(self):
        self.calls, self.offered = [], ()

    def __getattr__(self, method):
        return lambda *arguments: self.calls.append((method, *arguments))

    def modes(self, space, part):
        return self.offered

    def taken(self):
        calls, self.calls = self.calls, []
        return calls


@pytest.fixture
def rig():
    return SimpleNamespace(gui=Gui(), sent=Sent(), events=Events())


def joint_panel(rig, mode):
    return JointPanel(rig.gui, ROBOT, ARM, mode, rig.sent, rig.events)


@pytest.mark.parametrize(('group', 'button', 'call'), [
    ('Simulation', 'Pause', ('pause', True)), ('Simulation', 'Resume', ('pause', False)),
    ('Simulation', 'Step', ('step',)), ('Simulation', 'Reset', ('reset',)),
    ('Sensors', 'Tare wrench', ('tare',))])
def test_a_button_of_the_simulation_asks_for_what_it_says(rig, group, button, call):
    SimulationPanel(rig.gui, rig.sent, rig.events)
    rig.gui.found[group].use(value=button)
    assert rig.sent.taken() == []
    rig.events.run()
    assert rig.sent.taken() == [call]


def test_a_paused_simulation_can_be_resumed_and_one_of_no_known_state_is_left_alone(rig):
    panel = SimulationPanel(rig.gui, rig.sent, rig.events)
    for paused, first in ((None, 'Pause'), (True, 'Resume'), (None, 'Resume'), (False, 'Pause')):
        panel.show('waiting', 'waiting for <it>', paused)
        assert rig.gui.found['Simulation'].options == (first, 'Step', 'Reset')
    assert 'waiting for &lt;it&gt;' in rig.gui.found['text'].content


def test_a_slider_sends_its_joint_alone_and_once(rig):
    panel = joint_panel(rig, 'position')
    assert (rig.gui.found['a'].min, rig.gui.found['a'].max) == (-1.0, 2.0)
    assert 'left: arm [rad]' in rig.gui.found
    rig.gui.found['a'].use(value=0.4)
    rig.gui.found['a'].use(value=0.5)
    rig.events.run()
    panel.send(0.0)
    assert rig.sent.taken() == [('move_joints', '/left/', 'arm', 'position', {'robot0_a': 0.5})]
    panel.send(5.0)
    assert rig.sent.taken() == []


def test_sliders_follow_the_robot_but_not_under_a_hand(rig):
    panel = joint_panel(rig, 'position')
    a, b = rig.gui.found['a'], rig.gui.found['b']
    a.use(value=1.5)
    measured, still = {'robot0_a': 0.3, 'robot0_b': 0.6}, {'robot0_a': 0.0, 'robot0_b': 0.0}
    now_s = time.monotonic()
    panel.show(now_s, measured, still, paused=False)
    assert (a.value, b.value) == (1.5, pytest.approx(0.6, abs=a.step))
    panel.show(now_s + 5.0, measured, {'robot0_a': 1.0}, paused=False)
    assert a.value == 1.5  # It is on its way.
    panel.show(now_s + 10.0, measured, still, paused=False)
    assert a.value == pytest.approx(0.3, abs=a.step)
    # What is measured beyond the range does not break the slider.
    panel.show(now_s + 11.0, {'robot0_a': 9.0}, still, paused=False)
    assert a.value == pytest.approx(2.0, abs=a.step)


@pytest.mark.parametrize('mode', ['velocity', 'effort'])
def test_velocities_and_efforts_are_repeated_until_they_are_zero(rig, mode):
    panel = joint_panel(rig, mode)
    rig.gui.found['b'].use(value=0.2)
    rig.events.run()
    for tenth in range(4):
        panel.send(1.0 + tenth * 0.11)
    assert rig.sent.taken() == 4 * [
        ('move_joints', '/left/', 'arm', mode, {'robot0_b': 0.2})]
    rig.gui.found['Stop'].use()
    rig.events.run()
    panel.send(3.0)
    panel.send(3.2)
    assert rig.sent.taken() == [
        ('move_joints', '/left/', 'arm', mode, {'robot0_a': 0.0, 'robot0_b': 0.0})]
    panel.show(4.0, {'robot0_a': 1.0}, {}, paused=False)
    assert rig.gui.found['a'].value == 0.0  # It is no position.


def test_fingers_take_actions(rig):
    JointPanel(rig.gui, ROBOT, ShownPart('right/gripper', ()), 'position', rig.sent, rig.events)
    for value in ('Close', 'Open'):
        rig.gui.found['Fingers'].use(value=value)
        rig.events.run()
    assert rig.sent.taken() == [('act', '/left/', 'right/gripper', 1.0),
                                ('act', '/left/', 'right/gripper', -1.0)]


def test_a_base_is_driven_until_it_is_stopped(rig):
    panel = DrivePanel(rig.gui, ROBOT, rig.sent, rig.events)
    panel.send(0.0)
    assert rig.sent.taken() == []
    assert rig.gui.found['turn [rad/s]'].max == 2.0
    rig.gui.found['left [m/s]'].use(value=0.3)
    for tenth in range(3):
        panel.send(1.0 + tenth * 0.11)
    panel.send(1.23)
    assert rig.sent.taken() == 3 * [('drive', '/left/', (0.0, 0.3, 0.0))]
    rig.gui.found['Stop'].use()
    rig.events.run()
    panel.send(1.24)
    panel.send(2.0)
    assert rig.sent.taken() == [('drive', '/left/', (0.0, 0.0, 0.0))]


def test_a_target_is_sent_while_it_is_dragged_and_follows_the_end_effector_else(rig):
    target = EndEffectorTarget(rig.gui, '/left/', 'right', rig.sent)
    control = rig.gui.found['/targets/left/right']
    position, upright = np.array([0.5, 0.1, 1.0]), np.array([1.0, 0.0, 0.0, 0.0])
    target.follow(0.0, position, upright, paused=False)
    np.testing.assert_array_equal(control.position, np.zeros(3))  # It is not shown.
    target.show(True)
    target.follow(0.1, position, upright, paused=False)
    np.testing.assert_array_equal(control.position, position)
    control.use(position=np.array([0.6, 0.1, 1.0]), phase='update')
    target.send()
    target.send()
    (method, space, arm, position, quat), = rig.sent.taken()
    assert (method, space, arm) == ('reach', '/left/', 'right')
    np.testing.assert_array_equal(position, [0.6, 0.1, 1.0])
    np.testing.assert_array_equal(quat, upright)
    now_s = time.monotonic()
    target.follow(now_s + 3.0, position, upright, paused=False)
    assert control.position[0] == 0.6  # It is still held.
    control.use(phase='end')
    for later_s in (4.0, 4.1):
        target.follow(now_s + later_s, position, upright, paused=False)
    np.testing.assert_array_equal(control.position, position)
    # What nobody sees is not sent.
    for moved, followed in ((position + 5e-5, False), (position + 1e-3, True)):
        target.follow(now_s + 5.0, moved, upright, paused=False)
        np.testing.assert_array_equal(control.position, moved if followed else position)
    for angle, followed in ((1e-4, False), (0.1, True), (0.1 + 1e-3, True)):
        before = control.wxyz
        turned = np.array([math.cos(angle / 2.0), 0.0, 0.0, math.sin(angle / 2.0)])
        target.follow(now_s + 6.0, position, turned, paused=False)
        np.testing.assert_array_equal(control.wxyz, turned if followed else before)
    target.remove()
    assert control.removed


def test_images_are_asked_for_only_while_they_are_shown(rig):
    panel = CameraPanel(rig.gui, ['front'], rig.sent.watch, rig.events)
    box, images = rig.gui.found['Show'], {}
    box.use(value=True)
    rig.events.run()
    assert rig.sent.taken() == [('watch', 'front', True)]
    for count in range(10):
        images['front'] = np.full((2, 2, 3), count)
        panel.show(10.0 + 0.04 * count, images, wanted=True)
    # Ten a second at most.
    assert rig.gui.found['image'].image[0, 0, 0] == 9
    images['front'] = np.full((2, 2, 3), 99)
    panel.show(20.0, images, wanted=False)
    assert rig.gui.found['image'].image[0, 0, 0] == 9
    assert not images
    # Asked for again, it stays; what was never shown need not be removed.
    box.use(value=True)
    rig.events.run()
    assert rig.sent.taken() == [('watch', 'front', True)]
    assert not rig.gui.found['image'].removed
    box.use(value=False)
    rig.events.run()
    assert rig.sent.taken() == [('watch', 'front', False)]
    assert rig.gui.found['image'].removed


def latest(a=0.3, b=0.6):
    """Return states of the arm, with a joint that no slider has."""
    states = JointStates(['robot0_a', 'robot0_c', 'robot0_b'], np.array([a, 9.0, b]), np.zeros(3),
                         np.zeros(3), 0.0)
    return Latest(joints={'/left/': states})


def pose_panel(rig, poses, **fields):
    panel = PosePanel(rig.gui, poses, [ROBOT], rig.sent, rig.events, rig.sent.tell)
    panel.update(latest(), {f'left/{part}': field for part, field in fields.items()})
    return panel


def press(rig, label, value=None):
    rig.gui.found[label].use(value=value)
    rig.events.run()
    return rig.sent.taken()


def test_a_saved_pose_is_gone_to_within_the_ranges_of_the_joints(rig):
    panel = pose_panel(rig, Poses())
    panel.update(latest(a=-1.001), {})
    rig.gui.found['Name'].value = ' ready '
    assert press(rig, 'Save pose') == []
    assert rig.gui.found['Pose'].options == ('ready',)
    panel.update(latest(0.0, 0.0), {})
    assert press(rig, 'Saved', 'Go to pose') == [
        ('move_joints', '/left/', 'arm', 'position', {'robot0_a': -1.0, 'robot0_b': 0.6})]
    assert press(rig, 'Saved', 'Delete') == []
    assert rig.gui.found['Pose'].options == ('(none saved)',)
    rig.gui.found['Pose'].value = '(none saved)'
    assert press(rig, 'Saved', 'Go to pose') == []


def test_poses_are_kept_in_a_file_and_a_name_is_replaced(tmp_path):
    poses = Poses(tmp_path / 'poses.json')
    poses.save('b', {'x': 1.0})
    poses.save('a', {'x': 2.0, 'y': 3.0})
    poses.save('b', {'x': 4.0})
    assert Poses(tmp_path / 'poses.json').names == ['a', 'b']
    assert Poses(tmp_path / 'poses.json').get('b') == {'x': 4.0}
    poses.delete('b')
    assert Poses(tmp_path / 'poses.json').names == ['a']


@pytest.mark.parametrize(('text', 'reason'), [
    ('{', 'is not JSON'), ('[]', 'holds no poses'), ('{"a": {"x": NaN}}', 'holds no poses'),
    ('{"a": {"x": true}}', 'holds no poses'), ('{"<b>": {}}', 'holds no poses'),
    ('{"a": 1}', 'holds no poses'), ('[' * 100_000, 'is not JSON')])
def test_a_file_without_poses_is_rejected(tmp_path, text, reason):
    file = tmp_path / 'poses.json'
    file.write_text(text)
    with pytest.raises(ManipSimError, match=reason):
        Poses(file)
    with pytest.raises(ManipSimError, match='no such folder'):
        Poses(tmp_path / 'nowhere' / 'poses.json')
    with pytest.raises(ManipSimError, match='^cannot read .*: Is a directory$'):
        Poses(tmp_path)


def test_what_cannot_be_saved_changes_nothing_and_is_explained(rig, tmp_path):
    folder = tmp_path / 'folder'
    folder.mkdir()
    poses = Poses(folder / 'poses.json')
    poses.save('a', {'x': 1.0})
    for name in ('', ' ', '../a', 'a' * 41, '<b>', 'a\nb'):
        with pytest.raises(ManipSimError, match='cannot name a pose'):
            poses.save(name, {})
    (folder / 'poses.json').unlink()
    folder.rmdir()
    pose_panel(rig, poses)
    rig.gui.found['Name'].value = 'ready'
    for label, value in (('Save pose', None), ('Saved', 'Delete')):
        ((_, text),) = press(rig, label, value)
        assert text.startswith('cannot write ')
    assert poses.names == ['a']
    poses = Poses()
    for number in range(100):
        poses.save(f'p{number}', {})
    with pytest.raises(ManipSimError, match='there are 100 poses already'):
        poses.save('more', {})


def test_a_pose_needs_position_commands_and_joints_of_the_robot(rig):
    poses = Poses()
    poses.save('ready', {'robot0_a': 0.1})
    pose_panel(rig, poses, arm='effort')
    assert press(rig, 'Saved', 'Go to pose') == [
        ('tell', 'left: arm takes effort commands: a pose needs position commands')]
    assert press(rig, 'Save pose') == [('tell', 'no pose saved: no part takes position commands')]
    poses.save('ready', {'another': 0.1})
    pose_panel(rig, poses)
    assert press(rig, 'Saved', 'Go to pose') == [
        ('tell', 'this pose has no joint of these robots')]


@pytest.mark.parametrize(('count', 'told'), [(2, True), (8, True), (9, False)])
def test_a_plot_names_its_lines_while_each_has_a_colour_of_its_own(rig, count, told):
    joints = tuple(ShownJoint(f'j{i}', f'j{i}', False, RANGES) for i in range(count))
    robot = Robot('/', '', (ShownPart('arm', joints),), (), None)
    states = JointStates([joint.name for joint in joints], *(np.zeros(count),) * 3, 0.0)
    PlotPanel(rig.gui, Handle(), [robot]).show(0.0, Latest({'/': states}))
    assert rig.gui.found['position [rad]'].legend['show'] == told


def test_plots_leave_room_for_the_numbers_beside_them_alone(rig):
    panel = PlotPanel(rig.gui, Handle(), [ROBOT])
    panel.show(0.0, latest())
    plot = rig.gui.found['position [rad]']
    assert sum(plot.padding[1::2]) + plot.axes[1]['size'] <= 64
    assert plot.axes[0]['label'] == 'time [s]'
    assert plot.scales['x']['range'] == (-10.0, 0.0)
    # What hardly moves is a flat line in the middle, not noise that fills the plot.
    low, high = (plot.scales['y']['range'][end]['soft'] for end in ('min', 'max'))
    assert 0.01 <= high <= 0.1 and low == -high
    later = latest()
    later.joints['/left/'] = JointStates(
        ['robot0_a', 'robot0_b'], np.array([0.5, 0.7]), np.zeros(2), np.zeros(2), 1.0)
    panel.show(1.0, later)
    np.testing.assert_allclose(plot.data, [[-1.0, 0.0], [0.3, 0.5], [0.6, 0.7]])


@pytest.mark.parametrize(('limits', 'expected'), [
    ((-1.0, 2.0), (-1.0, 2.0)), ((-2.89725, 2.89725), (-2.8972, 2.8972)),
    ((0.00001, 0.0399999), (0.0001, 0.0399)), ((0.00012, 0.00018), (0.00012, 0.00018)),
    ((0.0, 0.0), (0.0, 0.0)), ((-0.00005, 0.00012), (0.0, 0.0001)),
    ((0.00005, 0.00012), (0.00005, 0.00012))])
def test_what_a_slider_sends_is_within_the_limits_of_its_joint(limits, expected):
    assert rounded_inward(*limits) == pytest.approx(expected, abs=1e-12)
    low, high = rounded_inward(*limits)
    assert limits[0] <= low <= high <= limits[1]


@pytest.mark.parametrize('measured', [-9.0, -0.99, -0.503, 0.5, 1.2345, 1.9999, 2.0, 9.0])
def test_a_slider_shows_four_digits_of_what_is_measured_within_its_range(rig, measured):
    panel, slider = joint_panel(rig, 'position'), rig.gui.found['a']
    panel.show(0.0, {'robot0_a': measured}, {}, paused=False)
    assert slider.value == min(max(round(measured, 4), -1.0), 2.0)
    assert slider.precision == 4  # Of its step by itself, which may have fewer digits.
    assert len(str(slider.value)) <= len('-0.1234')  # The browser shows it whole.


def test_the_ends_of_a_slider_are_told_in_few_digits(rig):
    assert _marks(-3.0718, -0.0698) == ((-3.0718, '-3.07'), (-0.0698, '-0.07'))
    assert _marks(0.0, 0.04) == ((0.0, '0'), (0.04, '0.04'))
    assert _marks(-0.0025, 10.0) == ((-0.0025, '0'), (10.0, '10'))


def test_a_record_and_a_picture_are_asked_for_by_buttons(rig):
    pictures = []
    panel = SavePanel(rig.gui, rig.sent, pictures.append, rig.events)
    assert rig.gui.found['Save'].options == ('Picture', 'Record')
    assert press(rig, 'Save', 'Picture') == [] and pictures == [1]
    assert press(rig, 'Save', 'Record') == [('record', True)]
    panel.show(True)
    assert rig.gui.found['Save'].options == ('Picture', 'Stop recording')
    assert press(rig, 'Save', 'Stop recording') == [('record', False)]
    panel.show(False)
    assert rig.gui.found['Save'].options == ('Picture', 'Record')
    SavePanel(rig.gui, None, pictures.append, rig.events).show(True)
    assert rig.gui.found['Save'].options == ('Picture',)


@pytest.mark.parametrize('panel', ['joints', 'drive'])
def test_the_control_mode_is_chosen_from_those_of_the_node_and_shown_as_it_is(rig, panel):
    rig.sent.offered = ('position', 'velocity')
    part = 'arm' if panel == 'joints' else 'base'
    mode = (joint_panel(rig, 'position') if panel == 'joints' else DrivePanel(
        rig.gui, ROBOT, rig.sent, rig.events)).mode
    choice = rig.gui.found['Mode']
    assert choice.options == ('position', 'velocity')
    mode.show(0.0, 'velocity')
    assert choice.value == 'velocity' and rig.sent.taken() == []
    assert press(rig, 'Mode', 'position') == [('switch_mode', '/left/', part, 'position')]
    mode.show(time.monotonic(), 'velocity')
    assert choice.value == 'position'  # Just chosen.
    mode.show(time.monotonic() + 5.0, 'velocity and effort')  # It was rejected.
    assert choice.value == 'velocity and effort' and choice.value in choice.options


def test_a_part_without_a_choice_of_modes_has_no_list(rig):
    for rig.sent.offered in ((), ('position',)):
        joint_panel(rig, 'position').mode.show(0.0, 'position')
    assert 'Mode' not in rig.gui.found


@given(st.floats(-1e3, 1e3), st.floats(0.0, 1e3))
def test_any_range_gives_a_slider(low, width):
    ranges = {**RANGES, 'position': (low, low + width)}
    rig = SimpleNamespace(gui=Gui(), sent=Sent(), events=Events())
    part = ShownPart('arm', (ShownJoint('robot0_a', 'a', False, ranges),))
    panel = JointPanel(rig.gui, ROBOT, part, 'position', rig.sent, rig.events)
    slider = rig.gui.found['a']
    assert low <= slider.min <= slider.value <= slider.max <= low + width
    assert slider.step > 0.0
    panel.show(0.0, {'robot0_a': low + 0.7 * width}, {}, paused=False)
    assert slider.min <= slider.value <= slider.max


def test_plots_show_what_was_measured_of_the_part_or_end_effector_that_is_chosen(rig):
    panel, found = PlotPanel(rig.gui, Handle(), [ROBOT]), rig.gui.found
    for second in range(4):
        # In another order than that of the part.
        states = JointStates(['robot0_b', 'robot0_a'], *(
            np.array([10.0 * kind + second, -second]) for kind in range(3)), float(second))
        panel.show(float(second), Latest(
            {'/left/': states}, wrenches={('/left/', 'right'): np.arange(6.0) + second}))
        if second == 1:
            times, a, b = found['velocity [rad/s]'].data
            assert found['velocity [rad/s]'].labels == ['s', 'a', 'b']
            np.testing.assert_array_equal([times, a, b], [[-1.0, 0.0], [0.0, -1.0], [10.0, 11.0]])
            found['Show'].value = found['Show'].options[1]
    assert found['velocity [rad/s]'].removed
    np.testing.assert_array_equal(found['external torque [N m]'].data, [
        [-1.0, 0.0], [5.0, 6.0], [6.0, 7.0], [7.0, 8.0]])
