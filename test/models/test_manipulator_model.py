# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of arms and the grippers on them."""

import numpy as np
import pytest

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.bases import RethinkMount

TWO_HANDS = """
<body name="base"><geom size="0.1"/>
  <body name="right_link" pos="0 -0.2 1"><joint name="r1" range="-1 1"/><geom size="0.1"/>
    <body name="right_hand" pos="0 0 0.1"/></body>
  <body name="left_link" pos="0 0.2 1"><joint name="l1" range="-1 1"/><geom size="0.1"/>
    <body name="left_hand" pos="0 0 0.1"/></body>
</body>
"""
HANDS = {'right': 'right_hand', 'left': 'left_hand'}


def angle_between(a, b):
    """Return the angle between two unit quaternions [rad]; the sign of them does not count."""
    return 2.0 * np.arccos(min(1.0, abs(float(np.dot(a, b)))))


@pytest.fixture
def hand_with(arm_class, mjcf):
    """Return a function that makes an arm whose hand body has an attribute more."""
    def make(attribute):
        return arm_class(mjcf('<body name="base"><geom size="0.1"/>'
                              f'<body name="right_hand" {attribute}/></body>'))
    return make


@pytest.fixture
def two_arms(arm_class, mjcf):
    """Return a robot with two arms."""
    arm_class.arm_type = 'bimanual'
    arm_class._eef_name = HANDS
    return arm_class(mjcf(TWO_HANDS))


def test_end_effector_is_named_by_arm_with_prefix(one_joint_arm, two_arms):
    assert two_arms.arms == ('right', 'left')
    assert two_arms.eef_name == {'right': 'robot0_right_hand', 'left': 'robot0_left_hand'}


@pytest.mark.parametrize(('attribute', 'quat_xyzw'), [
    ('', [0, 0, 0, 1]), ('quat="0 0 0 2"', [0, 0, 1, 0]),
    ('quat=" 1   1 0 0 "', [0.5**0.5, 0, 0, 0.5**0.5]),
    ('euler="0 0 1"', [0, 0, np.sin(0.5), np.cos(0.5)]),
    ('axisangle="0 3 0 1"', [0, np.sin(0.5), 0, np.cos(0.5)]),
    ('zaxis="1 0 0"', [0, 0.5**0.5, 0, 0.5**0.5])])
def test_hand_rotation_is_that_of_the_model_with_unit_norm(hand_with, attribute, quat_xyzw):
    offset = hand_with(attribute).hand_rotation_offset['right']
    assert np.linalg.norm(offset) == pytest.approx(1.0, abs=1e-12)
    assert angle_between(offset, quat_xyzw) < 1e-6


def test_unknown_arm_type_is_rejected(arm_class, mjcf):
    arm_class.arm_type = 'bimanal'
    with pytest.raises(UnknownNameError, match=r"^unknown arm type 'bimanal': did you mean "
                                               r"'bimanual'\? available: single, bimanual$"):
        arm_class(mjcf(TWO_HANDS))


def test_arm_type_must_fit_the_hands(arm_class, mjcf):
    arm_class.arm_type = 'bimanual'
    with pytest.raises(ModelError, match=r'^Arm0 is bimanual, so it needs an end effector body '
                                         r"for right, left; it has \{'right': 'right_hand'\}$"):
        arm_class(mjcf(TWO_HANDS))


def test_missing_hand_is_named(arm_class, mjcf):
    with pytest.raises(UnknownNameError, match=r"^unknown body of Arm0 in .* 'right_hand': .*"
                                               r'available: base, palm$'):
        arm_class(mjcf('<body name="base"><geom size="0.1"/><body name="palm"/></body>'))


@pytest.mark.parametrize('arm_name', ['right', 'robot0_right_hand', None])
def test_gripper_is_mounted_by_arm_by_body_or_without_a_name(one_joint_arm, gripper_class,
                                                             gripper_file, arm_name):
    robot, gripper = one_joint_arm(), gripper_class(gripper_file)
    robot.add_gripper(gripper, arm_name=arm_name)
    model = robot.compile()
    assert list(robot.grippers) == ['right']
    assert robot.grippers['right'] is gripper
    assert model.body(model.body('gripper0_palm').parentid[0]).name == robot.eef_name['right']


def test_grippers_answer_to_arm_and_body(one_joint_arm, gripper_class, gripper_file):
    robot, gripper = one_joint_arm(), gripper_class(gripper_file)
    assert 'robot0_right_hand' not in robot.grippers
    assert robot.grippers.get('right') is None
    with pytest.raises(KeyError, match=r"^'robot0_right_hand'$"):
        robot.grippers['robot0_right_hand']  # noqa: B018
    robot.add_gripper(gripper)
    assert 'right' in robot.grippers
    assert 'robot0_right_hand' in robot.grippers
    assert robot.grippers['robot0_right_hand'] is robot.grippers.get('right') is gripper
    assert len(robot.grippers) == 1


def test_without_a_name_every_arm_gets_an_own_copy(two_arms, gripper_class, gripper_file):
    two_arms.add_gripper(gripper_class(gripper_file, idn=0))
    right, left = two_arms.grippers.values()
    assert (right.naming_prefix, left.naming_prefix) == ('gripper0_right_', 'gripper0_left_')
    right.spec.geom('finger').size[0] = 0.03
    right.format_action([1.0])
    model = two_arms.compile()
    assert model.geom('gripper0_right_finger').size[0] == 0.03
    assert model.geom('gripper0_left_finger').size[0] == 0.01
    np.testing.assert_array_equal(left.current_action, [0.0])


