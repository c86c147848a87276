# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The two kinds of drives, and commands that concern several of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Union

import numpy as np

from manip_sim.errors import CommandError, describe_choices
from manip_sim.simulation.commands import Goal
from manip_sim.simulation.gripper_controller import GRIPPER_RATE_HZ, GripperController
from manip_sim.simulation.subsystem_drive import SubsystemDrive

Drive = Union[SubsystemDrive, GripperController]

__all__ = [
    'Drive', 'GRIPPER_RATE_HZ', 'GripperController', 'split_joint_command', 'SubsystemDrive']


def split_joint_command(drives: Mapping[str, Drive], names: list[str], position: Any,
                        velocity: Any, effort: Any) -> list[Goal]:
    """
    Validate goals for joints of any parts, all or none.

    :param drives: by part
    :param names: joints
    :param position: goals of the joints whose part is in position mode; with one entry for each
        name, or empty; so are ``velocity`` and ``effort``
    :raises CommandError: if a joint is not there, or the numbers do not fit
    """
    part_of = {joint: drive.part.name for drive in drives.values()
               for joint in _driven_joints(drive)}
    if not names:
        raise CommandError('joint_command: no joint is named')
    for name in names:
        if name not in part_of:
            raise CommandError(f"no joint '{name}' can be commanded: "
                               f'{describe_choices(name, part_of)}')
    fields = {'position': position, 'velocity': velocity, 'effort': effort}
    for field, values in fields.items():
        if np.size(values) not in (0, len(names)):
            raise CommandError(f'joint_command: {field} must have {len(names)} numbers or '
                               f'none, got {np.size(values)}')
    wanted: dict[str, list[int]] = {}
    for index, name in enumerate(names):
        wanted.setdefault(part_of[name], []).append(index)
    modes = {drives[part].mode for part in wanted}
    for field, values in fields.items():
        if np.size(values) and field not in modes:
            raise CommandError(f'joint_command: no part of it is in {field} mode, leave the '
                               f'field {field} empty')
    return [_goal(drives[part], names, indices, fields) for part, indices in wanted.items()]


def _driven_joints(drive: Drive) -> list[str]:
    driven = [joint for joint in drive.part.driven_joints if joint is not None]
    # A tendon can drive joints, too.
    return driven + (list(drive.joint_names) if isinstance(drive, GripperController) else [])


def _goal(drive: Drive, names: list[str], indices: list[int], fields: dict[str, Any]) -> Goal:
    own: dict[str, Any] = {
        field: (np.asarray(values, dtype=float)[indices]
                if field == drive.mode and np.size(values) else [])
        for field, values in fields.items()}
    return drive.joint_command([names[i] for i in indices], **own)
