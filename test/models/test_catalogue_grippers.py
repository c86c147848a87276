# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Every gripper of the catalogue has robosuite's names, frames, ranges and action rule."""

import mujoco
import numpy as np
import pytest

from catalogue import figures, GRIPPERS

from manip_sim.errors import CommandError
from manip_sim.models.grippers import create_gripper

EXPECTED = figures('grippers.json')['grippers']
#: Where we differ on purpose, and why.
DEVIATIONS = figures('grippers.json')['deviations']
ACTIONS = figures('format_action.json')
WITH_FIGURES = [name for name in GRIPPERS if name in EXPECTED]
WITH_ACTIONS = [name for name in GRIPPERS if name in ACTIONS['grippers']]
KINDS = {'hinge': mujoco.mjtJoint.mjJNT_HINGE, 'slide': mujoco.mjtJoint.mjJNT_SLIDE}


def composed(poses):
    """
    Return the pose that a row of poses, each in the frame of the one before, comes to.

    :param poses: pairs of a position and a quaternion (w, x, y, z)
    """
    position, turned = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    for pos, quat in poses:
        offset, product = np.empty(3), np.empty(4)
        mujoco.mju_rotVecQuat(offset, np.array(pos, dtype=float), turned)
        mujoco.mju_mulQuat(product, turned, np.array(quat, dtype=float))
        position, turned = position + offset, product / np.linalg.norm(product)
    return position, turned


@pytest.mark.parametrize('name', WITH_FIGURES)
def test_joints_actuators_sites_and_sensors_have_the_names_of_the_reference(name):
    expected, gripper = EXPECTED[name], create_gripper(name)
    assert gripper.root_body == gripper.correct_naming(expected['root'][0])
    assert gripper.joints == gripper.correct_naming([joint for joint, _, _ in expected['joints']])
    assert gripper.actuators == gripper.correct_naming([a for a, _, _ in expected['actuators']])
    of_reference = gripper.correct_naming([sensor for sensor, _ in expected['sensors']])
    assert gripper.sensors[:len(of_reference)] == of_reference
    # Behind them only the pads of ours.
    assert all(name.endswith('_touch') for name in gripper.sensors[len(of_reference):])
    assert set(gripper.correct_naming(expected['sites'])) <= set(gripper.sites)
    assert set(gripper.correct_naming(expected['bodies'])) <= set(gripper.bodies)


@pytest.mark.parametrize('name', WITH_FIGURES)
def test_joints_and_commands_have_the_ranges_of_the_reference(name):
    expected, gripper = EXPECTED[name], create_gripper(name)
    model = gripper.compile()
    for raw, kind, limits in expected['joints']:
        joint = model.joint(gripper.correct_naming(raw))
        assert int(joint.type[0]) == int(KINDS[kind])
        np.testing.assert_allclose(joint.range, limits, atol=1e-6, err_msg=raw)
    for raw, target, ctrlrange in expected['actuators']:
        actuator = model.actuator(gripper.correct_naming(raw))
        assert model.joint(actuator.trnid[0]).name == gripper.correct_naming(target)
        if 'ctrlrange' in DEVIATIONS.get(name, {}):
            ctrlrange = [limits for joint, _, limits in expected['joints'] if joint == target][0]
        np.testing.assert_allclose(actuator.ctrlrange, ctrlrange, atol=1e-6, err_msg=raw)


@pytest.mark.parametrize('name', WITH_FIGURES)
def test_the_grasp_frame_is_where_the_reference_has_it(name):
    expected, gripper = EXPECTED[name], create_gripper(name)
    model = gripper.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    chain = [expected['root'][1:3]] + [link[1:3] for link in expected['eef_below_root']]
    position, quat_wxyz = composed(chain)
    eef = data.body(gripper.correct_naming('eef'))
    assert np.abs(eef.xpos - position).max() < 1e-6
    assert abs(np.dot(eef.xquat, quat_wxyz)) > 1.0 - 1e-12
    assert abs(np.dot(np.roll(gripper.rotation_offset, 1), quat_wxyz)) > 1.0 - 1e-12


@pytest.mark.parametrize('name', GRIPPERS)
def test_the_force_sensor_sits_at_the_mount_and_is_not_turned(name):
    gripper = create_gripper(name)
    model = gripper.compile()
    site = model.site(gripper.correct_naming('ft_frame'))
    assert model.body(site.bodyid[0]).name == gripper.root_body
    assert not site.pos.any()
    assert site.quat.tolist() == [1.0, 0.0, 0.0, 0.0]
    for sensor in gripper.important_sensors.values():
        assert model.sensor(sensor).objid[0] == site.id


