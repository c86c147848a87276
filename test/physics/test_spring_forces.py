# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Springs that pull bodies: how strong, how long, and that nothing else remembers them."""

import math

import numpy as np
import pytest

pytest.importorskip('hypothesis', reason='needs hypothesis')

from hypothesis import given, settings, strategies as st  # noqa: E402

from manip_sim.errors import CommandError, UnknownNameError  # noqa: E402
from manip_sim.models import compose  # noqa: E402
from manip_sim.models.object_creation import create_object  # noqa: E402
from manip_sim.physics.object_spawning import plan_with  # noqa: E402
from manip_sim.simulation import Simulation  # noqa: E402

#: The cube of the table weighs 0.1 kg.
CUBE, G = 'cube', 9.81
STEPS = 5


@pytest.fixture(scope='module')
def simulation():
    return Simulation(compose('Panda', arena='table'))


@pytest.fixture
def table(simulation):
    simulation.reset()
    return simulation


def where(simulation, body=CUBE):
    return simulation.data.body(body).xpos.copy()


def hold(simulation, seconds, target, body=CUBE, point=None):
    point = where(simulation, body) if point is None else point
    for _ in range(round(seconds / (STEPS * simulation.timestep_s))):
        simulation.pulls.pull(body, point, target)
        simulation.advance(STEPS)


def test_a_spring_lifts_a_cube_to_below_its_target_by_its_weight_over_the_stiffness(table):
    target = where(table) + [0.05, 0.0, 0.3]
    hold(table, 3.0, target)
    # 100 N/m for each kilogram.
    np.testing.assert_allclose(where(table), target - [0.0, 0.0, G / 100.0], atol=2e-4)
    assert np.abs(table.data.qvel).max() < 1e-3


def test_it_ends_by_itself_a_fifth_of_a_second_after_it_was_asked_for_last(table):
    hold(table, 2.0, where(table) + [0.0, 0.0, 0.4])
    height = where(table)[2]
    for _ in range(19):
        table.advance(STEPS)
    assert table.pulls and where(table)[2] == pytest.approx(height, abs=1e-3)
    table.advance(STEPS)
    assert not table.pulls and not table.data.xfrc_applied.any()
    begin = where(table)[2]
    for _ in range(10):
        table.advance(STEPS)
    # It falls; the first of these periods may begin at a stamp that is still within the time.
    assert begin - where(table)[2] == pytest.approx(G * 0.1 ** 2 / 2.0, rel=0.25)


def test_a_far_target_pulls_with_five_times_the_weight(table):
    table.pulls.pull(CUBE, where(table), where(table) + [0.0, 0.0, 1e3])
    table.advance(STEPS)
    assert table.data.cvel[table.model.body(CUBE).id, 5] == pytest.approx(
        4.0 * G * STEPS * table.timestep_s, rel=1e-3)


def test_a_point_beside_the_centre_turns_the_body_towards_the_target(table):
    corner = where(table) + [0.024, 0.024, 0.024]
    target = corner + [0.0, 0.0, 0.4]
    for _ in range(400):
        table.pulls.pull(CUBE, corner, target)
        table.advance(STEPS)
    # It hangs by its corner: its centre is below the point that is held.
    np.testing.assert_allclose(where(table), target - [
        0.0, 0.0, G / 100.0 + math.sqrt(3.0) * 0.024], atol=5e-3)
    # A point that is far from the body is one on the sphere around it, not a long lever.
    table.reset()
    table.pulls.pull(CUBE, where(table) + [50.0, 0.0, 0.0], where(table) + [50.0, 0.0, 5.0])
    table.advance(1)
    assert np.abs(table.data.cvel[table.model.body(CUBE).id]).max() < 5.0


def test_a_link_gives_way_and_comes_back_and_the_wrench_feels_a_pull_of_the_gripper(table):
    for _ in range(50):
        table.advance(STEPS)
    gripper = 'gripper0_right_right_gripper'
    start, effector = where(table, gripper), table.robot.end_effectors['right']
    before = effector.external_wrench(table.data)
    hold(table, 1.0, start + [0.0, 0.5, 0.0], gripper, point=start)
    assert where(table, gripper)[1] - start[1] > 1e-3
    # The gripper is fixed to the last link, so that is what is as heavy.
    felt = np.linalg.norm((effector.external_wrench(table.data) - before)[:3])
    assert felt == pytest.approx(
        5.0 * G * table.model.body('robot0_link7').subtreemass[0], rel=0.02)
    for _ in range(200):
        table.advance(STEPS)
    np.testing.assert_allclose(where(table, gripper), start, atol=2e-4)


