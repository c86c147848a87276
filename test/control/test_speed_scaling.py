# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Trajectories in progress that are slowed down along their paths."""

import math
import pickle

import numpy as np
import pytest

from manip_sim.control.commands import Status
from manip_sim.errors import CommandError
from manip_sim.models import compose
from manip_sim.simulation import Simulation

ARM = [f'robot0_joint{n}' for n in range(1, 8)]
TIMES, POINTS = [0.6, 1.2], [[0.3, 0.4], [0.5, 0.1]]


def begin(simulation):
    command = simulation.robot.parse.trajectory('arm', ARM[:2], TIMES, POINTS)
    simulation.robot.apply(command)
    return command.handle


def references(simulation, count, change=lambda simulation, step: None):
    """Return position and velocity of the setpoints of two joints after each step."""
    found = []
    for step in range(count):
        change(simulation, step)
        simulation.advance(1)
        reference = simulation.robot.controller_state('arm').reference
        found.append([reference.position[:2], reference.velocity[:2]])
    return np.array(found).transpose(1, 0, 2)


@pytest.fixture(scope='module')
def whole():
    """Return what :func:`references` returns of a trajectory that nothing slows down."""
    simulation = Simulation(compose('Panda'))
    begin(simulation)
    return references(simulation, 640)


def test_at_half_the_speed_a_trajectory_is_where_it_would_be_in_half_the_time(panda_sim, whole):
    position, velocity = whole[:, :600]
    for _ in range(20):
        panda_sim.advance(5)
    panda_sim.robot.set_speed_scaling(0.5)
    panda_sim.advance(5)
    begin(panda_sim)
    slow, slow_velocity = references(panda_sim, 1200)
    np.testing.assert_allclose(slow[1::2], position, atol=1e-4)
    np.testing.assert_allclose(slow_velocity[1::2], 0.5 * velocity, atol=5e-3)


@pytest.mark.parametrize('scaling', [0.0, 0.2, 0.7])
def test_a_change_on_the_way_keeps_the_path_and_the_acceleration_limits(scaling, panda_sim, whole):
    path, whole_velocity = whole
    limit = panda_sim.robot.joints.acceleration_limits(np.arange(2))
    highest = np.abs(np.diff(whole_velocity, axis=0)).max() / 0.002

    def change(simulation, step):
        if step in (100, 600):
            simulation.robot.set_speed_scaling(scaling if step == 100 else 1.0)
    handle = begin(panda_sim)
    slow, velocity = references(panda_sim, 1300, change)
    accelerations = np.abs(np.diff(velocity, axis=0)) / 0.002
    assert accelerations.max() < highest + 0.5 * limit.max() * 1.05
    away = np.abs(slow[:, None] - path[None]).max(axis=2).min(axis=1)
    assert away.max() < 2e-3  # Between two of the steps.
    assert handle.status is Status.DONE
    np.testing.assert_allclose(slow[-1], POINTS[-1], atol=1e-6)
    if not scaling:
        assert np.abs(velocity[400:590]).max() < 1e-9


def test_a_trajectory_that_begins_while_another_one_stands_still_waits(panda_sim):
    panda_sim.robot.set_speed_scaling(0.0)
    for _ in range(100):
        panda_sim.advance(5)
    before = panda_sim.robot.state().position
    handle = begin(panda_sim)
    for _ in range(200):
        panda_sim.advance(5)
    np.testing.assert_allclose(panda_sim.robot.state().position, before, atol=1e-3)
    assert handle.is_active
    panda_sim.robot.set_speed_scaling(1.0)
    for _ in range(400):
        panda_sim.advance(5)
    assert handle.status is Status.DONE


def test_a_full_speed_that_was_never_changed_changes_no_bit(panda_sim):
    other = Simulation(panda_sim.world)
    for simulation in (panda_sim, other):
        begin(simulation)
        simulation.advance(100)
    panda_sim.robot.set_speed_scaling(1.0)
    for simulation in (panda_sim, other):
        for _ in range(60):
            simulation.advance(5)
    np.testing.assert_array_equal(panda_sim.data.qpos, other.data.qpos)


def test_a_saved_state_goes_on_at_its_speed_and_a_reset_keeps_it(panda_sim):
    begin(panda_sim)
    panda_sim.advance(100)
    panda_sim.robot.set_speed_scaling(0.3)
    panda_sim.advance(20)
    other = Simulation(panda_sim.world)
    other.restore(pickle.loads(pickle.dumps(panda_sim.save())))
    for simulation in (panda_sim, other):
        for _ in range(100):
            simulation.advance(5)
    assert panda_sim.digest() == other.digest()
    panda_sim.reset()
    assert panda_sim.robot.settings['speed_scaling'] == 0.3
    handle = begin(panda_sim)
    for _ in range(160):
        panda_sim.advance(5)
    assert handle.is_active


@pytest.mark.parametrize('scaling', [-0.1, 1.1, math.nan, math.inf, 'half', None])
def test_a_share_that_cannot_be_is_rejected_and_changes_nothing(scaling, panda_sim):
    digest = panda_sim.digest()
    with pytest.raises(CommandError, match='speed_scaling'):
        panda_sim.robot.set_speed_scaling(scaling)
    assert panda_sim.digest() == digest
