# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The grippers that do not grip: the eraser and the bare flange."""

import mujoco
import numpy as np
import pytest

from catalogue import equipped

from manip_sim.errors import CommandError
from manip_sim.models.grippers import NullGripper, WipingGripper
from manip_sim.models.robots import create_robot


def eraser_on_the_floor():
    """Return the model of an eraser that lies on its surface."""
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 0.1])
    body = spec.worldbody.add_body(pos=[0.0, 0.0, 0.04], quat=[0.0, 1.0, 0.0, 0.0])
    body.add_freejoint()
    WipingGripper().attach_to(spec, body.add_frame())
    return spec.compile()


def test_each_corner_of_the_eraser_feels_a_quarter_of_its_weight():
    model = eraser_on_the_floor()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 2000)
    mujoco.mj_forward(model, data)
    felt = [data.sensor(f'gripper0_touch{corner}').data[0] for corner in (1, 2, 3, 4)]
    np.testing.assert_allclose(felt, 0.03 * 9.81 / 4.0, rtol=1e-3)


def test_only_the_corner_that_is_pressed_feels_it():
    model = eraser_on_the_floor()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 2000)
    body = model.body('gripper0_wiping_gripper').id
    corner = data.geom('gripper0_wiping_corner2').xpos
    for _ in range(500):
        mujoco.mju_zero(data.qfrc_applied)
        mujoco.mj_applyFT(model, data, np.array([0.0, 0.0, -2.0]), np.zeros(3), corner, body,
                          data.qfrc_applied)
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    felt = [data.sensor(f'gripper0_touch{corner}').data[0] for corner in (1, 2, 3, 4)]
    assert felt[1] > 1.9
    assert max(felt[0], felt[2], felt[3]) < 0.3


def test_a_bare_flange_adds_no_mass_and_its_sensor_reads_nothing():
    bare, with_flange = create_robot('Panda').compile(), create_robot('Panda')
    with_flange.add_gripper(NullGripper())
    model = with_flange.compile()
    assert model.body_mass.sum() == bare.body_mass.sum()
    assert (model.nv, model.nu) == (bare.nv, bare.nu)
    data = mujoco.MjData(model)
    data.qvel[:] = 1.0
    mujoco.mj_step(model, data, 10)
    mujoco.mj_forward(model, data)
    for sensor in with_flange.grippers['right'].important_sensors.values():
        np.testing.assert_allclose(data.sensor(sensor).data, 0.0, atol=1e-12)


def test_the_grasp_frame_of_a_bare_flange_stands_on_the_end_effector():
    robot = equipped('Panda', gripper='NullGripper')
    model = robot.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    site = data.site(robot.grippers['right'].important_sites['grip_site'])
    np.testing.assert_allclose(site.xpos, data.body(robot.eef_name['right']).xpos, atol=1e-12)


@pytest.mark.parametrize('cls', [NullGripper, WipingGripper])
def test_tools_without_fingers_take_no_action(cls):
    tool = cls()
    assert tool.dof == 0 and tool.init_qpos is None
    assert tool.format_action([]).shape == (0,)
    with pytest.raises(CommandError, match=f'{cls.__name__} must have 0 numbers, got 1'):
        tool.format_action([1.0])
