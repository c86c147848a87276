# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of robots from URDF: servos from its limits, links without inertia, mimics, meshes."""

from pathlib import Path
import struct
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest

from files_rig import write

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models import compose, load_base, load_gripper, load_robot, urdf_of
from manip_sim.models.asset_files import LostShape
from manip_sim.simulation import Simulation

INERTIA = '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>'
SOLID = f'<inertial><origin xyz="0 0 0.1"/><mass value="1"/>{INERTIA}</inertial>'


def joint(name, parent, child, kind='revolute', more='', z=0.2):
    return (f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="0 0 {z}"/><axis xyz="0 1 0"/>{more}</joint>')


URDF = f"""<?xml version="1.0"?>
<robot name="arm">
  <link name="base_link">{SOLID}</link>
  <link name="upper">{SOLID}<collision><geometry><box size="0.02 0.02 0.1"/></geometry></collision>
  </link>
  <link name="lower">{SOLID}</link>
  <link name="tool0"/>
  {joint('shoulder', 'base_link', 'upper', more='<limit lower="-1" upper="2" effort="40" '
         'velocity="1.5"/><dynamics damping="0.3" friction="0.1"/>')}
  {joint('elbow', 'upper', 'lower', 'continuous', '<limit effort="0" velocity="0"/>')}
  {joint('flange', 'lower', 'tool0', 'fixed')}
</robot>
"""


def test_a_urdf_gets_servos_from_its_limits(tmp_path):
    robot = load_robot(write(tmp_path / 'arm.urdf', URDF))
    assert robot.arm_joints == robot.arm_actuators == ['robot0_shoulder', 'robot0_elbow']
    model = robot.compile()
    shoulder, elbow = model.actuator('robot0_shoulder'), model.actuator('robot0_elbow')
    np.testing.assert_allclose(shoulder.ctrlrange, [-1.0, 2.0])
    np.testing.assert_allclose(shoulder.forcerange, [-40.0, 40.0])
    # Zero is no limit.
    assert not elbow.forcelimited[0] and not elbow.ctrllimited[0]
    assert not model.joint('robot0_elbow').limited[0]
    np.testing.assert_allclose(model.jnt_user[:, 0], [1.5, 0.0])
    assert model.joint('robot0_shoulder').damping[0] == pytest.approx(0.3)
    assert any('position servos on 2 joints' in sentence for sentence in robot.inferred)


def test_links_on_fixed_joints_stay_and_tool0_is_the_end(tmp_path):
    robot = load_robot(write(tmp_path / 'arm.urdf', URDF))
    assert robot.eef_name == {'right': 'robot0_tool0'}
    data = mujoco.MjData(robot.compile())
    mujoco.mj_forward(data.model, data)
    np.testing.assert_allclose(data.body('robot0_tool0').xpos, [0.0, 0.0, 0.6], atol=1e-9)


def test_a_root_link_that_is_the_world_may_be_there(tmp_path):
    text = URDF.replace('<link name="base_link">',
                        '<link name="world"/>' + joint('stand', 'world', 'base_link', 'fixed')
                        + '<link name="base_link">')
    robot = load_robot(write(tmp_path / 'arm.urdf', text))
    assert robot.root_body == 'robot0_base_link'
    np.testing.assert_allclose(robot.compile().body('robot0_base_link').pos, [0.0, 0.0, 0.2])


def test_the_servos_of_a_urdf_follow_a_sine(tmp_path):
    from manip_sim.simulation.simulation import Simulation
    simulation = Simulation(compose(write(tmp_path / 'arm.urdf', URDF)))
    names = list(simulation.robot.robot_model.arm_joints)
    errors = []
    for tick in range(300):
        goal = 0.3 * np.sin(2.0 * np.pi * 0.5 * tick * 0.01)
        robot = simulation.robot
        robot.apply(*robot.parse.joint_command(names, position=[goal, goal]), period_s=0.01)
        simulation.advance(5)
        if tick > 50:
            errors.append(simulation.robot.state().position[:2] - goal)
    assert np.abs(errors).max() < 0.02


def test_a_link_that_moves_without_inertia_and_shape_gets_a_little(tmp_path):
    text = URDF.replace('<link name="tool0"/>', '<link name="tool0"/><link name="spinner"/>')
    text = text.replace('</robot>', joint('spin', 'lower', 'spinner', 'continuous') + '</robot>')
    robot = load_robot(write(tmp_path / 'arm.urdf', text))
    assert robot.compile().body('robot0_spinner').mass[0] == pytest.approx(1e-3)
    assert '1 g for links without inertia and shape: spinner' in robot.inferred


def test_a_link_with_a_shape_and_no_inertia_weighs_what_the_shape_does_in_water(tmp_path):
    text = URDF.replace(f'<link name="upper">{SOLID}', '<link name="upper"><visual><geometry>'
                        '<box size="1 1 1"/></geometry></visual>')
    robot = load_robot(write(tmp_path / 'arm.urdf', text))
    assert robot.compile().body('robot0_upper').mass[0] == pytest.approx(0.04)


def test_an_inertia_that_no_body_can_have_is_balanced(tmp_path):
    text = URDF.replace('ixx="0.01"', 'ixx="0.5"', 1)
    inertia = load_robot(write(tmp_path / 'arm.urdf', text)).compile().body(
        'robot0_base_link').inertia
    assert 2.0 * inertia.max() <= inertia.sum() + 1e-9


def test_a_mimic_joint_is_tied_and_gets_no_servo(tmp_path):
    fingers = ''.join(
        f'<link name="{name}">{SOLID}</link>' + joint(
            f'{name}_joint', 'palm', name, 'prismatic',
            f'<limit lower="-0.1" upper="0.1" effort="10" velocity="0.2"/>{more}')
        for name, more in (('left_finger', ''),
                           ('right_finger', '<mimic joint="left_finger_joint" multiplier="-1" '
                                            'offset="0.01"/>')))
    hand = load_gripper(write(tmp_path / 'hand.urdf', f"""<robot name="hand">
<link name="palm">{SOLID}</link>{fingers}</robot>"""))
    assert hand.actuators == ['gripper0_left_finger_joint']
    model = hand.compile()
    np.testing.assert_allclose(model.eq_data[:, :5], [[0.01, -1.0, 0.0, 0.0, 0.0]])
    data = mujoco.MjData(model)
    data.ctrl[0] = 0.05
    mujoco.mj_step(model, data, 1000)
    np.testing.assert_allclose(data.joint('gripper0_right_finger_joint').qpos, [-0.04], atol=2e-3)


def mesh_file(file):
    """Write a tetrahedron of 0.1 m as STL."""
    corners = [(0, 0, 0), (0.1, 0, 0), (0, 0.1, 0), (0, 0, 0.1)]
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(b'\0' * 80 + struct.pack('<I', 4) + b''.join(
        struct.pack('<12fH', 0, 0, 0, *corners[a], *corners[b], *corners[c], 0)
        for a, b, c in faces))


def with_mesh(name):
    return URDF.replace('<box size="0.02 0.02 0.1"/>', f'<mesh filename="{name}"/>')


@pytest.mark.parametrize(('name', 'place'), [
    ('meshes/link.stl', 'meshes/link.stl'), ('package:///link.stl', 'link.stl'),
    ('package://acme/urdf/meshes/link.stl', 'meshes/link.stl')])
def test_meshes_are_found_beside_the_file_and_in_its_package(tmp_path, name, place):
    mesh_file(tmp_path / 'acme' / 'urdf' / place)
    robot = load_robot(write(tmp_path / 'acme' / 'urdf' / 'arm.urdf', with_mesh(name)))
    assert robot.compile().nmesh == 1


@pytest.mark.parametrize(('variable', 'place'), [
    ('AMENT_PREFIX_PATH', 'share/acme'), ('ROS_PACKAGE_PATH', 'acme')])
def test_meshes_are_found_in_other_packages(tmp_path, monkeypatch, variable, place):
    mesh_file(tmp_path / 'prefix' / place / 'link.stl')
    monkeypatch.setenv(variable, str(tmp_path / 'prefix'))
    file = write(tmp_path / 'elsewhere' / 'arm.urdf', with_mesh('package://acme/link.stl'))
    assert load_robot(file).compile().nmesh == 1


NO_MESHES = Path(__file__).resolve().parents[1] / 'data/files/no_meshes.urdf'


@pytest.fixture
def no_packages(monkeypatch):
    monkeypatch.delenv('AMENT_PREFIX_PATH', raising=False)
    monkeypatch.delenv('ROS_PACKAGE_PATH', raising=False)


def lost(robot):
    return [sentence for sentence in robot.inferred if isinstance(sentence, LostShape)]


@pytest.mark.usefixtures('no_packages')
@pytest.mark.parametrize(('name', 'why', 'remedy'), [
    ('package://acme/link.stl', "package 'acme' is neither in AMENT_PREFIX_PATH or ROS_PACKAGE_"
     'PATH nor a folder above the file', "source the workspace that has 'acme', or add its folder "
     'to ROS_PACKAGE_PATH'),
    ('gone.stl', 'no such file: {folder}/gone.stl', 'put it there, or correct its name'),
    ('pointer.stl', '{folder}/pointer.stl was not fetched from Git LFS',
     "run 'git lfs pull' in {folder}"),
    ('part.step', 'not one of .stl, .obj, .msh, .dae, .glb, .gltf, .ply, .off',
     'convert it to STL or OBJ')])
def test_a_robot_loads_without_a_mesh_and_warns_with_link_and_remedy(tmp_path, name, why, remedy):
    write(tmp_path / 'pointer.stl', 'version https://git-lfs.github.com/spec/v1\noid sha256:0\n')
    write(tmp_path / 'part.step', 'solid')
    file = write(tmp_path / 'arm.urdf', with_mesh(name))
    first, last = lost(load_robot(file))
    why, remedy = (text.format(folder=tmp_path) for text in (why, remedy))
    assert first == (
        f"left out: 1 collision shape of files that cannot be read, such as '{name}' ({why}) of "
        f"link 'upper' in {file}; nothing touches these links there; {remedy}")
    assert last == (f'no collision shape is left in {file}: nothing touches it, and it cannot be '
                    'seen')


@pytest.mark.usefixtures('no_packages')
def test_masses_and_motion_stay_without_any_mesh():
    robot = load_robot(NO_MESHES)
    causes = [sentence.partition(' such as ')[2] for sentence in lost(robot)]
    assert causes[0].startswith("'gone.stl' (no such file") and 'nothing touches' in causes[0]
    assert causes[1].startswith("'package://elsewhere/base.stl' (package 'elsewhere' is neither")
    assert 'nothing touches' not in causes[1]
    assert lost(robot)[2].endswith('nothing touches it, and it cannot be seen')
    # The shoulder has no inertia, and neither has what is fixed to it.
    assert '1 g for links without inertia and shape: shoulder' in robot.inferred
    model = compose(robot).compile()
    assert model.body('robot0_shoulder').mass[0] == pytest.approx(1e-3)
    assert model.body('robot0_forearm').mass[0] == 1.0
    simulation = Simulation(compose(load_robot(NO_MESHES)))
    start = simulation.robot.state().position
    simulation.advance(500)
    np.testing.assert_allclose(simulation.robot.state().position, start, atol=5e-3)


@pytest.mark.usefixtures('no_packages')
def test_a_line_says_that_the_meshes_are_not_expected(tmp_path):
    robot = load_robot(write(tmp_path / 'arm.yaml', f'model: {NO_MESHES}\nmeshes: none\n'))
    assert not lost(robot)
    assert [said for said in robot.inferred if 'left out: 1 visual shape of files that' in said]


def test_a_mesh_that_mujoco_cannot_read_is_replaced_or_left_out(tmp_path):
    write(tmp_path / 'link.dae', 'x')
    robot = load_robot(write(tmp_path / 'arm.urdf', with_mesh('link.dae')))
    assert robot.compile().nmesh == 0
    assert any('left out: 1 ' in sentence and "'link.dae'" in sentence
               for sentence in robot.inferred)
    mesh_file(tmp_path / 'link.stl')
    assert load_robot(tmp_path / 'arm.urdf').compile().nmesh == 1


@pytest.mark.parametrize(('before', 'after', 'message'), [
    ('velocity="1.5"', 'velocity="1 2"', "velocity of its <limit> must be a finite number, "
     "got '1 2'"),
    ('velocity="1.5"', 'velocity="inf"', "velocity of its <limit> must be a finite number, "
     "got 'inf'"),
    ('<dynamics', '<mimic joint="elbow" multiplier="inf"/><dynamics',
     "multiplier of its <mimic> must be a finite number, got 'inf'")])
def test_a_number_of_a_joint_that_mujoco_does_not_read_is_checked(
        tmp_path, before, after, message):
    file = write(tmp_path / 'arm.urdf', URDF.replace(before, after))
    with pytest.raises(ModelError) as error:
        load_robot(file)
    assert str(error.value) == f"{file}: joint 'shoulder': {message}"


@pytest.mark.parametrize(('text', 'message'), [
    (URDF[:300], 'arm.urdf is not well-formed XML'),
    ('<mujoco/>', "arm.urdf is not URDF: its root is 'mujoco', not 'robot'"),
    (URDF.replace('</robot>', '<joint name="again" type="fixed"><parent link="base_link"/>'
                  '<child link="upper"/></joint></robot>'),
     "joint 'again' leads to link 'upper', as joint 'shoulder' does: delete one of them, or "),
    (URDF.replace('"upper"', '"world"'),
     "arm.urdf: joint 'shoulder' leads to link 'world', the fixed root of all: give it another"),
    (URDF.replace('</robot>', '<link name="upper"/></robot>'),
     "arm.urdf: 2 elements <link> have the name 'upper': give each another one"),
    ('<!DOCTYPE robot [<!ENTITY a "b">]><robot/>', "arm.urdf, line 1: the entity 'a' is declared"),
    (URDF.replace('<child link="upper"/>', '<child link="uper"/>'),
     "joint 'shoulder': its child link 'uper' is not declared"),
    (URDF.replace('</robot>', '<joint name="one" type="fixed"><parent link="a"/><child link="b"/>'
                  '</joint><joint name="two" type="fixed"><parent link="b"/><child link="a"/>'
                  '</joint></robot>'),
     "joints 'one', 'two' lead from link 'b' back to it, so nothing carries it: delete one of"),
    (URDF.replace('<child link="upper"/>', ''), "arm.urdf is not URDF that MuJoCo can read: .*"
     r"arm.urdf, line \d+: joint 'shoulder': <joint>: missing element: 'child': add it"),
    (URDF.replace('<link name="tool0"/>', '<link name="tool0"><inertial><mass value="1"/>'
                  '<inertia ixx="a" iyy="1" izz="1"/></inertial></link>'),
     r"arm.urdf, line \d+: link 'tool0': <inertia>: bad format in attribute 'ixx': write num")])
def test_a_urdf_that_cannot_be_read_is_told_in_one_line(tmp_path, text, message):
    with pytest.raises(ModelError, match=message) as raised:
        load_robot(write(tmp_path / 'arm.urdf', text))
    assert '\n' not in str(raised.value)


def test_a_urdf_may_be_called_xml(tmp_path):
    assert load_robot(write(tmp_path / 'arm.xml', URDF)).eef_name == {'right': 'robot0_tool0'}


def test_of_meshes_beside_others_each_kind_is_told(tmp_path):
    mesh_file(tmp_path / 'there.stl')
    shape = '<{0}><geometry><mesh filename="{1}"/></geometry></{0}>'
    (begin, end) = with_mesh('there.stl').split('<link name="upper">')
    for kind in ('visual', 'collision'):
        file = write(tmp_path / f'{kind}.urdf', (
            f'{begin}<link name="upper">{shape.format(kind, "gone.stl")}{end}'))
        robot = load_robot(file)
        (sentence,) = lost(robot)
        assert f'left out: 1 {kind} shape of ' in sentence
        assert ('nothing touches' in sentence) == (kind == 'collision')
        assert robot.compile().nmesh == 1


def test_a_mesh_by_the_path_of_another_machine_is_found_in_its_package(tmp_path, monkeypatch):
    monkeypatch.delenv('AMENT_PREFIX_PATH', raising=False)
    mesh_file(tmp_path / 'acme' / 'meshes' / 'link.stl')
    there = 'file:///home/somebody/ws/install/acme/share/acme/meshes/link.stl'
    file = write(tmp_path / 'acme' / 'urdf' / 'arm.urdf', with_mesh(there))
    assert load_robot(file).compile().nmesh == 1


def test_a_mesh_of_a_package_that_was_renamed_is_found_beside_the_file(tmp_path, monkeypatch):
    monkeypatch.delenv('AMENT_PREFIX_PATH', raising=False)
    mesh_file(tmp_path / 'acme' / 'meshes' / 'link.stl')
    file = write(tmp_path / 'acme' / 'urdf' / 'arm.urdf',
                 with_mesh('package://acme_v2/meshes/link.stl'))
    assert load_robot(file).compile().nmesh == 1


def test_of_several_materials_of_a_shape_the_first_is_read(tmp_path):
    text = URDF.replace('<link name="upper">', '<link name="upper"><visual><geometry>'
                        '<box size="0.1 0.1 0.1"/></geometry>'
                        '<material name="a"><color rgba="1 0 0 1"/></material>'
                        '<material name="b"><color rgba="0 1 0 1"/></material></visual>')
    assert '"b"' in text
    load_robot(write(tmp_path / 'arm.urdf', text))


@pytest.mark.parametrize(('element', 'one', 'other'), [
    ('visual', '<origin xyz="0 0 0.3"/>', '<origin xyz="0 0 0.7"/>'),
    ('collision', '<origin xyz="0 0 0.3"/>', '<origin xyz="0 0 0.7"/>')])
def test_of_an_element_that_is_there_twice_the_first_is_read(tmp_path, element, one, other):
    shape = '<geometry><box size="0.1 0.1 0.1"/></geometry>'
    text = URDF.replace('<link name="upper">', f'<link name="upper"><{element}>{one}{shape}'
                        f'{other}{shape}</{element}>')
    model = load_robot(write(tmp_path / 'arm.urdf', text)).compile()
    boxes = [geom for geom in range(model.ngeom) if np.allclose(model.geom_size[geom], 0.05)]
    assert [model.geom_pos[geom][2] for geom in boxes] == [0.3]


def test_of_several_shapes_of_a_geometry_the_first_is_read(tmp_path):
    text = URDF.replace('<link name="upper">', '<link name="upper"><visual><geometry>'
                        '<box size="0.2 0.2 0.2"/><mesh filename="package://acme/lost.stl"/>'
                        '<box size="0.4 0.4 0.4"/></geometry></visual>')
    model = load_robot(write(tmp_path / 'arm.urdf', text)).compile()
    assert 0.1 in model.geom_size and 0.2 not in model.geom_size


@pytest.mark.usefixtures('no_packages')
def test_each_missing_package_is_told(tmp_path):
    mesh_file(tmp_path / 'acme' / 'meshes' / 'link.stl')
    (begin, end) = with_mesh('package://old_name/meshes/link.stl').split('<link name="upper">')
    shape = '<visual><geometry><mesh filename="package://{}/meshes/lost.stl"/></geometry></visual>'
    file = write(tmp_path / 'acme' / 'urdf' / 'arm.urdf', ''.join((
        begin, '<link name="upper">', shape.format('one'), shape.format('other'),
        shape.format('one'), end)))
    robot = load_robot(file)
    assert robot.compile().nmesh == 1
    one, other = lost(robot)
    assert 'left out: 2 visual' in one and "source the workspace that has 'one'" in one
    assert 'left out: 1 visual' in other and "source the workspace that has 'other'" in other


def test_a_package_that_its_folder_does_not_name_is_found_beside_the_file(tmp_path, monkeypatch):
    monkeypatch.delenv('AMENT_PREFIX_PATH', raising=False)
    mesh_file(tmp_path / 'small' / 'link.stl')
    write(tmp_path / 'small' / 'package.xml', '<package><name>acme_small</name></package>')
    file = write(tmp_path / 'config' / 'urdf' / 'arm.urdf',
                 with_mesh('package://acme_small/link.stl'))
    assert load_robot(file).compile().nmesh == 1


def test_a_mesh_without_volume_may_show_something_but_not_weigh(tmp_path):
    corners = [(0, 0, 0), (0.1, 0, 0), (0, 0.1, 0), (0.1, 0.1, 0)]
    faces = [(0, 2, 1), (1, 2, 3)]
    (tmp_path / 'flat.stl').write_bytes(b'\0' * 80 + struct.pack('<I', 2) + b''.join(
        struct.pack('<12fH', 0, 0, 0, *corners[a], *corners[b], *corners[c], 0)
        for a, b, c in faces))
    visual = '<visual><geometry><mesh filename="flat.stl"/></geometry></visual>'
    file = write(tmp_path / 'arm.urdf', URDF.replace(
        '<link name="upper">', f'<link name="upper">{visual}'))
    assert load_robot(file).compile().nmesh == 1


def arm_with(kind, limit, origin='', axis='0 0 1'):
    """Return the URDF of an arm whose second joint has some limit."""
    return (f'<robot name="arm"><link name="base_link">{SOLID}</link><link name="upper">{SOLID}'
            f'</link><link name="lower">{SOLID}</link>'
            + joint('shoulder', 'base_link', 'upper',
                    more='<limit lower="-1" upper="2" effort="40" velocity="1.5"/>')
            + f'<joint name="elbow" type="{kind}"><parent link="upper"/><child link="lower"/>'
              f'{origin}<axis xyz="{axis}"/>{limit}</joint></robot>')


@pytest.mark.parametrize('kind', ['revolute', 'prismatic'])
@pytest.mark.parametrize(('ends', 'expected'), [
    ('lower="-1" upper="2"', (-1, 2)), ('lower="-1.5"', (-1.5, 0)), ('upper="0.5"', (0, 0.5)),
    ('lower="-2" upper="-1"', (-2, -1)), ('lower="0" upper="1"', (0, 1)), ('', None)])
def test_a_missing_limit_of_urdf_is_zero_and_without_both_there_is_no_range(
        tmp_path, kind, ends, expected):
    text = arm_with(kind, f'<limit {ends} effort="10" velocity="1"/>')
    robot = load_robot(write(tmp_path / 'arm.urdf', text))
    elbow = robot.compile().joint('robot0_elbow')
    assert bool(elbow.limited[0]) == (expected is not None)
    if expected is not None:
        assert tuple(elbow.range) == expected
    said = "not limited, as they have neither lower nor upper: 'elbow'"
    assert (said in robot.inferred) == (expected is None)


@pytest.mark.parametrize(('kind', 'limit'), [
    ('continuous', '<limit lower="-1" upper="1" effort="10" velocity="1"/>'),
    ('continuous', '<limit lower="1" upper="-1" effort="10" velocity="1"/>'),
    ('continuous', ''), ('revolute', ''), ('prismatic', '')])
def test_a_continuous_joint_and_one_without_limit_element_have_no_range(tmp_path, kind, limit):
    robot = load_robot(write(tmp_path / 'arm.urdf', arm_with(kind, limit)))
    assert not robot.compile().joint('robot0_elbow').limited[0]


@pytest.mark.parametrize('kind', ['revolute', 'prismatic'])
def test_a_joint_with_equal_limits_needs_an_axis_too(tmp_path, kind):
    limit = '<limit lower="0.3" upper="0.3" effort="10" velocity="1"/>'
    file = write(tmp_path / 'arm.urdf', arm_with(kind, limit, axis='0 0 0'))
    with pytest.raises(ModelError, match=f"{file}: joint 'elbow': its axis is zero"):
        load_robot(file)


def test_a_file_whose_joints_all_have_equal_limits_says_why_it_is_not_a_robot(tmp_path):
    file = write(tmp_path / 'locked.urdf', '<robot name="r"><link name="a"/><link name="b"/>'
                 '<joint name="lock" type="revolute"><parent link="a"/><child link="b"/>'
                 '<axis xyz="0 0 1"/><limit lower="1" upper="1" effort="1" velocity="1"/></joint>'
                 '</robot>')
    with pytest.raises(ModelError, match='no hinge or slide joint .fixed, as lower and upper of '
                       "their <limit> are equal: 'lock'"):
        load_robot(file)


@pytest.mark.parametrize(('kind', 'position'), [
    ('revolute', 0.0), ('revolute', 0.7), ('prismatic', 0.0), ('prismatic', -0.3)])
def test_a_joint_with_equal_limits_is_fixed_there(tmp_path, kind, position):
    origin, axis = '<origin xyz="0.1 0.2 0.3" rpy="0.4 -1.2 2.0"/>', '1 2 -2'
    limit = f'<limit lower="{position}" upper="{position}" effort="10" velocity="1"/>'
    robot = load_robot(write(tmp_path / 'arm.urdf', arm_with(kind, limit, origin, axis)))
    assert robot.joints == ['robot0_shoulder']
    assert "fixed, as lower and upper of their <limit> are equal: 'elbow'" in robot.inferred
    fixed = robot.compile().body('robot0_lower')
    wide = '<limit lower="-2" upper="2" effort="10" velocity="1"/>'
    moving = load_robot(write(tmp_path / 'arm.urdf', arm_with(kind, wide, origin, axis))).compile()
    data = mujoco.MjData(moving)
    data.joint('robot0_elbow').qpos[0] = position
    mujoco.mj_kinematics(moving, data)
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, fixed.quat)
    upper, lower = data.body('robot0_upper'), data.body('robot0_lower')
    turn = upper.xmat.reshape(3, 3).T
    np.testing.assert_allclose(rotation.reshape(3, 3), turn @ lower.xmat.reshape(3, 3), atol=1e-9)
    np.testing.assert_allclose(fixed.pos, turn @ (lower.xpos - upper.xpos), atol=1e-9)


