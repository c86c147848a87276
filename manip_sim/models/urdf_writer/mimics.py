# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Which joints follow another one, so that URDF can say it: ``a = multiplier * b + offset``."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass

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


@dataclass(frozen=True)
class _Coupling:
    follower: int
    leader: int
    multiplier: float
    offset: float
    linear: bool

    def seen_from(self, joint: int, mimic: Mimic) -> tuple[int, Mimic]:
        """Return the joint at the other end, and how it follows what the one here follows."""
        if joint == self.leader:
            return self.follower, Mimic(mimic.leader, self.multiplier * mimic.multiplier,
                                        self.multiplier * mimic.offset + self.offset)
        return self.leader, Mimic(mimic.leader, mimic.multiplier / self.multiplier,
                                  (mimic.offset - self.offset) / self.multiplier)


def find_mimics(model: mujoco.MjModel, joints: Collection[int], actuated: Iterable[int]
                ) -> tuple[dict[int, Mimic], list[str]]:
    """
    Return the linear couplings among some joints, from the equalities that are active.

    Of all joints that are coupled one leads, and the others follow that one: the joint with the
    first actuator, or where there is none the one that the equalities let lead.

    :param joints: ids of scalar joints
    :param actuated: ids of the joints that have an actuator, in the order of these
    :returns: by id of the joint, and a sentence for each coupling that URDF cannot say
    """
    couplings = [coupling for equality in range(model.neq)
                 if (coupling := _coupling(model, equality)) is not None
                 and coupling.follower in joints and coupling.leader in joints]
    notes = [f'{_name(model, c.follower)} follows {_name(model, c.leader)} by a curve: no mimic'
             for c in couplings if not c.linear]
    linear = [coupling for coupling in couplings if coupling.linear]
    followers = {coupling.follower for coupling in linear}
    candidates = [*actuated, *(c.leader for c in linear if c.leader not in followers), *joints]
    found: dict[int, Mimic] = {}
    used: list[_Coupling] = []
    for head in candidates:
        if head not in found and head in joints:
            _spread(head, linear, found, used)
    notes += [f'{_name(model, c.follower)} follows two joints: one mimic'
              for c in linear if not any(c is other for other in used)]
    return {joint: mimic for joint, mimic in found.items() if mimic.leader != joint}, notes


def _spread(head: int, couplings: list[_Coupling], found: dict[int, Mimic],
            used: list[_Coupling]) -> None:
    """Find how all joints follow that are coupled to a leader, over the couplings used."""
    found[head] = Mimic(head, 1.0, 0.0)
    waiting = [head]
    while waiting:
        joint = waiting.pop(0)
        for coupling in couplings:
            if joint in (coupling.follower, coupling.leader):
                other, mimic = coupling.seen_from(joint, found[joint])
                if other not in found:
                    found[other] = mimic
                    used.append(coupling)
                    waiting.append(other)


def _coupling(model: mujoco.MjModel, equality: int) -> _Coupling | None:
    """Return a coupling of two joints that is active, in positions."""
    if (int(model.eq_type[equality]) != int(mujoco.mjtEq.mjEQ_JOINT)
            or not model.eq_active0[equality] or int(model.eq_obj2id[equality]) < 0):
        return None
    follower, leader = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
    data = model.eq_data[equality]
    # MuJoCo's polynomial is of what the joints are away from qpos0.
    zero, leader_zero = (float(model.qpos0[model.jnt_qposadr[j]]) for j in (follower, leader))
    slope = float(data[1])
    return _Coupling(follower, leader, slope, zero + float(data[0]) - slope * leader_zero,
                     bool(slope) and not data[2:5].any())


def _name(model: mujoco.MjModel, joint: int) -> str:
    return quoted(model.joint(joint).name)
