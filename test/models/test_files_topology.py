# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What a file is by its topology: a hand alone, a torso, a base with a free root, a scene."""

import os
from pathlib import Path

from files_rig import ARM_WITH_HAND, write
import mujoco
import numpy as np
import pytest

from manip_sim.models import compose, load_base, load_gripper, load_robot
from manip_sim.models.files.fingers import Fingers
from manip_sim.simulation import Simulation

FILES = Path(__file__).resolve().parents[1] / 'data/files'
HAND = FILES / 'lone_hand.xml'


def test_a_hand_alone_is_a_robot_that_closes_and_opens():
    robot = load_robot(HAND)
    assert robot.own_hands == ('right',) and robot.arm_joints == []
    assert "right arm ends at body 'case': the file is a hand alone" in robot.inferred
    simulation = Simulation(compose(str(HAND)))
    assert list(simulation.robot.parts) == ['right/gripper']
    assert simulation.start_defects == []
    for action, angle in ((1.0, 0.5), (-1.0, 0.0)):
        simulation.robot.apply(simulation.robot.parse.action('right/gripper', [action] * 3))
        simulation.advance(1000)
        np.testing.assert_allclose(simulation.robot.state().position, angle, atol=0.02)


def test_a_hand_alone_is_a_robot_as_its_own_description_says(tmp_path):
    robot = load_robot(HAND)
    described = robot.described
    assert described['foot'] == [0.0, 0.0, pytest.approx(-0.184, abs=0.005)]
    assert described['arms']['right']['hand']['closing']['a'] == [0.0, 0.5]


def test_two_fingers_with_names_of_fingers_are_a_hand_alone(tmp_path):
    from files_rig import HAND as TWO
    (tmp_path / 'two.xml').write_text(TWO)
    assert load_robot(tmp_path / 'two.xml').own_hands == ('right',)


def test_three_chains_that_are_declared_as_arms_are_no_hand(tmp_path):
    (tmp_path / 'claw.yaml').write_text(f'model: {HAND}\narms: none\n')
    robot = load_robot(tmp_path / 'claw.yaml')
    assert not hasattr(robot, 'own_hands') and len(robot.joints) == 3


def test_what_carries_both_arms_is_the_torso_and_a_table_beside_it_is_left_out():
    file = FILES / 'two_arms_on_a_column.xml'
    robot = load_robot(file)
    assert robot.torso_joints == ['robot0_j1', 'robot0_j2']
    assert "left out: 1 body of the world body ('bench')" in robot.inferred
    parts = Simulation(compose(str(file))).robot.parts
    assert parts['right'].joints == ('robot0_right_j1', 'robot0_right_j2')
    assert parts['left'].joints == ('robot0_left_j1', 'robot0_left_j2')


def test_joints_that_are_declared_stay_of_the_arm(tmp_path):
    (tmp_path / 'column.yaml').write_text(
        f'model: {FILES / "two_arms_on_a_column.xml"}\nsubsystems: {{j1: arm}}\n')
    robot = load_robot(tmp_path / 'column.yaml')
    assert robot.torso_joints == ['robot0_j2'] and 'robot0_j1' in robot.arm_joints


def test_a_base_with_a_free_root_drives_a_robot_on_its_wheels():
    world = compose('UR5e', base=str(FILES / 'rover.xml'))
    simulation = Simulation(world)
    model, robot = simulation.model, simulation.robot
    free = np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE))
    assert model.joint(free[0]).bodyid[0] == model.body('robot0_base').rootid[0]
    chassis = simulation.data.body('mobilebase0_chassis')
    assert chassis.xpos[2] == pytest.approx(0.08)
    wheels = list(robot.parts['base'].joints)
    for command in robot.parse.joint_command(wheels, [], [2.0] * 4, []):
        robot.apply(command)
    simulation.advance(500)
    speed = simulation.data.body('robot0_base').cvel[3]
    assert speed == pytest.approx(2.0 * 0.08, rel=0.05)
    assert chassis.xpos[2] == pytest.approx(0.08, abs=2e-3)