@pytest.mark.parametrize(('limit', 'message'), [
    ('lower="0.5"', 'lower 0.5 of its <limit> is above upper 0; one that is missing is 0'),
    ('lower="nan" upper="1"', "lower of its <limit> must be a finite number, got 'nan'"),
    ('lower="" upper="1"', "lower of its <limit> must be a finite number, got ''"),
    ('lower="-1" upper="1,5"', "upper of its <limit> must be a finite number, got '1,5'"),
    ('lower="-1" upper="1" effort="much"',
     "effort of its <limit> must be a finite number, got 'much'")])
def test_limits_that_cannot_be_are_rejected_with_joint_and_file(tmp_path, limit, message):
    file = write(tmp_path / 'arm.urdf', arm_with('revolute', f'<limit {limit}/>'))
    with pytest.raises(ModelError) as error:
        load_robot(file)
    assert str(error.value) == f"{file}: joint 'elbow': {message}"


@pytest.mark.parametrize(('limits', 'effort', 'velocity'), [
    ('effort="-1" velocity="2"', 0.0, 2.0), ('effort="5" velocity="-1.0"', 5.0, 0.0),
    ('effort="-1" velocity="-1"', 0.0, 0.0)])
def test_minus_one_is_no_limit_of_effort_or_velocity_as_in_sdf(
        tmp_path, limits, effort, velocity):
    file = write(tmp_path / 'arm.urdf', arm_with('continuous', f'<limit {limits}/>'))
    robot = load_robot(file)
    model = robot.compile()
    joint = int(model.joint('robot0_elbow').id)
    actuator = int(np.flatnonzero(model.actuator_trnid[:, 0] == joint)[0])
    assert model.actuator_forcelimited[actuator] == bool(effort)
    assert model.actuator_forcerange[actuator, 1] == effort
    assert model.jnt_user[joint, 0] == velocity
    assert "without a limit of effort or velocity, as SDF writes it by -1 in their <limit>: " \
        "'elbow'; write 0 in the file" in robot.inferred


