# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of splines against closed forms, and of following them."""

import numpy as np
import pytest

from manip_sim.errors import CommandError
from manip_sim.simulation.trajectory import Trajectory

ZERO = np.zeros(1)


def test_every_point_is_passed():
    random = np.random.default_rng(3)
    times, positions = [0.5, 0.9, 2.0], random.normal(size=(3, 2))
    for velocities in (None, random.normal(size=(3, 2))):
        trajectory = Trajectory(np.ones(2), np.zeros(2), times, positions, velocities)
        np.testing.assert_allclose(trajectory.position(0.0), [1.0, 1.0])
        for time, position in zip(times, positions):
            np.testing.assert_allclose(trajectory.position(time), position, atol=1e-12)


@pytest.mark.parametrize('s', [0.0, 0.2, 0.5, 0.9, 1.0])
def test_cubic_from_rest_to_rest_is_the_smooth_step(s):
    trajectory = Trajectory(ZERO, ZERO, [2.0], np.array([[3.0]]), np.array([[0.0]]))
    assert trajectory.position(2.0 * s)[0] == pytest.approx(3.0 * (3 * s**2 - 2 * s**3))


@pytest.mark.parametrize('s', [0.0, 0.2, 0.5, 0.9, 1.0])
def test_quintic_from_rest_to_rest_is_the_smoother_step(s):
    trajectory = Trajectory(ZERO, ZERO, [2.0], np.array([[3.0]]), np.array([[0.0]]),
                            np.array([[0.0]]))
    expected = 3.0 * (10 * s**3 - 15 * s**4 + 6 * s**5)
    assert trajectory.position(2.0 * s)[0] == pytest.approx(expected)


def test_cubic_reproduces_a_cubic_between_its_points():
    polynomial = np.polynomial.Polynomial([0.3, -1.0, 0.5, 2.0])
    times = np.array([0.4, 1.1, 1.5])
    trajectory = Trajectory(np.array([polynomial(0.0)]), np.array([polynomial.deriv()(0.0)]),
                            times, polynomial(times)[:, None], polynomial.deriv()(times)[:, None])
    for time in np.linspace(0.0, 1.5, 16):
        assert trajectory.position(time)[0] == pytest.approx(polynomial(time))


def test_start_velocity_is_met_without_velocities_in_the_points():
    trajectory = Trajectory(ZERO, np.array([0.7]), [1.0, 2.0], np.array([[0.5], [0.8]]))
    step = 1e-6
    assert trajectory.position(step)[0] / step == pytest.approx(0.7, rel=1e-4)
    end = (trajectory.position(2.0) - trajectory.position(2.0 - step))[0] / step
    assert end == pytest.approx(0.0, abs=1e-4)


def test_motion_without_velocities_does_not_overshoot_its_points():
    trajectory = Trajectory(ZERO, ZERO, [1.0, 2.0, 3.0], np.array([[1.0], [1.0], [2.0]]))
    values = [trajectory.position(time)[0] for time in np.linspace(0, 3, 301)]
    assert (np.diff(values) >= -1e-12).all()
    assert max(values) <= 2.0 + 1e-12


def test_last_point_is_held_and_time_before_the_start_is_the_start():
    trajectory = Trajectory(ZERO, ZERO, [1.0], np.array([[0.5]]))
    assert trajectory.position(99.0)[0] == 0.5
    assert trajectory.position(-1.0)[0] == 0.0
    trajectory.position(99.0)[:] = 7.0
    assert trajectory.position(1.0)[0] == 0.5


def test_point_at_time_zero_replaces_the_start():
    trajectory = Trajectory(ZERO, ZERO, [0.0, 1.0], np.array([[0.2], [0.5]]))
    assert trajectory.position(0.0)[0] == pytest.approx(0.2)
    alone = Trajectory(ZERO, ZERO, [0.0], np.array([[0.2]]))
    assert alone.end_s == 0.0
    assert alone.position(0.0)[0] == 0.2


@pytest.mark.parametrize('times', [[-0.1], [1.0, 0.5], [1.0, 1.0]])
def test_times_must_increase_from_zero(times):
    with pytest.raises(CommandError, match=r'^time_from_start must not be negative and must '
                                           r'increase from point to point, got \['):
        Trajectory(ZERO, ZERO, times, np.zeros((len(times), 1)))


def test_trajectory_needs_a_point():
    with pytest.raises(CommandError, match=r'^a trajectory needs at least one point$'):
        Trajectory(ZERO, ZERO, [], np.zeros((0, 1)))


def test_arm_follows_a_trajectory_of_two_joints(panda_sim, run):
    arm, errors = panda_sim.drive('arm'), []
    start = panda_sim.state().position[[0, 4]]
    goals = np.array([[0.3, -0.2], [0.1, 0.4]])
    names = ['robot0_joint1', 'robot0_joint5']
    panda_sim.apply(arm.trajectory(names, [1.0, 2.0], goals, None, None))
    oracle = Trajectory(start, np.zeros(2), [1.0, 2.0], goals)
    first_step = panda_sim.step_count

    def compare():
        time_s = (panda_sim.step_count - first_step) * 0.002
        errors.append(panda_sim.state().position[[0, 4]] - oracle.position(time_s))

    run(panda_sim, 2.5, compare)
    assert np.abs(errors).max() < 0.02
    np.testing.assert_allclose(panda_sim.state().position[[0, 4]], goals[-1], atol=1e-3)


def test_newer_trajectory_goes_on_from_where_the_older_one_is(panda_sim, run):
    arm, positions = panda_sim.drive('arm'), []
    panda_sim.apply(arm.trajectory(['robot0_joint1'], [1.0], [[0.5]], None, None))
    run(panda_sim, 0.5, lambda: positions.append(panda_sim.state().position[0]))
    panda_sim.apply(arm.trajectory(['robot0_joint1'], [1.0], [[0.0]], None, None))
    run(panda_sim, 1.3, lambda: positions.append(panda_sim.state().position[0]))
    assert np.abs(np.diff(positions)).max() < 0.015
    assert positions[-1] == pytest.approx(0.0, abs=1e-3)


def test_goal_ends_a_trajectory(panda_sim, run):
    arm = panda_sim.drive('arm')
    panda_sim.apply(arm.trajectory(['robot0_joint1'], [1.0], [[0.5]], None, None))
    run(panda_sim, 0.5)
    panda_sim.apply(arm.joint_command(['robot0_joint1'], [0.1], [], []))
    run(panda_sim, 1.0)
    assert panda_sim.state().position[0] == pytest.approx(0.1, abs=1e-3)


def test_positions_past_the_limits_are_clamped_and_counted(panda_sim):
    points = panda_sim.drive('arm').trajectory(['robot0_joint2'], [1.0, 2.0], [[0.1], [9.0]],
                                               None, None)
    assert points.clamped == 1
    np.testing.assert_allclose(points.positions, [[0.1], [1.7628]])
