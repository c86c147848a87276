# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Noise of images against what was asked for, and the age of what they show."""

import hashlib
import subprocess
import sys

import numpy as np
import pytest

from manip_sim.models import World
from manip_sim.sensing.images import CameraSensing, ImageNoise
from manip_sim.sensing.robot_sensing import Measurements
from manip_sim.simulation import Simulation

SHAPE = (250, 400)
COUNT = SHAPE[0] * SHAPE[1]
#: A normal estimate is within so many standard errors with a probability of 1 - 6e-7.
ERRORS = 5.0


def noise_of(**values):
    return ImageNoise(**{'camera': 'front', 'seed': 3, 'count': 20, 'pixel': 0.0, 'depth': 0.0,
                         **values})


@pytest.mark.parametrize('metres', [0.5, 1.0, 3.0])
def test_the_deviation_of_depth_grows_with_its_square(metres):
    depth = np.full(SHAPE, metres, np.float32)
    scaled = (noise_of(depth=0.002).on_depth(depth) - depth) / (0.002 * metres**2)
    error = ERRORS / np.sqrt(COUNT)
    assert abs(scaled.mean()) < error
    assert abs(scaled.var() - 1.0) < error * np.sqrt(2.0) + 1e-3  # Single precision.
    assert abs((scaled**4).mean() - 3.0) < error * np.sqrt(96.0) + 1e-2
    assert abs((scaled[1:] * scaled[:-1]).mean()) < error * 1.01
    assert abs((scaled[:, 1:] * scaled[:, :-1]).mean()) < error * 1.01


def test_where_there_is_nothing_there_is_no_noise_and_depth_is_never_negative():
    depth = np.full(SHAPE, 2.0, np.float32)
    depth[0] = np.inf
    noisy = noise_of(depth=10.0).on_depth(depth)
    assert np.isposinf(noisy[0]).all()
    assert np.isfinite(noisy[1:]).all()
    assert noisy.min() == 0.0
    assert noisy.dtype == np.float32


def test_colours_have_the_deviation_that_was_asked_for_and_are_clipped():
    grey = np.full((*SHAPE, 3), 128, np.uint8)
    error = noise_of(pixel=5.0).on_colours(grey).astype(float) - 128.0
    assert abs(error.mean()) < ERRORS * 5.0 / np.sqrt(error.size)
    # Rounding adds a twelfth to the variance.
    assert error.var() == pytest.approx(25.0 + 1.0 / 12.0, rel=ERRORS * np.sqrt(2.0 / error.size))
    black = noise_of(pixel=5.0).on_colours(np.zeros((*SHAPE, 3), np.uint8))
    assert (black == 0).mean() == pytest.approx(0.54, abs=0.01)  # P(n < 0.1).
    assert black.max() < 40


def test_images_differ_by_instant_camera_and_seed_and_the_exact_ones_stay():
    depth = np.full(SHAPE, 2.0, np.float32)
    before = depth.copy()
    found = [noise_of(depth=0.01, **other).on_depth(depth) for other in (
        {}, {'seed': 4}, {'count': 21}, {'camera': 'wrist'})]
    np.testing.assert_array_equal(depth, before)
    for other in found[1:]:
        assert abs(np.corrcoef(found[0].ravel(), other.ravel())[0, 1]) < 0.02
    assert noise_of().on_depth(depth) is depth


_SCRIPT = """
import hashlib
import numpy as np
from manip_sim.sensing.images import ImageNoise
noise = ImageNoise('front', 3, 20, 4.0, 0.01)
print(hashlib.sha256(noise.on_depth(np.full((250, 400), 2.0, np.float32)).tobytes()
                     + noise.on_colours(np.full((250, 400, 3), 99, np.uint8)).tobytes()
                     ).hexdigest())
"""


@pytest.mark.full
def test_noise_is_the_same_in_another_process():
    noise = noise_of(pixel=4.0, depth=0.01)
    here = hashlib.sha256(
        noise.on_depth(np.full(SHAPE, 2.0, np.float32)).tobytes()
        + noise.on_colours(np.full((*SHAPE, 3), 99, np.uint8)).tobytes()).hexdigest()
    there = subprocess.run([sys.executable, '-c', _SCRIPT], capture_output=True, text=True,
                           check=True, timeout=300.0)
    assert there.stdout.strip() == here


@pytest.fixture
def robot(one_joint_arm):
    return Simulation(World([one_joint_arm()])).robot


def ages(robot, periods=100, steps=5):
    """Return how old what a camera measures is at the end of each period [steps]."""
    camera, found = CameraSensing('front', robot.sensing), []
    for period in range(periods):
        robot._clock.control_steps = period * steps
        scene, _ = camera.measured(period * steps)
        found.append(period * steps - scene)
    return found


def test_images_are_as_old_as_was_asked_for_once_one_has_arrived(robot):
    assert set(ages(robot)) == {0}
    robot.sensing.set('latency.image', 0.04)
    assert not robot.sensing.settings.measures
    found = ages(robot)
    assert found[:4] == [0, 5, 10, 15]
    assert set(found[4:]) == {20}


def test_jitter_has_its_deviation_and_what_is_newest_is_shown(robot):
    robot.sensing.set('latency.image', 0.1)
    robot.sensing.set('latency.image_jitter', 0.01)
    found = np.array(ages(robot, 5000, 1)[200:])
    assert found.min() > 20
    assert found.max() < 70
    # The newest of many that jitter is younger than the mean of 50 steps.
    assert 38 < found.mean() < 50
    assert np.diff(found).max() <= 1  # Never back in time.
    assert list(found) == ages(robot, 5000, 1)[200:]


def test_what_is_measured_again_at_an_instant_replaces_what_was_measured_then_or_later():
    found = Measurements()
    for count, value in ((0, 'start'), (5, 'first'), (10, 'late'), (5, 'again')):
        found.record(count, value, 3)
    assert [measured for _, measured in found] == [(0, 'start'), (5, 'again')]
    assert found.newest(7) == (0, 'start')
    assert found.newest(8) == (5, 'again')
