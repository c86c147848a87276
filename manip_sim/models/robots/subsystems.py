# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tell from a name, or from the joint it drives, what belongs to arm, base, torso, head, legs."""

from __future__ import annotations

import re

import mujoco

from manip_sim.errors import UnknownNameError

SUBSYSTEMS = ('arm', 'base', 'torso', 'head', 'legs')
#: In the order in which names are looked at; what fits none is arm.
KEYWORDS = {'torso': 'torso', 'mobile': 'base', 'head': 'head', 'leg': 'legs'}
_WORD = re.compile(r'[A-Z]?[a-z]+|[A-Z]+(?![a-z])')


class Subsystems:
    """The joints and actuators of a robot by subsystem; every list is a copy."""

    _joints_of: dict[str, list[str]]
    _actuators_of: dict[str, list[str]]

    @property
    def arm_joints(self) -> list[str]:
        """Joints of the arms, the right one first."""
        return list(self._joints_of['arm'])

    @property
    def base_joints(self) -> list[str]:
        """Joints that move the whole robot."""
        return list(self._joints_of['base'])

    @property
    def torso_joints(self) -> list[str]:
        """Joints of the torso."""
        return list(self._joints_of['torso'])

    @property
    def head_joints(self) -> list[str]:
        """Joints of the head."""
        return list(self._joints_of['head'])

    @property
    def legs_joints(self) -> list[str]:
        """Joints of the legs."""
        return list(self._joints_of['legs'])

    @property
    def arm_actuators(self) -> list[str]:
        """Actuators of the arms, the right one first."""
        return list(self._actuators_of['arm'])

    @property
    def base_actuators(self) -> list[str]:
        """Actuators that move the whole robot."""
        return list(self._actuators_of['base'])

    @property
    def torso_actuators(self) -> list[str]:
        """Actuators of the torso."""
        return list(self._actuators_of['torso'])

    @property
    def head_actuators(self) -> list[str]:
        """Actuators of the head."""
        return list(self._actuators_of['head'])

    @property
    def legs_actuators(self) -> list[str]:
        """Actuators of the legs."""
        return list(self._actuators_of['legs'])

    def joints_of(self, subsystem: str) -> list[str]:
        """
        Return the joints of a subsystem.

        :raises UnknownNameError: if there is no such subsystem
        """
        return list(self._lookup(self._joints_of, subsystem))

    def actuators_of(self, subsystem: str) -> list[str]:
        """
        Return the actuators of a subsystem.

        :raises UnknownNameError: if there is no such subsystem
        """
        return list(self._lookup(self._actuators_of, subsystem))

    def _lookup(self, table: dict[str, list[str]], subsystem: str) -> list[str]:
        if subsystem not in table:
            raise UnknownNameError('subsystem', subsystem, SUBSYSTEMS)
        return table[subsystem]


def classify(name: str) -> str:
    """
    Return the subsystem that an unprefixed name tells of.

    The reference's keywords torso, mobile, head and leg decide in this order, but only as whole
    words, in any case: ``head_pan`` is of the head, ``overhead_joint`` of the arm.
    """
    words = {word.lower() for word in _WORD.findall(name)}
    for keyword, subsystem in KEYWORDS.items():
        if keyword in words or subsystem in words - {'base'}:
            return subsystem
    return 'arm'


def driven_joint(model: mujoco.MjModel, actuator: int) -> str | None:
    """
    Return the name of the joint that an actuator drives, or None.

    :param actuator: number of the actuator
    """
    kind = int(model.actuator_trntype[actuator])
    if kind not in (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)):
        return None
    name: str = model.joint(int(model.actuator_trnid[actuator, 0])).name
    return name