@pytest.mark.parametrize(('kind', 'more', 'message'), [
    ('revolute', '<limit lower="-1" upper="1" effort="-5" velocity="1"/>',
     'effort of its <limit> is negative: -5; write 5, or 0 for none'),
    ('continuous', '<limit effort="5" velocity="-2"/>',
     'velocity of its <limit> is negative: -2; write 2, or 0 for none'),
    ('continuous', '<dynamics damping="-0.2"/>',
     'damping of its <dynamics> is negative: -0.2; write 0.2, or 0 for none'),
    ('continuous', '<dynamics damping="1" friction="-1e-3"/>',
     'friction of its <dynamics> is negative: -0.001; write 0.001, or 0 for none'),
    ('continuous', '<dynamics damping="nan"/>',
     "damping of its <dynamics> must be a finite number, got 'nan'")])
def test_negative_limits_and_losses_are_rejected_with_joint_file_and_remedy(
        tmp_path, kind, more, message):
    file = write(tmp_path / 'arm.urdf', arm_with(kind, more))
    with pytest.raises(ModelError) as error:
        load_robot(file)
    assert str(error.value) == f"{file}: joint 'elbow': {message}"


@pytest.mark.parametrize('load', [load_robot, load_gripper, load_base])
@pytest.mark.parametrize(('joints', 'named'), [
    (joint('trunk', 'base', 'link', 'floating') + joint('elbow', 'link', 'end'), 'trunk'),
    (joint('elbow', 'base', 'link') + joint('lost', 'link', 'end', 'floating'), 'lost'),
    (joint('root', 'world', 'base', 'floating') + joint('elbow', 'base', 'link')
     + joint('cup', 'base', 'end', 'floating'), 'cup')])
