# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Keyframes of files: where the joints of robots, hands and arenas start."""

from pathlib import Path

import pytest

from manip_sim.errors import UnknownNameError
from manip_sim.models import compose, load_arena, load_robot
from manip_sim.simulation import Simulation

FILES = Path(__file__).resolve().parents[1] / 'data/files'


@pytest.fixture
def arm():
    return load_robot(FILES / 'keyframes.xml')


def test_a_world_starts_from_the_keyframe_of_its_name_in_all_files(arm):
    arena = load_arena(FILES / 'room.xml')
    world = compose(arm, arena=arena, keyframe='high')
    assert world.keyframes == ['ajar', 'high', 'home']
    data = Simulation(world).data
    assert data.joint('robot0_lift').qpos[0] == 0.5 and data.joint('hinge').qpos[0] == 1.0


def test_a_keyframe_of_the_arena_leaves_the_robot_at_its_start(arm):
    simulation = Simulation(compose(arm, arena=load_arena(FILES / 'room.xml')))
    assert simulation.episode_start.keyframe == ''
    assert simulation.data.joint('hinge').qpos[0] == 0.0
    simulation.episode_start.keyframe = 'ajar'
    assert simulation.data.joint('hinge').qpos[0] == 0.0
    simulation.reset()
    assert simulation.data.joint('hinge').qpos[0] == 0.25
    assert simulation.data.joint('robot0_turn').qpos[0] == 0.1


def test_equal_seeds_give_the_same_noise_on_each_keyframe(arm):
    noise = {'type': 'uniform', 'magnitude': 0.01}
    world = compose(arm, initialization_noise=noise, seed=3)
    other = world.init_qpos(3, 'high')
    apart = {joint: round(other[joint] - at, 9) for joint, at in world.init_qpos(3, '').items()}
    assert apart == {'robot0_turn': 0.3, 'robot0_lift': 0.3}


def test_a_keyframe_that_no_file_has_is_an_error_with_the_nearest_one(arm):
    for wrong in (lambda: compose(arm, keyframe='hihg'),
                  lambda: compose('Panda', keyframe='home')):
        with pytest.raises(UnknownNameError, match='keyframe'):
            wrong()
