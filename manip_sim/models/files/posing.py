# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Choose start positions for a model that has none: zero, if that is in range and free."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.models.files.tree import SCALAR

#: A joint that is nearer to an end than this fraction of its range is at that end.
_AT_END = 0.05
#: How far from the end a joint at an end is moved, as a fraction of its range.
_INSIDE = 0.25
#: A pose is only better if the overlap of links is less by this much [m].
_BETTER_M = 1e-3


def choose_pose(model: mujoco.MjModel) -> tuple[FloatArray, list[str]]:
    """
    Return a pose with joints inside their ranges and little overlap of links.

    Three are tried: zero, with the middle of the range for joints that cannot be at zero; zero,
    with joints moved away from the ends of their ranges; and the middle of all ranges. The first
    one is taken unless another one has less overlap.

    :param model: a ``mujoco.MjModel``
    :returns: ``qpos``, shape (nq,), and what was done, in sentences
    """
    zero, moved = _with(model, lambda value, low, high: value if low <= value <= high
                        else (low + high) / 2.0)
    inside, _ = _with(model, _away_from_ends)
    middle, _ = _with(model, lambda value, low, high: (low + high) / 2.0)
    notes = [f'start pose: zero, and the middle of the range for {", ".join(moved)}'
             if moved else 'start pose: zero']
    best, overlap = zero, _overlap(model, zero)
    for pose, what in ((inside, 'zero, with joints away from the ends of their ranges'),
                       (middle, 'the middle of all ranges')):
        if overlap > 0.0 and _overlap(model, pose) < overlap - _BETTER_M:
            best, overlap, notes = pose, _overlap(model, pose), [
                f'start pose: {what}, because links overlap at zero']
    return best, notes


def _away_from_ends(value: float, low: float, high: float) -> float:
    span = high - low
    if value < low + _AT_END * span:
        return low + _INSIDE * span
    if value > high - _AT_END * span:
        return high - _INSIDE * span
    return value


def _with(model: mujoco.MjModel, choose: Callable[[float, float, float], float]
          ) -> tuple[FloatArray, list[str]]:
    """Return a pose with limited joints where a function puts them, and names of those moved."""
    qpos: FloatArray = model.qpos0.copy()
    moved = []
    for joint in range(model.njnt):
        if int(model.jnt_type[joint]) not in SCALAR or not model.jnt_limited[joint]:
            continue
        address = int(model.jnt_qposadr[joint])
        before = float(qpos[address])
        qpos[address] = choose(before, *map(float, model.jnt_range[joint]))
        if qpos[address] != before:
            moved.append(str(model.joint(joint).name))
    return qpos, moved


def _overlap(model: mujoco.MjModel, qpos: FloatArray) -> float:
    """Return the sum of the penetration depths of pairs of bodies, without the world [m]."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    deepest: dict[tuple[int, ...], float] = {}
    for contact in data.contact:
        if min(contact.geom) >= 0:
            pair = tuple(sorted(model.geom_bodyid[contact.geom].tolist()))
            deepest[pair] = max(deepest.get(pair, 0.0), -float(contact.dist))
    return float(np.sum([depth for (first, _), depth in deepest.items() if first]))