@pytest.mark.parametrize('name', GRIPPERS)
def test_important_names_exist_and_finger_geoms_collide(name):
    gripper = create_gripper(name)
    assert set(gripper.important_sites.values()) <= set(gripper.sites)
    assert set(gripper.important_sensors.values()) <= set(gripper.sensors)
    for role in ('left_finger', 'right_finger', 'left_fingerpad', 'right_fingerpad'):
        assert set(gripper.important_geoms[role]) <= set(gripper.contact_geoms), role
    for role, geoms in EXPECTED.get(name, {}).get('important_geoms', {}).items():
        assert bool(gripper.important_geoms[role]) == bool(geoms), role


@pytest.mark.parametrize('name', WITH_FIGURES)
def test_declarations_are_those_of_the_reference(name):
    expected, gripper = EXPECTED[name], create_gripper(name)
    assert gripper.dof == expected['dof']
    assert gripper.speed == expected['speed']
    if expected['init_qpos'] is None:
        assert gripper.init_qpos is None
    else:
        np.testing.assert_allclose(gripper.init_qpos, expected['init_qpos'], atol=1e-12)


@pytest.mark.parametrize('sequence', sorted(ACTIONS['sequences']))
@pytest.mark.parametrize('name', WITH_ACTIONS)
def test_twenty_actions_give_the_commands_of_the_reference(name, sequence):
    gripper, numbers = create_gripper(name), ACTIONS['sequences'][sequence]
    for step, expected in enumerate(ACTIONS['grippers'][name][sequence]):
        action = [numbers[(step + 3 * i) % len(numbers)] for i in range(gripper.dof)]
        out = gripper.format_action(np.array(action))
        np.testing.assert_allclose(out, expected, rtol=0.0, atol=1e-12, err_msg=f'step {step}')


@pytest.mark.parametrize('name', WITH_ACTIONS)
def test_the_state_of_the_action_has_the_shape_and_value_of_the_reference(name):
    expected, gripper = ACTIONS['grippers'][name], create_gripper(name)
    np.testing.assert_array_equal(gripper.current_action, expected['initial'])
    numbers = ACTIONS['sequences']['mixed20']
    for step in range(len(numbers)):
        gripper.format_action([numbers[(step + 3 * i) % len(numbers)]
                               for i in range(gripper.dof)])
    assert np.shape(gripper.current_action) == np.shape(expected['current_action_after_mixed20'])
    np.testing.assert_allclose(gripper.current_action, expected['current_action_after_mixed20'],
                               rtol=0.0, atol=1e-12)


@pytest.mark.parametrize('name', GRIPPERS)
def test_an_action_of_the_wrong_length_or_not_finite_is_rejected_and_changes_nothing(name):
    gripper, twin = create_gripper(name), create_gripper(name)
    with pytest.raises(CommandError, match=f'{name} must have {gripper.dof} numbers?, got'):
        gripper.format_action(np.zeros(gripper.dof + 1))
    for number in (np.nan, np.inf):
        if gripper.dof:
            with pytest.raises(CommandError, match=f'{name} must be finite'):
                gripper.format_action(np.full(gripper.dof, number))
    np.testing.assert_array_equal(gripper.current_action, twin.current_action)


@pytest.mark.parametrize('name', GRIPPERS)
def test_changing_what_format_action_returned_changes_nothing_else(name):
    gripper, twin = create_gripper(name), create_gripper(name)
    action = np.ones(gripper.dof)
    gripper.format_action(action)[...] = 7.0
    assert action.tolist() == [1.0] * gripper.dof
    twin.format_action(action)
    np.testing.assert_array_equal(gripper.format_action(action), twin.format_action(action))
    assert gripper.format_action(action).shape == (len(gripper.actuators),)


@pytest.mark.parametrize('name', WITH_ACTIONS)
def test_without_a_law_of_its_actions_a_gripper_passes_them_on(name):
    shipped = type(create_gripper(name))
    gripper = type('Direct', (shipped,), {'_action': {'steps': False}}, registered=False)()
    assert gripper.dof == len(gripper.actuators)
    action = np.linspace(-1.0, 1.0, gripper.dof)
    out = gripper.format_action(action)
    np.testing.assert_array_equal(out, action)
    assert not np.shares_memory(out, action)
    with pytest.raises(CommandError):
        gripper.format_action(np.append(action, 0.0))