def test_a_robot_with_a_free_root_on_a_free_base_has_one_free_joint(tmp_path):
    floating = ('<mujoco><worldbody><body name="r"><freejoint/><geom size="0.05"/>'
                '<body name="l" pos="0 0 0.2"><joint name="turn" armature="0.1" axis="0 0 1"/>'
                '<geom size="0.05"/></body></body></worldbody></mujoco>')
    (tmp_path / 'floating.xml').write_text(floating)
    base = load_base(FILES / 'rover.xml')
    assert "the robot stands on body 'chassis'" in base.inferred
    model = compose(str(tmp_path / 'floating.xml'), base=base).compile()
    assert (model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)).sum() == 1


ROOT = '<body name="r" pos="0.3 0 0.1" euler="0 0 90">{}</body>'
ARM = ('<geom size="0.05"/><body name="l" pos="0 0 0.2"><joint name="turn" armature="0.1"/>'
       '<geom size="0.05"/></body>')
CAMERAS = ('<camera name="wide" pos="1 2 3" euler="30 0 0" fovy="60" resolution="64 48"/>'
           '<camera name="lost" pos="1 0 1" mode="targetbody" target="ball"/>'
           '<camera name="at" pos="1 0 1" mode="targetbody" target="l"/>'
           '<body name="ball" pos="3 0 0"><freejoint/><geom size="0.1"/></body>')


@pytest.mark.parametrize('beside', ['', '<geom name="plinth" type="box" size="0.1 0.1 0.05"/>'])
def test_cameras_of_the_world_stay_where_they_are_on_the_root(tmp_path, beside):
    file = tmp_path / 'arm.xml'
    file.write_text(f'<mujoco><worldbody>{beside}{CAMERAS}{ROOT.format(ARM)}</worldbody></mujoco>')
    robot = load_robot(file)
    assert "cameras of the world body on the root: 'wide', 'at'" in robot.inferred
    assert robot.cameras == ['robot0_wide', 'robot0_at']
    bare = mujoco.MjSpec.from_file(str(file)).compile()
    model = robot.compile()
    found, expected = mujoco.MjData(model), mujoco.MjData(bare)
    mujoco.mj_kinematics(model, found)
    mujoco.mj_kinematics(bare, expected)
    for data, of in ((found, model), (expected, bare)):
        mujoco.mj_camlight(of, data)
    for name in ('wide', 'at'):
        np.testing.assert_allclose(found.camera(f'robot0_{name}').xpos,
                                   expected.camera(name).xpos, atol=1e-9)
        np.testing.assert_allclose(found.camera(f'robot0_{name}').xmat,
                                   expected.camera(name).xmat, atol=1e-6)
    wide = model.camera('robot0_wide').id
    assert model.cam_fovy[wide] == 60.0 and model.cam_resolution[wide].tolist() == [64, 48]


def test_cameras_of_the_world_are_left_out_where_the_root_is_free(tmp_path):
    file = tmp_path / 'rover.xml'
    file.write_text('<mujoco><worldbody><camera name="wide" pos="1 2 3"/>'
                    f'{ROOT.format("<freejoint/>" + ARM)}</worldbody></mujoco>')
    robot = load_robot(file)
    assert robot.cameras == []
    assert "left out: 1 camera of the world body ('wide')" in robot.inferred


def test_a_rod_beside_a_longer_chain_is_no_second_arm(tmp_path):
    joint = '<joint name="{0}" armature="0.1"/><geom size="0.02"/>'
    rod = (f'<body name="rod">{joint.format("rod1")}'
           f'<body name="tip">{joint.format("rod2")}</body></body>')
    arm = f'<body name="x">{joint.format("x")}<body name="y">{joint.format("y")}' \
        f'<body name="z">{joint.format("z")}</body></body></body>'
    (tmp_path / 'arm.xml').write_text('<mujoco><worldbody><body name="foot">'
                                      f'<geom size="0.1"/>{arm}{rod}</body></worldbody></mujoco>')
    robot = load_robot(tmp_path / 'arm.xml')
    assert robot.arm_joints == ['robot0_x', 'robot0_y', 'robot0_z']


