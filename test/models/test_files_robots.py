# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of robots from MJCF files that nobody wrote for this package: what is inferred of them."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from files_rig import ARM, arm_of, ARM_WITH_HAND, TWO_ARMS, write

from manip_sim.errors import ModelError
from manip_sim.models import compose, compose_robot, load_robot
from manip_sim.models.files.body_tree import BodyTree
from manip_sim.models.files.model_file import read_model
from manip_sim.models.files.part_descriptions import Description
from manip_sim.models.grippers import PandaGripper
from manip_sim.models.robots import ManipulatorModel, RobotModel
from manip_sim.models.spec_edits import free_name
from manip_sim.simulation import Simulation


def test_an_arm_has_the_joints_actuators_and_start_of_its_file(tmp_path):
    robot = load_robot(write(tmp_path / 'arm.xml', ARM))
    assert isinstance(robot, ManipulatorModel)
    assert robot.name == 'arm0'
    assert robot.arm_joints == ['robot0_turn', 'robot0_lift', 'robot0_bend']
    assert robot.arm_actuators == ['robot0_turn', 'robot0_lift', 'robot0_bend']
    np.testing.assert_allclose(robot.init_qpos, [0.1, 0.2, 0.3])
    np.testing.assert_allclose(robot.format_action('arm', [-1.0, 1.0, 0.0]), [-1.5, 1.5, 0.5])
    assert any("keyframe 'home'" in sentence for sentence in robot.inferred)


def test_a_gripper_hangs_where_the_attachment_site_is(tmp_path):
    file = write(tmp_path / 'arm.xml', ARM)
    original = mujoco.MjModel.from_xml_path(str(file))
    expected = mujoco.MjData(original)
    mujoco.mj_resetDataKeyframe(original, expected, 0)
    mujoco.mj_forward(original, expected)
    world = compose(file, 'PandaGripper')
    model = world.compile()
    data = mujoco.MjData(model)
    for joint, position in world.init_qpos().items():
        data.joint(joint).qpos[0] = position
    mujoco.mj_forward(model, data)
    hand = data.body('robot0_right_hand')
    site = expected.site('attachment_site')
    np.testing.assert_allclose(hand.xpos, site.xpos, atol=1e-9)
    np.testing.assert_allclose(hand.xmat, site.xmat, atol=1e-9)


def test_what_is_no_robot_is_left_out_and_said(tmp_path):
    robot = load_robot(write(tmp_path / 'arm.xml', ARM))
    said = ' '.join(robot.inferred)
    model = robot.compile()
    assert (model.nlight, model.ncam) == (0, 1)
    assert 'floor' not in [model.geom(i).name for i in range(model.ngeom)]
    for what in ("1 light of the world body ('top')", "1 ground of the world body ('floor')"):
        assert f'left out: {what}' in said


@pytest.mark.parametrize(('name', 'subsystem'), [
    ('fl_hx', 'legs'), ('left_hip_pitch_joint', 'legs'), ('FR_calf_joint', 'legs'),
    ('LF_HAA', 'legs'), ('neck_yaw', 'head'), ('wheel_left_joint', 'base'),
    ('joint_torso', 'torso'), ('shoulder_pan', 'arm'), ('lfemurrx', 'legs'), ('bthigh', 'legs'),
    ('headrx', 'head'), ('lwristry', 'arm'), ('lwheel', 'base'), ('forelimb', 'arm')])
def test_names_of_other_models_tell_the_subsystem(tmp_path, name, subsystem):
    robot = load_robot(write(tmp_path / 'arm.xml', ARM.replace('"turn"', f'"{name}"')))
    assert robot.joints_of(subsystem)[0] == f'robot0_{name}'


