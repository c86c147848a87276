# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Operational space control: efforts that make a hand behave like a mass on a spring and damper.

After Khatib (1987): the force at the hand is the arm's inertia as seen from the hand times the
wanted acceleration, and efforts that do not move the hand draw a redundant arm to a posture.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.simulation.cartesian.settings import CartesianSettings

#: Singular values of the Jacobian [m/rad and 1] below this are damped.
_SINGULAR = 0.06
#: Stiffness towards the posture in the null space [1/s^2], critically damped; that of robosuite.
_POSTURE = 10.0


def effort(jacobian: FloatArray, inertia: FloatArray, velocity: FloatArray, wanted: FloatArray,
           posture_error: FloatArray, damping: float) -> FloatArray:
    """
    Return joint efforts, without those against gravity, damping and Coriolis forces.

    The acceleration of the hand is damping times its velocity error, in all six directions.

    :param jacobian: of position and rotation of the hand, shape (6, n)
    :param inertia: of the joints, shape (n, n)
    :param velocity: of the joints [rad/s], shape (n,)
    :param wanted: velocity of the hand, as of :func:`wanted_motion` [m/s, rad/s], shape (6,)
    :param posture_error: posture minus position of the joints [rad], shape (n,)
    :param damping: [1/s]
    :returns: [N m], shape (n,)
    """
    acceleration = damping * (wanted - jacobian @ velocity)
    mobility = np.linalg.solve(inertia, jacobian.T)
    task_inertia = np.linalg.inv(jacobian @ mobility + _regular(jacobian, inertia))
    # Efforts towards the posture; the force at the hand cancels the motion that they cause there.
    own = inertia @ (_POSTURE * posture_error - 2.0 * math.sqrt(_POSTURE) * velocity)
    force = task_inertia @ (acceleration - mobility.T @ own)
    return np.asarray(jacobian.T @ force + own)


@dataclass(frozen=True)
class WantedMotion:
    """
    The motion wanted of a hand.

    :ivar twist: in the world [m/s, rad/s], shape (6,)
    :ivar joints: velocities of the joints that give it [rad/s], shape (n,)
    :ivar singular: whether a motion is wanted in a direction in which the hand can hardly move
    :ivar slowed: whether joint velocity limits slow it down
    """

    twist: FloatArray
    joints: FloatArray
    singular: bool
    slowed: bool


def wanted_motion(jacobian: FloatArray, error: FloatArray, twist: FloatArray,
                  settings: CartesianSettings, velocity_limit: FloatArray) -> WantedMotion:
    """
    Return the velocity of the hand at which spring and damper are in balance.

    It is limited to the velocities of the settings and of the joints, and to what the arm can do
    near a singularity.

    :param jacobian: of position and rotation of the hand, shape (6, n)
    :param error: translation [m] and rotation vector [rad] to the target, shape (6,)
    :param twist: velocity of the target [m/s, rad/s], shape (6,)
    :param velocity_limit: of the joints [rad/s], shape (n,)
    """
    wanted = settings.stiffness / settings.damping * error
    for half, limit in ((wanted[:3], settings.linear_velocity),
                        (wanted[3:], settings.angular_velocity)):
        half *= min(1.0, limit / max(float(np.linalg.norm(half)), 1e-12))
    left, values, right = np.linalg.svd(jacobian, full_matrices=False)
    damped = np.maximum(values**2, _SINGULAR**2)
    parts = left.T @ (wanted + twist)
    joints = right.T @ (values / damped * parts)
    excess = max(1.0, float((np.abs(joints) / velocity_limit).max()))
    return WantedMotion(left @ (values**2 / damped * parts) / excess, joints / excess,
                        values[-1] < _SINGULAR / 2.0
                        and bool(abs(parts[-1]) > 0.5 * np.linalg.norm(parts) + 1e-9),
                        excess > 1.0 + 1e-6)


def _regular(jacobian: FloatArray, inertia: FloatArray) -> FloatArray:
    """Return what to add to the inverse inertia at the hand, zero far from singularities."""
    squares = jacobian @ jacobian.T
    try:
        # The smallest squared singular value is at least 1 / trace of the inverse.
        if 0.0 < np.trace(np.linalg.inv(squares)) < _SINGULAR**-2:
            return np.zeros_like(squares)
    except np.linalg.LinAlgError:  # It is exactly singular.
        pass
    values, axes = np.linalg.eigh(squares)
    damping = np.maximum(0.0, _SINGULAR**2 - np.maximum(values, 0.0))
    return np.asarray((axes * (damping * len(inertia) / np.trace(inertia))) @ axes.T)
