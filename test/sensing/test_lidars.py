# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Lidars: distances against geometry, limits, noise, latency, and descriptions that are wrong."""

import math

from hypothesis import given, settings, strategies as st
import mujoco
import numpy as np
import pytest

from manip_sim.errors import ManipSimError, ModelError, UnknownNameError
from manip_sim.models import World
from manip_sim.models.cameras import create_lidar
from manip_sim.simulation import Simulation

#: A ball 3 m ahead and a box 2 m to the left of the lidar, which stands 1 m above the floor.
BALL = {'name': 'ball', 'shape': 'sphere', 'size': 0.5, 'mass': 1.0, 'position': [8.0, 5.0, 1.0]}
BOX = {'name': 'box', 'shape': 'box', 'size': [1.0, 1.0, 2.0], 'mass': 1.0,
       'position': [5.0, 7.5, 1.0]}
FLAT = {'name': 'flat', 'position': [5.0, 5.0, 1.0], 'samples': 8, 'range_max': 6.0}
ROUND = {**FLAT, 'name': 'round', 'samples': 4, 'rings': 3, 'elevation_min': -0.5,
         'elevation_max': 0.5}


@pytest.fixture
def simulate(one_joint_arm):
    def start(*lidars, objects=(BALL, BOX), **arguments):
        return Simulation(World([one_joint_arm()], objects=objects, lidars=lidars, **arguments))
    return start


def test_rays_go_round_from_behind_over_ahead(simulate):
    ranges = simulate(FLAT).lidars.exact('flat')
    # -180, -135, ... degrees: ahead is the fifth, to the left the seventh.
    assert ranges[4] == pytest.approx(2.5)
    assert ranges[6] == pytest.approx(2.0)
    assert np.isinf(ranges[[1, 2, 3, 5, 7]]).all()


def test_the_last_ray_of_less_than_a_turn_is_at_its_end(simulate):
    lidar = create_lidar({**FLAT, 'samples': 3, 'angle_min': 0.0, 'angle_max': math.pi / 2})
    simulation = simulate(lidar)
    assert simulation.lidars.exact('flat') == pytest.approx([2.5, np.inf, 2.0])


def test_rings_go_up_and_the_lower_ones_meet_the_floor(simulate):
    simulation = simulate(ROUND)
    ranges = simulation.lidars.exact('round').reshape(3, 4)
    assert ranges[1] == pytest.approx([np.inf, np.inf, 2.5, 2.0])
    # The floor is the world's, and so is the lidar: it does not hide it.
    assert ranges[0, 1] == pytest.approx(1.0 / math.sin(0.5))
    assert np.isinf(ranges[2, 1])
    x, y, z = (simulation.lidars['round'].directions[0, 3] * ranges[0, 3]).tolist()
    assert (x, y) == pytest.approx((0.0, 1.0 / math.tan(0.5)), abs=1e-9)
    assert z == pytest.approx(-1.0)


def test_the_lidar_moves_with_its_body_which_it_does_not_see(one_joint_arm):
    arm = one_joint_arm()
    hand = next(name for name in arm.bodies if name.endswith('right_hand'))
    link = next(name for name in arm.bodies if name.endswith('link1'))
    simulation = Simulation(World([arm], lidars=[
        {'name': 'carried', 'body': link, 'samples': 2, 'angle_min': 0.0, 'angle_max': 1.0},
        {'name': 'held', 'body': hand, 'samples': 2, 'angle_min': 0.0, 'angle_max': 1.0}]))
    geoms = np.zeros(1, np.int32)
    data = simulation.data
    simulation.data.qpos[0] = math.pi / 2  # About y: x points down.
    simulation.forward()
    ranges = simulation.lidars.exact('carried')
    site = simulation.model.site('carried').id
    body = int(simulation.model.site_bodyid[site])
    expected = mujoco.mj_ray(simulation.model, data, data.site_xpos[site],
                             data.site_xmat[site].reshape(3, 3)[:, 0].copy(), None, 1, body, geoms)
    assert ranges[0] == pytest.approx(expected)
    assert ranges[0] == pytest.approx(data.site_xpos[site][2], abs=0.06)
    assert simulation.lidars.sensing('carried') is simulation.robot.sensing


def test_beyond_the_range_is_inf_and_too_near_is_minus_inf(simulate):
    simulation = simulate({**FLAT, 'range_min': 2.2, 'range_max': 2.4})
    ranges = simulation.lidars.exact('flat')
    assert ranges[4] == math.inf
    assert ranges[6] == -math.inf


