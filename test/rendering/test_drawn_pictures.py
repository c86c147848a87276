# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Lights and cameras that are drawn for an episode are seen in its pictures."""

import mujoco
import numpy as np
import pytest

from manip_sim.models import compose
from manip_sim.rendering import OffscreenRenderer
from manip_sim.simulation import Simulation
from manip_sim.simulation.snapshots import take_snapshot, VisibleWorld

DRAWN = {
    'lights': {'key': {'diffuse': {'uniform': [[0.0] * 3, [1.0] * 3]}}},
    'cameras': {'frontview': {'position': {'offset': {'uniform': [[-0.2] * 3, [0.2] * 3]}}}}}
SIZE = 160, 120


@pytest.fixture(scope='module')
def simulation():
    return Simulation(compose('Panda', arena='table', seed=0, randomization=DRAWN))


@pytest.fixture(scope='module')
def visible(simulation):
    return VisibleWorld(simulation.plan)


def look(model, data):
    renderer = OffscreenRenderer(model, *SIZE)
    try:
        return renderer.render(data, 'frontview', *SIZE).rgb.astype(int)
    finally:
        renderer.close()


def picture(simulation, visible, seed):
    simulation.reset(seed)
    visible.show(take_snapshot(simulation))
    return look(visible.model, visible.data)


@pytest.mark.full
def test_an_episode_looks_the_same_each_time_and_others_differ(simulation, visible, gl):
    first, other, again = (picture(simulation, visible, seed) for seed in (1, 2, 1))
    np.testing.assert_array_equal(again, first)
    assert np.abs(other - first).mean() > 1.0


def test_pictures_are_those_of_a_model_with_what_was_drawn(simulation, visible, gl):
    seen = picture(simulation, visible, seed=3)
    drawn = simulation.randomized.drawn
    plain = VisibleWorld(Simulation(compose('Panda', arena='table', seed=0)).plan)
    plain.model.light('key').diffuse[:] = drawn['lights/key/diffuse']
    plain.model.camera('frontview').pos[:] = drawn['cameras/frontview/position']
    plain.data.qpos[:] = simulation.data.qpos
    mujoco.mj_kinematics(plain.model, plain.data)
    mujoco.mj_comPos(plain.model, plain.data)
    mujoco.mj_camlight(plain.model, plain.data)
    np.testing.assert_array_equal(look(plain.model, plain.data), seen)