def test_the_name_of_a_ball_joint_tells_its_subsystem_but_not_that_of_a_free_joint(tmp_path):
    robot = load_robot(write(tmp_path / 'dog.xml', """
<mujoco><worldbody><body name="trunk" pos="0 0 0.5"><freejoint name="neck"/><geom size="0.1"/>
  <body name="thigh" pos="0 0 -0.3"><joint name="hip" type="ball"/><geom size="0.05"/>
    <body name="shank" pos="0 0 -0.1"><joint name="knee"/><geom size="0.05"/></body></body></body>
  </worldbody><actuator><motor joint="knee"/></actuator></mujoco>"""))
    assert robot.legs_joints == ['robot0_hip', 'robot0_knee']
    assert 'legs: hip, knee' in robot.inferred
    assert not any(said.startswith('head') for said in robot.inferred)


def test_a_waist_is_of_the_arm_where_it_moves_nothing_else(tmp_path):
    robot = load_robot(write(tmp_path / 'arm.xml', ARM.replace('"turn"', '"waist"')))
    assert robot.arm_joints[0] == 'robot0_waist'


@pytest.mark.parametrize(('limits', 'start'), [
    ('1 2', 1.5), ('-2 -1', -1.5), ('0 1', 0.0), ('-1 0', 0.0)])
def test_zero_outside_a_range_starts_inside_of_it(tmp_path, limits, start):
    text = ARM[:ARM.index('<keyframe>')] + '</mujoco>'
    robot = load_robot(write(tmp_path / 'arm.xml',
                             text.replace('range="0 1"', f'range="{limits}"')))
    np.testing.assert_allclose(robot.init_qpos, [0.0, 0.0, start])
    said = ', and the middle of the range for bend' if start else ''
    assert f'start pose: zero{said}' in robot.inferred


@pytest.mark.parametrize(('limits', 'start'), [
    ('0 1', 0.25), ('-1 0', -0.25), ('-0.08 1.92', 0.42), ('-1.92 0.08', -0.42),
    # Farther than a twentieth of the range from its end, so only the middle is another pose.
    ('-0.1 1.9', 0.9), ('-1.9 0.1', -0.9)])
def test_a_start_in_which_links_overlap_is_avoided(tmp_path, limits, start):
    text = ARM[:ARM.index('<keyframe>')].replace('range="0 1"', f'range="{limits}"') + '</mujoco>'
    # At zero the last link lies on the first one.
    text = text.replace('pos="0 0 0.2" euler="0 0 0.5"', 'pos="0 0 0.2" euler="0 3.1 0"')
    robot = load_robot(write(tmp_path / 'arm.xml', text.replace('0 0 0.07"', '0 0 0.3"')))
    assert robot.init_qpos[2] == pytest.approx(start)
    assert any('because links overlap at zero' in said for said in robot.inferred)


def test_an_own_hand_is_the_gripper_of_its_arm(tmp_path):
    robot = load_robot(write(tmp_path / 'arm.xml', ARM_WITH_HAND))
    hand = robot.grippers['right']
    assert robot.arm_joints == ['robot0_turn', 'robot0_lift', 'robot0_bend']
    assert hand.joints == ['robot0_left_finger', 'robot0_right_finger']
    assert hand.actuators == ['robot0_pull']
    assert robot.eef_name == {'right': 'robot0_palm'}
    np.testing.assert_allclose(hand.init_qpos, [0.01, 0.01])
    # A greater control lengthens the tendon, which opens.
    np.testing.assert_allclose(hand.format_action([1.0]), [-1.0])
    np.testing.assert_allclose(hand.format_action([-1.0]), [1.0])
    assert robot.compile().site(hand.important_sites['grip_site']).pos.shape == (3,)


def test_the_grasp_frame_of_an_own_hand_is_between_its_fingertips(tmp_path):
    world = compose(write(tmp_path / 'arm.xml', ARM_WITH_HAND))
    model = world.compile()
    data = mujoco.MjData(model)
    for joint, position in world.init_qpos().items():
        data.joint(joint).qpos[0] = position
    mujoco.mj_forward(model, data)
    tips = [data.geom(f'robot0_{side}_pad').xpos for side in ('left', 'right')]
    grip = world.robots[0].grippers['right'].important_sites['grip_site']
    np.testing.assert_allclose(data.site(grip).xpos, np.mean(tips, axis=0), atol=1e-9)