def test_second_gripper_on_an_arm_is_rejected(one_joint_arm, gripper_class, gripper_file):
    robot = one_joint_arm()
    robot.add_gripper(gripper_class(gripper_file))
    with pytest.raises(ModelError, match=r"^Arm0's right arm holds MyGripper0 already, cannot add "
                                         r'MyGripper1$'):
        robot.add_gripper(gripper_class(gripper_file, idn=1))


def test_mounting_on_all_arms_changes_nothing_if_one_is_taken(two_arms, gripper_class,
                                                              gripper_file):
    two_arms.add_gripper(gripper_class(gripper_file), 'left')
    with pytest.raises(ModelError, match='left arm holds MyGripper0 already'):
        two_arms.add_gripper(gripper_class(gripper_file, idn=1))
    assert list(two_arms.grippers) == ['left']


@pytest.mark.parametrize('same_object', [True, False])
def test_two_grippers_of_one_prefix_are_rejected(two_arms, gripper_class, gripper_file,
                                                 same_object):
    gripper = gripper_class(gripper_file)
    two_arms.add_gripper(gripper, 'right')
    with pytest.raises(ModelError, match=r"^a gripper with the prefix 'gripper0_' is mounted on "
                                         r'Arm0 already: give MyGripper0 another idn$'):
        two_arms.add_gripper(gripper if same_object else gripper_class(gripper_file), 'left')


def test_gripper_of_another_type_is_rejected(one_joint_arm):
    with pytest.raises(TypeError, match=r'^a gripper must be a GripperModel, not RethinkMount$'):
        one_joint_arm().add_gripper(RethinkMount())


def test_unknown_arm_is_told_what_there_is(one_joint_arm, gripper_class, gripper_file):
    robot = one_joint_arm()
    with pytest.raises(UnknownNameError, match=r"^unknown arm of Arm0 'left': .*"
                                               r'available: right, robot0_right_hand$'):
        robot.add_gripper(gripper_class(gripper_file), 'left')
    assert not robot.grippers


def test_mount_offsets_move_and_turn_the_gripper(one_joint_arm, arm_class, gripper_class,
                                                 gripper_file):
    arm_class.gripper_mount_pos_offset = {'right': [0.0, 0.0, 0.1]}
    arm_class.gripper_mount_quat_offset = {'right': [0.0, 0.0, 0.0, 1.0]}
    robot, gripper = one_joint_arm(), gripper_class(gripper_file)
    robot.add_gripper(gripper)
    palm = robot.compile().body('gripper0_palm')
    np.testing.assert_allclose(palm.pos, [0, 0, 0.1])
    np.testing.assert_allclose(palm.quat, [0, 0, 0, 1])
    assert angle_between(gripper.rotation_offset, [0, 0, 1, 0]) < 1e-6


def test_models_are_base_then_grippers_in_order_of_mounting(two_arms, gripper_class,
                                                            gripper_file):
    left, right = gripper_class(gripper_file, idn=1), gripper_class(gripper_file, idn=2)
    base = RethinkMount()
    two_arms.add_gripper(left, 'left')
    two_arms.add_base(base)
    two_arms.add_gripper(right, 'right')
    assert two_arms.models == [base, left, right]


def test_gripper_joints_are_none_of_the_robots(one_joint_arm, gripper_class, gripper_file):
    robot = one_joint_arm()
    robot.add_gripper(gripper_class(gripper_file))
    assert robot.joints == robot.all_joints == robot.arm_joints == ['robot0_joint1']
    assert robot.all_actuators == ['robot0_torq_j1']


def test_cameras_of_grippers_are_listed_after_the_robots(arm_class, gripper_class, mjcf):
    robot = arm_class(mjcf('<body name="base"><geom size="0.1"/><camera name="front"/>'
                           '<body name="right_hand"/></body>'))
    palm = mjcf('<body name="palm"><geom name="finger" size="0.1"/><camera name="wrist"/>'
                '<body name="eef"/></body>', name='gripper')
    robot.add_gripper(gripper_class(palm))
    assert robot.cameras == ['robot0_front', 'gripper0_wrist']


def test_spec_edit_of_a_mounted_gripper_is_compiled(one_joint_arm, gripper_class, gripper_file):
    robot, gripper = one_joint_arm(), gripper_class(gripper_file)
    robot.add_gripper(gripper)
    gripper.spec.geom('finger').friction[0] = 3.0
    assert robot.compile().geom('gripper0_finger').friction[0] == 3.0


def test_model_in_degrees_mounts_on_one_in_radians(one_joint_arm, gripper_class, mjcf):
    robot = one_joint_arm()
    robot.add_gripper(gripper_class(mjcf(
        '<body name="palm"><geom size="0.1"/><body><joint name="j" range="-90 90"/>'
        '<geom name="finger" size="0.1"/></body><body name="eef"/></body>', angle='degree',
        name='gripper')))
    model = robot.compile()
    np.testing.assert_allclose(model.joint('gripper0_j').range, [-np.pi / 2, np.pi / 2])
    np.testing.assert_allclose(model.joint('robot0_joint1').range, [-2, 2])


def test_options_and_keyframes_of_a_mounted_part_are_left_behind(one_joint_arm, gripper_class,
                                                                 mjcf):
    robot = one_joint_arm(sections='<option timestep="0.003"/>')
    robot.add_gripper(gripper_class(mjcf(
        '<body name="palm"><geom name="finger" size="0.1"/><joint name="j"/><body name="eef"/>'
        '</body>', '<option timestep="0.001" gravity="0 0 -1"/><keyframe><key qpos="1"/>'
        '</keyframe>', name='gripper')))
    model = robot.compile()
    assert model.opt.timestep == 0.003
    np.testing.assert_allclose(model.opt.gravity, [0, 0, -9.81])
    assert model.nkey == 0
