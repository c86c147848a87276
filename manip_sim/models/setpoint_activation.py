# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Setpoints that move linearly between two writes, by means of MuJoCo's activations.

A position servo with integrator dynamics follows its activation instead of its control: ``act`` is
the setpoint and ``ctrl`` the velocity of the setpoint, which MuJoCo integrates in each step.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import BoolArray
from manip_sim.errors import ModelError


def is_position_servo(actuator: Any) -> bool:
    """
    Return whether an actuator pulls its transmission towards a length that the control sets.

    :param actuator: of a ``mujoco.MjSpec``
    """
    return bool(int(actuator.gaintype) == int(mujoco.mjtGain.mjGAIN_FIXED)
                and int(actuator.biastype) == int(mujoco.mjtBias.mjBIAS_AFFINE)
                and actuator.gainprm[0] > 0.0 and actuator.biasprm[1] < 0.0)


def position_servos(model: mujoco.MjModel, actuators: ArrayLike) -> BoolArray:
    """
    Return which actuators of a compiled model are position servos, as :func:`is_position_servo`.

    :param actuators: their ids, of any shape
    :returns: of that shape
    """
    ids = np.asarray(actuators, dtype=int)
    return np.asarray((model.actuator_gaintype[ids] == int(mujoco.mjtGain.mjGAIN_FIXED))
                      & (model.actuator_biastype[ids] == int(mujoco.mjtBias.mjBIAS_AFFINE))
                      & (model.actuator_gainprm[ids, 0] > 0.0)
                      & (model.actuator_biasprm[ids, 1] < 0.0))


def position_servos_without_dynamics(spec: mujoco.MjSpec, names: Iterable[str]) -> list[str]:
    """
    Return the names of the position servos without activation dynamics.

    :param spec: a ``mujoco.MjSpec``
    :param names: of actuators
    """
    none = int(mujoco.mjtDyn.mjDYN_NONE)
    return [name for name in names if is_position_servo(spec.actuator(name))
            and int(spec.actuator(name).dyntype) == none]


def add_setpoint_activation(spec: mujoco.MjSpec, names: Iterable[str]) -> None:
    """
    Give actuators an activation that holds their setpoint.

    The control range becomes the activation range too, which is not enforced. If it is inherited
    from a joint, MuJoCo's compiler fills in the activation range.

    :param spec: the ``mujoco.MjSpec``, changed in place
    :param names: of the actuators
    :raises ModelError: if a plugin computes the force of one of them
    """
    for name in names:
        actuator = spec.actuator(name)
        if actuator.plugin.active:
            raise ModelError(f"the force of actuator '{name}' comes from a plugin, so its joint "
                             'cannot have control modes: make it a motor or a servo')
        if not actuator.inheritrange:
            actuator.actrange = actuator.ctrlrange.copy()
        if is_position_servo(actuator):
            actuator.ctrllimited = 0  # The range is one of positions, not of velocities.
        actuator.dyntype = mujoco.mjtDyn.mjDYN_INTEGRATOR
        actuator.dynprm[0] = 1.0
        actuator.actlimited = 0
