# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim export``: files that MuJoCo loads and that make the same model."""

import os
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest

from manip_sim.cli.output import write_whole
from manip_sim.models import compose, urdf_of
from manip_sim.models.archive import roundings

SOURCE = Path(__file__).resolve().parents[2]


def loaded(file):
    if file.suffix == '.xml':
        return mujoco.MjModel.from_xml_path(str(file))
    with file.open('rb') as archive:
        return mujoco.MjSpec.from_zip(archive).compile()


@pytest.mark.full
def test_of_several_robots_one_is_named(here, rejected, tmp_path):
    world = SOURCE / 'config' / 'hand_over.yaml'
    assert rejected('export', tmp_path / 'out.urdf', '--params-file', world) == (
        'a URDF describes one robot: name one of left, middle, right')
    assert rejected('export', tmp_path / 'out.urdf', '--params-file', world, '--name', 'lift'
                    ).startswith("unknown robot 'lift': did you mean 'left'")
    code, _, errors = here('export', tmp_path / 'out.urdf', '--params-file', world, '--name',
                           'left', '--ros2-control')
    assert (code, errors) == (0, '')
    urdf = ElementTree.parse(tmp_path / 'out.urdf')
    joints = {joint.get('name') for joint in urdf.findall('joint')}
    assert 'left_joint1' in joints and not any(name.startswith('middle') for name in joints)
    assert '/left/robot_joint_states' in (tmp_path / 'out.urdf').read_text()


@pytest.mark.parametrize('name', ['out.xml', 'out.mjz', 'out.ZIP'])
def test_a_file_makes_the_same_model(name, here, tmp_path):
    code, text, errors = here('export', tmp_path / name, '--robot', 'UR5e', '--arena', 'table',
                              '--prefix', 'left_', '--position', '1', '0', '0')
    assert (code, errors) == (0, '')
    first, said = text.splitlines()
    assert str(tmp_path / name) in first and first.endswith(' kB)')
    assert said.startswith('the text of MJCF ')
    expected = compose('UR5e', arena='table', prefix='left_', position=[1, 0, 0]).compile()
    model = loaded(tmp_path / name)
    assert model.nbody == expected.nbody and model.nu == expected.nu
    assert np.allclose(model.body_pos, expected.body_pos, atol=1e-9)
    assert np.allclose(model.body_mass, expected.body_mass, atol=1e-9)
    assert model.opt.timestep == expected.opt.timestep
    assert model.joint('left_shoulder_pan_joint').id >= 0
    assert [file.name for file in tmp_path.iterdir()] == [name]


def test_a_binary_is_the_model_to_the_last_bit_and_the_text_is_said_not_to_be(here, tmp_path):
    options = ('--robot', 'Panda', '--arena', 'table')
    code, text, errors = here('export', tmp_path / 'out.mjb', *options)
    assert (code, errors) == (0, '') and 'only MuJoCo ' + mujoco.mj_versionString() in text
    expected = compose('Panda', arena='table').compile()
    model = mujoco.MjModel.from_binary_path(str(tmp_path / 'out.mjb'))
    assert roundings(expected, model) == {}
    data, other = mujoco.MjData(expected), mujoco.MjData(model)
    mujoco.mj_step(expected, data, 100)
    mujoco.mj_step(model, other, 100)
    assert data.qpos.tobytes() == other.qpos.tobytes()
    _, text, _ = here('export', tmp_path / 'out.xml', *options)
    rounded = roundings(expected, loaded(tmp_path / 'out.xml'))
    assert rounded and f'changes {len(rounded)} fields' in text and next(iter(rounded)) in text
    model.body_mass[2] += 0.5
    assert roundings(expected, model) == {'body_mass': pytest.approx(0.5)}


def test_a_urdf_is_that_of_the_robot_and_what_it_cannot_say_is_told(here, tmp_path):
    code, text, errors = here('export', tmp_path / 'out.urdf', '--robot', 'Jaco', '--arena',
                              'table', '--prefix', 'left_')
    assert (code, errors) == (0, '')
    assert text.splitlines()[0].endswith(' kB)')
    assert "'left_gripper_joint_thumb_distal' follows" in text
    assert (tmp_path / 'out.urdf').read_text() == urdf_of(compose(
        'Jaco', arena='table', prefix='left_')).xml


def test_a_urdf_for_ros2_control_has_the_default_control_modes(here, tmp_path):
    here('export', tmp_path / 'out.urdf', '--robot', 'PandaOmron', '--ros2-control')
    tag = ElementTree.parse(tmp_path / 'out.urdf').find('ros2_control')
    commands = {joint.get('name'): [c.get('name') for c in joint.findall('command_interface')]
                for joint in tag.findall('joint')}
    assert commands['robot0_joint1'] == commands['mobilebase0_joint_torso_height'] == ['position']
    assert commands['mobilebase0_joint_mobile_side'] == ['velocity']
    assert commands['gripper0_right_finger_joint1'] == ['position']
    assert commands['gripper0_right_finger_joint2'] == []
    topics = {p.get('name'): p.text for p in tag.findall('hardware/param')}
    # Those of the shipped configuration.
    config = (SOURCE / 'config' / 'topic_based_ros2_control.yaml').read_text()
    for name, topic in topics.items():
        assert f'<param name="{name}">{topic}</param>' in config


