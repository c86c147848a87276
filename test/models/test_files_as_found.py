# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Files as labs have them: links that overlap, inertias of no body, references to what is not."""

from pathlib import Path
import re

import mujoco
import numpy as np
import pytest

from files_rig import write

from manip_sim.errors import ModelError
from manip_sim.models import compose, load_base, load_gripper, load_robot
from manip_sim.models.asset_files import LostShape
from manip_sim.simulation import Simulation

INERTIA = '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>'
SOLID = f'<inertial><mass value="1"/>{INERTIA}</inertial>'
BALL = '<collision><geometry><sphere radius="0.12"/></geometry></collision>'
LIMIT = '<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="60" velocity="2"/>'


def joint(name, parent, child, kind='revolute'):
    return (f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="0 0 0.1"/>{LIMIT}</joint>')


def urdf(links, joints):
    return ('<robot name="r">' + ''.join(f'<link name="{name}">{content}</link>'
                                         for name, content in links.items())
            + ''.join(joints) + '</robot>')


#: Links 1 and 3 overlap by 4 cm at the start, and nothing says that they must not collide.
OVERLAPPING = urdf({'base': SOLID, 'l1': SOLID + BALL, 'l2': SOLID, 'l3': SOLID + BALL, 'tip': ''},
                   [joint('j1', 'base', 'l1'), joint('j2', 'l1', 'l2'), joint('j3', 'l2', 'l3'),
                    joint('f', 'l3', 'tip', 'fixed')])
SMALL = urdf({'base': SOLID, 'l1': SOLID, 'tool': '{}'},
             [joint('j1', 'base', 'l1'), joint('f', 'l1', 'tool', '{}')])


DATA = Path(__file__).resolve().parents[1] / 'data' / 'files'


def said(robot, words):
    return [sentence for sentence in robot.inferred if words in sentence]


def test_a_urdf_whose_links_overlap_at_the_start_holds_its_pose(tmp_path):
    robot = load_robot(write(tmp_path / 'arm.urdf', OVERLAPPING))
    assert said(robot, "'l1' and 'l3' overlap at the start, so they do not collide")
    simulation = Simulation(compose(robot))
    start = simulation.robot.state().position
    for _ in range(100):
        simulation.advance(5)
    state = simulation.robot.state()
    np.testing.assert_allclose(state.position, start, atol=1e-3)
    assert np.abs(state.velocity).max() < 1e-3


def test_an_mjcf_keeps_the_collisions_that_it_has(tmp_path):
    text = ('<mujoco><worldbody><body name="a"><geom size="0.1"/><body name="b" pos="0 0 0.1">'
            '<joint name="j" axis="0 1 0"/><geom size="0.01" contype="0" conaffinity="0"/>'
            '<body name="c" pos="0 0 0.05">'
            '<joint name="k" axis="0 1 0"/><geom size="0.1"/></body></body></body></worldbody>'
            '<actuator><motor joint="j"/><motor joint="k"/></actuator></mujoco>')
    robot = load_robot(write(tmp_path / 'arm.xml', text))
    # Link b moves on the fixed a; c is two joints away and touches it.
    assert not said(robot, 'overlap')
    assert robot.compile().nexclude == 0


def test_the_pairs_of_the_srdf_beside_a_urdf_do_not_collide(tmp_path):
    write(tmp_path / 'arm.srdf', '<robot name="r"><disable_collisions link1="l3" link2="l1" '
          'reason="Never"/><disable_collisions link1="base" link2="nothing"/></robot>')
    robot = load_robot(write(tmp_path / 'arm.urdf', OVERLAPPING))
    assert said(robot, 'left out: collisions of 1 pair of links, as its SRDF says')
    assert not said(robot, 'overlap')
    assert robot.compile().nexclude == 1


@pytest.mark.parametrize('load', [load_robot, load_gripper, load_base])
def test_hands_and_bases_exclude_the_links_that_a_robot_of_the_same_file_does(tmp_path, load):
    text = urdf({'palm': SOLID + BALL, 'a1': SOLID, 'a2': SOLID + BALL, 'b1': SOLID, 'b2': SOLID,
                 'b3': SOLID + BALL.replace('0 0 0', '0 0.2 0')},
                [joint('a1', 'palm', 'a1'), joint('a2', 'a1', 'a2'), joint('b1', 'palm', 'b1'),
                 joint('b2', 'b1', 'b2'), joint('b3', 'b2', 'b3')])
    part = load(write(tmp_path / 'part.urdf', text))
    pairs = [{*sentence.split("'")[1:4:2]} for sentence in said(part, 'overlap at the start')]
    excluded = [{item.bodyname1, item.bodyname2} for item in part.spec.excludes]
    assert excluded == pairs != []
    write(tmp_path / 'part.srdf', '<robot name="r"><disable_collisions link1="a1" link2="b3"/>'
                                  '</robot>')
    part = load(tmp_path / 'part.urdf')
    assert said(part, 'left out: collisions of 1 pair of links, as its SRDF says')
    again = [{item.bodyname1, item.bodyname2} for item in part.spec.excludes]
    assert again == [{'a1', 'b3'}, *pairs]


def test_a_hand_whose_links_overlap_holds_its_pose_on_an_arm(tmp_path):
    file = write(tmp_path / 'hand.urdf', OVERLAPPING.replace('name="j', 'name="finger_j'))
    world = compose('UR5e', gripper=str(file))
    assert world.compile(visual=False).nexclude == load_robot(file).compile().nexclude == 1
    simulation = Simulation(world)
    start = simulation.robot.state().position
    simulation.advance(500)
    assert np.abs(simulation.robot.state().velocity).max() < 1e-3
    np.testing.assert_allclose(simulation.robot.state().position, start, atol=2e-3)


@pytest.mark.parametrize('srdf', ['<robot', '<!DOCTYPE r [<!ENTITY a "b">]><robot/>', '\x00'])
def test_an_srdf_that_cannot_be_read_is_ignored_and_reported(tmp_path, srdf):
    write(tmp_path / 'arm.srdf', srdf)
    robot = load_robot(write(tmp_path / 'arm.urdf', OVERLAPPING))
    assert said(robot, "'arm.srdf' is ignored: ")
    assert said(robot, 'overlap')


@pytest.mark.parametrize('inertia', [
    'ixx="1e-6" iyy="1e-6" izz="1e-6" ixy="2e-6" ixz="0" iyz="0"',
    'ixx="-1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"',
    'ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"',
    'ixx="3e-20" iyy="5e-20" izz="1e-20" ixy="1e-21" ixz="0" iyz="0"',
    'ixx="1e-4" iyy="1e-4" izz="1.4e-12" ixy="0" ixz="9.6e-9" iyz="-9e-9"'])
@pytest.mark.parametrize('kind', ['fixed', 'revolute'])
def test_an_inertia_that_no_body_has_becomes_one_that_a_body_can_have(tmp_path, inertia, kind):
    text = SMALL.format(f'<inertial><mass value="0.1"/><inertia {inertia}/></inertial>', kind)
    robot = load_robot(write(tmp_path / 'arm.urdf', text))
    assert said(robot, "moments of inertia that are not positive became 1e-08 kg m^2: 'tool'")
    model = robot.compile()
    tool = model.body('robot0_tool')
    assert tool.mass[0] == 0.1
    assert (tool.inertia > 0.0).all()
    assert 2.0 * tool.inertia.max() <= tool.inertia.sum() * (1.0 + 1e-9)


def test_a_moving_link_of_mass_zero_gets_a_little(tmp_path):
    text = SMALL.format(f'<inertial><mass value="0"/>{INERTIA}</inertial>', 'revolute')
    robot = load_robot(write(tmp_path / 'arm.urdf', text))
    assert said(robot, "0.1 g for moving links of mass 0: 'tool'")
    assert robot.compile().body('robot0_tool').mass[0] == 1e-4


def test_valid_inertias_stay_as_they_are(tmp_path):
    robot = load_robot(write(tmp_path / 'arm.urdf', SMALL.format(SOLID, 'fixed')))
    assert not said(robot, 'moments of inertia')
    np.testing.assert_array_equal(robot.compile().body('robot0_tool').inertia, [0.01] * 3)


UNKNOWN = ('without a <box>, <cylinder>, <sphere> or <mesh> with its attributes, or without '
           'numbers in them')


@pytest.mark.parametrize(('shape', 'why'), [
    ('<sphere radius="0"/>', 'of size zero'), ('<box size="0.1 0 0.1"/>', 'of size zero'),
    ('<cylinder radius="0.1" length="0.0"/>', 'of size zero'),
    ('<cylinder radius="0.1"/>', UNKNOWN), ('<cone radius="0.1" length="1"/>', UNKNOWN),
    ('', UNKNOWN)])
@pytest.mark.parametrize('tag', ['visual', 'collision'])
def test_shapes_that_are_none_are_left_out_and_reported(tmp_path, tag, shape, why):
    text = SMALL.format(f'{SOLID}<{tag}><geometry>{shape}</geometry></{tag}>', 'fixed')
    robot = load_robot(write(tmp_path / 'arm.urdf', text))
    assert said(robot, f"left out: 1 shape {why}, of 'tool'")


def test_a_lost_collision_shape_is_a_warning_of_its_own(tmp_path):
    write(tmp_path / 'part.step', 'solid')
    mesh = '<geometry><mesh filename="part.step"/></geometry>'
    text = SMALL.format(f'{SOLID}<visual>{mesh}</visual><collision>{mesh}</collision>', 'fixed')
    robot = load_robot(write(tmp_path / 'arm.urdf', text))
    assert said(robot, '1 visual shape of files that cannot be read')
    assert said(robot, '1 collision shape ') == said(robot, 'nothing touches these links there')


@pytest.mark.parametrize('suffix', ['.glb', '.ply', '.off', '.dae'])
def test_a_mesh_in_another_format_keeps_its_size(tmp_path, monkeypatch, suffix):
    trimesh = pytest.importorskip('trimesh', reason='trimesh, which converts meshes, is missing')
    if suffix == '.dae':
        pytest.importorskip('collada', reason='pycollada, which reads Collada, is missing')
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path / 'cache'))
    trimesh.creation.box((0.1, 0.2, 0.3)).export(tmp_path / f'part{suffix}')
    mesh = f'<collision><geometry><mesh filename="part{suffix}"/></geometry></collision>'
    file = write(tmp_path / 'arm.urdf', SMALL.format(SOLID + mesh, 'fixed'))
    for _ in range(2):
        robot = load_robot(file)
        assert not said(robot, 'left out')
        vertices = robot.compile().mesh_vert
        size = np.sort(vertices.max(axis=0) - vertices.min(axis=0))
        np.testing.assert_allclose(size, [0.1, 0.2, 0.3], rtol=1e-5)
    assert len(list((tmp_path / 'cache' / 'manip_sim' / 'meshes').iterdir())) == 1