def test_a_joint_that_floats_off_the_world_is_rejected_with_joint_file_and_remedy(
        tmp_path, load, joints, named):
    links = ''.join(f'<link name="{name}"><collision><geometry><sphere radius="0.1"/></geometry>'
                    '</collision></link>' for name in ('base', 'link', 'end'))
    world = '<link name="world"/>' if 'world' in joints else ''
    file = write(tmp_path / 'arm.urdf', f'<robot name="r">{world}{links}{joints}</robot>')
    with pytest.raises(ModelError) as error:
        load(file)
    assert str(error.value) == (
        f"{file}: joint '{named}' is floating, which only a joint of the link 'world' can be; "
        'write type="fixed", or a joint for each direction, or <parent link="world"/> if the '
        'whole robot floats')


@pytest.mark.parametrize('kind', ['Revolute', 'hinge', ''])
def test_an_unknown_type_of_a_joint_is_told_with_joint_file_and_choices(tmp_path, kind):
    file = write(tmp_path / 'arm.urdf', arm_with(kind, '<limit lower="-1" upper="1"/>'))
    with pytest.raises(UnknownNameError) as error:
        load_robot(file)
    assert str(error.value).startswith(f"unknown type of joint 'elbow' of {file} '{kind}': ")
    assert 'available: fixed, revolute, prismatic, continuous' in str(error.value)


