# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Find joints that follow another one as URDF's mimics do: ``a = multiplier * b + offset``."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass

import mujoco

from manip_sim.quoting import quoted


@dataclass(frozen=True)
class Mimic:
    """
    How a joint follows another one.

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
        """Return the other joint, and how it follows the leader that the given joint follows."""
        if joint == self.leader:
            return self.follower, Mimic(mimic.leader, self.multiplier * mimic.multiplier,
                                        self.multiplier * mimic.offset + self.offset)
        return self.leader, Mimic(mimic.leader, mimic.multiplier / self.multiplier,
                                  (mimic.offset - self.offset) / self.multiplier)


def find_mimics(model: mujoco.MjModel, joints: Collection[int], actuated: Iterable[int]
                ) -> tuple[dict[int, Mimic], list[str]]:
    """
    Return the linear couplings among some joints, from the active equality constraints.

    Of coupled joints one leads and all others follow it: the joint with the first actuator or,
    without actuators, one that follows none in the constraints.

    :param joints: ids of scalar joints
    :param actuated: ids of the joints with actuators, in the order of the actuators
    :returns: by id of the joint, and a sentence for each coupling that URDF cannot express
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
    """Record how joints that are coupled to a leader follow it, and the couplings used."""
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
    """Return the active coupling of two joints by an equality, in positions, or None."""
    if (int(model.eq_type[equality]) != int(mujoco.mjtEq.mjEQ_JOINT)
            or not model.eq_active0[equality] or int(model.eq_obj2id[equality]) < 0):
        return None
    follower, leader = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
    data = model.eq_data[equality]
    # MuJoCo's polynomial relates the joints' displacements from qpos0.
    zero, leader_zero = (float(model.qpos0[model.jnt_qposadr[j]]) for j in (follower, leader))
    slope = float(data[1])
    return _Coupling(follower, leader, slope, zero + float(data[0]) - slope * leader_zero,
                     bool(slope) and not data[2:5].any())


def _name(model: mujoco.MjModel, joint: int) -> str:
    return quoted(model.joint(joint).name)