@pytest.mark.parametrize('load', [load_robot, load_gripper])
def test_fingers_that_cannot_touch_an_object_are_told_where_they_are(load, tmp_path):
    file = FILES / 'ghost_hand.xml'
    told = [note for note in told_by(load(file)) if 'can touch an object' in note]
    assert told == ['no shape of the fingers (left_finger, right_finger) can touch an object: '
                    f'give them collision shapes, with contype and conaffinity 1, in {file}']
    seen = tmp_path / 'seen.xml'
    # A shape that is touched by others, but touches none by itself, holds an object.
    seen.write_text(file.read_text().replace('conaffinity="0"', 'conaffinity="1"'))
    assert not any('can touch an object' in note for note in told_by(load(seen)))


def test_a_hand_that_was_loaded_before_is_tried_again_only_if_a_mesh_has_changed(
        tmp_path, monkeypatch):
    calls = []
    for name in ('closing', 'grasp_point'):
        method = getattr(Fingers, name)
        monkeypatch.setattr(Fingers, name, lambda *args, name=name, method=method: (
            calls.append(name), method(*args))[1])
    text = ARM_WITH_HAND.replace('</mujoco>', '<asset><mesh file="pad.obj"/></asset></mujoco>')
    for side in ('left', 'right'):
        text = text.replace(f'"{side}_pad" type="box" size="0.01 0.004 0.02"',
                            f'"{side}_pad" type="mesh" mesh="pad"')
    file = write(tmp_path / 'arm.xml', text)

    def grasp_height(top):
        corners = [f'v {x} {y} {z}' for x in (-0.01, 0.01) for y in (-0.004, 0.004)
                   for z in (0.0, top)]
        faces = ['f 1 2 4 3', 'f 5 7 8 6', 'f 1 5 6 2', 'f 3 4 8 7', 'f 1 3 7 5', 'f 2 6 8 4']
        write(tmp_path / 'pad.obj', '\n'.join([*corners, *faces]))
        hand, = load_robot(file).grippers.values()
        assert hand.closing == {'pull': [255.0, 0.0]}
        return hand.grasp_point.position[2]

    assert grasp_height(0.02) == pytest.approx(0.06)
    os.utime(tmp_path / 'pad.obj', ns=(0, 10**18))
    calls.clear()
    heights = [load_robot(file).grippers['right'].grasp_point.position[2] for _ in range(2)]
    assert heights == pytest.approx([0.06, 0.06]) and calls == ['grasp_point', 'closing']
    calls.clear()
    assert grasp_height(0.2) == pytest.approx(0.15) and calls == ['grasp_point', 'closing']


def told_by(model):
    """Return what was inferred of a hand, or of the hands of a robot."""
    hands = [model] if not hasattr(model, 'grippers') else model.grippers.values()
    return [note for hand in hands for note in hand.inferred]


def test_masses_that_come_from_shapes_in_all_bodies_load_and_stay(tmp_path):
    text = """
<mujoco><compiler inertiafromgeom="true"/><worldbody><body name="base"><geom size="0.1"/>
  <body name="link" pos="0 0 0.2"><inertial pos="0 0 0" mass="9" diaginertia="1 1 1"/>
  <joint name="turn" axis="0 1 0"/><geom type="capsule" size="0.03" fromto="0 0 0 0 0 0.3"/>
  <geom name="cover" size="0.05" contype="0" conaffinity="0"/></body></body></worldbody>
  <actuator><position joint="turn" kp="100"/></actuator></mujoco>"""
    file = tmp_path / 'arm.xml'
    file.write_text(text)
    bare = mujoco.MjModel.from_xml_path(str(file))
    model = compose(load_robot(file)).compile(visual=False)
    assert model.body('robot0_link').mass[0] == pytest.approx(bare.body('link').mass[0])
    assert bare.body('link').mass[0] != pytest.approx(9.0, rel=0.1)


