# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A file for each kind that files had which were chosen before anybody had loaded them."""

from pathlib import Path

from files_rig import ARM, write
import numpy as np
import pytest

from manip_sim.errors import ModelError
from manip_sim.models import compose, load_robot
from manip_sim.simulation import Simulation

DATA = Path(__file__).resolve().parents[1] / 'data' / 'files'
REMEDY = 'if another file includes this one, load that'


@pytest.mark.parametrize(('name', 'expected'), [
    ('four_shoulders.xml', {'legs': 12}),
    ('turning_claw.xml', {'arm': 3, 'right/gripper': 2}),
    ('head_called_hand.xml', {'torso': 1, 'right': 4, 'left': 4, 'other': 2}),
    ('two_robots_of_a_cell.xml', {'right': 4, 'left': 5, 'other': 1}),
    ('soft_pads.xml', {'right/gripper': 2}),
    ('pelvis.xml', {'torso': 2, 'legs': 4}),
    ('wheels_on_legs.xml', {'base': 12}),
    ('feet.xml', {'legs': 9}),
    ('worm.xml', {'other': 10}),
    ('steered_wheels.xml', {'base': 6, 'arm': 3}),
    ('leg_alone.xml', {'legs': 3}),
    ('names_in_capitals.xml', {'torso': 1, 'right': 2, 'left': 2, 'legs': 6}),
    ('fingers_in_a_row.xml', {'right/gripper': 11}),
    ('standing_pair.xml', {'legs': 6}),
    ('pistons.xml', {'arm': 6}),
    ('turning_fingers.xml', {'arm': 3, 'right/gripper': 1}),
    ('quadruped_with_hr.xml', {'legs': 12, 'arm': 2}),
    ('palm_in_the_world.xml', {'right/gripper': 10}),
    ('three_arms_on_a_column.xml', {'torso': 1, 'right': 4, 'left': 4, 'other': 4}),
    ('tied_ankle.xml', {'legs': 5}),
    ('names_of_both_links.urdf', {'legs': 6}),
    ('rocker_rover.urdf', {'base': 8}),
    ('floating_hinge.xml', {'base': 1, 'arm': 3}),
    ('carried_gripper.xml', {'base': 2, 'right/gripper': 2}),
    ('trunk_on_slides.xml', {'base': 6, 'legs': 8}),
    ('drawn_hand.xml', {'arm': 2, 'right/gripper': 2})])
def test_the_parts_are_those_that_a_reader_of_the_file_sees(name, expected):
    parts = Simulation(compose(load_robot(DATA / name))).robot.parts
    assert {part: len(own.joints) for part, own in parts.items()
            if own.atomic == (part,) and own.joints} == expected


@pytest.mark.parametrize(('old', 'new', 'expected'), [
    # Sides in the names of joints, and one wheel alone, as of a tool.
    ('three_arms_on_a_column.xml', {'body name="left_': 'body name="a_',
                                    'body name="right_': 'body name="b_'},
     {'torso': 1, 'right': 4, 'left': 4, 'other': 4}),
    ('wheels_on_legs.xml', {'"b_wheel"': '"b_tip"', '"b_roll"': '"b_last"'},
     {'base': 3, 'other': 9}),
    ('worm.xml', {'"s9"': '"tool"'}, {'arm': 10}),
    ('leg_alone.xml', {'knee': 'elbow', 'foot': 'fore'}, {'arm': 3}),
    ('leg_alone.xml', {'knee': 'third', 'foot': 'fore',
                       '</mujoco>': '<actuator><motor name="knee_motor" joint="third"/></actuator>'
                                    '</mujoco>'}, {'legs': 3}),
    ('fingers_in_a_row.xml', {'0 0.02 0.1': '0.05 0.02 0.1', '0 -0.02 0.1': '0.05 -0.02 0.1'},
     {'legs': 8, 'arm': 3}),
    ('steered_wheels.xml', {'"a1"': '"a1" axis="1 0 0"', '"c1"': '"c1" axis="1 0 0"'},
     {'base': 2, 'arm': 3, 'other': 4}),
    ('standing_pair.xml', {'0 0 0.45': '0 0 1.45'}, {'right': 3, 'left': 3}),
    ('palm_in_the_world.xml', {'thumb': 'one', 'index': 'two'}, {'other': 10})])
def test_less_in_the_file_says_less(tmp_path, old, new, expected):
    text = (DATA / old).read_text()
    for word, other in new.items():
        text = text.replace(word, other)
    parts = Simulation(compose(load_robot(write(tmp_path / 'robot.xml', text)))).robot.parts
    assert {part: len(own.joints) for part, own in parts.items()
            if own.atomic == (part,) and own.joints} == expected