def test_a_collada_file_in_millimetres_is_read_in_metres(tmp_path, monkeypatch):
    trimesh = pytest.importorskip('trimesh', reason='trimesh, which converts meshes, is missing')
    pytest.importorskip('collada', reason='pycollada, which reads Collada, is missing')
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path / 'cache'))
    trimesh.creation.box((100.0, 200.0, 300.0)).export(tmp_path / 'part.dae')
    text = (tmp_path / 'part.dae').read_text()
    text = re.sub(r'<unit [^>]*/>', '', text)
    write(tmp_path / 'part.dae', text.replace(
        '</asset>', '<unit name="millimeter" meter="0.001"/></asset>', 1))
    mesh = '<collision><geometry><mesh filename="part.dae"/></geometry></collision>'
    robot = load_robot(write(tmp_path / 'arm.urdf', SMALL.format(SOLID + mesh, 'fixed')))
    vertices = robot.compile().mesh_vert
    assert (vertices.max(axis=0) - vertices.min(axis=0)).max() == pytest.approx(0.3, rel=1e-5)


def test_a_mesh_that_cannot_be_converted_is_reported_with_the_reason(tmp_path, monkeypatch):
    pytest.importorskip('trimesh', reason='trimesh, which converts meshes, is missing')
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path / 'cache'))
    write(tmp_path / 'part.glb', 'nothing of the kind')
    mesh = '<collision><geometry><mesh filename="part.glb"/></geometry></collision>'
    robot = load_robot(write(tmp_path / 'arm.urdf', SMALL.format(SOLID + mesh, 'fixed')))
    (sentence,) = said(robot, "'part.glb' (")
    assert 'nothing touches these links there' in sentence


