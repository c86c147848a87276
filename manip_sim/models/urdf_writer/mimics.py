# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Which joints follow another one, so that URDF can say it: ``a = multiplier * b + offset``."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import mujoco

from manip_sim.quoting import quoted


@dataclass(frozen=True)
class Mimic:
    """
    What a joint follows.

    :ivar leader: id of a joint that follows none
    """

    leader: int
    multiplier: float
    offset: float


def find_mimics(model: Any, joints: Collection[int], actuated: Collection[int]
                ) -> tuple[dict[int, Mimic], list[str]]:
    """
    Return the linear couplings among some joints, from the equalities that are active.

    Of two joints the one that an equality names first follows; the other way round where only
    that one has an actuator. A joint that follows a follower follows its leader.

    :param joints: ids of scalar joints
    :param actuated: ids of the joints that have an actuator
    :returns: by id of the joint, and a sentence for each coupling that URDF cannot say
    """
    found: dict[int, Mimic] = {}
    notes = []
    for equality in range(model.neq):
        coupling = _coupling(model, equality)
        if coupling is None or coupling[0] not in joints or coupling[1] not in joints:
            continue
        follower, leader, constant, slope, linear = coupling
        if not linear:
            notes.append(f'{_name(model, follower)} follows {_name(model, leader)} by a curve: '
                         'no mimic')
            continue
        if follower in actuated and leader not in actuated:
            follower, leader = leader, follower
            constant, slope = -constant / slope, 1.0 / slope
        if follower in found or _head(found, leader) == follower:
            notes.append(f'{_name(model, follower)} follows two joints: one mimic')
            continue
        found[follower] = Mimic(leader, slope, constant)
    return {joint: _to_head(found, mimic) for joint, mimic in found.items()}, notes


def _coupling(model: Any, equality: int) -> tuple[int, int, float, float, bool] | None:
    """Return follower, leader, constant and slope in positions, and whether it is linear."""
    if (int(model.eq_type[equality]) != int(mujoco.mjtEq.mjEQ_JOINT)
            or not model.eq_active0[equality] or int(model.eq_obj2id[equality]) < 0):
        return None
    follower, leader = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
    data = model.eq_data[equality]
    # MuJoCo's polynomial is of what the joints are away from qpos0.
    zero, leader_zero = (float(model.qpos0[model.jnt_qposadr[j]]) for j in (follower, leader))
    slope = float(data[1])
    constant = zero + float(data[0]) - slope * leader_zero
    return follower, leader, constant, slope, bool(slope) and not data[2:5].any()


def _head(found: dict[int, Mimic], joint: int) -> int:
    while joint in found:
        joint = found[joint].leader
    return joint


def _to_head(found: dict[int, Mimic], mimic: Mimic) -> Mimic:
    while mimic.leader in found:
        above = found[mimic.leader]
        mimic = Mimic(above.leader, mimic.multiplier * above.multiplier,
                      mimic.multiplier * above.offset + mimic.offset)
    return mimic


def _name(model: Any, joint: int) -> str:
    return quoted(model.joint(joint).name)