@pytest.mark.parametrize('gripper', ['none', 'PandaGripper'])
def test_an_own_hand_goes_when_another_gripper_or_none_is_wanted(tmp_path, gripper):
    text = ARM_WITH_HAND.replace('<geom name="palm"', '<inertial mass="0.4" pos="0 0 0" '
                                 'diaginertia="1e-3 1e-3 1e-3"/><geom name="palm"')
    file = write(tmp_path / 'arm.xml', text)
    robot = compose_robot(file, gripper)
    model = robot.compile()
    names = [model.joint(i).name for i in range(model.njnt)]
    assert not any('robot0' in name and 'finger' in name for name in names)
    assert model.body('robot0_palm').mass[0] == 0.0
    assert [type(g) for g in robot.grippers.values()] == [PandaGripper] * (gripper != 'none')
    expected = mujoco.MjModel.from_xml_path(str(file))
    # Nothing else of the arm is gone.
    np.testing.assert_allclose(model.body('robot0_link3').mass, expected.body('link3').mass)


@pytest.mark.parametrize('side', ['right', 'left'])
def test_one_own_hand_of_two_goes_and_the_other_stays_as_it_is(tmp_path, side):
    file = write(tmp_path / 'pair.xml', TWO_ARMS)
    other = {'right': 'left', 'left': 'right'}[side]
    before = load_robot(file).grippers[other]
    robot = load_robot(file)
    robot.add_gripper(PandaGripper(), side)
    after = robot.grippers[other]
    assert (after.joints, after.actuators) == (before.joints, before.actuators)
    np.testing.assert_allclose(after.init_qpos, before.init_qpos)
    np.testing.assert_allclose(after.format_action([1.0]), before.format_action([1.0]))
    # Four of the arms, one of the hand that stays, two of the Panda's.
    assert robot.compile().nu == 7


@pytest.mark.parametrize(('gripper', 'actuators'), [
    ('none', 4), ({'left': 'none'}, 5), ({'right': 'none'}, 5), ('PandaGripper', 8)])
def test_own_hands_of_two_arms_go_where_others_or_none_are_wanted(tmp_path, gripper, actuators):
    robot = compose_robot(write(tmp_path / 'pair.xml', TWO_ARMS), gripper)
    assert robot.compile().nu == actuators


def test_two_arms_with_roots_of_their_own_are_one_robot(tmp_path):
    robot = load_robot(write(tmp_path / 'pair.xml', TWO_ARMS))
    assert robot.arm_type == 'bimanual'
    assert robot.eef_name == {'right': 'robot0_right/palm', 'left': 'robot0_left/palm'}
    assert robot.root_body == 'robot0_root'
    assert any("new root body 'root'" in sentence for sentence in robot.inferred)
    robot.set_base_xpos([1.0, 0.0, 0.0])
    model = robot.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.body('robot0_left/base').xpos, [1.0, 0.4, 0.0])


@pytest.mark.parametrize(('taken', 'name'), [
    (('root', 'elbow'), 'root1'), (('root', 'root1'), 'root2'), (('root1', 'root2'), 'root')])
def test_a_new_root_has_a_name_that_no_body_has(tmp_path, taken, name):
    text = TWO_ARMS
    for side, body in zip(('left', 'right'), taken):
        text = text.replace(f'"{side}/upper"', f'"{body}"')
    robot = load_robot(write(tmp_path / 'pair.xml', text))
    assert robot.root_body == f'robot0_{name}'
    assert set(robot.bodies) >= {f'robot0_{body}' for body in taken}


