# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of random starts."""

import numpy as np
import pytest

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models import compose, compose_robot
from manip_sim.models.randomization import InitializationNoise
from manip_sim.models.world import World
from manip_sim.simulation import Simulation

UNIFORM = {'type': 'uniform', 'magnitude': 0.1}
ENDLESS = [(-np.inf, np.inf)]


def start(seed=1, noise=UNIFORM, **parts):
    return compose('Panda', initialization_noise=noise, seed=seed, **parts).init_qpos()


def changes(noisy):
    plain = compose('Panda').init_qpos()
    return np.array([noisy[joint] - plain[joint] for joint in plain])


def test_a_world_without_noise_starts_as_declared():
    assert compose('Panda', seed=3).init_qpos() == compose('Panda').init_qpos()
    assert start(noise={'magnitude': 0.0}) == compose('Panda').init_qpos()


def test_noise_moves_the_arm_and_not_the_gripper():
    moved = changes(start())
    assert (moved[:7] != 0.0).all()
    assert not moved[7:].any()


def test_a_seed_gives_the_same_start_in_another_world_and_after_a_reset():
    assert start(7) == start(7, arena='table')
    assert start(7) != start(8)
    world = compose('Panda', initialization_noise=UNIFORM)
    assert world.init_qpos() == world.init_qpos() == start(world.noise.seed)
    simulation = Simulation(world)
    first = simulation.robot.state().position
    simulation.advance(100)
    simulation.reset()
    np.testing.assert_array_equal(simulation.robot.state().position, first)
    np.testing.assert_array_equal(
        first[:7], list(world.init_qpos().values())[:7])


@pytest.mark.parametrize('magnitude', [0.02, 0.1])
def test_coupled_fingers_start_where_they_do_without_noise(magnitude):
    def fingers(simulation):
        part = simulation.robot.grippers['right/gripper'].part
        return simulation.data.qpos[part.qpos_addresses].tolist()
    plain = fingers(Simulation(compose('Panda', gripper='Robotiq85Gripper')))
    assert np.any(plain)
    noisy = Simulation(compose('Panda', gripper='Robotiq85Gripper', seed=1,
                               initialization_noise={'magnitude': magnitude}))
    for seed in (1, 2, 3):
        noisy.reset(seed)
        assert fingers(noisy) == plain


def test_without_a_seed_each_world_is_another():
    assert start(None) != start(None)


def test_two_robots_start_differently_and_each_as_without_the_other():
    robots = [compose_robot('Panda', idn=number) for number in range(2)]
    both = World(robots, initialization_noise=UNIFORM, seed=1).init_qpos()
    arms = [[both[joint] for joint in robot.arm_joints] for robot in robots]
    assert arms[0] != arms[1]
    assert arms[0] == [start(1)[joint] for joint in robots[0].arm_joints]


@pytest.mark.parametrize(('settings', 'spread', 'largest'), [
    ({'type': 'gaussian', 'magnitude': 0.1}, 0.1, 0.5), ({}, 0.02, 0.1),
    (UNIFORM, 0.1 / np.sqrt(3.0), 0.1)])
def test_noise_has_the_distribution_asked_for(settings, spread, largest):
    added = InitializationNoise(settings, 5).added(np.ones(20_000), ENDLESS * 20_000, 0) - 1.0
    assert added.mean() == pytest.approx(0.0, abs=0.03 * spread)
    assert added.std() == pytest.approx(spread, rel=0.03)
    assert spread < np.abs(added).max() <= largest


def test_noise_stays_within_the_ranges_of_the_joints():
    added = InitializationNoise({'magnitude': 3.0}, 2).added(
        [0.0] * 100, [(-0.1, 0.2)] * 50 + ENDLESS * 50, 0)
    assert added[:50].min() == -0.1 and added[:50].max() == 0.2
    assert np.abs(added[50:]).max() > 1.0


def test_a_robot_starts_within_its_ranges(panda):
    start = World([panda], initialization_noise={'magnitude': 3.0}, seed=1).init_qpos()
    model = panda.compile()
    for joint in panda.arm_joints:
        low, high = model.joint(joint).range
        assert low <= start[joint] <= high


@pytest.mark.parametrize(('settings', 'message'), [
    ({'typ': 'uniform'}, "unknown key of initialization_noise 'typ': did you mean 'type'"),
    ({'type': 'gausian'}, "unknown type of initialization_noise 'gausian': did you mean 'gau"),
    ({'magnitude': -0.1}, 'magnitude of initialization_noise must be .* 0 to 3.142, got -0.1'),
    ({'magnitude': float('nan')}, 'must be .*, got nan'), ({'magnitude': 4}, 'must be .*, got 4'),
    ({'magnitude': True}, 'must be .*, got True'), ({'magnitude': '1'}, "must be .*, got '1'")])
def test_bad_settings_are_rejected(settings, message):
    with pytest.raises(ModelError, match=message):
        InitializationNoise(settings, 1)
    assert issubclass(UnknownNameError, ModelError)


@pytest.mark.parametrize('seed', [-1, 1.5, True, 'one'])
def test_a_seed_that_is_no_whole_number_is_rejected(seed):
    with pytest.raises(ModelError, match='^seed must be a whole number from 0, got '):
        InitializationNoise({}, seed)
