# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""After an edit of a part's spec, what the part tells of itself is current."""

import mujoco
import numpy as np
import pytest

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models import World
from manip_sim.models.arenas import EmptyArena, TableArena
from manip_sim.models.bases import RethinkMount
from manip_sim.models.grippers import PandaGripper
from manip_sim.models.robots import Panda


def refreshed(robot):
    robot.refresh()


def compiled(robot):
    robot.compile()


def put_into_a_world(robot):
    World([robot]).compose()


def given_a_base(robot):
    robot.add_base(RethinkMount())


def given_a_gripper(robot):
    robot.add_gripper(PandaGripper())


@pytest.fixture(params=[refreshed, compiled, put_into_a_world, given_a_base, given_a_gripper])
def after(request):
    """Return what is done with a robot between an edit and a look at it."""
    return request.param


def test_a_joint_and_its_motor_that_are_added_are_listed_and_commanded(one_joint_arm, after):
    robot = one_joint_arm()
    hand = robot.spec.body('right_hand')
    hand.add_joint(name='head_pan', axis=[0, 0, 1])
    hand.add_geom(size=[0.01, 0, 0])
    motor = robot.spec.add_actuator(name='pan', target='head_pan', ctrlrange=[-3, 5],
                                    ctrllimited=True)
    motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
    after(robot)
    assert robot.joints == ['robot0_joint1', 'robot0_head_pan']
    assert robot.dof == 2
    assert robot.head_joints == ['robot0_head_pan']
    assert robot.actuators == ['robot0_torq_j1', 'robot0_pan']
    assert robot.contact_geoms[-1] == 'robot0_g2_col'
    np.testing.assert_allclose(robot.format_action('head', [0.5]), [3.0])


def test_a_range_that_is_changed_is_that_of_commands(one_joint_arm, after):
    robot = one_joint_arm()
    robot.spec.actuator('torq_j1').ctrlrange = [-4.0, 8.0]
    after(robot)
    np.testing.assert_allclose(robot.format_action('arm', [1.0]), [8.0])


def test_a_joint_that_is_renamed_has_its_new_name(one_joint_arm, after):
    robot = one_joint_arm()
    robot.spec.joint('joint1').name = 'torso_lift'
    robot.spec.actuator('torq_j1').target = 'torso_lift'
    after(robot)
    assert robot.torso_joints == ['robot0_torso_lift']
    assert robot.torso_actuators == ['robot0_torq_j1']
    assert robot.arm_joints == []


def test_a_hand_that_is_turned_tells_its_rotation(one_joint_arm, after):
    robot = one_joint_arm()
    robot.spec.body('right_hand').quat = [0.0, 0.0, 1.0, 0.0]
    after(robot)
    np.testing.assert_allclose(robot.hand_rotation_offset['right'], [0.0, 1.0, 0.0, 0.0])


def test_a_root_that_is_lifted_keeps_its_floor(one_joint_arm):
    robot = one_joint_arm()
    robot.spec.body('base').pos = [0.0, 0.0, 0.3]
    assert World([robot]).compile().body('robot0_base').pos[2] == pytest.approx(0.3)
    np.testing.assert_allclose(robot.bottom_offset, [0.0, 0.0, -0.3])


def test_an_edit_of_a_mounted_gripper_is_seen_through_the_robot(
        one_joint_arm, gripper_class, gripper_file):
    robot = one_joint_arm()
    gripper = gripper_class(gripper_file)
    robot.add_gripper(gripper)
    gripper.spec.body('eef').quat = [0.0, 1.0, 0.0, 0.0]
    gripper.spec.body('eef').add_site(name='tip')
    robot.refresh()
    assert gripper.sites[-1] == 'gripper0_tip'
    np.testing.assert_allclose(gripper.rotation_offset, [1.0, 0.0, 0.0, 0.0])


def test_the_state_of_a_gripper_stays_while_its_actuators_do(gripper_class, gripper_file):
    gripper = gripper_class(gripper_file)
    gripper.format_action([1.0])
    gripper.spec.body('palm').pos = [0.0, 0.0, 0.1]
    gripper.refresh()
    np.testing.assert_allclose(gripper.current_action, [0.1])
    gripper.spec.add_actuator(name='second', target='slide', trntype=mujoco.mjtTrn.mjTRN_JOINT)
    gripper.refresh()
    np.testing.assert_array_equal(gripper.current_action, [0.0, 0.0])