def test_long_fingers_on_a_wrist_are_a_hand(tmp_path):
    finger = ('<body name="{0}1" pos="{1} 0 0.1">' + ''.join(
        f'<joint name="{{0}}j{i}" axis="0 1 0"/><geom size="0.01"/>'
        f'<body name="{{0}}{i + 2}" pos="0 0 0.05">' for i in range(3))
        + '<geom size="0.01"/>' + '</body>' * 4)
    fingers = ''.join(finger.format(*one) for one in (('ff', -0.03), ('mf', 0.0), ('rf', 0.03)))
    (tmp_path / 'hand.xml').write_text(f"""
<mujoco><worldbody><body name="forearm"><geom size="0.05"/>
  <body name="palm" pos="0 0 0.2"><joint name="wr0" axis="0 1 0"/><joint name="wr1" axis="1 0 0"/>
  <geom size="0.04"/>{fingers}</body></body></worldbody></mujoco>""")
    text = (tmp_path / 'hand.xml').read_text()
    other = ''.join(f'<joint name="object{axis}" type="slide" axis="{axis}"/>'
                    for axis in ('1 0 0', '0 1 0', '0 0 1'))
    (tmp_path / 'turned.xml').write_text(text.replace(
        '</worldbody>', f'<body name="object">{other}<geom size="0.02"/></body></worldbody>'))
    (tmp_path / 'lifted.xml').write_text(text.replace('wr0', 'shoulder_lift'))
    assert load_robot(tmp_path / 'lifted.xml').arm_joints == ['robot0_shoulder_lift', 'robot0_wr1']
    for file in ('hand.xml', 'turned.xml'):
        robot = load_robot(tmp_path / file)
        assert robot.arm_joints == ['robot0_wr0', 'robot0_wr1']
        assert len(robot.grippers['right'].joints) == 9
        assert len(robot.joints_of('other')) == (3 if file == 'turned.xml' else 0)


def test_two_hands_of_one_arm_are_one_gripper_and_a_line_takes_one_of_them(tmp_path):
    file = FILES / 'two_hands.xml'
    robot = load_robot(file)
    assert len(robot.grippers['right'].joints) == 4
    assert ("right hand: the fingers on 'front', 'rear' are one gripper; arms: {right: {hand: "
            "front}} in a YAML file takes one of them, and the joints of the others become the "
            "part 'other'") in robot.inferred
    (tmp_path / 'arm.yaml').write_text(f'model: {file}\narms: {{right: {{hand: front}}}}\n')
    robot = load_robot(tmp_path / 'arm.yaml')
    assert robot.grippers['right'].joints == ['robot0_front_finger1', 'robot0_front_finger2']
    assert robot.other_joints == ['robot0_rear_finger1', 'robot0_rear_finger2']
    assert not any('one gripper' in said for said in robot.inferred)


def test_gravity_of_the_file_of_a_robot_is_left_behind_and_an_arena_sets_it(tmp_path):
    robot = load_robot(FILES / 'two_hands.xml')
    option = '<option gravity="0 0 -1.62"/>'
    assert (f'left behind: the gravity of the file, 0 0 -1.62 m/s^2; {option} in the MJCF file of '
            'an arena sets that of its worlds') in robot.inferred
    assert compose(robot).compile().opt.gravity[2] == -9.81
    (tmp_path / 'moon.xml').write_text(
        f'<mujoco>{option}<worldbody><geom type="plane" size="1 1 1"/></worldbody></mujoco>')
    assert compose(FILES / 'two_hands.xml', arena=tmp_path / 'moon.xml').compile(
        ).opt.gravity[2] == -1.62
    assert not any('gravity' in said for said in load_robot(FILES / 'rover.xml').inferred)


def test_several_roots_with_sizes_of_user_data_are_one_robot_without_a_warning(tmp_path):
    text = (FILES / 'two_hands.xml').read_text()
    rack = ('<body name="rack" pos="1 0 0.5"><joint name="rack" axis="1 0 0"/>'
            '<geom size="0.1"/></body>')
    (tmp_path / 'arm.xml').write_text(
        text.replace('<worldbody>', f'<size nuser_body="9"/><worldbody>{rack}'))
    robot = load_robot(tmp_path / 'arm.xml')
    assert "new root body 'root' that holds 'rack', 'base'" in robot.inferred
    assert robot.compile().njnt == 7


