# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
The gains with which a servo is stable in steps of a given length.

``implicitfast`` treats damping implicitly and stiffness explicitly: a joint of inertia ``M`` with
passive damping ``D`` is stable if ``h^2 kp / 2 < 2 M + h (kv + D)``, the condition that both
eigenvalues of a step ``h`` are in the unit circle. At a force limit MuJoCo treats the servo
explicitly, and the joint may oscillate between both limits for ever, with a period of two steps,
unless ``h^2 kp / 2 + h kv < 2 M + h D``.
"""

from __future__ import annotations

import numpy as np

from manip_sim.arrays import BoolArray, FloatArray

#: Share of the stable range of gains that lowered gains use.
_SHARE = 0.75
#: Upper bound of damping x timestep / inertia of gains that are upper bounds themselves.
_EXPLICIT_DAMPING = 1.5
#: Highest damping ratio that a servo keeps when its gains are lowered to that bound.
_SOFT_RATIO = 3.0
Gains = tuple[FloatArray, FloatArray]


def stable_gains(stiffness: FloatArray, damping: FloatArray, inertia: FloatArray,
                 passive: FloatArray, limited: BoolArray, timestep_s: float) -> Gains:
    """
    Return gains as they are where they are stable, and lower ones elsewhere.

    A servo with a force limit loses damping first, down to its critical damping, so that it stays
    as stiff as it can.

    :param stiffness: kp at the joints [N m/rad or N/m], shape (n,)
    :param damping: kv at the joints [N m s/rad or N s/m], shape (n,)
    :param inertia: lowest inertia of each joint [kg m^2 or kg], shape (n,)
    :param passive: damping of the joints themselves [N m s/rad or N s/m], shape (n,)
    :param limited: whether each servo has a force limit, shape (n,)
    :param timestep_s: length of a step [s]
    :returns: kp and kv, each of shape (n,)
    """
    spring, most = timestep_s**2 * stiffness / 2.0, 2.0 * inertia + timestep_s * passive
    implicit = most + timestep_s * damping
    too_stiff = ~limited & (spring > implicit)
    free = np.where(too_stiff, 2.0 * _SHARE * implicit / timestep_s**2, stiffness)
    at_limit = limited & (spring + timestep_s * damping > most)
    # The stiffest with h^2 kp / 2 + h kv = s most and this damping ratio, by x = h sqrt(kp).
    ratio = np.minimum(damping / (2.0 * np.sqrt(np.maximum(stiffness * inertia, 1e-300))), 1.0)
    slope, room = 2.0 * ratio * np.sqrt(inertia), _SHARE * most
    stiffest = ((np.sqrt(slope**2 + 2.0 * room) - slope) / timestep_s)**2
    lower = np.minimum(stiffness, stiffest)
    return (np.where(at_limit, lower, free),
            np.where(at_limit, np.minimum(damping, room / timestep_s - timestep_s * lower / 2.0),
                     damping))


def highest_gains(stiffness: FloatArray, damping: FloatArray, inertia: FloatArray,
                  timestep_s: float) -> Gains:
    """
    Return the gains for upper bounds, as the catalogue has them; arguments as before.

    :returns: kp and kv, each of shape (n,)
    """
    factor = np.minimum(1.0, _EXPLICIT_DAMPING / np.maximum(
        timestep_s * damping / inertia, 1e-12))
    damping = damping * factor
    # A servo that was overdamped would become too soft if it kept its damping ratio.
    enough = (damping / (2.0 * _SOFT_RATIO))**2 / inertia
    return np.maximum(stiffness * factor**2, np.minimum(stiffness, enough)), damping


def bounded_gains(stiffness: FloatArray, damping: FloatArray, inertia: FloatArray,
                  timestep_s: float) -> Gains:
    """
    Return the gains of a control mode, lowered to what any servo may have; arguments as before.

    :returns: kp and kv, each of shape (n,)
    """
    most = _EXPLICIT_DAMPING * inertia / timestep_s
    # At the highest stiffness, the highest damping is critical.
    return (np.minimum(stiffness, most * _EXPLICIT_DAMPING / (4.0 * timestep_s)),
            np.minimum(damping, most))


def changes(joint: str, before: tuple[float, float], after: tuple[float, float], limited: bool,
            timestep_s: float) -> str:
    """Return the sentence that reports lowered gains of a joint: kp and kv before and after."""
    parts = [f'{gain} {old:.4g} to {new:.4g}' for gain, old, new in zip(
        ('stiffness', 'damping'), before, after) if new != old]
    where = ' at its force limit' if limited else ''
    return (f"servo of joint '{joint}': {' and '.join(parts)}, as the gains of its file are not "
            f'stable{where} with a timestep of {timestep_s * 1e3:g} ms')
