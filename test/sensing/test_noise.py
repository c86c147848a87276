# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Noise against what was asked for: moments, Allan variance, independence, repetition."""

import subprocess
import sys

from hypothesis import given, settings, strategies
import numpy as np
import pytest

from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.sensing.randomness import generator, NormalRows
from manip_sim.sensing.sensor_noise import (
    JointChannel, QUANTITIES, SensingSettings, TORQUE_PER_FORCE_M, WrenchChannel)

COUNT = 100_000
TIMESTEP_S = 0.002
#: A normal estimate is within so many standard errors with a probability of 1 - 6e-7.
ERRORS = 5.0


def samples(channel, count=COUNT, every=1):
    return np.array([channel.noise(n * every, TIMESTEP_S) for n in range(count)])


def channel_with(cls, width, **values):
    asked = SensingSettings()
    for name, value in values.items():
        asked.set(name.replace('__', '.'), value)
    channel = cls('sensor', width)
    channel.set_seed(7)
    channel.adapt(asked)
    return channel


def allan_variance(values, length):
    """Return the Allan variance of rows of values over non-overlapping clusters."""
    clusters = values[:len(values) // length * length].reshape(-1, length, values.shape[1])
    return (np.diff(clusters.mean(axis=1), axis=0)**2).mean(axis=0) / 2.0


@pytest.mark.full
def test_white_noise_has_the_moments_of_a_normal_distribution_and_no_memory():
    noise = samples(channel_with(WrenchChannel, 6, noise__wrench_force=2.0,
                                 noise__wrench_torque=0.1))
    scaled = noise / np.repeat([2.0, 0.1], 3)
    error = ERRORS / np.sqrt(COUNT)
    assert np.abs(scaled.mean(axis=0)).max() < error
    assert np.abs(scaled.var(axis=0) - 1.0).max() < error * np.sqrt(2.0)
    assert np.abs((scaled**3).mean(axis=0)).max() < error * np.sqrt(15.0)
    assert np.abs((scaled**4).mean(axis=0) - 3.0).max() < error * np.sqrt(96.0)
    for lag in (1, 2, 255, 256, 257):
        assert np.abs((scaled[lag:] * scaled[:-lag]).mean(axis=0)).max() < error
    correlation = scaled.T @ scaled / COUNT - np.eye(6)
    assert np.abs(correlation - np.diag(np.diag(correlation))).max() < error


@pytest.fixture(scope='module')
def white_noise():
    """Return noise of a force, shape (n, 3)."""
    return samples(channel_with(WrenchChannel, 6, noise__wrench_force=1.0))[:, :3]


@pytest.fixture(scope='module')
def drift():
    """Return the drift of a wrench, shape (n, 6)."""
    return samples(channel_with(WrenchChannel, 6, noise__wrench_drift=3.0))


@pytest.mark.full
@pytest.mark.parametrize('length', [1, 10, 100, 1000])
def test_allan_variance_of_white_noise_falls_with_the_length(length, white_noise):
    # Independent clusters: the estimate of a variance v has the standard error v sqrt(3 / n).
    clusters = COUNT / length
    expected = 1.0 / length
    np.testing.assert_allclose(allan_variance(white_noise, length), expected,
                               rtol=ERRORS * np.sqrt(3.0 / clusters))


@pytest.mark.full
@pytest.mark.parametrize('length', [10, 100, 1000])
def test_allan_variance_of_drift_rises_with_the_length(length, drift):
    expected = 9.0 * TIMESTEP_S * (2.0 * length**2 + 1.0) / (6.0 * length)
    scale = np.repeat([1.0, TORQUE_PER_FORCE_M], 3)**2
    np.testing.assert_allclose(allan_variance(drift, length) / scale, expected,
                               rtol=ERRORS * np.sqrt(3.0 * length / COUNT))


def test_an_offset_is_constant_in_an_episode_and_spread_over_seeds_as_asked_for():
    channel = channel_with(WrenchChannel, 6, noise__wrench_bias=4.0)
    assert np.ptp(samples(channel, 100), axis=0).max() == 0.0
    drawn = []
    for seed in range(2000):
        channel.set_seed(seed)
        drawn.append(channel.noise(seed, TIMESTEP_S)[:3])
    error = ERRORS / np.sqrt(len(drawn))
    assert np.abs(np.mean(drawn, axis=0)).max() < 4.0 * error
    np.testing.assert_allclose(np.std(drawn, axis=0), 4.0, rtol=error)


def test_a_drift_is_the_same_whatever_was_asked_before():
    forward, jumping = NormalRows(3, 'a', 2), NormalRows(3, 'a', 2)
    expected = [forward.sum(n) for n in range(1000)]
    rows = [forward.row(n) for n in range(1000)]
    np.testing.assert_allclose(expected[-1], np.sum(rows[:-1], axis=0), atol=1e-10)
    for count in (999, 3, 512, 511, 256, 0, 998):
        np.testing.assert_array_equal(jumping.sum(count), expected[count])
        np.testing.assert_array_equal(jumping.row(count), rows[count])


def test_numbers_are_the_same_in_another_process_and_differ_by_seed_name_and_count():
    arguments = [(7, 'a', 0), (8, 'a', 0), (7, 'b', 0), (7, 'a', 1)]
    here = [generator(*each).standard_normal(4).tolist() for each in arguments]
    program = ('from manip_sim.sensing.randomness import generator\n'
               f'print([generator(*a).standard_normal(4).tolist() for a in {arguments}])')
    there = subprocess.run([sys.executable, '-c', program], capture_output=True, text=True,
                           check=True).stdout
    assert there.strip() == str(here)
    assert len({tuple(row) for row in here}) == 4


def test_encoders_round_positions_to_steps_and_nothing_else():
    channel = channel_with(JointChannel, np.zeros(2, bool), resolution__joint_position=0.01)
    measured = channel.measure(np.array([0.1234, -0.118, 0.1234, 0.118, 0.1234, 0.118]), 0, 1.0)
    np.testing.assert_allclose(measured, [0.12, -0.12, 0.1234, 0.118, 0.1234, 0.118])


@pytest.mark.full
@given(strategies.sampled_from(sorted(QUANTITIES)), strategies.one_of(
    strategies.floats(), strategies.integers(), strategies.text(), strategies.booleans(),
    strategies.none()))
@settings(max_examples=200, deadline=None)
def test_a_value_is_taken_or_rejected_by_name_and_changes_nothing_then(name, value):
    asked = SensingSettings()
    fits = (isinstance(value, (int, float)) and not isinstance(value, bool)
            and 0.0 <= value <= QUANTITIES[name].maximum)
    if fits:
        asked.set(name, value)
        assert asked[name] == value
    else:
        with pytest.raises(CommandError, match=f'^{name} must be a number from 0 to'):
            asked.set(name, value)
        assert not asked.measures and not asked.delays_commands


def test_an_unknown_quantity_is_named_with_the_nearest():
    with pytest.raises(UnknownNameError, match="unknown quantity 'noise.wrench_forc'.*"
                                               "noise.wrench_force"):
        SensingSettings().set('noise.wrench_forc', 1.0)
