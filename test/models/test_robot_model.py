# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of what all robots share: subsystems, base, place, joint attributes, abstract actions."""

import mujoco
import numpy as np
import pytest

from manip_sim.errors import CommandError, ModelError, UnknownNameError
from manip_sim.models.bases import MobileBaseModel, RethinkMount
from manip_sim.models.robots.robot_model import classify

HALF_TURN_Z = [0.0, 0.0, 0.0, 1.0]


@pytest.mark.parametrize(('name', 'subsystem'), [
    ('torso_lift', 'torso'), ('mobile_x', 'base'), ('head_pan', 'head'), ('left_leg_1', 'legs'),
    ('torso_mobile_head_leg', 'torso'), ('mobile_head_leg', 'base'), ('head_leg', 'head'),
    ('joint1', 'arm'), ('finger_joint1', 'arm'), ('hip_pitch', 'arm'), ('knee', 'arm'),
    ('base_joint', 'arm'), ('wheel_joint', 'arm'), ('neck', 'arm'), ('waist_yaw', 'arm')])
def test_names_of_the_reference_are_classified_as_there(name, subsystem):
    assert classify(name) == subsystem


@pytest.mark.parametrize(('name', 'subsystem'), [
    ('overhead_joint', 'arm'), ('bulkhead', 'arm'), ('automobile', 'arm'), ('elegant', 'arm'),
    ('legacy_joint', 'arm'), ('Torso_lift', 'torso'), ('headPan', 'head'), ('legs_1', 'legs'),
    ('joint_head2', 'head'), ('leg1_joint', 'legs'), ('HEAD_TILT', 'head')])
def test_only_whole_words_in_any_case_count(name, subsystem):
    assert classify(name) == subsystem


@pytest.mark.parametrize('idn', ['leg', 'head1', 'mobile_a', 'torso', 0])
def test_idn_does_not_decide_the_subsystem(robot_with, idn):
    robot = robot_with('joint1', idn=idn)
    assert robot.arm_joints == [f'robot{idn}_joint1']
    assert robot.arm_actuators == [f'robot{idn}_m0']
    assert not robot.legs_joints + robot.head_joints + robot.base_joints + robot.torso_joints


def test_explicit_table_comes_before_the_words(robot_with):
    table = {'neck': 'head', 'head_holder': 'arm'}
    robot = robot_with('neck', 'head_holder', subsystem_of_joint=table)
    assert robot.head_joints == ['robot0_neck']
    assert robot.arm_joints == ['robot0_head_holder']


@pytest.mark.parametrize(('table', 'message'), [
    ({'nek': 'head'}, r"^unknown joint in _subsystem_of_joint of Robot0 'nek': did you mean "
                      r"'neck'\? available: neck$"),
    ({'neck': 'haed'}, r"^unknown subsystem of joint 'neck' of Robot0 'haed': did you mean "
                       r"'head' or 'base'\? available: arm, base, ")])
def test_explicit_table_with_unknown_names_is_rejected(robot_with, table, message):
    with pytest.raises(UnknownNameError, match=message):
        robot_with('neck', subsystem_of_joint=table)


def test_actuators_go_with_the_joint_that_they_drive(robot_with):
    robot = robot_with('torso_lift', 'joint1', 'leg_1', 'head_pan')
    assert robot.torso_actuators == ['robot0_m0']
    assert robot.arm_actuators == ['robot0_m1']
    assert robot.legs_actuators == ['robot0_m2']
    assert robot.head_actuators == ['robot0_m3']
    assert robot.base_actuators == []


def test_updating_again_changes_nothing(robot_with, mobile_base):
    robot = robot_with('joint1', 'head_pan')
    robot.add_base(mobile_base)
    before = [robot.joints_of(s) + robot.actuators_of(s) for s in ('arm', 'base', 'torso', 'head')]
    for _ in range(2):
        robot.update_joints()
        robot.update_actuators()
    assert before == [robot.joints_of(s) + robot.actuators_of(s)
                      for s in ('arm', 'base', 'torso', 'head')]


def test_subsystem_lists_are_copies(robot_with):
    robot = robot_with('joint1')
    robot.arm_joints.clear()
    robot.actuators_of('arm').clear()
    assert robot.arm_joints == robot.joints_of('arm') == ['robot0_joint1']
    assert robot.arm_actuators == ['robot0_m0']


