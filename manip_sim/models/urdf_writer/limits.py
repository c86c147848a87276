# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The greatest velocity and effort of joints, of which URDF requires one number each."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from manip_sim.models.declared_limits import declared_velocity
from manip_sim.models.urdf_writer.mimics import Mimic

#: Of a joint without a limit, as in the simulation's servos [rad/s or m/s].
DEFAULT_VELOCITY = float(np.pi)
#: Of a joint whose actuators have no limit [N m or N].
DEFAULT_EFFORT = 1000.0
_JOINT = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
_TENDON = int(mujoco.mjtTrn.mjTRN_TENDON)


def actuated_joints(model: mujoco.MjModel) -> dict[int, list[tuple[int, float]]]:
    """Return by id of the joint its actuators' ids, and the effort at the joint per force."""
    found: dict[int, list[tuple[int, float]]] = {}
    for actuator in range(model.nu):
        gear = float(model.actuator_gear[actuator, 0])
        kind, target = int(model.actuator_trntype[actuator]), model.actuator_trnid[actuator, 0]
        if kind in _JOINT:
            terms = [(int(target), 1.0)]
        elif kind == _TENDON:
            first = int(model.tendon_adr[target])
            terms = [(int(model.wrap_objid[w]), float(model.wrap_prm[w]))
                     for w in range(first, first + int(model.tendon_num[target]))
                     if int(model.wrap_type[w]) == int(mujoco.mjtWrap.mjWRAP_JOINT)]
        else:
            terms = []
        for joint, coefficient in terms:
            found.setdefault(joint, []).append((actuator, abs(gear * coefficient)))
    return found


def effort_limit(model: mujoco.MjModel, joint: int, actuators: list[tuple[int, float]]) -> float:
    """
    Return the greatest effort of the actuators at a joint [N m or N]; zero without actuators.

    :param actuators: those of the joint, as in what :func:`actuated_joints` returns
    """
    effort = sum(_force_limit(model, actuator) * per_force for actuator, per_force in actuators)
    if actuators and model.jnt_actfrclimited[joint]:
        effort = min(effort, float(np.abs(model.jnt_actfrcrange[joint]).max()))
    return effort if np.isfinite(effort) else DEFAULT_EFFORT


def _force_limit(model: mujoco.MjModel, actuator: int) -> float:
    if model.actuator_forcelimited[actuator]:
        return float(np.abs(model.actuator_forcerange[actuator]).max())
    motor = (int(model.actuator_biastype[actuator]) == int(mujoco.mjtBias.mjBIAS_NONE)
             and int(model.actuator_gaintype[actuator]) == int(mujoco.mjtGain.mjGAIN_FIXED))
    if motor and model.actuator_ctrllimited[actuator]:
        return float(np.abs(model.actuator_ctrlrange[actuator]).max()
                     * abs(model.actuator_gainprm[actuator, 0]))
    return float(np.inf)


def velocity_limit(model: mujoco.MjModel, joint: int, mimics: Mapping[int, Mimic]) -> float:
    """Return the velocity limit of a joint [rad/s or m/s]: as declared, or by what it follows."""
    declared = float(declared_velocity(model, joint))
    if np.isfinite(declared):
        return declared
    if joint in mimics:
        mimic = mimics[joint]
        return abs(mimic.multiplier) * velocity_limit(model, mimic.leader, {})
    return DEFAULT_VELOCITY
