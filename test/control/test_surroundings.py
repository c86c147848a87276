# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Joints and mocap bodies of an arena's file, and actuators that are of no part."""

from pathlib import Path

import numpy as np
import pytest

from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.models import compose
from manip_sim.simulation import Simulation

FILES = Path(__file__).resolve().parents[1] / 'data/files'
ROOM, WRIST = FILES / 'room.xml', FILES / 'differential_wrist.xml'


@pytest.fixture(scope='module')
def simulation():
    return Simulation(compose('Panda', arena=ROOM))


def test_an_actuator_of_the_arena_moves_its_joint_to_the_goal(simulation):
    simulation.reset()
    found = simulation.surroundings
    assert found.joints == ('hinge', 'slide') and found.actuators == ('drawer',)
    arena = found.commands['arena']
    arena.command(arena.checked(['slide'], [0.2], [], []))
    for _ in range(200):
        simulation.advance(5)
    assert found.state()[1] == pytest.approx(0.2, abs=1e-4)
    assert arena.checked(['slide'], [9.0], [], []) == {'slide': 0.3}
    assert arena.checked(['slide'], [np.nan], [], []) == {}


def test_the_effort_of_an_arena_joint_is_what_moved_it(simulation):
    simulation.reset()
    arena, joint = simulation.surroundings, simulation.data.joint('slide')
    arena.commands['arena'].command({'slide': 0.2})
    for _ in range(20):
        before = joint.qvel[0]
        simulation.advance(1)
        acceleration = (joint.qvel[0] - before) / simulation.timestep_s
        # The drawer of 1 kg slides level; its joint has a damping of 5 N s/m.
        assert arena.state()[5] == pytest.approx(acceleration + 5.0 * joint.qvel[0], abs=1e-6)
        simulation.advance(4)


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
        simulation.surroundings.commands['arena'].checked(*command)


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


@pytest.fixture
def wrist():
    return Simulation(compose(WRIST))


def angles(simulation):
    return [simulation.data.joint(f'robot0_{name}').qpos[0] for name in ('pitch', 'roll')]


def advance(simulation, seconds):
    for _ in range(round(seconds * 100)):
        simulation.advance(5)


def test_servos_of_tendons_hold_the_start_of_the_robot(wrist):
    others = ('robot0_sum', 'robot0_difference', 'robot0_spin')
    assert wrist.surroundings.other_actuators == others
    assert set(others).isdisjoint(wrist.robot.parts['arm'].actuators)
    before = angles(wrist)
    advance(wrist, 2.0)
    np.testing.assert_allclose(before, [0.3, 0.1], atol=1e-12)
    np.testing.assert_allclose(angles(wrist), before, atol=2e-3)


def test_commands_by_actuator_move_what_two_tendons_share(wrist):
    actuators = wrist.surroundings.commands['actuators']
    actuators.command(actuators.checked(
        ['robot0_difference', 'robot0_sum'], [0.2, 0.8], [], []))
    advance(wrist, 2.0)
    np.testing.assert_allclose(angles(wrist), [0.5, 0.3], atol=5e-3)
    lengths, rates, forces = wrist.surroundings.state_of_actuators().reshape(3, -1)
    np.testing.assert_allclose(lengths[:2], [0.8, 0.2], atol=1e-2)
    np.testing.assert_allclose(rates, 0.0, atol=1e-4)
    np.testing.assert_array_equal(forces, wrist.data.actuator_force[-3:])
    wrist.reset()
    np.testing.assert_allclose(angles(wrist), [0.3, 0.1], atol=1e-12)
    advance(wrist, 1.0)
    np.testing.assert_allclose(angles(wrist), [0.3, 0.1], atol=2e-3)


def test_a_servo_that_integrates_its_control_takes_a_velocity(wrist):
    actuators = wrist.surroundings.commands['actuators']
    actuators.command(actuators.checked(['robot0_spin'], [], [0.2], []))
    advance(wrist, 1.0)  # By now it follows at a constant distance.
    before = wrist.surroundings.state_of_actuators()[2]
    advance(wrist, 1.0)
    moved = wrist.surroundings.state_of_actuators()[2] - before
    assert moved == pytest.approx(0.2, abs=1e-3)
    with pytest.raises(CommandError, match="actuators: 'robot0_spin' takes a velocity, got a pos"):
        actuators.checked(['robot0_spin'], [1.0], [], [])


@pytest.mark.parametrize('value', [1.1e10, -1e300])
def test_an_actuator_without_a_range_takes_no_number_that_mujoco_cannot_use(wrist, value):
    actuators = wrist.surroundings.commands['actuators']
    with pytest.raises(CommandError, match=r"'robot0_spin' must be within 1e\+10, got"):
        actuators.checked(['robot0_spin'], [], [value], [])
    wrist.data.actuator('robot0_spin').ctrl[0] = 1e10
    wrist.advance(5)
    assert wrist.diverged is None


def test_a_saved_state_holds_the_commands_of_tendons(wrist):
    actuators = wrist.surroundings.commands['actuators']
    actuators.command(actuators.checked(['robot0_sum'], [1.0], [], []))
    saved = wrist.save()
    advance(wrist, 0.5)
    digest = wrist.digest()
    wrist.reset()
    wrist.restore(saved)
    advance(wrist, 0.5)
    assert wrist.digest() == digest
    with pytest.raises(UnknownNameError, match="unknown actuator that is of no part 'robot0_sam'"):
        actuators.checked(['robot0_sam'], [1.0], [], [])
