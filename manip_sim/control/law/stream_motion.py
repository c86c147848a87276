# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Motion of a stream of velocities or poses between messages, by coordinate."""

from __future__ import annotations

from typing import Any

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.control.law.compiling import compiled, inner
from manip_sim.control.law.small_matrices import clip


@compiled
def velocities_at(motion: Any, now: float) -> FloatArray:
    """
    Return the velocities at a time, shape (n,).

    :param motion: records of ``MOTION``, shape (n,)
    :param now: simulation time [s]
    """
    velocity = np.empty(len(motion))
    for i in range(len(motion)):
        x = motion[i]
        left = x.reached - now
        velocity[i] = x.velocity - x.slope * left if left > 1e-9 else x.velocity
    return velocity


@inner
def own_accelerations_at(motion: Any, now: float) -> FloatArray:
    """
    Return the accelerations of the stream itself, shape (n,).

    :param motion: records of ``MOTION``, shape (n,)
    :param now: simulation time [s]
    """
    acceleration = np.zeros(len(motion))
    for i in range(len(motion)):
        x = motion[i]
        if now < x.reached - 1e-9:
            acceleration[i] = clip(x.slope, -x.own, x.own)
    return acceleration


@inner
def positions_at(motion: Any, now: float) -> FloatArray:
    """
    Return the positions at a time, shape (n,).

    :param motion: records of ``MOTION``, shape (n,)
    :param now: simulation time [s]
    """
    position = np.empty(len(motion))
    for i in range(len(motion)):
        x = motion[i]
        left = max(x.reached - now, 0.0)
        position[i] = x.position + x.velocity * (now - x.due) + x.slope * left * left / 2.0
    return position