def test_an_edit_of_an_arena_is_seen(panda):
    arena = EmptyArena()
    arena.spec.worldbody.add_body(name='post').add_geom(name='post', size=[0.1, 0, 0])
    model = World([panda], arena).compile()
    assert model.body('post').id > model.body('robot0_base').id
    assert 'post' in arena.bodies and 'post' in arena.contact_geoms


def test_an_edit_that_takes_away_what_is_needed_is_told(one_joint_arm):
    robot = one_joint_arm()
    robot.spec.body('right_hand').name = 'tool'
    with pytest.raises(UnknownNameError, match=r"^unknown body of Arm0 in .* 'right_hand': "
                                               '.*available: base, link1, tool$'):
        robot.compile()


def test_an_edit_that_does_not_compile_is_told(one_joint_arm):
    robot = one_joint_arm()
    robot.spec.actuator('torq_j1').target = 'elbow'
    with pytest.raises(ModelError, match='^Arm0 does not compile: .*elbow'):
        robot.refresh()


def test_a_world_moves_a_copy_of_a_robot_and_not_the_robot(one_joint_arm):
    robot = one_joint_arm()
    authored = robot.spec.body('base').pos.copy()
    alone = robot.to_xml()
    robot.base_xpos_offset['empty'] = (1.0, 2.0, 0.0)
    for _ in range(2):
        model = World([robot]).compile()
        np.testing.assert_allclose(model.body('robot0_base').pos, [1.0, 2.0, 0.0])
    np.testing.assert_array_equal(robot.spec.body('base').pos, authored)
    assert not robot.is_placed
    assert robot.to_xml() == alone


def test_one_robot_stands_in_two_worlds(one_joint_arm):
    robot = one_joint_arm()
    robot.base_xpos_offset.update(empty=(1.0, 0.0, 0.0), table=(2.0, 0.0, 0.0))
    worlds = World([robot]), World([robot], TableArena())
    for world, x in (*zip(worlds, (1.0, 2.0)), (worlds[0], 1.0)):
        assert world.compile().body('robot0_base').pos[0] == x


def test_a_placed_robot_stands_there_alone_and_in_a_world(one_joint_arm):
    robot = one_joint_arm()
    robot.set_base_xpos([0.5, 0.0, 0.1])
    robot.set_base_ori([0.0, 0.0, np.pi])
    assert robot.is_placed
    for model in (robot.compile(), World([robot]).compile()):
        np.testing.assert_allclose(model.body('robot0_base').pos, [0.5, 0.0, 0.1])
        np.testing.assert_allclose(model.body('robot0_base').quat, [0, 0, 0, 1], atol=1e-12)


@pytest.mark.parametrize(('method', 'values', 'message'), [
    ('set_base_xpos', [0.0, np.nan, 0.0], 'position of Panda0 must be finite, got nan at index 1'),
    ('set_base_xpos', [0.0, 1.0], 'position of Panda0 must have 3 numbers, got 2'),
    ('set_base_ori', [0.0, 0.0, np.inf], 'orientation of Panda0 must be finite, got inf at '),
    ('set_base_ori', 'upright', "orientation of Panda0 must be numbers, got 'upright'")])
def test_a_place_that_is_none_is_rejected_at_once(method, values, message):
    robot = Panda()
    with pytest.raises(ModelError, match=f'^{message}'):
        getattr(robot, method)(values)
    assert not robot.is_placed


@pytest.mark.parametrize(('pose', 'message'), [
    ({'pos': [0.0, 0.0]}, 'position of PandaGripper0 must have 3 numbers, got 2'),
    ({'quat_wxyz': [0.0] * 4}, 'quaternion of PandaGripper0 must not be zero'),
    ({'quat_wxyz': [1.7e308] * 4}, 'quaternion of PandaGripper0 must have a finite norm'),
    ({'pos': [0.0, 0.0, 10**400]}, 'position of PandaGripper0 must be numbers, got '),
    ({'quat_wxyz': [1.0, np.nan, 0.0, 0.0]}, 'quaternion of PandaGripper0 must be finite')])
def test_a_mount_pose_that_is_none_is_rejected(pose, message):
    with pytest.raises(ModelError, match=f'^{message}'):
        PandaGripper().set_mount_pose(**pose)


def test_a_place_in_an_arena_that_is_none_names_robot_and_arena(one_joint_arm):
    robot = one_joint_arm()
    robot.base_xpos_offset['empty'] = (np.nan, 0.0, 0.0)
    with pytest.raises(ModelError, match=r"^base_xpos_offset\['empty'\] of Arm0 must be finite, "
                                         'got nan at index 0$'):
        World([robot]).compose()