def test_noise_is_that_of_the_description_and_of_the_robot_and_of_what_is_hit(simulate):
    many = {**FLAT, 'samples': 100_000, 'angle_min': 1.4, 'angle_max': 1.7, 'noise': 0.02}
    simulation = simulate(many, {**many, 'name': 'other', 'noise': 0.0}, seed=5)
    lidars = simulation.lidars

    def errors(name='flat'):
        error = lidars.measured(name) - lidars.exact(name)
        return error - error.mean() if abs(error.mean()) < 1e-3 else error
    np.testing.assert_array_equal(errors('other'), 0.0)
    assert errors().std() == pytest.approx(0.02, rel=0.01)
    simulation.robot.sensing.set('noise.range', 0.03)
    assert errors().std() == pytest.approx(0.05, rel=0.01)
    assert errors('other').std() == pytest.approx(0.03, rel=0.01)
    assert abs(np.corrcoef(errors(), errors('other'))[0, 1]) < 0.01
    before = lidars.measured('flat')
    np.testing.assert_array_equal(lidars.measured('flat'), before)
    simulation.advance(1)
    assert (lidars.measured('flat') != before).mean() > 0.99
    simulation.reset(5)
    np.testing.assert_array_equal(lidars.measured('flat'), before)
    simulation.reset(6)
    assert (lidars.measured('flat') != before).mean() > 0.99


def test_latency_shows_what_was_there(simulate):
    simulation = simulate(FLAT)
    simulation.robot.sensing.set('latency.state', 0.02)
    seen = []
    for _ in range(40):
        simulation.advance(5)
        seen.append((simulation.lidars.exact('flat')[4], simulation.lidars.measured('flat')[4]))
    exact, measured = np.array(seen).T
    assert np.ptp(exact) > 0.0  # The ball falls and rolls.
    np.testing.assert_array_equal(measured[2:], exact[:-2])


@pytest.mark.parametrize('wrong, what', [
    ({'samples': 1}, "lidar 'flat': 'samples' must be at least 2, got 1"),
    ({'samples': 2.5}, "'samples' must be a whole number, got 2.5"),
    ({'rings': 129}, "'rings' must be at most 128, got 129"),
    ({'samples': 200_000, 'rings': 2}, "'samples' times 'rings' must be at most 262144, got "
     '400000'),
    ({'range_min': 30.0}, "'range_min' must be less than 'range_max', got 30 and 6"),
    ({'angle_min': 1.0, 'angle_max': 1.0}, "'angle_min' must be less than 'angle_max'"),
    ({'noise': -0.1}, "'noise' must be at least 0, got -0.1"),
    ({'range_max': float('inf')}, "'range_max' must be"),
    ({'sample': 9}, "unknown key 'sample': did you mean 'samples'"),
    ({'name': 'a b'}, "'a b' cannot be the name of a lidar and its topics"),
    ({'rpy': [0, 0, 0], 'quat_xyzw': [0, 0, 0, 1]}, "give 'rpy' or 'quat_xyzw', not both")],
    ids=str)
def test_a_wrong_description_is_told_on_one_line(wrong, what):
    with pytest.raises(ModelError, match=what) as error:
        create_lidar({**FLAT, **wrong})
    assert '\n' not in str(error.value)


def test_a_lidar_needs_a_name_of_its_own_and_a_body(simulate):
    with pytest.raises(UnknownNameError, match="unknown body of the lidar 'flat' 'bal'"):
        simulate({**FLAT, 'body': 'bal'})
    with pytest.raises(ModelError, match="lidar 'flat': there is a site of this name already"):
        simulate(FLAT, FLAT)


VALUES = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.lists(
    st.floats(), max_size=4)


@pytest.mark.full
@settings(max_examples=300, deadline=None)
@given(st.dictionaries(st.sampled_from([
    'name', 'body', 'position', 'rpy', 'quat_xyzw', 'samples', 'rings', 'angle_min', 'angle_max',
    'elevation_min', 'elevation_max', 'range_min', 'range_max', 'rate', 'noise', 'other']), VALUES,
    max_size=6))
def test_any_description_is_a_lidar_or_one_line(description):
    try:
        lidar = create_lidar({'name': 'flat', **description})
    except ManipSimError as error:
        assert '\n' not in str(error)
    else:
        directions = lidar.rays.directions()
        np.testing.assert_allclose((directions**2).sum(axis=-1), 1.0)