def test_unknown_subsystem_is_told_what_there_is(robot_with):
    with pytest.raises(UnknownNameError, match=r"^unknown subsystem 'hed': did you mean 'head' or "
                                               r"'other'\? "
                                               r'available: arm, base, torso, head, legs, other$'):
        robot_with('joint1').joints_of('hed')


def test_joints_of_a_mobile_base_are_sorted_too(robot_with, mobile_base):
    robot = robot_with('joint1')
    robot.add_base(mobile_base)
    assert robot.base_joints == ['mobilebase0_joint_mobile_forward']
    assert robot.base_actuators == ['mobilebase0_drive']
    assert robot.torso_joints == ['mobilebase0_joint_torso_height']
    assert robot.torso_actuators == ['mobilebase0_mobile_lift']
    assert robot.all_joints == robot.arm_joints + mobile_base.joints
    assert robot.all_actuators == robot.arm_actuators + mobile_base.actuators
    assert robot.models == [mobile_base]
    assert robot.dof == 1


def test_joints_of_a_mobile_base_without_a_keyword_move_the_base(robot_with, mjcf):
    class Wheels(MobileBaseModel, registered=False):
        pass

    robot = robot_with('joint1')
    robot.add_base(Wheels(mjcf(
        '<body name="cart"><joint name="forward" type="slide"/><geom size="0.1"/>'
        '<body name="wheel"><joint name="left_wheel"/><geom size="0.1"/></body>'
        '<body name="support"/></body>',
        '<actuator><motor name="left" joint="left_wheel"/></actuator>', name='wheels')))
    assert robot.base_joints == ['mobilebase0_forward', 'mobilebase0_left_wheel']
    assert robot.base_actuators == ['mobilebase0_left']
    assert robot.arm_joints == ['robot0_joint1']


def test_robot_on_a_mobile_base_hangs_on_its_support(robot_with, mobile_base):
    robot = robot_with('joint1')
    robot.add_base(mobile_base)
    model = robot.compile()
    mount = model.body('robot0_manipulator_mount')
    assert model.body(mount.parentid[0]).name == 'mobilebase0_support'
    assert model.body(model.body('mobilebase0_cart').parentid[0]).name == robot.root_body
    assert model.body(model.jnt_bodyid[model.joint('robot0_joint1').id]).parentid[0] == mount.id


def test_mobile_base_without_support_is_rejected(robot_with, mobile_base):
    robot = robot_with('joint1')
    mobile_base.support_body = 'deck'
    with pytest.raises(UnknownNameError, match=r"^unknown body of Cart0 to mount a robot on 'deck'"
                                               r': available: cart, support$'):
        robot.add_base(mobile_base)
    assert robot.base is None


def test_second_base_is_rejected(robot_with):
    robot = robot_with('joint1')
    robot.add_base(RethinkMount())
    with pytest.raises(ModelError, match=r'^Robot0 stands on RethinkMount0 already, cannot add '
                                         r'RethinkMount1$'):
        robot.add_base(RethinkMount(1))


def test_base_of_another_type_is_rejected(robot_with):
    with pytest.raises(TypeError, match='^a base must be a Mount.* or a Mobile.*, not str$'):
        robot_with('joint1').add_base('RethinkMount')


def test_root_is_placed_above_the_floor_by_base_and_position(robot_with):
    robot = robot_with('joint1')
    robot.add_base(RethinkMount())
    robot.set_base_xpos((0.1, 0.2, 0.0))
    np.testing.assert_allclose(robot.bottom_offset, [0, 0, -0.912], atol=1e-12)
    np.testing.assert_allclose(robot.compile().body('robot0_base').pos, [0.1, 0.2, 0.912])


@pytest.mark.parametrize('root', ['pos="0 0 0.793"', 'pos="0 0 0.793" euler="0 0 1"'])
def test_root_that_is_authored_above_the_floor_stays_there(robot_with, root):
    robot = robot_with('joint1', root=root)
    for _ in range(2):
        robot.set_base_xpos((1.0, 0.0, 0.0))
    np.testing.assert_allclose(robot.compile().body('robot0_base').pos, [1.0, 0.0, 0.793])


def test_framed_root_is_placed_as_any_other(robot_class, mjcf):
    robot = robot_class(mjcf('<frame pos="0 0 0.5" euler="0 0 1"><body name="base">'
                             '<geom size="0.1"/></body></frame>'))
    robot.set_base_xpos((1.0, 0.0, 0.0))
    robot.set_base_ori((0.0, 0.0, np.pi))
    root = robot.compile().body('robot0_base')
    np.testing.assert_allclose(root.pos, [1.0, 0.0, 0.5])
    np.testing.assert_allclose(root.quat, HALF_TURN_Z, atol=1e-12)


