# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The odometry of a base with wheels that slip: how it drifts, repeated, saved and restored."""

import numpy as np
import pytest

from manip_sim.models import compose
from manip_sim.sensing.sensor_noise import OdometryChannel, SensingSettings
from manip_sim.simulation import Simulation
from manip_sim.worlds import Worlds


def driven(seed, way, **settings):
    """Return what is measured at the end of a way of poses x, y, heading."""
    channel, values = OdometryChannel('base'), SensingSettings()
    for name, value in settings.items():
        values.set(f'noise.odom_{name}', value)
    channel.set_seed(seed)
    channel.adapt(values)
    for count, (x, y, heading) in enumerate(way):
        exact = np.array([x, y, 0.3, 0.0, 0.0, np.sin(0.5 * heading), np.cos(0.5 * heading),
                          *[1.0] * 6])
        channel.end_period(exact, count)
    measured = channel.measure(exact, count, 0.01)
    return measured, 2.0 * np.arctan2(measured[5], measured[6]), channel


#: 2 m ahead along a line that is turned by 0.7 rad, in 400 control periods.
LINE = np.linspace([1.0, 1.0, 0.7], [1.0 + 2.0 * np.cos(0.7), 1.0 + 2.0 * np.sin(0.7), 0.7], 401)


def test_slip_is_a_share_of_the_way_and_of_velocities():
    measured, heading, channel = driven(3, LINE, slip=0.05)
    rates = channel._rates()
    assert 1e-3 < abs(rates[0] - 1.0) < 0.2 and heading == pytest.approx(0.7)
    np.testing.assert_allclose(
        measured[:2], LINE[0, :2] + rates[0] * (LINE[-1] - LINE[0])[:2], atol=1e-9)
    np.testing.assert_allclose(measured[7:], [rates[0], rates[1], 1.0, 1.0, 1.0, rates[2]])
    # A turn on the spot of more than half a circle.
    turn = np.linspace([0.0, 0.0, 0.0], [0.0, 0.0, 5.0], 401)
    _, heading, _ = driven(3, turn, slip=0.05)
    assert np.cos(heading) == pytest.approx(np.cos(5.0 * rates[2]))


@pytest.mark.full
def test_drift_grows_with_the_square_root_of_the_way_whatever_the_periods_are():
    for way in (LINE, LINE[::8]):
        ends = np.array([driven(seed, way, drift=0.02)[0][:2] for seed in range(150)])
        np.testing.assert_allclose(ends.mean(axis=0), LINE[-1, :2], atol=0.012)
        np.testing.assert_allclose(ends.std(axis=0), 0.02 * np.sqrt(2.0), rtol=0.2)
    headings = [driven(seed, LINE, heading_drift=0.03)[1] for seed in range(150)]
    assert np.std(headings) == pytest.approx(0.03 * np.sqrt(2.0), rel=0.2)
    still, heading, _ = driven(1, [LINE[0]] * 50, drift=0.1, heading_drift=0.1)
    np.testing.assert_allclose(still[:2], LINE[0, :2])  # Wheels that rest do not drift.


def drive(simulation, periods=40):
    robot = simulation.robot
    robot.apply(robot.parse.twist(0.4, 0.1, 0.5))
    for _ in range(periods):
        simulation.advance(5)
    return robot.sensing.measured('odom'), robot.sensing.exact('odom')


def test_odometry_is_repeated_saved_restored_and_read_by_nobody():
    simulation = Simulation(compose('PandaOmron', seed=5))
    exact = drive(simulation)[0]
    np.testing.assert_array_equal(exact, simulation.robot.sensing.exact('odom'))
    for name, value in (('slip', 0.1), ('drift', 0.05), ('heading_drift', 0.05)):
        simulation.robot.sensing.set(f'noise.odom_{name}', value)
    simulation.reset(7)
    measured, true = drive(simulation)
    digest, saved = simulation.digest(), simulation.save()
    assert np.abs(measured - true)[:2].max() > 0.002
    later = drive(simulation)[0]
    elsewhere = Simulation(compose('PandaOmron', seed=5))
    elsewhere.restore(saved)
    assert elsewhere.digest() == digest
    np.testing.assert_array_equal(drive(elsewhere)[0], later)
    for seed, same in ((7, True), (8, False)):
        simulation.reset(seed)
        np.testing.assert_allclose(*[simulation.robot.sensing.measured('odom')[:7],
                                     simulation.robot.sensing.exact('odom')[:7]], atol=1e-12)
        assert (drive(simulation)[0] == measured).all() == same
        assert (simulation.digest() == digest) is same
    with Worlds(compose('PandaOmron', seed=5), 2) as worlds:
        for robot in (found.robot for found in worlds.simulations):
            for name, value in (('slip', 0.1), ('drift', 0.05), ('heading_drift', 0.05)):
                robot.sensing.set(f'noise.odom_{name}', value)
        worlds.reset([7, 8])
        for found in worlds.simulations:
            found.robot.apply(found.robot.parse.twist(0.4, 0.1, 0.5))
        for _ in range(40):
            worlds.advance(5)
        assert worlds.simulations[0].digest() == digest
    simulation.robot.sensing.set('noise.odom_slip', 0.0)
    simulation.robot.sensing.set('noise.odom_drift', 0.0)
    assert (simulation.robot.sensing.measured('odom') != simulation.robot.sensing.exact(
        'odom')).any()
    simulation.robot.sensing.set('noise.odom_heading_drift', 0.0)
    np.testing.assert_array_equal(simulation.robot.sensing.measured('odom'),
                                  simulation.robot.sensing.exact('odom'))


def test_a_robot_without_a_base_that_moves_has_no_odometry():
    assert Simulation(compose('Panda')).robot.sensing.odometry is None
