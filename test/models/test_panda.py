# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of the Panda against robosuite, the kinematic facts and Franka's data sheet."""

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from manip_sim.models.robots import Panda

#: Franka Emika data sheet and FCI documentation, "Limits for Panda".
TORQUE_LIMITS_N_M = [87.0] * 4 + [12.0] * 3
VELOCITY_LIMITS_RAD_S = [2.175] * 4 + [2.61] * 3
MASS_KG = 18.0


def hand_pose_by_hand(chain, qpos):
    """Return position and rotation of the last body: a product of transforms, joints about z."""
    position, rotation, angles = np.zeros(3), Rotation.identity(), iter(qpos)
    for link in chain:
        position = position + rotation.apply(link['pos'])
        rotation = rotation * Rotation.from_quat(np.roll(link['quat_wxyz'], -1))
        if link['joint']:
            rotation = rotation * Rotation.from_rotvec([0.0, 0.0, next(angles)])
    return position, rotation


def test_names_are_those_of_the_reference(reference):
    robot = Panda()
    for name in ('joints', 'actuators', 'bodies', 'cameras'):
        assert getattr(robot, name) == reference[name], name
    assert robot.sites == [*reference['sites'], 'robot0_right_imu']
    assert robot.arm_joints == reference['joints']
    assert robot.arm_actuators == reference['actuators']
    assert robot.root_body == 'robot0_base'


def test_declared_values_are_those_of_the_reference(reference):
    robot = Panda()
    for name in ('default_base', 'default_gripper', 'default_controller_config'):
        assert getattr(robot, name) == reference[name], name
    np.testing.assert_allclose(robot.init_qpos, reference['init_qpos'])
    np.testing.assert_allclose(robot.top_offset, reference['top_offset'])
    offset = np.array(reference['hand_rotation_offset'])
    np.testing.assert_allclose(robot.hand_rotation_offset['right'],
                               offset / np.linalg.norm(offset), atol=1e-9)


def test_places_by_arena_are_those_of_the_reference(reference):
    places, expected = Panda().base_xpos_offset, reference['base_xpos_offset']
    assert list(places['bins']) == expected['bins']
    assert list(places['empty']) == expected['empty']
    for length in (0.8, 1.0):
        np.testing.assert_allclose(places['table'](length), expected[f'table_{length}'])


def test_composed_model_has_the_order_and_the_tree_of_the_reference(panda, reference):
    model = panda.compile()
    assert [model.joint(i).name for i in range(model.njnt)] == reference['joint_order_in_model']
    assert [model.actuator(i).name for i in range(model.nu)] == (
        reference['actuator_order_in_model'])
    tree = {name: parent for name, parent in reference['body_parents'].items()
            if not name.startswith('fixed_mount0_') or name.endswith('_base')}
    assert {name: model.body(model.body(name).parentid[0]).name for name in tree} == tree
    np.testing.assert_allclose(panda.bottom_offset, reference['bottom_offset_on_mount'])


def test_grasp_frame_at_the_start_is_where_the_reference_has_it(panda, reference):
    model = panda.compile()
    data = mujoco.MjData(model)
    data.qpos[:7] = panda.init_qpos
    mujoco.mj_kinematics(model, data)
    pos = data.site('gripper0_right_grip_site').xpos - data.body('robot0_base').xpos
    np.testing.assert_allclose(pos, reference['grip_site_at_init']['pos'], atol=1e-6)
    rotation = Rotation.from_matrix(data.site('gripper0_right_grip_site').xmat.reshape(3, 3))
    wanted = Rotation.from_quat(reference['grip_site_at_init']['quat_xyzw'])
    assert (rotation.inv() * wanted).magnitude() < 1e-4


def test_forward_kinematics_is_the_product_of_the_joint_frames(reference):
    model = Panda().compile()
    data = mujoco.MjData(model)
    random = np.random.default_rng(1)
    for qpos in random.uniform(*model.jnt_range.T, size=(20, 7)):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        position, rotation = hand_pose_by_hand(reference['chain'], qpos)
        np.testing.assert_allclose(data.body('robot0_right_hand').xpos, position, atol=1e-8)
        found = Rotation.from_matrix(data.body('robot0_right_hand').xmat.reshape(3, 3))
        assert (found.inv() * rotation).magnitude() < 1e-7


def test_joint_ranges_are_those_of_the_facts(reference):
    ranges = [link['range'] for link in reference['chain'] if link['joint']]
    np.testing.assert_allclose(Panda().compile().jnt_range, ranges)


def test_torque_and_velocity_limits_are_those_of_the_data_sheet():
    model = Panda().compile()
    np.testing.assert_allclose(model.jnt_actfrcrange[:, 1], TORQUE_LIMITS_N_M)
    np.testing.assert_allclose(model.jnt_actfrcrange[:, 0], np.negative(TORQUE_LIMITS_N_M))
    np.testing.assert_allclose(model.actuator_forcerange[:, 1], TORQUE_LIMITS_N_M)
    np.testing.assert_allclose(model.jnt_user[:, 0], VELOCITY_LIMITS_RAD_S)


def test_arm_and_hand_weigh_what_the_data_sheet_says(panda):
    model = panda.compile()
    data = mujoco.MjData(model)
    assert Panda().compile().body_mass.sum() == pytest.approx(MASS_KG, abs=0.1)
    mujoco.mj_forward(model, data)
    hand = model.body('gripper0_right_right_gripper').id
    assert model.body_subtreemass[hand] == pytest.approx(0.73, abs=0.05)


def test_mass_matrix_is_positive_definite_over_the_workspace():
    model = Panda().compile()
    data = mujoco.MjData(model)
    random = np.random.default_rng(2)
    for qpos in random.uniform(*model.jnt_range.T, size=(10, 7)):
        data.qpos[:] = qpos
        mujoco.mj_forward(model, data)
        inertia = np.array([apply_mass(model, data, column) for column in np.eye(7)])
        np.testing.assert_allclose(inertia, inertia.T, atol=1e-9)
        assert np.linalg.eigvalsh(inertia).min() > 0.09


def apply_mass(model, data, acceleration):
    """Return the joint torques of an acceleration, which every MuJoCo can compute."""
    torque = np.empty(model.nv)
    mujoco.mj_mulM(model, data, torque, acceleration)
    return torque
