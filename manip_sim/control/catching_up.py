# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
How setpoints catch up what is missing of their way beside a reference that goes on by itself.

A time-optimal profile with limited velocity and acceleration takes them there, and after it two
low-pass stages, which average and so never overshoot.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from manip_sim.arrays import BoolArray, FloatArray
from manip_sim.control.motion_profiles import braking_velocity, low_pass, way_of_ramp, within
from manip_sim.control.stream_estimation import StreamEstimator

#: Time constant of each of the two low-pass stages that smooth what is caught up [s].
_SMOOTHING_S = 0.02
#: That of moving streams, in message intervals, and in measures of their jitter, at least.
_SMOOTHING_INTERVALS, _SMOOTHING_JITTERS = 1.0, 20.0


class Terms(NamedTuple):
    """What the way that is caught up depends on from message to message, shape (..., n)."""

    #: Time constants of the low-pass stages [s].
    smoothing_s: FloatArray
    #: Limits of the sum of velocities, and of what is caught up beside the reference.
    top: FloatArray
    lowest: FloatArray
    highest: FloatArray


def terms_of(estimator: StreamEstimator, streams: BoolArray, seeks: BoolArray, goal: FloatArray,
             top: FloatArray) -> Terms:
    """
    Return the terms of setpoints.

    :param estimator: of the streams of their goals
    :param streams: which of them follow a stream, shape (..., n)
    :param seeks: which of them come to a goal, shape (..., n)
    :param goal: velocity that their references come to, shape (..., n)
    :param top: limit of their velocity, shape (n,)
    """
    stream_s = np.maximum(np.maximum(_SMOOTHING_INTERVALS * estimator.interval_s,
                                     _SMOOTHING_JITTERS * estimator.jitter_s), _SMOOTHING_S)
    return Terms(np.where(streams & (goal != 0.0), stream_s, _SMOOTHING_S),
                 np.where(seeks, top, np.inf), -top - goal, top - goal)


def lateness(estimator: StreamEstimator, streams: BoolArray, now_s: float | FloatArray
             ) -> FloatArray:
    """
    Return how long ago references should have been at the goals of streams [s], shape (..., n).

    :param estimator: of the streams
    :param streams: which coordinates follow one, shape (..., n); others are never late
    :param now_s: simulation time [s]
    """
    return np.where(streams, now_s - estimator.sent_s - 1.5 * estimator.interval_s, 0.0)


def missing_way(goal: FloatArray, late_s: FloatArray, position: FloatArray, begin: FloatArray,
                end: FloatArray, slope: FloatArray) -> FloatArray:
    """
    Return how far behind setpoints will be whose references only ramp, shape (..., n).

    :param goal: where they should have been [rad or m], shape (..., n)
    :param late_s: how long ago, as :func:`lateness` returns
    :param position: where they are [rad or m], shape (..., n)
    :param begin: velocity of the references; they come to ``end`` with accelerations of the size
        ``slope``, each of shape (..., n)
    """
    missing: FloatArray = goal + end * late_s - position - way_of_ramp(begin, end, slope)
    return missing


def caught_up(stages: FloatArray, missing: FloatArray, limit: FloatArray, terms: Terms,
              duration_s: float) -> FloatArray:
    """
    Return the velocities of what is caught up after an interval, before and after each stage.

    :param stages: the same before it, shape (3, ..., n)
    :param missing: way that is missing [rad or m], shape (..., n)
    :param limit: of the acceleration, shape (n,)
    :param duration_s: length of the interval [s]
    """
    change = limit * duration_s
    raw = within(braking_velocity(missing, limit, duration_s),
                 stages[0] - change, stages[0] + change)
    raw = within(raw, terms.lowest, terms.highest)
    return low_pass(stages, raw, terms.smoothing_s, duration_s)