@pytest.mark.parametrize('limit', ['lower="0.5" upper="0.5"', 'lower="0" upper="0.5"'])
@pytest.mark.parametrize(('origin', 'axis', 'message'), [
    ('<origin xyz="0 0 x"/>', '0 0 1', "bad format in attribute 'xyz'"),
    ('', '0 1', "attribute 'xyz' does not have enough data: write as many numbers as it needs")])
def test_a_place_or_axis_of_a_joint_that_cannot_be_read_is_told_in_one_line(
        tmp_path, limit, origin, axis, message):
    limit = f'<limit {limit} effort="10" velocity="1"/>'
    file = write(tmp_path / 'arm.urdf', arm_with('revolute', limit, origin, axis))
    with pytest.raises(ModelError, match=message):
        load_robot(file)


def hand_with(mimic, kind='prismatic', more=''):
    limit = '<limit lower="-0.1" upper="0.1" effort="10" velocity="0.2"/>'
    return (f'<robot name="hand"><link name="palm">{SOLID}</link><link name="left">{SOLID}</link>'
            f'<link name="right">{SOLID}</link><link name="other">{SOLID}</link>'
            + joint('left_finger', 'palm', 'left', 'prismatic', limit + more)
            + joint('right_finger', 'palm', 'right', kind, limit + mimic)
            + joint('mount', 'palm', 'other', 'KIND', limit) + '</robot>')


