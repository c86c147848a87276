# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A running world gets another arena, and is then as one that began with it."""

from pathlib import Path

import numpy as np
import pytest

from manip_sim.errors import ModelError
from manip_sim.models import compose, create_arena
from manip_sim.simulation import Simulation
from manip_sim.simulation.robot_spawning import plan_in_arena, plan_with_robot

ROOM = Path(__file__).resolve().parents[1] / 'data' / 'files' / 'room.xml'


def test_a_world_in_another_arena_moves_as_one_that_began_there():
    simulation = Simulation(compose('Panda', arena='table'))
    simulation.advance(100)
    for name in ('bins', 'conveyor', 'drawer', 'empty', 'table'):
        simulation.change_robots(plan_in_arena(simulation, create_arena(name)))
        simulation.reset()
        new = Simulation(compose('Panda', arena=name))
        assert simulation.plan.object_names == new.plan.object_names
        assert simulation.world.arena.arena_name == name
        for one in (simulation, new):
            one.advance(200)
        np.testing.assert_allclose(simulation.data.qpos, new.data.qpos, rtol=0.0, atol=1e-12)


def test_robots_that_were_placed_stay_where_they_are():
    world = compose('Panda', arena='table')
    world.robots[0].set_base_xpos([0.1, 0.2, 0.3])
    simulation = Simulation(world)
    before = simulation.data.body('robot0_base').xpos.copy()
    assert before[:2].tolist() == [0.1, 0.2]
    simulation.change_robots(plan_in_arena(simulation, create_arena('bins')))
    np.testing.assert_array_equal(simulation.data.body('robot0_base').xpos, before)


def test_a_world_keeps_its_arena_if_something_needs_it():
    simulation = Simulation(compose('Panda', arena=ROOM))
    with pytest.raises(ModelError, match="arena empty has no camera 'overview'"):
        plan_in_arena(simulation, create_arena('empty'), ['overview'])
    plan_in_arena(simulation, create_arena('empty'), ['agentview'])
    drawn = Simulation(compose('Panda', arena='table', randomization={
        'placements': {'top': {'objects': ['cube'], 'x': [0.0, 0.1], 'y': [0.0, 0.1],
                               'z': 0.8}}}))
    with pytest.raises(ModelError, match='draws its objects'):
        plan_in_arena(drawn, create_arena('empty'))


def test_a_robot_comes_after_the_arena_was_replaced():
    simulation = Simulation(compose('Panda', arena='table'))
    simulation.change_robots(plan_in_arena(simulation, create_arena('bins')))
    robot = compose('UR5e', prefix='second_', idn='second').robots[0]
    simulation.change_robots(plan_with_robot(simulation, robot))
    assert len(simulation.robots) == 2
    simulation.advance(10)
