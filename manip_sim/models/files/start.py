# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The start positions that a description declares."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Union

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.files.model_file import ModelFile


def start_pose(model_file: ModelFile, declared: Union[str, Mapping[str, float], None],
               where: object) -> dict[str, float]:
    """
    Return the start positions of scalar joints, by name [rad or m].

    :param declared: positions by joint [rad or m]; without one, a joint starts as in the file
    :raises UnknownNameError: if there is no such joint
    :raises ModelError: if a position is outside the joint's range
    """
    start = dict(model_file.start)
    if declared is None or isinstance(declared, str):
        return start
    model = model_file.tree.model
    for name, position in declared.items():
        if name not in start:
            raise UnknownNameError(f"joint in 'start' of {where}", name, start)
        joint = model.joint(name)
        low, high = joint.range
        if joint.limited[0] and not low <= position <= high:
            raise ModelError(f"'start' of joint '{name}' in {where} must be within {low:g} to "
                             f'{high:g}, got {position:g}')
        start[name] = float(position)
    return start
