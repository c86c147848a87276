# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of splines against closed forms."""

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from manip_sim.control.trajectory import Trajectory
from manip_sim.errors import CommandError

ZERO = np.zeros(1)


def spline(times, positions, velocities=None, accelerations=None, start=ZERO, speed=ZERO):
    """Return a trajectory of one joint or more that begins somewhere at time zero."""
    columns = [None if values is None else np.reshape(values, (len(times), -1)).astype(float)
               for values in (positions, velocities, accelerations)]
    trajectory = Trajectory(np.array(times, dtype=float), *columns)
    trajectory.begin_at(np.asarray(start, dtype=float), np.asarray(speed, dtype=float))
    return trajectory


def position(trajectory, time_s):
    return trajectory.at(time_s)[0]


def test_every_point_is_passed():
    random = np.random.default_rng(3)
    times, positions = [0.5, 0.9, 2.0], random.normal(size=(3, 2))
    for velocities in (None, random.normal(size=(3, 2))):
        trajectory = spline(times, positions, velocities, start=np.ones(2), speed=np.zeros(2))
        np.testing.assert_allclose(position(trajectory, 0.0), [1.0, 1.0])
        for time, point in zip(times, positions):
            np.testing.assert_allclose(position(trajectory, time), point, atol=1e-12)


@pytest.mark.parametrize('s', [0.0, 0.2, 0.5, 0.9, 1.0])
def test_cubic_from_rest_to_rest_is_the_smooth_step(s):
    trajectory = spline([2.0], [3.0], [0.0])
    assert position(trajectory, 2.0 * s)[0] == pytest.approx(3.0 * (3 * s**2 - 2 * s**3))


@pytest.mark.parametrize('s', [0.0, 0.2, 0.5, 0.9, 1.0])
def test_quintic_from_rest_to_rest_is_the_smoother_step(s):
    trajectory = spline([2.0], [3.0], [0.0], [0.0])
    expected = 3.0 * (10 * s**3 - 15 * s**4 + 6 * s**5)
    assert position(trajectory, 2.0 * s)[0] == pytest.approx(expected)


@pytest.mark.parametrize('coefficients', [[0.3, -1.0, 0.5, 2.0],
                                          [0.3, -1.0, 0.0, 2.0, -0.7, 0.4]])
def test_polynomial_is_reproduced_between_its_points_with_its_derivatives(coefficients):
    polynomial = np.polynomial.Polynomial(coefficients)
    first, second = polynomial.deriv(), polynomial.deriv(2)
    times = np.array([0.4, 1.1, 1.5])
    quintic = second(times) if len(coefficients) > 4 else None
    trajectory = spline(times, polynomial(times), first(times), quintic,
                        start=[polynomial(0.0)], speed=[first(0.0)])
    for time in np.linspace(0.0, 1.49, 16):
        found = [values[0] for values in trajectory.at(time)]
        assert found == pytest.approx([polynomial(time), first(time), second(time)], abs=1e-9)


def test_start_velocity_is_met_without_velocities_in_the_points():
    trajectory = spline([1.0, 2.0], [0.5, 0.8], speed=[0.7])
    step = 1e-6
    assert position(trajectory, step)[0] / step == pytest.approx(0.7, rel=1e-4)
    end = (position(trajectory, 2.0) - position(trajectory, 2.0 - step))[0] / step
    assert end == pytest.approx(0.0, abs=1e-4)


def test_motion_without_velocities_does_not_overshoot_its_points():
    trajectory = spline([1.0, 2.0, 3.0], [1.0, 1.0, 2.0])
    values = [position(trajectory, time)[0] for time in np.linspace(0, 3, 301)]
    assert (np.diff(values) >= -1e-12).all()
    assert max(values) <= 2.0 + 1e-12


def test_velocities_that_are_not_given_are_those_of_scipy_to_the_last_bit():
    random = np.random.default_rng(5)
    times = np.cumsum(random.uniform(0.05, 1.5, size=40))
    positions = np.round(random.normal(size=(40, 6)), 1)
    positions[10:13] = positions[9]
    positions[20:24] = np.arange(4.0)[:, None] * 1e-200
    found = np.array([spline(times, positions, start=np.zeros(6), speed=np.zeros(6)).at(time)[1]
                      for time in times[:-1]])
    # The first point is not the first knot: the motion begins at time zero.
    knots = np.concatenate([[0.0], times]), np.vstack([np.zeros(6), positions])
    wanted = PchipInterpolator(*knots, axis=0).derivative()(times[:-1])
    assert np.count_nonzero(wanted == 0.0) > 40
    np.testing.assert_array_equal(found, wanted)


def test_last_point_is_held_and_time_before_the_start_is_the_start():
    trajectory = spline([1.0], [0.5], [0.3])
    assert [values[0] for values in trajectory.at(99.0)] == [0.5, 0.3, 0.0]
    assert position(trajectory, -1.0)[0] == 0.0
    for values in trajectory.at(99.0):
        values[:] = 7.0
    assert position(trajectory, 1.0)[0] == 0.5


def test_point_at_time_zero_is_dropped_where_others_follow():
    assert position(spline([0.0, 1.0], [0.2, 0.5]), 0.0)[0] == 0.0
    alone = spline([0.0], [0.2])
    assert alone.end_s == 0.0
    assert position(alone, 0.0)[0] == 0.2