ARM = ('<body name="base"><geom size="0.05"/><body name="l1" pos="0 0 0.1">'
       '<joint name="j1" axis="0 1 0" range="-2 2"/>'
       '<geom name="foot" type="capsule" size="0.03" fromto="0 0 0.05 0 0 0.3" {}/></body></body>')
END = '<actuator><position joint="j1" kp="50" kv="5"/></actuator>'


def mjcf(arm='', beside='', after=''):
    return (f'<mujoco><compiler angle="radian"/><worldbody>{beside}{ARM.format(arm)}</worldbody>'
            f'{after}{END}</mujoco>')


def test_the_suffix_mjcf_loads(tmp_path):
    robot = load_robot(write(tmp_path / 'arm.mjcf', mjcf()))
    assert robot.arm_joints == ['robot0_j1']


@pytest.mark.parametrize('content', [b'\xff\xfe', b'<mujoco>', b''])
def test_a_broken_file_with_the_suffix_mjcf_is_one_error(tmp_path, content):
    (tmp_path / 'arm.mjcf').write_bytes(content)
    with pytest.raises(ModelError) as caught:
        load_robot(tmp_path / 'arm.mjcf')
    assert '\n' not in str(caught.value)


def test_a_shape_that_touches_the_ground_by_a_pair_touches_that_of_the_arena(tmp_path):
    robot = load_robot(write(tmp_path / 'arm.xml', mjcf(
        'contype="0" conaffinity="0"', '<geom name="floor" type="plane" size="1 1 0.1"/>',
        '<contact><pair geom1="foot" geom2="floor" friction="0.7 0.7 0.01 0.001 0.001"/></contact>'
        )))
    assert said(robot, 'contact of 1 shape with the arena, where contact pairs named the ground: '
                       "'foot'")
    model = compose(robot, position=(0.0, 0.0, -0.25)).compile()
    foot = model.geom('robot0_foot')
    assert foot.friction.tolist() == [0.7, 0.01, 0.001]
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert any(foot.id in contact.geom for contact in data.contact)