MOVES = 'not one of revolute, prismatic, continuous'


@pytest.mark.parametrize(('leader', 'message'), [
    *((f'mount:{kind}', f"its <mimic> names joint 'mount', which is {kind}, {MOVES}")
      for kind in ('floating', 'planar')),
    ('right_finger', "its <mimic> is a circle, so nothing can drive it: 'right_finger' follows "
                     "'right_finger'"),
    ('left_fingr', "did you mean 'left_finger'"), ('', 'available: left_finger')])
@pytest.mark.parametrize('load', [load_gripper, load_robot])
def test_a_mimic_of_no_joint_that_moves_is_rejected_in_one_line(tmp_path, leader, message, load):
    name, _, kind = leader.partition(':')
    file = write(tmp_path / 'hand.urdf', hand_with(f'<mimic joint="{name}"/>').replace(
        'KIND', kind or 'fixed'))
    with pytest.raises(ModelError) as error:
        load(file)
    for part in (str(file), "joint 'right_finger'", message):
        assert part in str(error.value)
    assert '\n' not in str(error.value)


@pytest.mark.parametrize('kind', ['floating', 'planar'])
def test_a_mimic_on_a_joint_that_cannot_follow_is_rejected_in_one_line(tmp_path, kind):
    file = write(tmp_path / 'hand.urdf', hand_with('<mimic joint="left_finger"/>', kind).replace(
        'KIND', 'fixed'))
    with pytest.raises(ModelError) as error:
        load_gripper(file)
    assert str(error.value) == (f"{file}: joint 'right_finger': its <mimic> is on a joint which "
                                f'is {kind}, {MOVES}')


@pytest.mark.parametrize('kind', ['fixed', 'prismatic'])
def test_a_joint_that_is_fixed_follows_no_other(tmp_path, kind):
    text = hand_with('<mimic joint="left_finger"/>', kind).replace('KIND', 'fixed')
    right = text.index('name="right_finger"')
    text = text[:right] + text[right:].replace('lower="-0.1" upper="0.1"',
                                               'lower="0" upper="0"', 1)
    robot = load_robot(write(tmp_path / 'hand.urdf', text))
    assert "<mimic> is ignored on joints that are fixed: 'right_finger'" in robot.inferred
    assert robot.compile().njnt == 1 and robot.compile().neq == 0


