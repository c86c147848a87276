# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of the arena with two bins."""

import mujoco
import numpy as np
import pytest

from manip_sim.models import compose
from manip_sim.models.arenas import arena_names, BinsArena, create_arena
from manip_sim.models.world import World

# Middles of the open bin and of the four compartments of the other.
COMPARTMENTS = [(0.1, -0.25), (0.0, 0.155), (0.0, 0.405), (0.2, 0.155), (0.2, 0.405)]


def test_bins_are_an_arena_by_name():
    assert 'bins' in arena_names()
    assert isinstance(create_arena('bins'), BinsArena)


def test_bins_stand_where_the_reference_has_them():
    model = BinsArena().compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    # robosuite 1.5.2: bodies at a height of 0.8 m, floors 0.04 m thick.
    np.testing.assert_allclose(data.body('bin1').xpos, [0.1, -0.25, 0.8])
    np.testing.assert_allclose(data.body('bin2').xpos, [0.1, 0.28, 0.8])
    np.testing.assert_allclose(data.site('bin1').xpos[2], 0.82)
    np.testing.assert_allclose(data.site('bin2').xpos[2], 0.82)


@pytest.mark.parametrize(('x', 'y'), COMPARTMENTS)
def test_ball_that_rolls_through_a_bin_does_not_leave_it(x, y):
    # Between three faces at right angles a ball can stay wedged if friction exceeds 1 / sqrt(2):
    # each face then bears the halves of the other two forces.
    arena = BinsArena(friction=0.5)
    ball = arena.spec.worldbody.add_body(name='ball', pos=[x, y, 0.86])
    ball.add_freejoint()
    ball.add_geom(size=[0.02, 0.0, 0.0], mass=0.05, friction=[0.5, 0.005, 0.0001])
    model = World([], arena).compile()
    data = mujoco.MjData(model)
    data.qvel[:2] = [0.6, 0.8]
    mujoco.mj_step(model, data, 1500)
    half = np.array([0.2, 0.25] if y < 0.0 else [0.1, 0.125])
    assert (np.abs(data.body('ball').xpos[:2] - [x, y]) < half).all()
    assert data.body('ball').xpos[2] == pytest.approx(0.84, abs=1e-3)


@pytest.mark.parametrize(('robot', 'base'), [('Panda', 'RethinkMount'),
                                             ('PandaOmron', 'OmronMobileBase')])
def test_robot_starts_at_the_bins_without_touching_them(robot, base):
    world = compose(robot, 'PandaGripper', base, 'bins')
    compiled = world.compile()
    data = mujoco.MjData(compiled)
    for joint, position in world.init_qpos().items():
        data.joint(joint).qpos = position
    mujoco.mj_forward(compiled, data)
    np.testing.assert_allclose(data.body(world.robots[0].root_body).xpos[:2],
                               world.robots[0].base_xpos_offset['bins'][:2])
    assert data.ncon == 0