def test_what_an_inertial_lacks_or_has_twice_is_completed_or_left_out():
    robot = load_robot(DATA / 'loose_inertials.urdf')
    model = robot.compile()
    bodies = {name: model.body(f'robot0_{name}') for name in ('ball', 'plain', 'double')}
    assert [body.mass[0] for body in bodies.values()] == [4.18879, 2.0, 3.0]
    moments = 0.4 * 4.18879 * 0.1**2, 0.02, 0.01
    np.testing.assert_allclose([body.inertia.max() for body in bodies.values()], moments, 1e-5)
    np.testing.assert_array_equal(bodies['ball'].pos, [0.0, 0.0, 0.4])
    np.testing.assert_array_equal(model.geom_rgba[model.geom_group < 3][1], [1.0, 0.0, 0.0, 1.0])
    assert {"left out: <inertial> without <mass>, of 'weightless'",
            'the moment of inertia of a ball of water for links whose <inertial> has no <inertia>'
            ": 'ball'"} <= set(robot.inferred)


def test_fingers_on_servos_that_integrate_velocities_open_and_close():
    robot = load_robot(DATA / 'integrating_fingers.xml')
    simulation = Simulation(compose(robot))
    for action, ends in ((-1.0, 0.03), (1.0, 0.0), (-1.0, 0.03)):
        simulation.robot.apply(simulation.robot.parse.action('right/gripper', [action, action]))
        simulation.advance(round(2.5 / simulation.timestep_s))
        np.testing.assert_allclose(simulation.robot.state().position, ends, atol=1e-3)
    ids = simulation.robot.parts['right/gripper'].actuator_ids
    np.testing.assert_array_equal(simulation.model.actuator_ctrlrange[ids], [[-0.02, 0.02]] * 2)


def test_a_gripper_that_a_base_carries_closes_and_opens_and_stays_where_the_file_has_it():
    robot = load_robot(DATA / 'carried_gripper.xml')
    assert "right arm ends at body 'gripper_base': it carries a hand, and no arm is there" in (
        robot.inferred)
    assert not [note for note in robot.inferred if 'in the air' in note]
    simulation = Simulation(compose(robot))
    for action, ends in ((-1.0, 0.03), (1.0, 0.0), (-1.0, 0.03)):
        simulation.robot.apply(simulation.robot.parse.action('right/gripper', [action] * 2))
        simulation.advance(round(2.0 / simulation.timestep_s))
        position = simulation.robot.state().position[
            [simulation.robot.joint_names.index(f'robot0_{side}_finger')
             for side in ('left', 'right')]]
        np.testing.assert_allclose(position, ends, atol=2e-3)


def test_fingers_with_more_contacts_than_memory_load_and_close_by_their_tips(tmp_path):
    balls = ''.join(f'<geom size="0.02" pos="{0.001 * i} 0 0.05"/>' for i in range(30))
    fingers = ''.join(f'<body name="{side}_finger" pos="0 {y} 0"><joint name="{side}"/>{balls}'
                      '</body>' for side, y in (('left', 0.05), ('right', -0.05)))
    servos = ''.join(f'<position name="{side}" joint="{side}" kp="100" ctrlrange="-0.03 0.03"/>'
                     for side in ('left', 'right'))
    robot = load_robot(write(tmp_path / 'robot.xml', f"""<mujoco>
      <compiler angle="radian" autolimits="true"/><size memory="100K"/>
      <default><joint type="slide" axis="0 1 0" armature="0.01" range="-0.03 0.03"/>
        <geom mass="0.01" condim="6"/></default>
      <worldbody><body name="palm" pos="0 0 0.5"><geom type="box" size="0.02 0.06 0.01"/>{fingers}
      </body></worldbody><actuator>{servos}</actuator></mujoco>"""))
    assert 'right hand: closing: left from 0.03 to -0.03, right from -0.03 to 0.03' in (
        robot.inferred)


def test_what_refers_to_the_scene_that_includes_a_file_is_left_out_with_what_it_refers_to():
    robot = load_robot(DATA / 'part_of_a_scene.xml')
    of_reference = 'with a reference to what is not in the file:'
    correct = f'; {REMEDY}, else correct the name'
    assert {note for note in robot.inferred if note.startswith('left out: ')} == {
        f"left out: 1 exclude {of_reference} 'terrain'{correct}",
        f"left out: 2 equality constraints {of_reference} 'door', 'target'{correct}",
        f"left out: 2 sensors {of_reference} 'cube', 'goal'{correct}",
        f"left out: 1 camera target {of_reference} 'cube'{correct}",
        f"left out: 1 light {of_reference} 'cube'{correct}",
        f"left out: 1 material {of_reference} 'steel'{correct}",
        "left out: keyframe 'home', which has 8 positions where the file has 1; "
        f"{REMEDY}, or write 'start' in a YAML file"}
    model = robot.compile()
    assert [model.sensor(i).name for i in range(model.nsensor)
            if 'own' in model.sensor(i).name] == ['robot0_own']
    assert model.neq == 0
    simulation = Simulation(compose(robot))
    simulation.advance(100)
    np.testing.assert_allclose(simulation.robot.state().position, 0.0, atol=1e-3)