@pytest.mark.parametrize('kind', ['fixed', 'prismatic'])
def test_what_follows_a_joint_that_is_fixed_is_fixed_too(tmp_path, kind):
    text = hand_with('<mimic joint="mount" multiplier="2" offset="0.03"/>').replace('KIND', kind)
    mount = text.index('name="mount"')
    text = text[:mount] + text[mount:].replace('lower="-0.1" upper="0.1"',
                                               'lower="0.02" upper="0.02"')
    robot = load_robot(write(tmp_path / 'hand.urdf', text))
    assert "fixed, as the joints are that they follow: 'right_finger'" in robot.inferred
    model = robot.compile()
    free = load_robot(write(tmp_path / 'free.urdf', hand_with('').replace('KIND', 'prismatic')))
    other = free.compile()
    data = mujoco.MjData(other)
    data.joint('robot0_right_finger').qpos[0] = 0.03 if kind == 'fixed' else 0.07
    mujoco.mj_kinematics(other, data)
    found = mujoco.MjData(model)
    mujoco.mj_kinematics(model, found)
    np.testing.assert_allclose(found.body('robot0_right').xpos, data.body('robot0_right').xpos,
                               atol=1e-12)


def test_a_link_that_only_a_joint_names_is_added(tmp_path):
    text = hand_with('').replace('KIND', 'fixed').replace(
        '</robot>', joint('tool', 'right', 'tool_tip', 'fixed', '') + '</robot>')
    robot = load_robot(write(tmp_path / 'hand.urdf', text))
    assert ("joint 'tool': its child link 'tool_tip' is not declared: write <link "
            'name="tool_tip"/>; it is added without mass and shape') in robot.inferred
    assert 'robot0_tool_tip' in robot.bodies


@pytest.mark.parametrize(('old', 'new', 'message'), [
    ('parent link="palm"', 'parent link="plam"',
     "joint 'left_finger': its parent link 'plam' is not declared: write <link name=\"plam\"/>"),
    ('child link="left"', 'child link="lefty"',
     "joint 'left_finger': its child link 'lefty' is not declared: write <link name=\"lefty\"/>; "
     "no joint leads to 'left'")])
def test_a_link_that_is_misspelt_is_told_with_its_joint(tmp_path, old, new, message):
    text = hand_with('').replace('KIND', 'fixed')
    assert old in text
    with pytest.raises(ModelError) as error:
        load_robot(write(tmp_path / 'hand.urdf', text.replace(old, new, 1)))
    assert str(error.value) == f'{tmp_path / "hand.urdf"}: {message}'


def test_mimics_in_a_circle_are_rejected_with_their_names(tmp_path):
    file = write(tmp_path / 'hand.urdf', hand_with(
        '<mimic joint="mount"/>', more='<mimic joint="right_finger"/>').replace(
        'KIND', 'prismatic').replace('</joint></robot>',
                                     '<mimic joint="left_finger"/></joint></robot>'))
    with pytest.raises(ModelError) as error:
        load_gripper(file)
    assert str(error.value) == (
        f"{file}: joint 'left_finger': its <mimic> is a circle, so nothing can drive it: "
        "'left_finger' follows 'right_finger' follows 'mount' follows 'left_finger'")


def test_a_mimic_of_a_joint_whose_own_leader_is_unknown_is_rejected(tmp_path):
    file = write(tmp_path / 'hand.urdf', hand_with(
        '<mimic joint="nothing"/>', more='<mimic joint="right_finger"/>').replace(
        'KIND', 'fixed'))
    with pytest.raises(ModelError, match="<mimic> of joint 'right_finger' of .* 'nothing'"):
        load_gripper(file)


@pytest.mark.parametrize(('more', 'said'), [
    ('multiplier="-2"', "joint 'left_finger' reaches only -0.05 to 0.05 of its range -0.1 to 0.1: "
                        "there joint 'right_finger', which follows it, is at the ends of its own"),
    ('multiplier="-1"', None), ('multiplier="0.5"', None), ('multiplier="0"', None)])
def test_a_joint_that_ends_before_its_leader_is_told(tmp_path, more, said):
    file = write(tmp_path / 'hand.urdf', hand_with(
        f'<mimic joint="left_finger" {more}/>').replace('KIND', 'fixed'))
    told = [note for note in load_gripper(file).inferred if 'range' in note]
    assert told == ([] if said is None else [said])


LOCKED = ("the limits of joint 'right_finger' are left out: within them, joint 'left_finger', "
          'which it follows, would hardly move; correct lower and upper in its <limit>, or the '
          'multiplier in its <mimic>')


@pytest.mark.parametrize(('mimic', 'limit'), [('offset="1"', '-0.1 0.1'),
                                              ('multiplier="-1"', '0 0.1')])
def test_limits_of_a_follower_that_would_lock_its_leader_are_left_out(tmp_path, mimic, limit):
    lower, upper = limit.split()
    text = hand_with(f'<mimic joint="left_finger" {mimic}/>').replace('KIND', 'fixed').replace(
        'lower="-0.1" upper="0.1"', f'lower="{lower}" upper="{upper}"')
    hand = load_gripper(write(tmp_path / 'hand.urdf', text))
    assert LOCKED in hand.inferred
    simulation = Simulation(compose('Panda', hand))
    leader, follower = (simulation.model.joint(f'gripper0_{side}_finger').qposadr[0]
                        for side in ('left', 'right'))
    moved = []
    for action in (-1.0, 1.0):
        simulation.robot.apply(simulation.robot.parse.action('right/gripper', [action]))
        simulation.advance(1500)
        moved.append(simulation.data.qpos[[leader, follower]].copy())
    way = np.abs(moved[1] - moved[0])
    assert way.min() > 0.9 * (float(upper) - float(lower)), way


