# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Operational space control: which efforts let a hand behave like a mass on a spring and damper.

After Khatib (1987): the force at the hand is its inertia as seen by the arm times the acceleration
that is wanted, and a redundant arm is drawn to a posture by efforts that do not move the hand.
"""

from __future__ import annotations

import math

import numpy as np

from manip_sim.simulation.cartesian.settings import CartesianSettings
from manip_sim.typing import FloatArray

#: Singular values of the Jacobian [m/rad and 1] below this are damped.
_SINGULAR = 0.04
#: Stiffness towards the posture in the null space [1/s^2], critically damped; that of robosuite.
_POSTURE = 10.0


def effort(jacobian: FloatArray, inertia: FloatArray, velocity: FloatArray, error: FloatArray,
           twist: FloatArray, posture_error: FloatArray, settings: CartesianSettings
           ) -> FloatArray:
    """
    Return joint efforts beside those against gravity, damping and Coriolis forces.

    The hand comes to where it shall be as x'' = stiffness * error - damping * velocity in all six
    directions; where the error is large it comes with the velocities of the settings.

    :param jacobian: of position and rotation of the hand, shape (6, n)
    :param inertia: of the joints, shape (n, n)
    :param velocity: of the joints [rad/s], shape (n,)
    :param error: way [m] and rotation vector [rad] to where the hand shall be, shape (6,)
    :param twist: velocity that it shall have there [m/s, rad/s], shape (6,)
    :param posture_error: way of the joints to the posture [rad], shape (n,)
    :returns: [N m], shape (n,)
    """
    stiffness = settings.stiffness
    damping = 2.0 * math.sqrt(stiffness) * settings.damping_ratio
    wanted = stiffness / damping * error
    for half, limit in ((wanted[:3], settings.linear_velocity),
                        (wanted[3:], settings.angular_velocity)):
        half *= min(1.0, limit / max(float(np.linalg.norm(half)), 1e-12))
    acceleration = damping * (wanted + twist - jacobian @ velocity)
    mobility = np.linalg.solve(inertia, jacobian.T)
    task_inertia = np.linalg.inv(jacobian @ mobility + _regular(jacobian, inertia))
    # What is left of posture efforts once the part that moves the hand is taken away.
    own = inertia @ (_POSTURE * posture_error - 2.0 * math.sqrt(_POSTURE) * velocity)
    force = task_inertia @ (acceleration - mobility.T @ own)
    return np.asarray(jacobian.T @ force + own)


def _regular(jacobian: FloatArray, inertia: FloatArray) -> FloatArray:
    """Return what to add to the inverse inertia at the hand where it is near a singularity."""
    squares = jacobian @ jacobian.T
    try:
        # The smallest singular value is no less than the root of the inverse trace.
        if 0.0 < np.trace(np.linalg.inv(squares)) < _SINGULAR**-2:
            return np.zeros_like(squares)
    except np.linalg.LinAlgError:  # It is exactly singular.
        pass
    values, axes = np.linalg.eigh(squares)
    damping = np.maximum(0.0, _SINGULAR**2 - np.maximum(values, 0.0))
    return np.asarray((axes * (damping * len(inertia) / np.trace(inertia))) @ axes.T)
