# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What is taken for the velocity of a stream of goals, message by message."""

import numpy as np
import pytest

from manip_sim.simulation.streams import StreamEstimator

PERIOD_S, LIMIT = 0.01, np.array([10.0])
JOINT = np.array([0])


def taken(*goals, interval_s=PERIOD_S):
    """Return an estimator that has seen goals at even intervals."""
    estimator = StreamEstimator(1)
    for number, goal in enumerate(goals):
        estimator.take(JOINT, np.array([goal]), number * interval_s, PERIOD_S, LIMIT)
    return estimator


def test_a_first_goal_tells_no_velocity_wherever_it_is():
    assert taken(5.0).velocity == 0.0


def test_the_second_goal_of_a_stream_may_be_as_far_as_the_joint_can_accelerate():
    # In an interval of 0.01 s, 2 * 10 * 0.01 rad/s is as much as it may change.
    assert taken(0.0, 0.0019).velocity == pytest.approx(0.19)
    assert taken(0.0, 0.0021).velocity == 0.0


def test_a_stream_of_constant_velocity_has_that_velocity():
    goals = [0.0015 * n for n in range(12)]
    assert taken(*goals).velocity == pytest.approx(0.15)
    assert taken(*goals).clock.jitter_s == pytest.approx(0.0, abs=1e-15)
    assert taken(*goals).interval_s == pytest.approx(PERIOD_S)