def test_controls_of_a_keyframe_for_other_actuators_are_left_out_and_its_pose_is_kept(tmp_path):
    text = (DATA / 'part_of_a_scene.xml').read_text().replace(
        'qpos="0.5 1 0 0 1 0 0 0"', 'qpos="0.5" ctrl="0.5 0 0"')
    robot = load_robot(write(tmp_path / 'robot.xml', text))
    assert "left out: 3 controls of keyframe 'home', as the file has 1 actuator" in robot.inferred
    np.testing.assert_allclose(Simulation(compose(robot)).robot.state().position, 0.5)


def test_what_refers_to_an_own_element_stays(tmp_path):
    text = (DATA / 'part_of_a_scene.xml').read_text()
    for name, own in (('cube', 'link'), ('terrain', 'base'), ('target', 'base'), ('goal', 'tip'),
                      ('"door"', '"turn"'), (' material="steel"', '')):
        text = text.replace(f'"{name}"' if name.isalpha() else name,
                            f'"{own}"' if name.isalpha() else own)
    text = text.replace('<joint joint1="turn" joint2="turn"/>', '<joint joint1="turn"/>')
    text = text.replace(' 1 0 0 1 0 0 0"', '"')
    robot = load_robot(write(tmp_path / 'robot.xml', text))
    assert not [note for note in robot.inferred if 'not in the file' in note
                or 'keyframe' in note and 'left out' in note]
    model = robot.compile()
    assert model.neq == 2 and model.nexclude >= 1


def test_an_actuator_of_a_joint_that_the_file_lacks_is_an_error(tmp_path):
    text = (DATA / 'part_of_a_scene.xml').read_text().replace(
        'position joint="turn"', 'position joint="door"')
    with pytest.raises(ModelError, match=f"robot\\.xml .* transmission target 'door'.*{REMEDY}$"):
        load_robot(write(tmp_path / 'robot.xml', text))


def test_soft_bodies_of_a_file_that_is_not_there_are_left_out_with_file_and_line():
    file = DATA / 'soft_pads.xml'
    assert (f"left out: <flexcomp> 'pad' in {file}, line 10, as there is no file "
            "'pad.obj'; put it there, or correct its name") in load_robot(file).inferred


@pytest.mark.parametrize(('attribute', 'radius'), [
    ('size=0.03', 0.03), ("size= '0.03'", 0.03), ('size =0.03', 0.03),
    ('size=0.03 name="a = b"', 0.03), ('name=a/b size=0.03', 0.03),
    ("name='x =1' size=3e-2 rgba='1 0 0 1'", 0.03)])
def test_values_without_quotes_get_them_and_values_with_quotes_stay(tmp_path, attribute, radius):
    text = (f'<mujoco model=bare><worldbody><body name="base"><geom {attribute}/>'
            '<body name="link" pos="0 0 0.1"><joint name="j" axis="0 1 0" range="-1 1" '
            'limited=true /><geom size=0.02></geom></body></body></worldbody></mujoco>')
    model = load_robot(write(tmp_path / 'bare.xml', text)).compile()
    assert model.geom_size[0, 0] == radius


@pytest.mark.parametrize('attribute', ['size=', 'size', 'size="0.03', 'size=0.03"'])
def test_what_is_no_value_stays_an_error_with_line_and_column(tmp_path, attribute):
    text = f'<mujoco>\n<worldbody>\n<geom {attribute}/></worldbody></mujoco>'
    with pytest.raises(ModelError, match=r'is not well-formed XML: .*: line 3, column \d+; '):
        load_robot(write(tmp_path / 'bare.xml', text))


def test_a_word_that_mujoco_does_not_know_is_told_with_file_line_element_and_remedy(tmp_path):
    file = write(tmp_path / 'robot.xml', (DATA / 'part_of_a_scene.xml').read_text().replace(
        'reftype="site"', 'reftype="world"'))
    with pytest.raises(ModelError) as error:
        load_robot(file)
    assert str(error.value) == (
        f"{file} is not MJCF that MuJoCo can read: {file}, line 21: <framepos>: invalid keyword: "
        "'world': write a word that MuJoCo knows, or delete the attribute")


def test_an_object_with_a_ball_joint_beside_an_arm_is_left_out(tmp_path):
    text = ARM.replace('</worldbody>', '<body name="flail" pos="1 0 1"><freejoint/>'
                       '<geom size="0.1"/><body><joint type="ball"/><geom size="0.1"/></body>'
                       '</body></worldbody>').replace(
        'qpos="0.1 0.2 0.3"', 'qpos="0.1 0.2 0.3 1 0 1 1 0 0 0 1 0 0 0"')
    robot = load_robot(write(tmp_path / 'arm.xml', text))
    assert any("left out: 1 body of the world body ('flail')" in note for note in robot.inferred)
    state = Simulation(compose(robot)).robot.state()
    np.testing.assert_allclose(state.position, [0.1, 0.2, 0.3])
