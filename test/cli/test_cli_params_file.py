# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Worlds of several robots and objects, from the node's own files of parameters."""

from xml.etree import ElementTree

import mujoco
import numpy as np
from PIL import Image
import pytest

from manip_sim.models import arena_names, compose, compose_robot, World
from manip_sim.resources import share_directory

HAND_OVER = share_directory() / 'config' / 'hand_over.yaml'
TWO = """
robots: [left, right]
left: {robot: Baxter, gripper: '{right: PandaGripper, left: none}', position: [1, 2, 0]}
right: {robot: PandaOmron, orientation: [0.0, 0.0, 0.5], control_mode: {torso: velocity}}
objects: ['{name: can, shape: cylinder, size: [0.03, 0.12], mass: 0.3}']
"""


def names(rows):
    return [row['name'] for row in rows]


def test_each_robot_is_described_under_its_name(described, parameters_file):
    found = described('--params-file', parameters_file(TWO))
    assert names(found['parts']) == [
        'left/arm', 'left/right', 'left/left', 'left/right/gripper', 'right/arm', 'right/right',
        'right/base', 'right/torso', 'right/right/gripper']
    assert [(m['robot'], m['kind'], m['class'], m['arm']) for m in found['models']] == [
        ('left', 'robot', 'Baxter', None), ('left', 'base', 'RethinkMinimalMount', None),
        ('left', 'gripper', 'PandaGripper', 'right'), ('right', 'robot', 'PandaOmron', None),
        ('right', 'base', 'OmronMobileBase', None), ('right', 'gripper', 'PandaGripper', 'right')]
    joint = next(row for row in found['joints'] if row['name'] == 'right_joint1')
    assert joint['part'] == 'right/arm'
    torso = next(row for row in found['parts'] if row['name'] == 'right/torso')
    assert torso['control_mode'] == 'velocity'
    assert found['objects'] == [{'name': 'can', 'mass_kg': pytest.approx(0.3)}]
    assert found['mass_kg'] == pytest.approx(sum(m['mass_kg'] for m in found['models']))


def test_topics_and_parameters_are_those_of_robots_and_world(described, parameters_file):
    found = described('--params-file', parameters_file(TWO))
    topics = names(found['topics'])
    assert {'left/right/wrench', 'right/base/cmd_vel', 'objects/can/pose'} <= set(topics)
    assert topics.count('/clock') == topics.count('~/mjcf') == 1
    assert not {'joint_states', 'left/base/cmd_vel', 'left/left/wrench'} & set(topics)
    values = {row['name']: row['value'] for row in found['parameters']}
    assert values['left.position'] == [1.0, 2.0, 0.0]
    assert values['right.orientation'] == [0.0, 0.0, 0.5]
    assert values['right.control_mode.base'] == 'velocity' and 'robot' not in values


def test_tables_tell_the_robots_too(here, parameters_file):
    text = here('describe', '--params-file', parameters_file(TWO))[1]
    assert text.startswith('Baxterleft and PandaOmronright in arena empty, ')
    assert '\n  left: gripper (right)' in text and '\n  right/torso' in text


def test_a_place_that_is_given_is_told(described):
    found = described('--arena', 'table', '--position', '1', '-2', '0.5',
                      '--orientation', '0', '0', '1')
    values = {row['name']: row['value'] for row in found['parameters']}
    assert (values['position'], values['orientation']) == ([1.0, -2.0, 0.5], [0.0, 0.0, 1.0])
    default = {row['name']: row['default'] for row in found['parameters']}
    assert default['position'] == pytest.approx([-0.56, 0.0, 0.0])


def test_an_export_is_the_world_that_the_file_asks_for(here, tmp_path, parameters_file):
    file = parameters_file(TWO, node='manip_sim')
    assert here('export', tmp_path / 'out.mjz', '--params-file', file)[0] == 0
    with (tmp_path / 'out.mjz').open('rb') as archive:
        model = mujoco.MjSpec.from_zip(archive).compile()
    left = compose_robot('Baxter', {'right': 'PandaGripper', 'left': 'none'}, prefix='left_')
    right = compose_robot('PandaOmron', prefix='right_')
    left.set_base_xpos([1.0, 2.0, 0.0])
    expected = World([left, right]).compile()
    assert model.nbody == expected.nbody + 1 and model.nu == expected.nu
    assert np.allclose(model.body('left_base').pos[:2], [1.0, 2.0])
    assert model.body('can').mass[0] == pytest.approx(0.3)


@pytest.mark.full
@pytest.mark.parametrize('arena', arena_names())
def test_options_a_file_and_python_make_the_same_world_of_the_same_words(
        arena, here, tmp_path, parameters_file):
    file = parameters_file(f'robot: UR5e\narena: {arena}')
    worlds = [compose('UR5e', arena=arena).to_xml()]
    for words in (('--params-file', file), ('--robot', 'UR5e', '--arena', arena)):
        assert here('export', tmp_path / 'out.xml', *words)[0] == 0
        worlds.append((tmp_path / 'out.xml').read_text())
        (tmp_path / 'out.xml').unlink()
    assert worlds[0] == worlds[1] == worlds[2]


@pytest.mark.parametrize('file', sorted(HAND_OVER.parent.glob('*.yaml')), ids=lambda f: f.name)
def test_nothing_is_wrong_with_the_start_of_a_shipped_file(file, here):
    code, text, errors = here('check', '--params-file', file)
    assert (code, errors) == (0, '')
    assert text.endswith(': nothing is wrong with the start\n')


