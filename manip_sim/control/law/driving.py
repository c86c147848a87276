# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Twists of a mobile base as velocities of its joints, which do not turn with it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.law.compiling import inner
from manip_sim.control.law.setpoint_changes import ramp_to
from manip_sim.control.law.small_matrices import clip
from manip_sim.control.law.stream_motion import velocities_at
from manip_sim.physics.physics import WorldArrays


@inner
def drive_base(world: WorldArrays, servos: Any, setpoints: Any, base: IntArray, owned: IntArray,
               twist: Any, now: float, duration: float) -> None:
    """
    Set velocities of the setpoints that a twist owns.

    The twist is limited in the frame of the base: limits of single joints would let it slide
    sideways.

    :param servos: records of the robot, shape (n,)
    :param setpoints: records of the robot, shape (n,), changed
    :param base: the joints x, y and yaw of the base, shape (3,)
    :param owned: which of these three the twist owns, shape (k,)
    :param twist: along x and y [m/s] and about z [rad/s], records of ``MOTION``, shape (3,)
    :param now: simulation time at the beginning of the interval [s]
    :param duration: of the interval [s]
    """
    yaw, wanted = (
        world.kinematics.positions[servos[base[2]].qpos], velocities_at(twist, now + duration))
    velocity, limit = np.empty(3), np.empty(3)
    if len(owned) == 3:
        before, present = np.empty(3), np.empty(3)
        for i in range(3):
            before[i], limit[i] = setpoints[base[i]].velocity, setpoints[base[i]].limit
        _turn(before, -yaw, present)
        ahead = _approach(present, wanted, limit, duration)
        _turn(ahead, yaw + (present[2] + ahead[2]) / 2.0 * duration, velocity)
        for i in range(3):
            limit[i] = max(limit[i], abs(velocity[i] - before[i]) / duration)
    else:
        _turn(wanted, yaw, velocity)
        for i in range(3):
            limit[i] = setpoints[base[i]].limit
    indices = np.empty(len(owned), np.int64)
    speeds, most = np.empty(len(owned)), np.empty(len(owned))
    for i in range(len(owned)):
        indices[i], speeds[i], most[i] = base[owned[i]], velocity[owned[i]], limit[owned[i]]
    ramp_to(setpoints, indices, speeds, duration, most)


@inner
def _turn(twist: FloatArray, yaw: float, turned: FloatArray) -> None:
    """Write a twist along x and y and about z in a frame that is turned by minus ``yaw``."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    turned[0] = cos * twist[0] - sin * twist[1]
    turned[1] = sin * twist[0] + cos * twist[1]
    turned[2] = twist[2]


@inner
def _length(x: float, y: float) -> float:
    return math.sqrt(x * x + y * y)


@inner
def _approach(present: FloatArray, wanted: FloatArray, limit: FloatArray, duration: float
              ) -> FloatArray:
    """
    Return the twist after an interval, on the straight line from the present to the wanted one.

    With the acceleration of turning, that of the slide joints stays within their limit, or within
    twice the acceleration of turning if that is more.
    """
    linear = min(limit[0], limit[1])
    turning = _length(present[0], present[1]) * abs(present[2])
    higher = max(linear, 2.0 * turning)
    most = min(linear, math.sqrt(higher * higher - turning * turning)) * duration
    twist = np.empty(3)
    along, aside = wanted[0] - present[0], wanted[1] - present[1]
    distance = _length(along, aside)
    share = most / distance if distance > most else 1.0
    twist[0], twist[1] = present[0] + share * along, present[1] + share * aside
    turn = limit[2] * duration
    twist[2] = present[2] + clip(wanted[2] - present[2], -turn, turn)
    return twist
