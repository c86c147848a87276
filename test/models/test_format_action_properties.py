# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Properties of ``format_action`` of every gripper and of the robots, for any actions."""

from functools import cache

import numpy as np
import pytest

pytest.importorskip('hypothesis', reason='needs hypothesis')

from hypothesis import given, settings, strategies as st  # noqa: E402

from manip_sim.errors import CommandError  # noqa: E402
from manip_sim.models.grippers import create_gripper, gripper_names  # noqa: E402
from manip_sim.models.robots import create_robot, robot_names  # noqa: E402

FINITE = st.floats(allow_nan=False, allow_infinity=False) | st.floats(-2.0, 2.0)
JUNK = st.none() | st.text(max_size=3) | st.sampled_from([np.nan, np.inf, -np.inf, 10**400])
#: Their actions are positions, which are not clamped here, and not steps.
OF_POSITIONS = ('FourierLeftHand', 'FourierRightHand')


@cache
def gripper_of(name):
    return create_gripper(name)


def actions(dof, most=3):
    """Return sequences of actions of the right length."""
    return st.lists(st.lists(FINITE, min_size=dof, max_size=dof), min_size=1, max_size=most)


@pytest.mark.parametrize('name', gripper_names())
@settings(max_examples=12)
@given(data=st.data())
def test_commands_of_a_gripper_are_finite_in_range_and_a_step_apart(name, data):
    gripper = gripper_of(name)
    gripper.current_action = np.zeros_like(gripper.current_action)
    before = None
    for action in data.draw(actions(gripper.dof)):
        command = gripper.format_action(action)
        assert command.shape == (len(gripper.actuators),)
        assert np.isfinite(command).all()
        if name in OF_POSITIONS:
            # Each motor is at what its action says.
            assert set(command.tolist()) <= set(action) and set(action) <= set(command.tolist())
        else:
            assert np.abs(command).max(initial=0.0) <= 1.0
            if before is not None:
                # One gripper moves in proportion to its action.
                most = gripper.speed * np.maximum(1.0, np.abs(action).max(initial=0.0))
                step = np.abs(command - before).max(initial=0.0)
                assert step <= most * (1.0 + 1e-12) or gripper.speed == 0.0
        before = command.copy()
        # What is returned is a copy.
        command[:] = 7.0
        if name not in OF_POSITIONS:
            np.testing.assert_array_equal(gripper.format_action([0.0] * gripper.dof), before)


@pytest.mark.parametrize('name', gripper_names())
@settings(max_examples=12)
@given(data=st.data())
def test_an_action_that_does_not_fit_a_gripper_is_rejected_and_changes_nothing(name, data):
    gripper, dof = gripper_of(name), gripper_of(name).dof
    for action in data.draw(actions(dof, 2)):
        gripper.format_action(action)
    before = np.copy(gripper.current_action)
    wrong = data.draw(
        st.lists(FINITE, max_size=dof + 2).filter(lambda action: len(action) != dof)
        | st.tuples(st.lists(FINITE, min_size=dof, max_size=dof), JUNK, st.integers(0, 20)).map(
            lambda t: [*t[0][:t[2] % dof], t[1], *t[0][t[2] % dof + 1:]] if dof else [t[1]])
        | st.just([[0.0] * dof]) | st.just(None) | st.just('close'))
    with pytest.raises(CommandError, match=rf'^an action of {name} must '):
        gripper.format_action(wrong)
    np.testing.assert_array_equal(gripper.current_action, before)


@pytest.mark.parametrize('name', gripper_names())
@settings(max_examples=12)
@given(data=st.data())
def test_a_gripper_goes_on_from_where_it_has_been(name, data):
    gripper = gripper_of(name)
    sequence = data.draw(actions(gripper.dof))
    for action in sequence:
        reached = gripper.format_action(action)
    if name in OF_POSITIONS:
        return
    gripper.current_action = np.zeros_like(gripper.current_action)
    gripper.start_at(reached)
    np.testing.assert_allclose(gripper.format_action([0.0] * gripper.dof), reached, atol=1e-12)


@pytest.mark.parametrize('name', robot_names())
@settings(max_examples=6)
@given(data=st.data())
def test_an_action_of_a_robot_maps_one_to_one_onto_the_control_ranges(name, data):
    robot = robot_of(name)
    subsystem = data.draw(st.sampled_from([s for s in ('arm', 'base', 'torso', 'head', 'legs')
                                           if robot.actuators_of(s)]))
    count = len(robot.actuators_of(subsystem))
    bounds = st.tuples(st.floats(-1e3, 0.0), st.floats(1e-3, 1e3))
    ranges = np.array(data.draw(st.lists(bounds, min_size=count, max_size=count)))
    inside = np.array(data.draw(st.lists(st.floats(-1.0, 1.0), min_size=count, max_size=count)))
    command = robot.format_action(subsystem, inside, ranges)
    low, high = ranges.T
    assert command.shape == (count,)
    assert (low - 1e-9 <= command).all() and (command <= high + 1e-9).all()
    np.testing.assert_allclose(2.0 * (command - low) / (high - low) - 1.0, inside, atol=1e-9)
    wild = data.draw(st.lists(FINITE, min_size=count, max_size=count))
    clamped = robot.format_action(subsystem, wild, ranges)
    np.testing.assert_array_equal(
        clamped, robot.format_action(subsystem, np.clip(wild, -1.0, 1.0), ranges))
    wrong = data.draw(st.lists(FINITE, max_size=count + 2).filter(lambda a: len(a) != count)
                      | st.just([np.nan] * count) | st.just(None))
    with pytest.raises(CommandError):
        robot.format_action(subsystem, wrong, ranges)


@cache
def robot_of(name):
    return create_robot(name)


def test_the_ends_of_actions_are_the_ends_of_ranges_to_the_last_bit():
    panda = create_robot('Panda')
    ranges = np.array([[-3.0718, -0.0698]] * 7)
    assert panda.format_action('arm', np.ones(7), ranges).tolist() == [-0.0698] * 7
    assert panda.format_action('arm', -np.ones(7), ranges).tolist() == [-3.0718] * 7


@pytest.mark.parametrize('action', [['0', 0.0, 0.0], ['0', '0', '0'], [b'0', b'0', b'0']])
def test_text_is_no_number_of_an_action(action):
    gripper = create_gripper('JacoThreeFingerDexterousGripper')
    with pytest.raises(CommandError, match='must be numbers'):
        gripper.format_action(action)