@pytest.mark.full
def test_several_robots_are_rendered(command, tmp_path, renderer):
    done = command('render', tmp_path / 'out.png', '--params-file', HAND_OVER)
    assert (done.returncode, done.stderr) == (0, '')
    with Image.open(tmp_path / 'out.png') as picture:
        red, green, blue = np.moveaxis(np.asarray(picture.convert('RGB'), dtype=float), 2, 0)
    # The cube is red, as nothing else.
    assert np.count_nonzero((red > 80.0) & (np.maximum(green, blue) < 0.3 * red)) > 20


def test_objects_and_grippers_by_arm_are_given_by_options(described, mjcf):
    ball = mjcf('<body name="ball"><geom size="0.03" mass="0.2"/></body>', name='ball')
    found = described('--robot', 'Baxter', '--gripper', '{left: PandaGripper}', '--object', ball,
                      '--object', '{name: box, shape: box, size: [0.1, 0.1, 0.1], mass: 2}')
    assert [(m['class'], m['arm']) for m in found['models'] if m['kind'] == 'gripper'] == [
        ('RethinkGripper', 'right'), ('PandaGripper', 'left')]
    assert {row['name']: round(row['mass_kg'], 6) for row in found['objects']} == {
        'ball': 0.2, 'box': 2.0}
    assert 'objects/ball/pose' in names(found['topics'])


@pytest.mark.parametrize(('text', 'what'), [
    ('robots: [left]\nleft: {robt: UR5e}', "unknown parameter 'left.robt': did you mean"),
    ('robt: UR5e', "unknown parameter 'robt': did you mean 'robot'"),
    ('robots: [left]\nrobot: UR5e', "unknown parameter 'robot'"),
    ('control_mode: {legs: velocity}', "'control_mode.legs': this robot has no legs"),
    ('control_mode: {arm: torque}', "'control_mode.arm': unknown value 'torque'"),
    ('timestep: fast', "parameter 'timestep' must be of type double, got 'fast'"),
    ('position: [1, 2]', "parameter 'position' must be 3 finite numbers, got [1.0, 2.0]"),
    ('robots: [a, a]', "parameter 'robots': the names must differ"),
    ('publish_rate: 300.0', "parameter 'publish_rate': a period of 300 Hz is not a whole number"),
    ("gripper: '{right: PandaGriper}'", "'gripper': unknown value 'PandaGriper': did you mean"),
    ("gripper: '{left: PandaGripper}'", "unknown arm of Panda0 'left'"),
    ("gripper: '{right: 1}'", "parameter 'gripper': the gripper of arm 'right' must be a name"),
    ('objects: ["{name: x}"]', "'x'")])
def test_a_file_that_no_node_starts_with_is_one_line(text, what, rejected, parameters_file):
    assert what in rejected('check', '--params-file', parameters_file(text))


def test_a_file_and_options_do_not_mix(rejected):
    line = rejected('describe', '--params-file', HAND_OVER, '--arena-param', 'cube=true', code=2)
    assert '--params-file cannot be combined with --arena-param' in line


def test_a_number_in_names_is_whole(rejected):
    assert "must be a whole number, got 'left'" in rejected('check', '--idn', 'left', code=2)


def test_the_tag_of_ros2_control_has_the_modes_of_the_file(here, parameters_file, tmp_path):
    file = parameters_file('robot: PandaOmron\ncontrol_mode: {arm: velocity}')
    assert here('export', tmp_path / 'out.urdf', '--ros2-control', '--params-file', file)[0] == 0
    joints = ElementTree.parse(tmp_path / 'out.urdf').findall('ros2_control/joint')
    commands = {joint.get('name'): [c.get('name') for c in joint.findall('command_interface')]
                for joint in joints}
    assert commands['robot0_joint1'] == commands['robot0_joint7'] == ['velocity']
    assert commands['gripper0_right_finger_joint1'] == ['position']


@pytest.mark.parametrize(('text', 'right', 'left'), [
    ('control_mode: {arm: effort}', 'effort', 'effort'),
    ('control_mode: {left: velocity, arm: effort}', 'effort', 'velocity'),
    ('control_mode: {left: position, arm: effort}', 'effort', 'position')])
def test_a_mode_for_both_arms_is_that_of_each_unless_it_has_its_own(
        text, right, left, here, described, parameters_file, tmp_path):
    file = parameters_file(f'robot: Baxter\n{text}')
    found = described('--params-file', file)
    modes = {row['name']: row['control_mode'] for row in found['parts']}
    assert (modes['right'], modes['left']) == (right, left)
    timeouts = {row['name']: row['value'] for row in found['parameters']}
    assert timeouts['command_timeout.right'] == 0.2
    assert here('export', tmp_path / 'out.urdf', '--ros2-control', '--params-file', file)[0] == 0
    joints = ElementTree.parse(tmp_path / 'out.urdf').findall('ros2_control/joint')
    commands = {joint.get('name'): [c.get('name') for c in joint.findall('command_interface')]
                for joint in joints}
    assert commands['robot0_right_s0'] == [right] and commands['robot0_left_s0'] == [left]


def test_a_single_arm_has_the_mode_of_its_other_name(described, parameters_file):
    found = described('--params-file', parameters_file('control_mode: {right: velocity}'))
    assert [row['control_mode'] for row in found['parts']] == ['velocity', 'velocity', 'position']


def test_a_lidar_with_several_rings_has_a_cloud_and_one_with_one_a_scan(
        described, parameters_file):
    for rings, topic, kind in ((1, 'scan', 'LaserScan'), (2, 'points', 'PointCloud2')):
        found = described('--params-file', parameters_file(
            f"lidars: ['{{name: front, position: [0, 0, 1], rings: {rings}}}']"))
        assert {row['name'].split('/')[-1]: row['type'].split('/')[-1]
                for row in found['topics'] if row['name'].startswith('front/')} == {topic: kind}