def test_nothing_is_left_of_it_in_states_that_are_saved_restored_or_reset(table):
    start = table.digest()
    target = where(table) + [0.1, 0.1, 0.2]
    hold(table, 0.2, target)
    saved, digest = table.save(), table.digest()
    table.advance(STEPS)
    pulled = table.digest()
    table.restore(saved)
    assert table.digest() == digest and not table.pulls
    table.advance(STEPS)
    assert table.digest() != pulled  # The spring was no part of the state.
    table.pulls.pull(CUBE, where(table), target)
    table.reset()
    assert table.digest() == start
    # The same pulls give the same bits.
    found = set()
    for _ in range(2):
        table.reset()
        hold(table, 0.3, target)
        found.add(table.digest())
    assert len(found) == 1


def test_an_object_that_comes_or_goes_ends_it():
    simulation = Simulation(compose('Panda', arena='table'))
    simulation.pulls.pull(CUBE, where(simulation), where(simulation) + [0.0, 0.0, 0.3])
    simulation.advance(STEPS)
    ball = create_object({'name': 'ball', 'shape': 'sphere', 'size': 0.03, 'mass': 0.1,
                          'position': [0.5, 0.0, 1.0]})
    simulation.change_objects(plan_with(simulation.plan, ball))
    assert not simulation.pulls and not simulation.data.xfrc_applied.any()
    simulation.pulls.pull('ball', [0.5, 0.0, 1.0], [0.5, 0.0, 1.5])
    simulation.advance(STEPS)
    assert simulation.data.body('ball').cvel[5] > 0.1


def test_physics_that_diverges_lets_go(table):
    table.pulls.pull(CUBE, where(table), where(table) + [0.0, 0.0, 0.3])
    table.data.qvel[0] = 1e6
    with pytest.raises(Exception, match='diverged'):
        table.advance(STEPS)
    assert not table.data.xfrc_applied.any()


@pytest.mark.parametrize(('body', 'point', 'target', 'message'), [
    ('cub', [0, 0, 0], [0, 0, 0], "unknown body 'cub': did you mean 'cube'"),
    ('', [0, 0, 0], [0, 0, 0], 'unknown body'),
    ('world', [0, 0, 0], [0, 0, 0], 'unknown body'),
    ('robot0_link0', [0, 0, 0], [0, 0, 0], "'robot0_link0' cannot move"),
    (CUBE, [0, 0], [0, 0, 0], 'the point'), (CUBE, [0, 0, 0], [0, math.nan, 0], 'the target'),
    (CUBE, [0, 0, 2e4], [0, 0, 0], 'the point must be within 10000 m')])
def test_what_cannot_be_pulled_is_an_error_and_changes_nothing(
        table, body, point, target, message):
    with pytest.raises((CommandError, UnknownNameError), match=message):
        table.pulls.pull(body, point, target)
    assert not table.pulls


NUMBERS = st.lists(st.floats() | st.floats(-2.0, 2.0), min_size=2, max_size=4)


@pytest.mark.full
@settings(max_examples=150, deadline=None)
@given(st.sampled_from([CUBE, 'robot0_link7', 'gripper0_right_leftfinger', 'table', 'x']),
       NUMBERS, NUMBERS, st.integers(-2**31, 2**31 - 1), st.sampled_from([1, 5, 50]))
def test_whatever_pulls_the_physics_stays_finite_and_the_force_bounded(
        simulation, body, point, target, number, steps):
    pulls, data = simulation.pulls, simulation.data
    try:
        pulls.pull(body, point, target, number)
    except (CommandError, UnknownNameError) as error:
        assert str(error)
        return
    pulls.apply(steps * simulation.timestep_s)
    force = np.linalg.norm(data.xfrc_applied[:, :3], axis=1)
    assert (force <= 5.0 * G * simulation.model.body_subtreemass + 1e-9).all()
    pulls.release()
    simulation.advance(steps)
    assert np.isfinite(data.qpos).all() and simulation.diverged is None
    if simulation.step_count % 7 == 0:
        simulation.reset()