def parts_of(file):
    """Return the number of joints by part."""
    parts = Simulation(compose(str(file))).robot.parts
    return {name: len(part.joints) for name, part in parts.items() if part.atomic == (name,)}


def test_each_of_two_arms_has_a_hand_where_only_its_branches_say_so():
    assert parts_of(FILES / 'two_unnamed_hands.xml') == {
        'torso': 1, 'right': 3, 'left': 3, 'right/gripper': 6, 'left/gripper': 6}


def test_arms_without_sides_in_their_names_have_those_of_their_places():
    file = FILES / 'two_arms_without_sides.urdf'
    assert parts_of(file) == {'right': 4, 'left': 4, 'right/gripper': 2, 'left/gripper': 2}
    robot = load_robot(file)
    assert robot.eef_name == {'right': 'robot0_unit_1_link4', 'left': 'robot0_unit_2_link4'}
    assert any('have no side' in sentence for sentence in robot.inferred)


def test_a_floating_robot_loads_without_the_furniture_and_objects_beside_it():
    file = FILES / 'floating_beside_a_shelf.xml'
    assert parts_of(file) == {'arm': 2}
    assert "left out: 2 bodies of the world body ('shelf', 'book')" in load_robot(file).inferred


def test_a_letter_in_the_name_of_a_robot_is_no_side(tmp_path):
    text = (FILES / 'two_unnamed_hands.xml').read_text().replace('name="', 'name="r2/')
    (tmp_path / 'r2.xml').write_text(text.replace('_zero', '_thumb'))
    assert parts_of(tmp_path / 'r2.xml') == {
        'torso': 1, 'right': 3, 'left': 3, 'right/gripper': 6, 'left/gripper': 6}


LIMB = '<body name="{0}1"><joint name="{0}1" axis="0 1 0"/><geom size="0.02"/>{1}</body>'


def test_chains_that_branch_again_are_not_the_fingers_of_a_hand_alone(tmp_path):
    branching = LIMB.format('a', LIMB.format('b', '') + LIMB.format('c', ''))
    limbs = branching + LIMB.format('d', '') + LIMB.format('e', '')
    (tmp_path / 'body.xml').write_text(
        f'<mujoco><worldbody><body name="root"><geom size="0.1"/>{limbs}</body></worldbody>'
        '</mujoco>')
    assert not hasattr(load_robot(tmp_path / 'body.xml'), 'own_hands')


def test_a_single_joint_beside_those_of_a_base_is_no_arm(tmp_path):
    limbs = ''.join([LIMB.format('tilt', LIMB.format('wheel_c', '')), *(
        LIMB.format(name, '') for name in ('laser', 'wheel_a', 'wheel_b'))])
    (tmp_path / 'cart.xml').write_text(
        f'<mujoco><worldbody><body name="root"><geom size="0.1"/>{limbs}</body></worldbody>'
        '</mujoco>')
    assert parts_of(tmp_path / 'cart.xml') == {'base': 4, 'other': 1}


def test_joints_beside_a_floating_robot_are_left_out_with_their_actuators(tmp_path):
    text = (FILES / 'floating_beside_a_shelf.xml').read_text()
    text = text.replace('</worldbody>', LIMB.format('unused', '') + '</worldbody>').replace(
        '</actuator>', '<position joint="unused1" kp="1000" kv="10"/></actuator>')
    (tmp_path / 'robot.xml').write_text(text)
    robot = load_robot(tmp_path / 'robot.xml')
    assert parts_of(tmp_path / 'robot.xml') == {'arm': 2}
    assert robot.compile().nu == 2 and robot.joints == ['robot0_shoulder', 'robot0_elbow']
    assert any("'unused1'" in sentence for sentence in robot.inferred)
