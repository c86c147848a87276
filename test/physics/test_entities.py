# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Where things are and how they move, against finite differences and the laws of motion."""

import mujoco
import numpy as np
import pytest

from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.physics.entities import Entities
from manip_sim.physics.poses_and_twists import Pose, Twist

# The brick's centre of mass is beside its frame, so that the frame's origin is swung around.
WORLD = """
<mujoco>
  <option timestep="1e-4"/>
  <worldbody>
    <body name="base"><geom size="0.1"/></body>
    <body name="brick" pos="0 0 2">
      <freejoint/>
      <geom type="box" size="0.1 0.05 0.02" pos="0.2 0 0"/>
    </body>
    <body><freejoint/><geom size="0.1"/></body>
  </worldbody>
</mujoco>
"""
TILTED = Pose.checked([0.1, 0.2, 3.0], np.array([1.0, 2.0, 3.0, 4.0]) / np.sqrt(30.0))
SPIN = Twist.checked([1.0, 2.0, 3.0], [2.0, -1.0, 3.0])


@pytest.fixture
def model():
    return mujoco.MjModel.from_xml_string(WORLD)


@pytest.fixture
def data(model):
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return data


@pytest.fixture
def entities(model):
    return Entities(model, {'base': 'base'}, ['base'])


def rotation(pose):
    x, y, z, w = pose.quat_xyzw
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])


def test_the_robot_and_named_free_bodies_are_entities(entities):
    assert entities.names == ['base', 'brick']
    assert entities.is_free('brick') and not entities.is_free('base')


def test_what_is_placed_is_read(entities, data):
    entities.place(data, 'brick', TILTED, SPIN)
    state = entities.read(data, 'brick')
    np.testing.assert_allclose(state.pose.position, TILTED.position, atol=1e-12)
    np.testing.assert_allclose(state.pose.quat_xyzw, TILTED.quat_xyzw, atol=1e-12)
    np.testing.assert_allclose(state.twist.linear, SPIN.linear, atol=1e-12)
    np.testing.assert_allclose(state.twist.angular, SPIN.angular, atol=1e-12)


def test_twist_and_acceleration_are_the_rates_of_pose_and_twist(entities, model, data):
    entities.place(data, 'brick', TILTED, SPIN)
    before = entities.read(data, 'brick')
    mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    after = entities.read(data, 'brick')
    step_s = model.opt.timestep
    np.testing.assert_allclose(
        (after.pose.position - before.pose.position) / step_s, before.twist.linear, atol=1e-2)
    turn = (rotation(after.pose) - rotation(before.pose)) / step_s @ rotation(before.pose).T
    np.testing.assert_allclose([turn[2, 1], turn[0, 2], turn[1, 0]], before.twist.angular,
                               atol=1e-2)
    np.testing.assert_allclose((after.twist.linear - before.twist.linear) / step_s,
                               before.linear_acceleration, atol=2e-2)
    np.testing.assert_allclose((after.twist.angular - before.twist.angular) / step_s,
                               before.angular_acceleration, atol=2e-2)


def test_what_lies_still_has_no_acceleration(entities, data):
    state = entities.read(data, 'base')
    assert not state.linear_acceleration.any() and not state.angular_acceleration.any()


def test_a_new_pose_leaves_the_velocity_in_world_axes_as_it_is(entities, data):
    entities.place(data, 'brick', None, SPIN)
    entities.place(data, 'brick', TILTED, None)
    twist = entities.read(data, 'brick').twist
    np.testing.assert_allclose(twist.linear, SPIN.linear, atol=1e-12)
    np.testing.assert_allclose(twist.angular, SPIN.angular, atol=1e-12)


def test_a_fixed_body_is_not_placed(entities, data):
    with pytest.raises(CommandError, match="'base' cannot be moved, .*: brick"):
        entities.place(data, 'base', TILTED, None)


def test_an_unknown_entity_is_told_with_the_nearest_names(entities, data):
    with pytest.raises(UnknownNameError, match="unknown entity 'brik': did you mean 'brick'"):
        entities.read(data, 'brik')
    with pytest.raises(UnknownNameError, match='available: base, brick'):
        entities.is_free('sphere')


def test_a_quaternion_that_is_nearly_of_unit_length_is_normalised():
    pose = Pose.checked([0.0, 0.0, 0.0], [0.0, 0.0, 0.707, 0.707])
    assert np.linalg.norm(pose.quat_xyzw) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize('position, quat_xyzw, text', [
    ([0.0, np.nan, 0.0], [0.0, 0.0, 0.0, 1.0], 'position must be finite, got nan at index 1'),
    ([0.0, 0.0, -2e4], [0.0, 0.0, 0.0, 1.0], 'position must be within 10000 m'),
    ([0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0], 'of length 0'),
    ([0.0, 0.0, 0.0], [0.0, np.inf, 0.0, 0.0], 'orientation must be finite')])
def test_a_pose_that_is_none_is_rejected(position, quat_xyzw, text):
    with pytest.raises(CommandError, match=text):
        Pose.checked(position, quat_xyzw)


@pytest.mark.parametrize('linear, angular, text', [
    ([0.0, -2e3, 0.0], [0.0, 0.0, 0.0], 'linear velocity must be within 1000'),
    ([0.0, 0.0, 0.0], [np.nan, 0.0, 0.0], 'angular velocity must be finite')])
def test_a_twist_that_is_too_great_or_not_finite_is_rejected(linear, angular, text):
    with pytest.raises(CommandError, match=text):
        Twist.checked(linear, angular)