def test_an_object_that_rests_on_a_table_is_left_out_without_a_trace(tmp_path):
    table = ('<body name="table" pos="1 0 0.2"><geom type="box" size="0.2 0.2 0.2"/></body>'
             '<body name="obj" pos="1 0 0.42"><freejoint/>'
             '<geom name="o" type="box" size="0.02 0.02 0.02"/></body>')
    text = mjcf(beside=table, after='<contact><pair geom1="o" geom2="foot"/></contact>')
    robot = load_robot(write(tmp_path / 'arm.xml', text))
    assert said(robot, "'obj'")
    model = Simulation(compose(robot)).model
    assert model.npair == 0


def test_masses_that_follow_from_shapes_are_told_one_by_one():
    robot = load_robot(DATA / 'masses.urdf')
    assert said(robot, 'no <inertial>') == [
        "link 'upper' has no <inertial>: 2 kg from its collision shapes at 1000 kg/m^3"]
    model = robot.compile()
    assert model.body('robot0_upper').mass[0] == pytest.approx(2.0)
    assert model.body('robot0_lower').mass[0] == pytest.approx(0.7)


@pytest.mark.parametrize('carried', [True, False])
def test_links_without_gravity_in_gazebo_need_no_effort_here(tmp_path, carried):
    text = (DATA / 'no_gravity.urdf').read_text()
    if not carried:
        text = text.replace('>true<', '>false<').replace('<gravity>0<', '<gravity>1<')
    robot = load_robot(write(tmp_path / 'arm.urdf', text))
    assert bool(said(robot, "no gravity on 2 links, as <gazebo> elements say: 'upper', "
                            "'lower'")) == carried
    simulation = Simulation(compose(robot, position=(0.0, 0.0, 1.0)))
    assert bool(simulation.start_defects) != carried
    start = simulation.robot.state().position
    simulation.advance(500)
    state = simulation.robot.state()
    assert (np.abs(state.position - start).max() < 1e-3) == carried
    if carried:
        np.testing.assert_allclose(state.effort, 0.0, atol=0.05)