def without_arms(file, count):
    """Return whether a robot is loaded without arms, and says what to write for them."""
    robot = load_robot(file)
    told = [s for s in robot.inferred if s.startswith(f'no arms: {count} chains of joints')]
    return (not isinstance(robot, ManipulatorModel) and len(told) == 1
            and "declare 'arms'" in told[0] and len(robot.joints_of('other')) >= count)


@pytest.mark.parametrize(('one', 'two', 'right', 'why'), [
    ('0 0.4 0', '0 -0.4 0', 'two', 'left is the one that stands further left, along y'),
    ('0.4 0 0', '-0.4 0 0', 'one', 'right is the one in front, along x'),
    ('0 0 0', '0 0 0.5', 'two', 'right is the upper one'),
    ('0 0 0', '0 0 0', 'one', 'right is the one that comes first in the file')])
def test_two_arms_without_sides_are_told_apart_by_their_places(tmp_path, one, two, right, why):
    text = TWO_ARMS.replace('left/', 'one/').replace('right/', 'two/')
    text = text.replace('pos="0 0.4 0"', f'pos="{one}"').replace('pos="0 -0.4 0"', f'pos="{two}"')
    robot = load_robot(write(tmp_path / 'pair.xml', text))
    left = {'one': 'two', 'two': 'one'}[right]
    assert robot.eef_name == {'right': f'robot0_{right}/tip', 'left': f'robot0_{left}/tip'}
    assert [said for said in robot.inferred if why in said and (
        f'arms: {{right: {{mount: {left}/tip}}, left: {{mount: {right}/tip}}}}' in said)]


def test_names_that_differ_in_their_first_letter_have_sides_whatever_their_places(tmp_path):
    text = TWO_ARMS.replace('left/', 'raxis/').replace('right/', 'laxis/')
    robot = load_robot(write(tmp_path / 'pair.xml', text))
    assert robot.eef_name == {'right': 'robot0_raxis/palm', 'left': 'robot0_laxis/palm'}


def test_three_arms_without_sides_are_no_arms_and_it_says_what_to_write(tmp_path):
    text = TWO_ARMS.replace('left/', 'one/').replace('right/', 'two/')
    third = arm_of('three', 0.0)
    assert without_arms(write(tmp_path / 'trio.xml', text.replace(
        '</worldbody>', f'{third}</worldbody>')), 3)


@pytest.mark.parametrize('elbow', [True, False])
def test_of_two_chains_of_one_side_the_longer_one_is_the_arm_if_there_is_one(tmp_path, elbow):
    small = arm_of('small_right', 0.0)
    if not elbow:
        small = small.replace('<joint name="small_right/elbow" axis="0 1 0"/>', '')
    file = write(tmp_path / 'trio.xml', TWO_ARMS.replace('</worldbody>', f'{small}</worldbody>'))
    if elbow:
        assert without_arms(file, 3)
    else:
        assert load_robot(file).eef_name['right'].startswith('robot0_right/')


def test_what_has_no_joints_is_no_robot(tmp_path):
    with pytest.raises(ModelError, match='rock.xml is not a robot: it has no hinge or slide'):
        load_robot(write(tmp_path / 'rock.xml', '<mujoco><worldbody><body><freejoint/>'
                                                '<geom size="1"/></body></worldbody></mujoco>'))


def test_legs_alone_are_a_robot_without_arms(tmp_path):
    robot = load_robot(write(tmp_path / 'dog.xml', """
<mujoco><worldbody><body name="trunk" pos="0 0 0.5"><freejoint/><geom size="0.1"/>
  <body name="leg"><joint name="fl_hx"/><geom size="0.05"/></body></body></worldbody>
  <actuator><motor joint="fl_hx"/></actuator>
  <keyframe><key name="home" qpos="0 0 0.4 1 0 0 0 0.1"/></keyframe></mujoco>"""))
    assert isinstance(robot, RobotModel) and not isinstance(robot, ManipulatorModel)
    assert robot.legs_joints == ['robot0_fl_hx']
    np.testing.assert_allclose(robot.compile().qpos0[:3], [0.0, 0.0, 0.4])


