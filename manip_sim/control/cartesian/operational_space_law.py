# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Operational space control: what makes an end effector behave like a mass on a spring and damper.

As Khatib (1987) the end effector accelerates as spring and damper say, whatever the inertia of the
arm; here by joint accelerations rather than by a force at the end effector, which is the same for
the end effector and well behaved where the arm is singular. What leaves the end effector where it
is goes to a posture.
"""

from __future__ import annotations

from collections.abc import Sequence
import math

from mujoco import mju_norm
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.control.cartesian.cartesian_settings import CartesianSettings
from manip_sim.control.cartesian.inverse_kinematics import Displacements

#: Stiffness towards the posture in the null space [1/s^2], critically damped; that of robosuite.
_POSTURE = 10.0
_POSTURE_DAMPING = 2.0 * math.sqrt(_POSTURE)
#: Displacements are sought for a longer motion than this no more [m], [rad].
_LARGEST_STEP, _LARGEST_TURN = 0.1, 0.5


class WantedMotions:
    """
    The motion at which spring and damper are in balance, of one arm or several.

    It is limited to the velocities of the settings and of the joints, and to what the arm can do
    near a singularity and near the ends of the ranges of the joints. Several arms have as many
    joints, and arrays have a row for each; for one arm, arrays have no axis of rows.

    :param jacobians: of position and rotation of the end effectors, shape (rows, 6, n)
    :param errors: translations [m] and rotation vectors [rad] to the targets, shape (rows, 6)
    :param twists: velocity of each target [m/s, rad/s], shape (6,); None where it rests
    :param settings: of each arm
    :param velocity_limit: of the joints [rad/s], shape (rows, n)
    :param low: lowest displacements within the ranges of the joints [rad], shape (rows, n)
    :param high: highest displacements [rad], shape (rows, n)
    :param away: displacements to the postures [rad], shape (rows, n)
    :param rested: whether each end effector was as near as it can come before
    :ivar joints: velocities for the end effectors [rad/s], shape (rows, n)
    :ivar found: the displacements that they make in a while
    """

    def __init__(self, jacobians: FloatArray, errors: FloatArray,
                 twists: Sequence[FloatArray | None], settings: Sequence[CartesianSettings],
                 velocity_limit: FloatArray, low: FloatArray, high: FloatArray, away: FloatArray,
                 rested: Sequence[bool]) -> None:
        one = errors.ndim == 1
        dampings = [own.damping for own in settings]
        rates = [own.stiffness / damping for own, damping in zip(settings, dampings)]
        self._damping = _column(dampings, one)
        tasks = _column(rates, one) * errors
        whiles_s = _column([
            _limit(wanted, rate, twist, own.linear_velocity, own.angular_velocity)
            for wanted, rate, twist, own in zip(
                (tasks,) if one else tasks, rates, twists, settings)], one)
        tasks *= whiles_s
        self.found = Displacements(jacobians, tasks, low, high, away, rested)
        joints = self.joints = self.found.step / whiles_s
        shares = (np.abs(joints) / velocity_limit).tolist()
        self._excess = [max(row) for row in ((shares,) if one else shares)]
        for row, excess in zip((joints,) if one else joints, self._excess):
            if excess > 1.0:
                row /= excess

    def slowed(self, row: int) -> bool:
        """Return whether the velocity limits of its joints slow an arm down."""
        return bool(self._excess[row] > 1.0 + 1e-6)

    def accelerations(self, velocity: FloatArray) -> FloatArray:
        """
        Return the accelerations of the joints [rad/s^2], shape (rows, n).

        Those of an end effector are damping times its velocity error, in all six directions.

        :param velocity: of the joints [rad/s], shape (rows, n)
        """
        slack = self.found.slack(velocity)
        result: FloatArray = self.joints - velocity
        result += slack
        result *= self._damping
        result += _POSTURE * self.found.drift
        slack *= _POSTURE_DAMPING
        result -= slack
        return result


def _column(values: Sequence[float], one: bool) -> float | FloatArray:
    """Return the only number, or a number for each row, shape (rows, 1)."""
    return values[0] if one else np.array(values)[:, None]


def _limit(wanted: FloatArray, rate: float, twist: FloatArray | None, linear_velocity: float,
           angular_velocity: float) -> float:
    """
    Limit the velocity that an end effector shall have, in place, and add that of its target.

    :returns: for how long displacements are sought [s]
    """
    way, turn = wanted[:3], wanted[3:]
    size, angle = mju_norm(way), mju_norm(turn)
    if size > linear_velocity:
        way *= linear_velocity / size
        size = mju_norm(way)
    if angle > angular_velocity:
        turn *= angular_velocity / angle
        angle = mju_norm(turn)
    if twist is not None:
        wanted += twist
        size, angle = mju_norm(way), mju_norm(turn)
    return float(min(1.0 / rate, _LARGEST_STEP / max(size, 1e-12),
                     _LARGEST_TURN / max(angle, 1e-12)))