@pytest.mark.parametrize(('arguments', 'what'), [
    (['out.xml', '--ros2-control'], '--ros2-control without DIR is for a .urdf'),
    (['--moveit', 'config', '--ros2-control'], '--ros2-control without DIR is for a .urdf'),
    (['out.mjz', '--name', 'left'], '--name is for a .urdf'),
    (['out.xml', '--moveit', 'config'], 'give either a FILE, or --moveit DIR'),
    ([], 'give either a FILE, or --moveit DIR, --ros2-control DIR, or both')])
def test_options_that_do_not_go_together_are_told(arguments, what, rejected):
    assert what in rejected('export', *arguments, code=2)


@pytest.mark.full
def test_a_package_for_moveit_is_that_of_the_composition(here, tmp_path):
    code, text, errors = here('export', '--moveit', tmp_path / 'ur5e_moveit_config', '--robot',
                              'UR5e', '--gripper', 'none', '--prefix', 'left_')
    assert (code, errors, text) == (0, '', f'{tmp_path}/ur5e_moveit_config\n')
    srdf = ElementTree.parse(tmp_path / 'ur5e_moveit_config' / 'config' / 'UR5e.srdf')
    assert srdf.find('group/chain').get('tip_link') == 'left_right_hand'


def test_a_package_with_a_wrong_name_is_told(rejected, tmp_path):
    assert 'cannot be the name of a ROS package' in rejected('export', '--moveit',
                                                             tmp_path / 'My-Robot')


def arm(file):
    """Write an arm of six joints, whose name in packages is that of its file."""
    link = ('<link name="l{0}"><inertial><mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.1" '
            'ixy="0" ixz="0" iyz="0"/></inertial></link>')
    joint = ('<joint name="j{0}" type="revolute"><parent link="l{0}"/><child link="l{1}"/>'
             '<origin xyz="0 0 0.25"/><axis xyz="0 {2} {3}"/>'
             '<limit lower="-2" upper="2" effort="50" velocity="2"/></joint>')
    links = ''.join(link.format(i) for i in range(7))
    joints = ''.join(joint.format(i, i + 1, i % 2, 1 - i % 2) for i in range(6))
    file.write_text(f'<robot name="arm">{links}{joints}</robot>')
    return file


@pytest.mark.parametrize('name', [
    "x'), __import__('os').system('id'", 'x"""; import os', 'a\nb', 'a<b>&c', '$(id)', '-x'])
@pytest.mark.parametrize('option', ['--moveit', '--ros2-control'])
def test_the_name_of_a_file_never_becomes_code_of_a_launch_file(
        name, option, rejected, tmp_path):
    file = arm(tmp_path / f'{name}.urdf')
    error = rejected('export', option, tmp_path / 'pkg', '--robot', file)
    assert 'cannot name a robot in a ROS package' in error and '\n' not in error
    assert [*tmp_path.iterdir()] == [file]


@pytest.mark.full
def test_a_package_takes_a_name_with_spaces_and_dots(here, tmp_path):
    file = arm(tmp_path / 'my arm-v1.2+b.urdf')
    for option in ('--moveit', '--ros2-control'):
        folder = tmp_path / f'pkg{option.replace("-", "_").replace("__", "_")}'
        code, _, errors = here('export', option, folder, '--robot', file)
        assert (code, errors) == (0, '')
        for launch in folder.rglob('*.launch.py'):
            compile(launch.read_text(), str(launch), 'exec')
        assert ElementTree.parse(folder / 'package.xml').find('name').text == folder.name


def test_a_file_can_be_read_by_whom_the_mask_lets(here, tmp_path):
    before = os.umask(0o027)
    try:
        here('export', tmp_path / 'out.xml')
    finally:
        os.umask(before)
    assert (tmp_path / 'out.xml').stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize(('name', 'what'), [
    ('out.sdf', 'out.sdf: the name must end with .xml, .mjz, .zip, .mjb or .urdf'),
    ('out', 'the name must end with'), ('lost/out.xml', 'no such folder: '),
    ('folder.xml', 'is a folder, give the name of a file')])
def test_what_cannot_be_written_is_told_and_leaves_nothing(name, what, rejected, tmp_path):
    (tmp_path / 'folder.xml').mkdir()
    assert what in rejected('export', tmp_path / name)
    assert [file.name for file in tmp_path.iterdir()] == ['folder.xml']


@pytest.mark.skipif(os.geteuid() == 0, reason='the superuser may write everywhere')
def test_a_folder_that_cannot_be_written_to_is_told(rejected, tmp_path):
    tmp_path.chmod(0o500)
    assert 'Permission denied' in rejected('export', tmp_path / 'out.xml')


def test_a_wrong_name_leaves_an_older_file_as_it_is(rejected, tmp_path):
    (tmp_path / 'out.xml').write_text('old')
    assert "unknown value 'Pnda'" in rejected('export', tmp_path / 'out.xml', '--robot', 'Pnda')
    assert (tmp_path / 'out.xml').read_text() == 'old'


def test_a_file_that_is_not_finished_does_not_replace_an_older_one(tmp_path):
    file = tmp_path / 'out.xml'
    file.write_text('old')

    def fail(path):
        path.write_text('half')
        raise OSError(28, 'No space left on device')

    with pytest.raises(OSError, match='No space left') as caught:
        write_whole(file, fail)
    assert caught.value.filename == str(file)
    assert file.read_text() == 'old' and list(tmp_path.iterdir()) == [file]