@pytest.mark.parametrize('keyframe', [
    '', '<keyframe><key name="home" qpos="0 0 -1 1 0 0 0 0"/></keyframe>'])
def test_a_free_robot_that_was_made_for_another_floor_is_raised(tmp_path, keyframe):
    robot = load_robot(write(tmp_path / 'dog.xml', f"""
<mujoco><worldbody><body name="trunk" pos="0 0 -0.2"><freejoint/><geom size="0.1"/>
  <body name="leg"><joint name="fl_hx"/><geom size="0.05" pos="0 0 -0.3"/></body></body>
  </worldbody>
  <actuator><motor joint="fl_hx"/></actuator>{keyframe}</mujoco>"""))
    np.testing.assert_allclose(robot.compile().qpos0[2], 0.35)
    assert any('so that it stands on the floor' in sentence for sentence in robot.inferred)


def test_a_free_robot_that_stands_a_little_low_is_not_raised(tmp_path):
    robot = load_robot(write(tmp_path / 'dog.xml', """
<mujoco><worldbody><body name="trunk" pos="0 0 0.0999"><freejoint/><geom size="0.1"/>
  <body name="leg"><joint name="fl_hx"/><geom size="0.05"/></body></body></worldbody>
  <actuator><motor joint="fl_hx"/></actuator></mujoco>"""))
    assert not any('stands on the floor' in sentence for sentence in robot.inferred)
    assert robot.compile().body(robot.root_body).pos[2] == pytest.approx(0.0999)


def test_an_object_beside_the_robot_is_left_out(tmp_path):
    text = ARM.replace('<worldbody>', '<worldbody><body name="cube" pos="1 0 0.1"><freejoint/>'
                                      '<geom size="0.02"/></body>')
    text = text.replace('qpos="', 'qpos="0 0 0 1 0 0 0 ')
    robot = load_robot(write(tmp_path / 'arm.xml', text))
    assert 'robot0_cube' not in robot.bodies
    np.testing.assert_allclose(robot.init_qpos, [0.1, 0.2, 0.3])


def test_a_base_and_its_first_link_may_overlap_where_they_start(tmp_path):
    text = ARM.replace('<joint name="turn"', '<geom size="0.095" mass="0.1"/><joint name="turn"')
    text = text.replace('<joint name="lift"', '<geom size="0.29" mass="0.1"/><joint name="lift"')
    robot = load_robot(write(tmp_path / 'arm.xml', text))
    assert "'base' and 'link1' overlap at the start, so they do not collide" in robot.inferred
    data = mujoco.MjData(robot.compile())
    mujoco.mj_forward(data.model, data)
    # The second link reaches into the base too, which is said to nobody but left as it is.
    bodies = {tuple(sorted(data.model.body(data.model.geom_bodyid[geom]).name
                           for geom in contact.geom)) for contact in data.contact}
    assert bodies == {('robot0_base', 'robot0_link2')}


@pytest.mark.parametrize('extra', [
    '<motor name="extra" joint="turn"/>',
    # Its bias is not used, and the other pushes away from what it is given.
    '<general name="extra" joint="turn" gainprm="9" biastype="none" biasprm="0 -9"/>',
    '<general name="extra" joint="turn" gainprm="-9" biastype="affine" biasprm="0 -9"/>'])
def test_of_two_actuators_on_a_joint_the_servo_stays(tmp_path, extra):
    text = ARM.replace('<actuator>', f'<actuator>{extra}')
    text = text.replace(' ctrl="', ' ctrl="0 ')
    robot = load_robot(write(tmp_path / 'arm.xml', text))
    assert robot.arm_actuators == ['robot0_turn', 'robot0_lift', 'robot0_bend']
    assert any("actuator 'extra' is left out" in sentence for sentence in robot.inferred)