@pytest.mark.parametrize('compensates', [True, False])
def test_a_load_on_links_without_gravity_still_weighs(compensates):
    robot = load_robot(DATA / 'no_gravity.urdf')
    simulation = Simulation(compose(robot, position=(0.0, 0.0, 1.0),
                                    gravity_compensation=compensates))
    model, data = simulation.model, simulation.data
    assert not model.jnt_actgravcomp.any()
    lower = model.body('robot0_lower').id
    data.xfrc_applied[lower, 2] = -9.81
    before = simulation.robot.state().position
    simulation.advance(500)
    state = simulation.robot.state()
    assert abs(state.effort[1]) == pytest.approx(9.81 * 0.2, rel=0.05)
    np.testing.assert_allclose(state.position, before, atol=5e-3)


def test_masses_that_a_file_does_not_give_are_such_that_motors_carry_them():
    robot = load_robot(DATA / 'thick_links.urdf')
    assert said(robot, 'so that no pose needs more than 50% of an effort limit')
    model = robot.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)  # Stretched out: no pose needs more.
    shares = np.abs(data.qfrc_bias) / model.jnt_actfrcrange[:, 1]
    assert 0.4 < shares.max() <= 0.52
    assert model.body('robot0_tool').mass[0] == 0.5
    simulation = Simulation(compose(robot, position=(0.0, 0.0, 1.0)))
    assert not simulation.start_defects


def test_masses_that_motors_carry_or_no_limit_restricts_are_not_changed(tmp_path):
    strong = (DATA / 'thick_links.urdf').read_text().replace('effort="', 'effort="9')
    for text in (strong, re.sub('effort="[0-9]*"', 'effort="0"', strong)):
        robot = load_robot(write(tmp_path / 'arm.urdf', text))
        assert not said(robot, 'so that no pose')
        assert robot.compile().body('robot0_upper').mass[0] == pytest.approx(12.0)


def test_a_joint_starts_where_the_joint_has_it_that_it_mimics():
    robot = load_robot(DATA / 'parallel_rod.urdf')
    assert said(robot, 'the middle of all ranges, because links overlap at zero')
    simulation = Simulation(compose(robot, position=(0.0, 0.0, 1.0)))
    names = simulation.robot.joint_names
    start = simulation.robot.state().position
    elbow, rod = (start[names.index(f'robot0_{name}')] for name in ('elbow', 'rod_joint'))
    assert (elbow, rod) == pytest.approx((0.8, -0.8))
    simulation.advance(500)
    np.testing.assert_allclose(simulation.robot.state().position, start, atol=5e-3)


