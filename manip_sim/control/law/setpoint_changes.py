# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Set positions and velocities of setpoints, and what these come to, in place of any stream."""

from __future__ import annotations

import math
from typing import Any

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.law.compiling import compiled, inner
from manip_sim.control.law.joint_records import SMOOTHING_S
from manip_sim.control.law.small_matrices import clip

#: Least acceleration of a ramp [rad/s^2 or m/s^2].
_LEAST_SLOPE = 1e-9


@inner
def come_to(x: Any, velocity: float) -> None:
    """Let the reference come to a velocity with the acceleration limit, and seek no goal."""
    x.rate, x.rate_goal, x.slope, x.until = x.velocity, velocity, x.limit, math.inf
    x.raw = x.first = x.second = x.seeks = x.brakes = x.waiting = 0.0
    x.moves = 1.0


@inner
def _forget_stream(x: Any) -> None:
    """Let the next message begin a stream."""
    x.number, x.arrived, x.smoothing, x.held = 0.0, -math.inf, SMOOTHING_S, 0.0


@compiled
def set_velocity(joints: Any, indices: IntArray, velocity: FloatArray) -> None:
    """
    Let setpoints come to velocities with their acceleration limits.

    :param joints: records, shape (n,)
    :param indices: of those that do, shape (k,)
    :param velocity: [rad/s or m/s], shape (k,)
    """
    for k in range(len(indices)):
        x = joints[indices[k]]
        come_to(x, velocity[k])
        _forget_stream(x)


@compiled
def ramp_to(joints: Any, indices: IntArray, velocity: FloatArray, duration: float,
            limit: FloatArray) -> None:
    """
    Let setpoints come to velocities in a time, or later at a limit of the acceleration.

    :param joints: records, shape (n,)
    :param indices: of those that do, shape (k,)
    :param velocity: [rad/s or m/s], shape (k,)
    :param duration: the time [s]
    :param limit: above the limits of the joints, which count if it is empty [rad/s^2 or m/s^2]
    """
    for k in range(len(indices)):
        x = joints[indices[k]]
        most = x.limit
        if len(limit):
            most, x.bound = limit[k], max(limit[k], x.bound)
        come_to(x, velocity[k])
        _forget_stream(x)
        x.slope = clip(abs(velocity[k] - x.velocity) / duration, _LEAST_SLOPE, most)


@compiled
def set_state(joints: Any, indices: IntArray, position: FloatArray, velocity: FloatArray) -> None:
    """
    Set setpoints, which come to rest from there; beyond an end of the range they stop at it.

    :param joints: records, shape (n,)
    :param indices: of those that are set, shape (k,)
    :param position: [rad or m], shape (k,)
    :param velocity: [rad/s or m/s], shape (k,)
    """
    for k in range(len(indices)):
        _place(joints[indices[k]], position[k], velocity[k], 0.0)


@inner
def follow(joints: Any, indices: IntArray, motion: FloatArray) -> None:
    """
    Set setpoints from another source; beyond the range they rest at its end.

    :param joints: records, shape (n,)
    :param indices: of those that are set, shape (k,)
    :param motion: their position, velocity and acceleration, shape (k, 3)
    """
    for k in range(len(indices)):
        x, position = joints[indices[k]], motion[k, 0]
        if x.low <= position <= x.high:
            _place(x, position, motion[k, 1], motion[k, 2])
        else:
            _place(x, position, 0.0, 0.0)


@inner
def _place(x: Any, position: float, velocity: float, acceleration: float) -> None:
    """Set a setpoint, which comes to rest from there."""
    x.position = clip(position, x.low, x.high)
    x.velocity = clip(velocity, 0.0 if position < x.low else -math.inf,
                      0.0 if position > x.high else math.inf)
    x.acceleration = acceleration
    come_to(x, 0.0)
    _forget_stream(x)