def test_a_tendon_over_tied_joints_is_driven_by_one_of_them(tmp_path):
    text = ARM.replace('<actuator>', """<equality><joint joint1="bend" joint2="lift"/></equality>
  <tendon><fixed name="both"><joint joint="lift" coef="0.5"/><joint joint="bend" coef="1"/></fixed>
  </tendon><actuator>""")
    text = text.replace('name="bend" joint="bend" kp', 'name="bend" tendon="both" kp')
    text = text.replace('<position name="lift" joint="lift" kp="900" kv="60" '
                        'ctrlrange="-1.5 1.5"/>', '').replace(' ctrl="0.1 0.2 0.3"', '')
    robot = load_robot(write(tmp_path / 'arm.xml', text))
    assert robot.arm_actuators == ['robot0_turn', 'robot0_bend']
    model = robot.compile()
    actuator = model.actuator('robot0_bend')
    assert model.joint(actuator.trnid[0]).name == 'robot0_lift'
    assert actuator.gear[0] == pytest.approx(1.5)


@pytest.mark.parametrize('motor', ['<motor', '<general biastype="none" biasprm="0 -9 -9"'])
def test_a_light_joint_with_a_strong_motor_gets_rotor_inertia(tmp_path, motor):
    text = ARM.replace(' armature="0.1"', '')
    text = text.replace('<position name="bend" joint="bend" kp="900" kv="60" ctrlrange="0 1"/>',
                        f'{motor} name="bend" joint="bend" ctrlrange="-100 100"/>')
    robot = load_robot(write(tmp_path / 'arm.xml', text))
    model = robot.compile()
    np.testing.assert_allclose(model.dof_armature[1:], [0.0, 100.0 / 5000.0])
    assert any('too light for their actuators' in line and 'bend' in line
               for line in robot.inferred)
    damped = text.replace('joint="turn" kp="900" kv="60"', 'joint="turn" kp="900" kv="3000"')
    model = load_robot(write(tmp_path / 'damped.xml', damped)).compile()
    np.testing.assert_allclose(model.dof_armature[0], 0.1)
    weak = load_robot(write(tmp_path / 'weak.xml', text.replace('-100 100', '-1 1')))
    np.testing.assert_allclose(weak.compile().dof_armature[1:], np.zeros(2))


def test_a_root_on_rails_is_a_base(tmp_path):
    rails = ''.join(
        f'<joint name="joint_{name}" type="{kind}" axis="{axis}"/>' for name, kind, axis in
        (('x', 'slide', '1 0 0'), ('y', 'slide', '0 1 0'), ('th', 'hinge', '0 0 1')))
    text = ARM.replace('<geom name="foot"', f'{rails}<geom name="foot"')
    text = text.replace('qpos="', 'qpos="0 0 0 ')
    robot = load_robot(write(tmp_path / 'arm.xml', text))
    assert robot.base_joints == ['robot0_joint_x', 'robot0_joint_y', 'robot0_joint_th']
    assert len(robot.arm_joints) == 3


@pytest.mark.parametrize('joints', [
    {'rail_x': 'slide'}, {'pan': 'hinge', 'tilt': 'hinge'}, {'rail_x': 'slide', 'lean': 'hinge'}],
    ids=list)
def test_a_root_on_one_rail_or_on_joints_of_other_names_is_of_the_arm(tmp_path, joints):
    axes = ('1 0 0', '0 1 0')
    text = ARM.replace('<geom name="foot"', ''.join(
        f'<joint name="{name}" type="{kind}" axis="{axis}"/>'
        for (name, kind), axis in zip(joints.items(), axes)) + '<geom name="foot"')
    text = text.replace('qpos="', 'qpos="' + '0 ' * len(joints))
    robot = load_robot(write(tmp_path / 'arm.xml', text))
    assert robot.base_joints == []
    assert robot.arm_joints[:len(joints)] == [f'robot0_{name}' for name in joints]


