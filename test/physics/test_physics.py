# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of the holder of model and data."""

from collections.abc import Mapping

import pytest

from manip_sim.models import compose
from manip_sim.models.object_creation import create_object
from manip_sim.physics.object_spawning import plan_with, plan_without
from manip_sim.simulation import Simulation

BALL = {'name': 'ball', 'shape': 'sphere', 'size': [0.1], 'mass': 1.0, 'position': [3.0, 3.0, 5.0]}


def reachable(left):
    """Return all objects of the simulation that can be reached through attributes."""
    found = {}
    while left:
        item = left.pop()
        if id(item) in found:
            continue
        found[id(item)] = item
        if isinstance(item, Mapping):
            left += item.values()
        elif isinstance(item, (list, tuple, set, frozenset)):
            left += item
        elif type(item).__module__.startswith(
                ('manip_sim.control.', 'manip_sim.physics.', 'manip_sim.simulation.')):
            left += getattr(item, '__dict__', {}).values()
    return found.values()


@pytest.mark.parametrize('robot', ['Panda', 'Baxter', 'PandaOmron'])
def test_what_controls_a_robot_keeps_neither_model_nor_data(robot):
    simulation = Simulation(compose(robot, arena='empty'))
    model, data = simulation.model, simulation.data
    keepers = {type(item).__name__
               for item in reachable([simulation.robots, simulation.efforts])
               if any(kept is model or kept is data
                      for kept in getattr(item, '__dict__', {}).values())}
    assert keepers == {'Physics'}


def test_what_depends_on_the_model_is_made_anew_at_once_and_at_each_change():
    simulation = Simulation(compose('Panda', arena='empty'))
    seen = []
    simulation.physics.on_change(lambda: seen.append(
        (simulation.model is simulation.physics.model, simulation.model.nbody)))
    bodies = simulation.model.nbody
    simulation.change_objects(plan_with(simulation.plan, create_object(BALL)))
    simulation.change_objects(plan_without(simulation.plan, 'ball'))
    assert seen == [(True, bodies), (True, bodies + 1), (True, bodies)]


def test_edits_of_the_model_and_its_options_survive_a_spawn_while_an_end_effector_moves():
    simulation = Simulation(compose('Panda', arena='empty'))
    simulation.model.opt.gravity[2] = -1.6
    simulation.model.body('robot0_link3').mass[0] = 5.0
    simulation.robot.apply(simulation.robot.parse.action('right/gripper', [1.0]))
    simulation.advance(5)
    simulation.change_objects(plan_with(simulation.plan, create_object(BALL)))
    simulation.advance(5)
    assert simulation.model.opt.gravity[2] == -1.6
    assert simulation.model.body('robot0_link3').mass[0] == 5.0
