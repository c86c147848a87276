# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The odometry of a base whose joints have an offset, against finite differences."""

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from manip_sim.physics.robot_frames import OdometryReader

BASE = """<mujoco><option gravity="0 0 0"/><worldbody>
  <body name="root" pos="1 2 3" euler="0 0 50"><body name="base" pos="0.1 0.2 0">
    <joint name="x" type="slide" axis="1 0 0" ref="0.3"/>
    <joint name="y" type="slide" axis="0 1 0"/>
    <joint name="yaw" axis="0 0 1" ref="0.4"/>
    <geom size="0.1"/></body></body></worldbody></mujoco>"""


@pytest.fixture
def base():
    """Return the model, its data and a reader."""
    model = mujoco.MjModel.from_xml_string(BASE)
    return model, mujoco.MjData(model), OdometryReader(model, ('x', 'y', 'yaw'))


def test_with_its_joints_at_zero_a_base_is_at_the_origin(base):
    model, data, reader = base
    data.qpos[:] = 0.0
    mujoco.mj_forward(model, data)
    found = reader.read(model, data)
    np.testing.assert_allclose(found.position, np.zeros(3), atol=1e-12)
    np.testing.assert_allclose(found.quat_xyzw, [0.0, 0.0, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(reader.origin.position, data.body('base').xpos, atol=1e-12)
    assert reader.base == 'base'


def test_the_twist_is_how_the_pose_changes(base):
    model, data, reader = base
    data.qpos[:], data.qvel[:] = [0.5, -0.4, 1.0], [0.3, 0.2, 0.9]
    found, step_s = [], 1e-6
    for _ in range(2):
        mujoco.mj_forward(model, data)
        found.append(reader.read(model, data))
        mujoco.mj_integratePos(model, data.qpos, data.qvel, step_s)
    before, after = found
    turn = Rotation.from_quat(before.quat_xyzw)
    np.testing.assert_allclose(turn.apply(before.linear),
                               (after.position - before.position) / step_s, atol=1e-5)
    change = turn.inv() * Rotation.from_quat(after.quat_xyzw)
    np.testing.assert_allclose(before.angular, change.as_rotvec() / step_s, atol=1e-5)