@pytest.mark.parametrize('base', ['none', 'OmronMobileBase'])
def test_an_actuator_of_a_plugin_is_of_no_part_and_keeps_its_plugin(tmp_path, base):
    text = ARM.replace('<actuator>', """<extension><plugin plugin="mujoco.pid"/></extension>
    <actuator><plugin name="pid" joint="lift" plugin="mujoco.pid"><config key="kp" value="40"/>
    </plugin>""")
    robot = compose_robot(write(tmp_path / 'arm.xml', text.replace(' ctrl="', ' ctrl="0 ')),
                          base=base)
    assert robot.arm_actuators == ['robot0_turn', 'robot0_lift', 'robot0_bend']
    simulation = Simulation(compose(robot, base=None))
    assert simulation.surroundings.other_actuators == ('robot0_pid',)
    pid = simulation.model.actuator('robot0_pid').id
    assert np.flatnonzero(simulation.model.actuator_plugin >= 0).tolist() == [pid]
    start = float(simulation.data.joint('robot0_lift').qpos[0])
    simulation.data.ctrl[pid] = start + 0.5
    mujoco.mj_forward(simulation.model, simulation.data)
    assert simulation.data.actuator_force[pid] == pytest.approx(20.0)


def test_actuators_that_are_no_servos_of_a_joint_are_of_no_part(tmp_path):
    text = ARM.replace('<actuator>', """<tendon><fixed name="both">
    <joint joint="lift" coef="0.5"/><joint joint="bend" coef="1"/></fixed></tendon><actuator>
    <position name="cable" tendon="both" kp="100"/><muscle name="muscle" joint="lift"/>""")
    robot = load_robot(write(tmp_path / 'arm.xml', text.replace(' ctrl="', ' ctrl="0 0 ')))
    assert robot.arm_actuators == ['robot0_turn', 'robot0_lift', 'robot0_bend']
    assert ("neither motors nor servos of one joint: actuators cable, muscle; "
            "'actuators/command' moves them") in robot.inferred
    simulation = Simulation(compose(robot))
    assert simulation.surroundings.other_actuators == ('robot0_cable', 'robot0_muscle')
    assert simulation.data.actuator('robot0_cable').force[0] == pytest.approx(0.0, abs=1e-9)
    assert simulation.surroundings.commands['actuators'].control('robot0_muscle')[0] == 'effort'


def test_left_and_right_fingers_are_one_hand(tmp_path):
    text = ARM_WITH_HAND.replace('_tip"', '_knuckle"').replace('_finger"', '_driver"')
    for side, sign in (('left', ''), ('right', '-')):
        text = text.replace(f'pos="0 {sign}0.004 0" mass="0.02"/>', f"""mass="0.02"/>
          <body name="{side}_end"><joint name="{side}_finger" range="0 1" armature="0.01"/>
            <geom size="0.01" pos="0 0 0.02" mass="0.02"/></body>""")
    text = text.replace('0.3 0.01 0.01"', '0.3 0.01 0 0.01 0"')
    robot = load_robot(write(tmp_path / 'arm.xml', text))
    assert robot.eef_name == {'right': 'robot0_palm'}
    assert len(robot.grippers['right'].joints) == 4


def test_unnamed_chains_at_the_end_of_an_arm_are_its_hand(tmp_path):
    text = ARM_WITH_HAND
    for old, new in (('left_finger', 'j4'), ('right_finger', 'j5'), ('"pull"', '"m"'),
                     ('palm', 'link4'), ('left_', 'a'), ('right_', 'b')):
        text = text.replace(old, new)
    robot = load_robot(write(tmp_path / 'arm.xml', text))
    assert robot.grippers['right'].joints == ['robot0_j4', 'robot0_j5']
    assert any('it carries a hand' in sentence for sentence in robot.inferred)


