# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A robot with a fixed root that its file puts into the floor stands above it."""

from __future__ import annotations

from files_rig import ARM, write
import mujoco
import numpy as np
import pytest

from manip_sim.models import compose, load_robot
from manip_sim.simulation import Simulation

#: A trunk at the origin with a leg below it, whose lowest shape is made by its test.
URDF = """<robot name="r"><link name="trunk"><inertial><mass value="5"/>
  <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><geometry><box size="0.2 0.2 0.1"/></geometry></collision></link>
  <link name="shank"><inertial><mass value="1"/>
  <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><origin xyz="0 0 -0.2" rpy="{rpy}"/><geometry>{shape}</geometry></collision></link>
  <joint name="knee" type="revolute"><parent link="trunk"/><child link="shank"/>
  <origin xyz="0 0 -0.3"/><axis xyz="0 1 0"/>
  <limit lower="-1" upper="1" effort="50" velocity="2"/></joint></robot>"""
BOX, WHEEL = '<box size="0.1 0.1 0.1"/>', '<cylinder radius="0.1" length="0.04"/>'


def simulated(file, **options):
    """Return a simulation of a robot and the height of its root."""
    simulation = Simulation(compose(file, **options))
    return simulation, float(simulation.data.body(simulation.robot.robot_model.root_body).xpos[2])


def lowest(model, data):
    """Return the height of the lowest point of the robot, measured by MuJoCo against the floor."""
    floor = model.geom('floor').id
    return min(mujoco.mj_geomDistance(model, data, floor, geom, 10.0, None)
               for geom in range(model.ngeom) if model.geom_bodyid[geom])


@pytest.mark.parametrize(('shape', 'rpy', 'below'), [
    (BOX, '0 0 0', 0.55), (BOX, '0.785398 0 0', 0.5 + 0.05 * np.sqrt(2.0)),
    ('<sphere radius="0.1"/>', '0.5 0.3 0', 0.6), (WHEEL, '1.570796 0 0', 0.6),
    (WHEEL, '0.8 0 0', 0.5 + 0.1 * np.sin(0.8) + 0.02 * np.cos(0.8))])
def test_a_robot_is_raised_by_its_lowest_shape(tmp_path, shape, rpy, below):
    file = write(tmp_path / 'r.urdf', URDF.format(shape=shape, rpy=rpy))
    simulation, height = simulated(file)
    assert height == pytest.approx(below, abs=2e-3) and simulation.start_defects == []
    assert 0.0 < lowest(simulation.model, simulation.data) < 2e-3
    said = [note for note in load_robot(file).inferred
            if note.startswith(f'raised by {height:.3f}')]
    assert len(said) == 1 and 'foot: [0, 0, 0] in a YAML file' in said[0]
    start = simulation.robot.state().position
    simulation.advance(1000)
    np.testing.assert_allclose(simulation.robot.state().position, start, atol=1e-3)


def test_the_start_pose_decides_how_far_a_robot_is_raised(tmp_path):
    write(tmp_path / 'r.urdf', URDF.format(shape='<sphere radius="0.1"/>', rpy='0 0 0'))
    file = write(tmp_path / 'r.yaml', 'start: {knee: 1.0}\n')
    assert simulated(file)[1] == pytest.approx(0.3 + 0.2 * np.cos(1.0) + 0.1, abs=2e-3)


@pytest.mark.parametrize(('yaml', 'options', 'height'), [
    ('foot: [0, 0, 0]', {}, 0.0), ('foot: [0, 0, -0.7]', {}, 0.7),
    ('', {'position': [0.0, 0.0, 1.5]}, 1.5), ('', {'position': [0.4, 0.2, 0.0]}, 0.0),
    ('base: RethinkMount', {}, 0.912)])
def test_a_robot_that_its_description_or_the_user_places_is_not_raised(
        tmp_path, yaml, options, height):
    file = write(tmp_path / 'r.urdf', URDF.format(shape=BOX, rpy='0 0 0'))
    write(tmp_path / 'r.yaml', yaml + '\n')
    assert simulated(file, **options)[1] == pytest.approx(height, abs=2e-3)


def test_a_place_that_is_nobodys_choice_is_one_for_the_lowest_shape(tmp_path):
    robot = load_robot(write(tmp_path / 'r.urdf', URDF.format(shape=BOX, rpy='0 0 0')))
    robot.set_base_xpos([0.4, 0.2, 0.0], may_be_raised=True)
    simulation, height = simulated(robot)
    assert height == pytest.approx(0.55, abs=2e-3)
    place = simulation.data.body(simulation.robot.robot_model.root_body).xpos[:2]
    np.testing.assert_allclose(place, [0.4, 0.2], atol=1e-12)


@pytest.mark.parametrize(('height', 'raised'), [(0.02, False), (-0.01, False), (-0.5, True)])
def test_the_foot_of_an_arm_may_reach_a_little_into_the_floor(tmp_path, height, raised):
    file = write(tmp_path / 'arm.xml', ARM.replace('pos="0 0 0.02"', f'pos="0 0 {height}"'))
    robot = load_robot(file)
    assert any(note.startswith('raised by') for note in robot.inferred) == raised
    expected = 0.021 if raised else height
    assert robot.compile().body(robot.root_body).pos[2] == pytest.approx(expected)


@pytest.mark.parametrize(('height', 'raised'), [(0.03, False), (-0.06, True)])
def test_a_wide_shape_of_the_foot_counts_where_more_than_half_of_it_is_in_the_floor(
        tmp_path, height, raised):
    file = write(tmp_path / 'arm.xml', ARM.replace(
        '"base" pos="0 0 0.02">', f'"base" pos="0 0 {height}"><geom size="0.12"/>'))
    robot = load_robot(file)
    assert any(note.startswith('raised by') for note in robot.inferred) == raised