def test_points_that_are_past_are_dropped_and_the_rest_is_bridged():
    trajectory = spline([0.5, 1.0, 1.5, 2.0], [1.0, 2.0, 3.0, 4.0], [2.0] * 4)
    trajectory.begin_at(np.array([1.9]), np.array([2.0]), 1.2)
    assert position(trajectory, 1.2)[0] == pytest.approx(1.9)
    for time, point in ((1.5, 3.0), (1.75, 3.5), (2.0, 4.0)):
        assert position(trajectory, time)[0] == pytest.approx(point)


def test_start_after_the_last_point_leaves_that():
    trajectory = spline([0.5, 1.0], [1.0, 2.0])
    trajectory.begin_at(ZERO, ZERO, 3.0)
    assert position(trajectory, 3.0)[0] == 2.0


def test_slowed_motion_has_the_same_path():
    random = np.random.default_rng(4)
    times, points = np.array([0.5, 0.9, 2.0]), random.normal(size=(3, 2))
    velocities, accelerations = random.normal(size=(2, 3, 2))
    for derivatives in ((), (velocities,), (velocities, accelerations)):
        trajectory = spline(times, points, *derivatives, start=np.zeros(2), speed=np.zeros(2))
        slow = trajectory.slowed(3.0)
        slow.begin_at(np.zeros(2), np.zeros(2))
        assert slow.end_s == pytest.approx(6.0)
        for time in np.linspace(0.0, 1.99, 21):
            fast, late = trajectory.at(time), slow.at(3.0 * time)
            for power, (value, slower) in enumerate(zip(fast, late)):
                np.testing.assert_allclose(slower, value / 3.0**power, atol=1e-9)


@pytest.mark.parametrize(('from_s', 'times_s'), [
    (0.0, [0.0, 1.0, 4.0, 6.0]), (0.2, [0.6, 3.6, 5.6]), (0.5, [3.0, 5.0]), (1.5, [1.0, 3.0]),
    (4.0, [0.0])])
def test_rest_of_a_path_is_slowed_from_a_time_on(from_s, times_s):
    trajectory = Trajectory(np.array([0.0, 0.5, 2.0, 3.0]), np.arange(4.0)[:, None])
    slow = trajectory.slowed(2.0, from_s)
    np.testing.assert_allclose(slow.times_s, times_s)
    np.testing.assert_allclose(slow.positions[:, 0], np.arange(4.0)[-len(times_s):])


@pytest.mark.full
def test_highest_velocity_is_that_of_a_fine_sampling():
    random = np.random.default_rng(5)
    for _ in range(10):
        trajectory = spline([0.5, 0.9, 2.0], random.normal(size=(3, 2)),
                            random.normal(size=(3, 2)), start=np.zeros(2), speed=np.zeros(2))
        sampled = np.abs([trajectory.at(t)[1] for t in np.linspace(0.0, 2.0, 4001)]).max(axis=0)
        np.testing.assert_allclose(trajectory.highest_velocity(), sampled, rtol=5e-3)
    np.testing.assert_array_equal(spline([0.0], [1.0]).highest_velocity(), [0.0])


def test_motion_of_some_joints_is_that_of_all():
    random = np.random.default_rng(6)
    times, points, speeds = [0.5, 2.0], random.normal(size=(2, 3)), random.normal(size=(2, 3))
    whole = spline(times, points, speeds, start=np.zeros(3), speed=np.zeros(3))
    part = whole.of(np.array([2, 0]))
    part.begin_at(np.zeros(2), np.zeros(2))
    for time in (0.3, 1.0, 2.5):
        np.testing.assert_allclose(position(part, time), position(whole, time)[[2, 0]])


@pytest.mark.parametrize(('times', 'told'), [
    ([-0.1], '-0.1 s at point 0'), ([1.0, 0.5], '0.5 s at point 1 after 1 s'),
    ([1.0, 1.0], '1 s at point 1 after 1 s')])
def test_times_must_increase_from_zero(times, told):
    with pytest.raises(CommandError, match=r'^time_from_start must not be negative and must '
                                           f'increase from point to point, got {told}$'):
        Trajectory(np.array(times), np.zeros((len(times), 1)))


def test_trajectory_needs_a_point():
    with pytest.raises(CommandError, match=r'^a trajectory needs at least one point$'):
        Trajectory(np.zeros(0), np.zeros((0, 1)))


@pytest.mark.parametrize(('times', 'positions', 'derivatives'), [
    ([1.0, 100.0], [0.0, 1.0], ([1e308, 1e308],)), ([1.0, 2.0], [1e308, -1e308], ()),
    ([1.0, 2.0], [1e308, -1e308], ([0.0, 0.0],)),
    ([1.0, 2.0], [0.0, 0.0], ([0.0, 0.0], [1e308, -1e308])),
    ([1e-300, 1.0], [1.0, 1.0], ([0.0, 0.0],))])
def test_spline_that_is_not_finite_is_rejected(times, positions, derivatives):
    with pytest.raises(CommandError, match=r'^the spline through the points is not finite: '
                                           r'positions, velocities or accelerations are too '):
        spline(times, positions, *derivatives)