def test_an_own_hand_without_control_range_gets_one(tmp_path):
    text = ARM_WITH_HAND.replace('ctrlrange="0 255" forcerange="-50 50"', '')
    robot = load_robot(write(tmp_path / 'arm.xml', text))
    assert "right hand: actuator 'pull' has no limits: actions are its control" in robot.inferred
    np.testing.assert_allclose(robot.compile().actuator('robot0_pull').ctrlrange, [-1.0, 1.0])


def test_joints_without_actuators_get_servos(tmp_path):
    text = ARM[:ARM.index('<actuator>')] + '</mujoco>'
    robot = load_robot(write(tmp_path / 'arm.xml', text))
    assert robot.arm_actuators == ['robot0_turn', 'robot0_lift', 'robot0_bend']
    model = robot.compile()
    np.testing.assert_allclose(model.actuator_ctrlrange, model.jnt_range)
    assert (model.actuator_biasprm[:, 1] < 0.0).all()


def test_what_stands_beside_the_robot_and_has_shapes_or_joints_stays(tmp_path):
    beside = """<body name="table" pos="1 0 0"><geom size="0.2"/></body>
      <body name="door" pos="2 0 0"><joint name="hinge"/>
        <inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/></body>
      <body name="marker" pos="3 0 0"/><body name="base" """
    file = write(tmp_path / 'arm.xml', ARM.replace('<body name="base"', beside))
    spec = read_model(file, Description(), file).spec
    assert {'table', 'door', 'base'} <= {body.name for body in spec.bodies}
    assert spec.body('marker') is None


def test_an_actuator_that_sticks_to_things_drives_no_joint():
    model = mujoco.MjModel.from_xml_string("""<mujoco><worldbody>
      <body><joint name="turn"/><geom size="1"/><body name="pad"><joint name="press" type="slide"/>
        <geom size="1"/><site name="middle"/></body></body></worldbody>
      <actuator><adhesion name="stick" body="pad" ctrlrange="0 1"/>
        <general name="thrust" site="middle"/><motor name="torque" joint="turn"/></actuator>
      </mujoco>""")
    tree = BodyTree(model)
    assert [tree.driven(actuator) for actuator in range(3)] == [set(), {0, 1}, {0}]


@pytest.mark.parametrize(('taken', 'found'), [
    ([], 'a'), (['a'], 'a1'), (['a', 'a1'], 'a2'), (['a', 'a2'], 'a1')])
def test_a_free_name_has_the_first_number_that_is_free(taken, found):
    assert free_name(taken, 'a') == found


def test_a_tendon_through_sites_acts_on_the_joints_that_move_some_of_them(tmp_path):
    text = ARM_WITH_HAND
    for side in ('left', 'right'):
        text = text.replace(f'<geom name="{side}_pad"',
                            f'<site name="{side}"/><geom name="{side}_pad"')
    text = text.replace('<tendon>', '<tendon><spatial name="rope"><site site="left"/>'
                        '<site site="right"/></spatial>')
    text = text.replace('<actuator>', '<actuator><motor name="rope" tendon="rope"/>')
    model = mujoco.MjModel.from_xml_string(text.replace(' ctrl="', ' ctrl="0 '))
    joints = BodyTree(model).driven(model.actuator('rope').id)
    assert {model.joint(joint).name for joint in joints} == {'left_finger', 'right_finger'}


def test_what_turns_beside_the_fingers_is_of_the_hand_but_not_a_longer_chain():
    robot = load_robot(Path(__file__).parents[1] / 'data' / 'files' / 'propeller_hand.xml')
    assert robot.arm_joints == ['robot0_waist', 'robot0_elbow', 'robot0_wrist']
    hand = robot.grippers['right']
    assert hand.body == 'mount'
    assert {*hand.joints} == {'robot0_gripper', 'robot0_left_finger', 'robot0_right_finger'}
    assert robot.other_joints == ['robot0_pan', 'robot0_tilt']
