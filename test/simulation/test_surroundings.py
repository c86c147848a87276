# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Joints and mocap bodies of an arena's file."""

from pathlib import Path

import numpy as np
import pytest

from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.models import compose
from manip_sim.simulation import Simulation

ROOM = Path(__file__).resolve().parents[1] / 'data/files/room.xml'


@pytest.fixture(scope='module')
def simulation():
    return Simulation(compose('Panda', arena=ROOM))


def test_an_actuator_of_the_arena_moves_its_joint_to_the_goal(simulation):
    simulation.reset()
    found = simulation.surroundings
    assert found.joints == ('hinge', 'slide') and found.actuators == ('drawer',)
    found.command(found.checked(['slide'], [0.2], [], []))
    for _ in range(200):
        simulation.advance(5)
    assert found.state()[1] == pytest.approx(0.2, abs=1e-4)
    assert found.checked(['slide'], [9.0], [], []) == {'slide': 0.3}
    assert found.checked(['slide'], [np.nan], [], []) == {}


def test_a_drawer_stays_where_a_keyframe_has_it():
    simulation = Simulation(compose('Panda', arena=ROOM, keyframe='high'))
    for _ in range(100):
        simulation.advance(5)
    assert simulation.data.joint('slide').qpos[0] == pytest.approx(0.1, abs=1e-4)


@pytest.mark.parametrize('command, error', [
    ((['hinge'], [1.0], [], []), "no actuator of the arena drives 'hinge'; driven are: 'slide'"),
    ((['slid'], [1.0], [], []), "unknown joint of the arena 'slid': did you mean 'slide'"),
    ((['slide'], [], [1.0], []), "'slide' takes a position, got a velocity"),
    ((['slide'], [1.0, 2.0], [], []), 'expected 1 numbers in position'),
    ((['slide'], [np.inf], [], []), "position of 'slide' must be finite"),
    ((['slide', 'slide'], [0.0, 0.0], [], []), 'each of them once'), (([], [], [], []), 'names')])
def test_a_command_that_does_not_fit_is_an_error(simulation, command, error):
    with pytest.raises((CommandError, UnknownNameError), match=error):
        simulation.surroundings.checked(*command)


def test_a_mocap_body_is_where_it_was_put_until_the_reset(simulation):
    simulation.reset()
    simulation.surroundings.set_target('marker', [0.5, 0.0, 1.0], [0.0, 0.0, 1.0, 0.0])
    simulation.advance(5)
    body = simulation.data.body('marker')
    np.testing.assert_array_equal(body.xpos, [0.5, 0.0, 1.0])
    np.testing.assert_array_equal(simulation.surroundings.pose('marker')[3:], [0, 0, 1, 0])
    simulation.reset()
    np.testing.assert_array_equal(simulation.data.body('marker').xpos, [0.0, 1.0, 1.0])
    with pytest.raises(UnknownNameError, match="'markr': did you mean 'marker'"):
        simulation.surroundings.set_target('markr', [0, 0, 0], [0, 0, 0, 1])
    with pytest.raises(CommandError, match='orientation'):
        simulation.surroundings.set_target('marker', [0, 0, 0], [0, 0, 0, 0])
