# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Operational space control: what makes a hand behave like a mass on a spring and damper.

As Khatib (1987) the hand accelerates as spring and damper say, whatever the inertia of the arm;
here by joint accelerations rather than by a force at the hand, which is the same for the hand and
well behaved where the arm is singular. What leaves the hand where it is goes to a posture.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.algebra import length
from manip_sim.simulation.cartesian.displacements import displace, Displacement
from manip_sim.simulation.cartesian.inverse_kinematics import STILL
from manip_sim.simulation.cartesian.settings import CartesianSettings

#: Stiffness towards the posture in the null space [1/s^2], critically damped; that of robosuite.
_POSTURE = 10.0
#: Displacements are sought for a longer motion than this no more [m], [rad].
_LARGEST_STEP, _LARGEST_TURN = 0.1, 0.5


class WantedMotion(NamedTuple):
    """
    The motion wanted of the joints of an arm.

    :ivar joints: velocities for the hand [rad/s], shape (n,)
    :ivar found: the displacements that they make in a while
    :ivar slowed: whether joint velocity limits slow it down
    """

    joints: FloatArray
    found: Displacement
    slowed: bool

    def acceleration(self, velocity: FloatArray, damping: float) -> FloatArray:
        """
        Return the accelerations of the joints [rad/s^2], shape (n,).

        That of the hand is damping times its velocity error, in all six directions.

        :param velocity: of the joints [rad/s], shape (n,)
        :param damping: [1/s]
        """
        slack = self.found.slack(velocity)
        result = self.joints - velocity
        result += slack
        result *= damping
        result += _POSTURE * self.found.drift
        slack *= 2.0 * math.sqrt(_POSTURE)
        result -= slack
        return result


def wanted_motion(jacobian: FloatArray, error: FloatArray, twist: FloatArray,
                  settings: CartesianSettings, velocity_limit: FloatArray, low: FloatArray,
                  high: FloatArray, away: FloatArray, rested: bool = False) -> WantedMotion:
    """
    Return the motion at which spring and damper are in balance.

    It is limited to the velocities of the settings and of the joints, and to what the arm can do
    near a singularity and near the ends of the ranges of the joints.

    :param jacobian: of position and rotation of the hand, shape (6, n)
    :param error: translation [m] and rotation vector [rad] to the target, shape (6,)
    :param twist: velocity of the target [m/s, rad/s], shape (6,)
    :param velocity_limit: of the joints [rad/s], shape (n,)
    :param low: lowest displacements within the ranges of the joints [rad], shape (n,)
    :param high: highest displacements [rad], shape (n,)
    :param away: displacements to the posture [rad], shape (n,)
    :param rested: whether the hand was as near as it can come before
    """
    rate = settings.stiffness / settings.damping
    wanted = rate * error
    for half, limit in ((wanted[:3], settings.linear_velocity),
                        (wanted[3:], settings.angular_velocity)):
        size = length(half)
        if size > limit:
            half *= limit / size
    if twist is not STILL:
        wanted += twist
    while_s = min(1.0 / rate,
                  _LARGEST_STEP / max(length(wanted[:3]), 1e-12),
                  _LARGEST_TURN / max(length(wanted[3:]), 1e-12))
    found = displace(jacobian, while_s * wanted, low, high, away, rested)
    joints = found.step / while_s
    excess = max((np.abs(joints) / velocity_limit).tolist())
    if excess > 1.0:
        joints /= excess
    return WantedMotion(joints, found, excess > 1.0 + 1e-6)
