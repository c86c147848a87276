# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Compiled models as MuJoCo's binary, which is exact, and what the text of MJCF rounds."""

from __future__ import annotations

import mujoco
import numpy as np


def to_binary(model: mujoco.MjModel) -> bytes:
    """
    Return a model as MuJoCo writes it in a file ``.mjb``, exact to the last bit.

    Only the same release of MuJoCo reads it.
    """
    buffer = np.empty(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer.tobytes()


def roundings(model: mujoco.MjModel, other: mujoco.MjModel) -> dict[str, float]:
    """
    Return the greatest differences of two models by field, in its unit, the greatest first.

    :param other: of the same world, such as one loaded from its MJCF
    """
    found = {}
    for field in dir(model):
        if field.startswith('_'):
            continue
        ours, theirs = getattr(model, field), getattr(other, field)
        if not isinstance(ours, np.ndarray) or ours.dtype.kind != 'f' or not ours.size:
            continue
        if ours.shape != theirs.shape:
            found[field] = np.inf
        elif not np.array_equal(ours, theirs, equal_nan=True):
            found[field] = float(np.nanmax(np.abs(ours - theirs)))
    return dict(sorted(found.items(), key=lambda item: -item[1]))


def said_of_text(model: mujoco.MjModel, other: mujoco.MjModel) -> str:
    """
    Return a sentence on what the text of MJCF changes.

    :param model: the ``mujoco.MjModel`` that was written
    :param other: what was read again
    """
    found = roundings(model, other)
    if not found:
        return 'the text of MJCF gives this model to the last bit'
    worst = ', '.join(f'{field} by {most:.1e}' for field, most in list(found.items())[:3])
    return (f'the text of MJCF changes {len(found)} fields of the model, at most {worst}; '
            '.mjb is exact to the last bit')