def test_limits_that_are_the_wrong_way_round_are_swapped_and_told(tmp_path):
    limit = '<limit lower="1.5" upper="-0.5" effort="10" velocity="1"/>'
    robot = load_robot(write(tmp_path / 'arm.urdf', arm_with('revolute', limit)))
    np.testing.assert_allclose(robot.joint_ranges['robot0_elbow'], [-0.5, 1.5])
    assert ("read the other way round, as lower is above upper in their <limit>: 'elbow'; swap "
            'these numbers in the file') in robot.inferred


BALL = '<visual><origin xyz="0 0 0.2"/><geometry><sphere radius="0.03"/></geometry></visual>'
BOX = ('<collision><origin xyz="0 0 0.2"/><geometry><box size="0.2 0.2 0.2"/></geometry>'
       '</collision>')


def shapes_of(urdf, name):
    """Return the kinds of the visual and of the collision shapes of a link."""
    link = next(link for link in ElementTree.fromstring(urdf).findall('link')
                if link.get('name').endswith(name))
    return tuple([next(iter(shape.find('geometry'))).tag for shape in link.findall(kind)]
                 for kind in ('visual', 'collision'))


@pytest.mark.parametrize('how', ['robot', 'gripper', 'base'])
def test_collision_shapes_of_links_with_visual_ones_are_not_drawn(tmp_path, how):
    limit = '<limit lower="-1" upper="1" effort="9" velocity="1"/>'
    file = str(write(tmp_path / 'shown.urdf', (
        f'<robot name="shown"><link name="foot">{SOLID}</link>'
        f'<link name="both">{SOLID}{BALL}{BOX}</link><link name="plain">{SOLID}{BOX}</link>'
        f'<link name="seen">{SOLID}{BALL}</link>' + joint('a', 'foot', 'both', more=limit)
        + joint('b', 'both', 'plain', more=limit) + joint('c', 'plain', 'seen', more=limit)
        + '</robot>')))
    world = (compose(file) if how == 'robot' else compose('UR5e', gripper=file)
             if how == 'gripper' else compose('UR5e', base=file))
    urdf = urdf_of(world).xml
    assert shapes_of(urdf, '_both') == (['sphere'], ['box'])
    assert shapes_of(urdf, '_plain') == (['box'], ['box'])
    assert shapes_of(urdf, '_seen') == (['sphere'], [])


@pytest.mark.parametrize(('old', 'new'), [
    ('<link name="base_link">', '<!-- -- one -- two\n--- --><link name="base_link">'),
    ('<link name="base_link">', '<!-- caf\xe9 in Latin-1 --><link name="base_link">'),
    ('lower="-1" upper="2"', 'lower="-1"upper="2"'),
    ('<robot name="arm">', '<robot name="arm" version="1 & 2">')])
def test_what_mujoco_reads_although_it_is_no_xml_is_read(tmp_path, old, new):
    assert old in URDF
    loose_file = tmp_path / 'loose.urdf'
    loose_file.write_bytes(URDF.replace(old, new).encode('latin-1'))
    plain, loose = map(load_robot, (write(tmp_path / 'plain.urdf', URDF), loose_file))
    assert loose.joints == plain.joints
    np.testing.assert_array_equal(*(robot.compile().jnt_range for robot in (loose, plain)))


def test_a_joint_that_is_there_twice_is_read_once(tmp_path):
    joint = URDF[URDF.index('<joint name="shoulder"'):]
    joint = joint[:joint.index('</joint>') + len('</joint>')]
    robot = load_robot(write(tmp_path / 'arm.urdf', URDF.replace('</robot>', joint + '</robot>')))
    assert "left out: joints that are there twice: 'shoulder'" in robot.inferred
    assert robot.joints == load_robot(write(tmp_path / 'one.urdf', URDF)).joints


def test_a_link_that_two_joints_fix_in_one_place_is_read_once_and_in_two_places_never(tmp_path):
    joints = ''.join(
        f'<joint name="{name}" type="fixed"><parent link="lower"/><child link="tool"/>'
        f'<origin {origin}/></joint>' for name, origin in (
            ('mount', 'xyz="0 0 0.1" rpy="0 0 0"'), ('again', 'rpy="0  0 0" xyz="0 0 0.1"')))
    text = URDF.replace('</robot>', f'<link name="tool"/>{joints}</robot>')
    robot = load_robot(write(tmp_path / 'arm.urdf', text))
    assert "left out: joints that are there twice: 'again'" in robot.inferred
    file = write(tmp_path / 'apart.urdf', text.replace('rpy="0  0 0"', 'rpy="0 0 1"'))
    with pytest.raises(ModelError, match="joint 'again' leads to link 'tool', as joint 'mount'"):
        load_robot(file)


def test_joints_that_are_fixed_may_have_one_name_and_others_may_not(tmp_path):
    tools = ''.join(f'<link name="{link}"/><joint name="{{}}" type="fixed"><parent link="lower"/>'
                    f'<child link="{link}"/></joint>' for link in ('one', 'two'))
    text = URDF.replace('</robot>', f'{tools}</robot>')
    robot = load_robot(write(tmp_path / 'arm.urdf', text.format('mount', 'mount')))
    assert {'robot0_one', 'robot0_two'} <= set(robot.bodies)
    with pytest.raises(ModelError, match="2 elements <joint> have the name 'shoulder'"):
        load_robot(write(tmp_path / 'arm.urdf', text.format('shoulder', 'mount')))


def test_an_error_behind_a_loose_comment_names_the_line_of_the_file(tmp_path):
    text = ('<!-- a -- b\n-->\n' + URDF[URDF.index('<robot'):]).replace(
        '<link name="tool0"/>', '<link name="tool0"')
    with pytest.raises(ModelError, match=r'loose.urdf is not well-formed XML: .*line 9'):
        load_robot(write(tmp_path / 'loose.urdf', text))