@pytest.mark.parametrize(('rpy', 'matrix'), [
    ((0.0, 0.0, np.pi / 2), [[0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    # Fixed axes as in REP 103: first about x, then about z: y goes to z.
    ((np.pi / 2, 0.0, np.pi / 2), [[0, 0, 1], [1, 0, 0], [0, 1, 0]])])
def test_orientation_is_roll_pitch_yaw_about_fixed_axes(robot_with, rpy, matrix):
    robot = robot_with('joint1', root='euler="0.4 0.1 0.2"')
    robot.set_base_ori(rpy)
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, robot.compile().body('robot0_base').quat)
    np.testing.assert_allclose(rotation.reshape(3, 3), matrix, atol=1e-12)


@pytest.mark.parametrize('with_base', ['before', 'after', 'never'])
def test_joint_attribute_reaches_the_compiled_model(robot_with, mobile_base, with_base):
    robot = robot_with('joint1', 'joint2')
    if with_base == 'before':
        robot.add_base(mobile_base)
    robot.set_joint_attribute('damping', [3.0, 4.0])
    robot.set_joint_attribute('armature', np.array([0.1, 0.2]))
    if with_base == 'after':
        robot.add_base(mobile_base)
    model = robot.compile()
    dofs = [model.joint(name).dofadr[0] for name in robot.joints]
    damping = np.asarray(model.dof_damping).reshape(model.nv, -1)[dofs, 0]
    np.testing.assert_allclose(damping, [3, 4])
    np.testing.assert_allclose(model.dof_armature[dofs], [0.1, 0.2])


def test_joint_attribute_without_force_only_fills_in(robot_with):
    robot = robot_with('joint1', 'joint2')
    robot.spec.joint('joint1').armature = 0.5
    robot.set_joint_attribute('armature', [9.0, 0.2], force=False)
    np.testing.assert_allclose(robot.compile().dof_armature, [0.5, 0.2])


@pytest.mark.parametrize(('values', 'message'), [
    ([1.0], 'have 2 numbers, got 1'), ([1.0, 2.0, 3.0], 'have 2 numbers, got 3'),
    ([1.0, np.nan], 'be finite, got nan at index 1'),
    ([0.0, -0.5], 'not be negative, got -0.5 at index 1')])
def test_joint_attribute_rejects_wrong_values(robot_with, values, message):
    with pytest.raises(CommandError, match=f'^damping of Robot0 must {message}$'):
        robot_with('joint1', 'joint2').set_joint_attribute('damping', values)


def test_joint_attribute_rejects_unknown_attributes(robot_with):
    with pytest.raises(UnknownNameError, match=r"^unknown joint attribute 'dampning': "
                                               r"did you mean 'damping'\?"):
        robot_with('joint1').set_joint_attribute('dampning', [1.0])


def test_action_is_mapped_onto_the_control_ranges_and_clamped(robot_with):
    robot = robot_with('joint1', 'joint2', 'joint3')
    np.testing.assert_allclose(robot.format_action('arm', [-1.0, 0.0, 0.5]), [-1.0, 0.0, 1.5])
    np.testing.assert_allclose(robot.format_action('arm', [-7.0, 7.0, 0.0]), [-1.0, 2.0, 0.0])
    np.testing.assert_allclose(robot.format_action('arm', [0.0] * 3, [[0, 4]] * 3), [2.0] * 3)


@pytest.mark.parametrize(('action', 'message'), [
    ([0.0], r'have 2 numbers, got 1$'), (0.0, r'have 2 numbers, got the shape \(\)$'),
    ([0.0, np.nan], 'be finite, got nan at index 1$'),
    ([np.inf, 0.0], 'be finite, got inf at index 0$')])
def test_action_that_does_not_fit_is_rejected(robot_with, action, message):
    with pytest.raises(CommandError, match=f'^an action of the arm of Robot0 must {message}'):
        robot_with('joint1', 'joint2').format_action('arm', action)


def test_robot_needs_exactly_one_root_body(robot_class, mjcf):
    with pytest.raises(ModelError, match='must have exactly one root body, found 2: a, b'):
        robot_class(mjcf('<body name="a"/><body name="b"/>'))


def test_radius_is_the_larger_one_of_robot_and_base(robot_with):
    robot = robot_with('joint1')
    assert robot.horizontal_radius == 0.0
    robot.add_base(RethinkMount())
    assert robot.horizontal_radius == 0.25
