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
def come_to(x: Any, velocity: float, slope: float) -> None:
    """Let a setpoint come to a velocity, and forget all goals."""
    x.rate, x.rate_goal, x.slope, x.smoothing = x.velocity, velocity, slope, SMOOTHING_S
    x.raw = x.first = x.second = x.seeks = x.brakes = x.waiting = x.number = x.held = 0.0
    x.until, x.arrived, x.moves = math.inf, -math.inf, 1.0


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
        come_to(x, velocity[k], x.limit)


@compiled
def ramp_to(joints: Any, indices: IntArray, velocity: FloatArray, duration: float,
            limit: FloatArray) -> None:
    """
    Let setpoints come to velocities in a time, or later at a limit of the acceleration.

    :param joints: records, shape (n,)
    :param indices: of those that do, shape (k,)
    :param velocity: [rad/s or m/s], shape (k,)
    :param duration: the time [s]
    :param limit: above those of the joints, which count if it is empty [rad/s^2 or m/s^2]
    """
    for k in range(len(indices)):
        x = joints[indices[k]]
        most = x.limit
        if len(limit):
            most, x.bound = limit[k], max(limit[k], x.bound)
        slope = abs(velocity[k] - x.velocity) / duration
        come_to(x, velocity[k], clip(slope, _LEAST_SLOPE, most))


@compiled
def place(joints: Any, indices: IntArray, position: FloatArray, velocity: FloatArray,
          acceleration: FloatArray) -> None:
    """
    Set setpoints, which come to rest from there; beyond an end of the range they stop at it.

    :param joints: records, shape (n,)
    :param indices: of those that are set, shape (k,)
    :param position: [rad or m], shape (k,)
    :param velocity: [rad/s or m/s], shape (k,)
    :param acceleration: [rad/s^2 or m/s^2], shape (k,)
    """
    for k in range(len(indices)):
        x = joints[indices[k]]
        x.position = clip(position[k], x.low, x.high)
        x.velocity = clip(velocity[k], 0.0 if position[k] < x.low else -math.inf,
                          0.0 if position[k] > x.high else math.inf)
        x.acceleration = acceleration[k]
        come_to(x, 0.0, x.limit)
