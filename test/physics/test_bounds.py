# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Boxes around shapes, against closed forms and MuJoCo's own distances."""

import math

import mujoco
import numpy as np
import pytest

from manip_sim.models import compose
from manip_sim.physics.entities import Box, box_around, Sphere
from manip_sim.simulation import Simulation

CORNERS = [(0, 0, 0), (0.4, 0, 0), (0, 0.2, 0), (0, 0, 0.1)]
MESH = ' '.join(f'{x} {y} {z}' for x, y, z in CORNERS)
S = math.sqrt(0.5)


def world(*geoms):
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><asset><mesh name="m" vertex="{MESH}"/></asset><worldbody>'
        + ''.join(f'<geom {geom}/>' for geom in geoms) + '</worldbody></mujoco>')
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def around(model, data, axes=((1, 0, 0), (0, 1, 0), (0, 0, 1)), position=(0.0, 0.0, 0.0)):
    return box_around(model, data, range(model.ngeom), np.array(position), np.array(axes))


@pytest.mark.parametrize(('geom', 'half'), [
    ('type="sphere" size="0.2"', (0.2, 0.2, 0.2)),
    ('type="box" size="0.3 0.1 0.2"', (0.5 * S, 0.1, 0.5 * S)),
    ('type="capsule" size="0.1 0.3"', (0.1 + 0.3 * S, 0.1, 0.1 + 0.3 * S)),
    ('type="cylinder" size="0.1 0.3"', (0.4 * S, 0.1, 0.4 * S)),
    ('type="ellipsoid" size="0.3 0.1 0.2"',
     (math.sqrt(0.065), 0.1, math.sqrt(0.065)))])
def test_the_box_around_a_shape_that_is_turned_by_45_degrees_touches_it(geom, half):
    box = around(*world(f'{geom} euler="0 45 0" pos="1 2 3"'))
    np.testing.assert_allclose((box.low + box.high) / 2, [1.0, 2.0, 3.0], atol=1e-12)
    np.testing.assert_allclose((box.high - box.low) / 2, half, atol=1e-12)


def test_the_box_around_a_mesh_is_that_of_its_corners():
    box = around(*world('type="mesh" mesh="m" euler="0 0 90" pos="1 2 3"'))
    moved = [(1 - y, 2 + x, 3 + z) for x, y, z in CORNERS]
    np.testing.assert_allclose(box.low, np.min(moved, axis=0), atol=1e-6)
    np.testing.assert_allclose(box.high, np.max(moved, axis=0), atol=1e-6)


def test_boxes_are_in_the_frame_that_is_asked_for_and_hold_all_shapes_but_planes():
    model, data = world('type="plane" size="1 1 1"', 'type="sphere" size="0.1" pos="1 0 0"',
                        'type="sphere" size="0.2" pos="0 2 0"')
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # x to y.
    box = around(model, data, quarter, (0.0, 1.0, 0.0))
    np.testing.assert_allclose(box.low, [-1.1, -1.1, -0.2], atol=1e-12)
    np.testing.assert_allclose(box.high, [1.2, 0.2, 0.2], atol=1e-12)
    assert around(*world('type="plane" size="1 1 1"')) is None


def test_walls_at_the_faces_of_the_box_around_a_robot_touch_it():
    simulation = Simulation(compose('Panda', arena='table'))
    box = simulation.entities.bounds(simulation.data, 'robot0_base', in_world=True)
    spec = simulation.plan.spec.copy()
    for axis in range(3):
        for sign, face in ((-1.0, box.low[axis]), (1.0, box.high[axis])):
            size, place = np.full(3, 10.0), np.zeros(3)
            size[axis], place[axis] = 0.1, face + sign * 0.1
            spec.worldbody.add_geom(name=f'wall{axis}{sign}', type=mujoco.mjtGeom.mjGEOM_BOX,
                                    size=size, pos=place)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos = simulation.data.qpos
    mujoco.mj_forward(model, data)
    robot = [geom for geom in range(model.ngeom)
             if model.body_rootid[model.geom_bodyid[geom]] == model.body('robot0_base').rootid]
    walls = [geom for geom in range(model.ngeom) if model.geom(geom).name.startswith('wall')]
    assert len(robot) > 10 and len(walls) == 6
    for wall in walls:
        nearest = min(mujoco.mj_geomDistance(model, data, wall, geom, 1.0, None)
                      for geom in robot)
        assert nearest == pytest.approx(0.0, abs=1e-4), model.geom(wall).name


@pytest.mark.parametrize(('region', 'overlaps'), [
    (Box(np.array([1.0, 0.0, 0.0]), np.array([2.0, 1.0, 1.0])), True),
    (Box(np.array([1.01, 0.0, 0.0]), np.array([2.0, 1.0, 1.0])), False),
    (Sphere(np.array([1.3, 1.4, 0.5]), 0.5), True),
    (Sphere(np.array([1.3, 1.4, 0.5]), 0.49), False),
    (Sphere(np.array([0.5, 0.5, 0.5]), 0.0), True)])
def test_a_region_overlaps_a_box_that_it_touches(region, overlaps):
    assert region.overlaps(Box(np.zeros(3), np.ones(3))) is overlaps