def test_a_pose_in_which_a_mimic_leaves_its_range_is_no_start(tmp_path):
    text = (DATA / 'parallel_rod.urdf').read_text().replace('continuous', 'revolute').replace(
        '<limit effort="50" velocity="2"/>',
        '<limit lower="0" upper="1" effort="50" velocity="2"/>')
    robot = load_robot(write(tmp_path / 'arm.urdf', text))
    assert said(robot, 'start pose: zero') == ['start pose: zero']


def test_an_mjcf_file_loads_without_meshes_that_give_no_mass(tmp_path):
    file = DATA / 'lost_mesh.xml'
    robot = load_robot(file)
    collision, visual = (sentence for sentence in robot.inferred
                         if isinstance(sentence, LostShape))
    assert collision == (
        "left out: 1 collision shape of files that cannot be read, such as 'shell' (no such "
        f"file: {DATA / 'shell.stl'}) of body 'link' in {file}; nothing touches these links "
        'there; put it there, or correct its name')
    assert 'left out: 1 visual shape ' in visual and 'nothing touches' not in visual
    model = robot.compile()
    assert (model.nmesh, model.npair, model.body('robot0_link').mass[0]) == (0, 0, 2.0)
    accepted = load_robot(write(tmp_path / 'arm.yaml', f'model: {file}\nmeshes: none'))
    assert [str(said) for said in accepted.inferred] == [str(said) for said in robot.inferred]
    assert not any(isinstance(sentence, LostShape) for sentence in accepted.inferred)


def test_a_link_that_is_a_speck_of_dust_can_be_composed(tmp_path):
    speck = '<inertial><mass value="6.5e-8"/><inertia ixx="1.64e-15" iyy="1.64e-15" ' \
        'izz="1.64e-15" ixy="0" ixz="-1.1e-47" iyz="-1.3e-47"/></inertial>'
    robot = load_robot(write(tmp_path / 'arm.urdf', SMALL.format(speck, 'fixed')))
    assert compose(robot).compile().body('robot0_tool').mass[0] > 0.0


def test_contact_pairs_with_the_ground_of_a_scene_touch_the_arena(tmp_path):
    text = """<mujoco><worldbody><body name="base" pos="0 0 0.1"><freejoint/>
      <geom name="sole" type="box" size="0.1 0.1 0.1" contype="0" conaffinity="0"/>
      <body name="arm" pos="0 0 0.2"><joint name="turn" axis="0 0 1"/><geom size="0.05"/></body>
      </body></worldbody><contact><pair geom1="ground" geom2="sole"/></contact>
      <actuator><position joint="turn" kp="10"/></actuator></mujoco>"""
    robot = load_robot(write(tmp_path / 'walker.xml', text))
    assert said(robot, "1 contact pair with shapes that are not in the file: 'ground'")
    simulation = Simulation(compose(robot))
    simulation.advance(500)
    assert simulation.data.body('robot0_base').xpos[2] == pytest.approx(0.1, abs=5e-3)


@pytest.mark.parametrize(('name', 'expected'), [
    ('loose_arm.urdf', {'arm': 2, 'right/gripper': 2}),
    ('sliding_root.xml', {'base': 3, 'arm': 3}), ('three_rotors.xml', {'other': 3})])
def test_the_parts_of_a_file_that_is_not_as_it_should_be(name, expected):
    simulation = Simulation(compose(load_robot(DATA / name)))
    assert {part: len(found.joints) for part, found in simulation.robot.parts.items()
            if found.atomic == (part,) and found.joints} == expected


def test_all_that_is_read_otherwise_than_it_is_written_is_told():
    robot = load_robot(DATA / 'loose_arm.urdf')
    np.testing.assert_allclose(robot.joint_ranges['robot0_shoulder'], [-1.5, 1.5])
    assert said(robot, 'read the other way round, as lower is above upper in their <limit>: ')
    assert said(robot, "the limits of joint 'jaw_b' are left out")
