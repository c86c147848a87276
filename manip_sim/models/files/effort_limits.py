# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Effort limits of joints that cannot carry what they move, reported or replaced by guesses."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.models.files.link_masses import greatest_weight
from manip_sim.quoting import counted, quoted_names

#: Acceleration that a joint shall give its load beside the weight [rad/s^2 or m/s^2].
_ACCELERATION = 5.0
#: Share of a guessed limit that the weight and that acceleration need in the worst pose.
_SHARE = 0.5
#: Number of names that one sentence lists.
_LISTED = 8


def report_efforts(model: mujoco.MjModel, qpos: FloatArray) -> list[str]:
    """Return which joints cannot hold a pose by their effort limits, and the remedy, in words."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    limited = np.flatnonzero(model.jnt_actfrclimited)
    dofs = model.jnt_dofadr[limited]
    needed = np.abs(data.qfrc_bias - data.qfrc_passive)[dofs]
    weak = limited[needed > np.abs(model.jnt_actfrcrange[limited]).max(axis=1)]
    if not len(weak):
        return []
    names = quoted_names([str(model.joint(joint).name) for joint in weak], _LISTED)
    return [f'the effort limits of {counted(len(weak), "joint")} cannot hold the start pose: '
            f'{names}; if they are placeholders, efforts: guess in a YAML file replaces those '
            'that are too low']


def guess_efforts(spec: mujoco.MjSpec, model: mujoco.MjModel) -> list[str]:
    """
    Replace effort limits that cannot carry the links in some pose, and accelerate them a little.

    :param model: the spec, compiled
    :returns: which limits, in a sentence
    """
    limited = np.flatnonzero(model.jnt_actfrclimited)
    dofs = model.jnt_dofadr[limited]
    needed = greatest_weight(model)[dofs] + _ACCELERATION * model.dof_M0[dofs]
    replaced = []
    for joint, effort in zip(limited.tolist(), needed.tolist()):
        if effort > np.abs(model.jnt_actfrcrange[joint]).max():
            name = str(model.joint(joint).name)
            element: Any = spec.joint(name)
            limit = float(f'{effort / _SHARE:.2g}')
            before, element.actfrcrange = element.actfrcrange[1], [-limit, limit]
            replaced.append(f'{name} {before:g} to {limit:g}')
    return [f'effort limits are guesses where the file has less than the links weigh [N m or N]: '
            f'{", ".join(replaced)}'] if replaced else []
