# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Sort joints and actuators into arm, base, torso, head, legs and other, by name or joint."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from functools import lru_cache
import re
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.models.bases import RobotBaseModel
from manip_sim.models.mjcf import MujocoXMLModel
from manip_sim.validation import finite_numbers

SUBSYSTEMS = ('arm', 'base', 'torso', 'head', 'legs', 'other')
#: In the order in which they are tried; a name without any of them is arm.
KEYWORDS = {'torso': 'torso', 'mobile': 'base', 'head': 'head', 'leg': 'legs'}
#: Types of the joints that actuators of parts drive.
SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
_WORD = re.compile(r'[A-Z]?[a-z]+|[A-Z]+(?![a-z])')


def _sorted(kind: str, subsystem: str, doc: str) -> Any:
    """Return a property: the joints or actuators of a subsystem, a copy."""
    def names(robot: Subsystems) -> list[str]:
        return list(getattr(robot, f'_{kind}_of')[subsystem])
    return property(names, doc=doc)


class Subsystems(MujocoXMLModel):
    """The joints and actuators of a robot and its base by subsystem; every list is a copy."""

    #: Subsystem by raw joint name, which takes precedence over the name.
    _subsystem_of_joint: Mapping[str, str] = {}
    _joints_of: dict[str, list[str]]
    _actuators_of: dict[str, list[str]]

    arm_joints: list[str] = _sorted(
        'joints', 'arm', 'Joints of the arms, in the order of the file.')
    base_joints: list[str] = _sorted('joints', 'base', 'Joints that move the whole robot.')
    torso_joints: list[str] = _sorted('joints', 'torso', 'Joints of the torso.')
    head_joints: list[str] = _sorted('joints', 'head', 'Joints of the head.')
    legs_joints: list[str] = _sorted('joints', 'legs', 'Joints of the legs.')
    other_joints: list[str] = _sorted(
        'joints', 'other', "Joints of the robot's file that belong to no other subsystem.")
    arm_actuators: list[str] = _sorted(
        'actuators', 'arm', 'Actuators of the arms, in the order of the file.')
    base_actuators: list[str] = _sorted(
        'actuators', 'base', 'Actuators that move the whole robot.')
    torso_actuators: list[str] = _sorted('actuators', 'torso', 'Actuators of the torso.')
    head_actuators: list[str] = _sorted('actuators', 'head', 'Actuators of the head.')
    legs_actuators: list[str] = _sorted('actuators', 'legs', 'Actuators of the legs.')
    other_actuators: list[str] = _sorted(
        'actuators', 'other', 'Actuators of the joints of no other subsystem.')

    def joints_of(self, subsystem: str) -> list[str]:
        """
        Return the joints of a subsystem.

        :param subsystem: such as ``arm`` or ``torso``
        :raises UnknownNameError: if the subsystem is unknown
        """
        return list(self._lookup(self._joints_of, subsystem))

    def actuators_of(self, subsystem: str) -> list[str]:
        """
        Return the actuators of a subsystem.

        :param subsystem: such as ``arm`` or ``torso``
        :raises UnknownNameError: if the subsystem is unknown
        """
        return list(self._lookup(self._actuators_of, subsystem))

    def _lookup(self, table: dict[str, list[str]], subsystem: str) -> list[str]:
        if subsystem not in table:
            raise UnknownNameError('subsystem', subsystem, SUBSYSTEMS)
        return table[subsystem]

    @property
    def joint_actuators(self) -> list[str]:
        """The actuators of all subsystems, but not of tendons, sites and ball joints."""
        return [name for names in self._actuators_of.values() for name in names]

    @abstractmethod
    def _own_parts(self) -> list[MujocoXMLModel]:
        """Return the robot, and its base if it has one."""

    @property
    def all_joints(self) -> list[str]:
        """Joints of the robot, then of its base."""
        return [joint for part in self._own_parts() for joint in part.joints]

    @property
    def all_actuators(self) -> list[str]:
        """Actuators of the robot, then of its base."""
        return [actuator for part in self._own_parts() for actuator in part.actuators]

    def _check_subsystems(self) -> None:
        """Check that what the class declares of joints has the names of joints and subsystems."""
        for joint, subsystem in self._subsystem_of_joint.items():
            if joint not in self._joints:
                raise UnknownNameError(f'joint in _subsystem_of_joint of {self.name}', joint,
                                       self._joints)
            if subsystem not in SUBSYSTEMS:
                raise UnknownNameError(f"subsystem of joint '{joint}' of {self.name}", subsystem,
                                       SUBSYSTEMS)

    def update_joints(self) -> None:
        """Sort all joints into subsystems again, as ``add_base`` does."""
        self._joints_of = {part: [] for part in SUBSYSTEMS}
        for part in self._own_parts():
            for raw, name in zip(part._joints, part.correct_naming(part._joints)):
                self._joints_of[self._subsystem(part, raw)].append(name)

    def update_actuators(self) -> None:
        """Sort all actuators that drive a joint into subsystems again, as ``add_base`` does."""
        self._actuators_of = {part: [] for part in SUBSYSTEMS}
        for part in self._own_parts():
            for raw, name in zip(part._actuators, part.correct_naming(part._actuators)):
                driven = driven_joint(part._own_model, part._own_model.actuator(raw).id)
                if driven is not None:
                    self._actuators_of[self._subsystem(part, driven)].append(name)

    def _subsystem(self, part: MujocoXMLModel, raw: str) -> str:
        if part is self and raw in self._subsystem_of_joint:
            return self._subsystem_of_joint[raw]
        subsystem = classify(raw)
        if subsystem == 'arm' and isinstance(part, RobotBaseModel):
            return part.subsystem_of_others
        return subsystem

    def format_action(self, subsystem: str, action: ArrayLike,
                      ctrlrange: ArrayLike | None = None) -> FloatArray:
        """
        Map an abstract action to commands of a subsystem's actuators, clamping it to [-1, 1].

        :param subsystem: ``arm``, ``base``, ``torso``, ``head``, ``legs`` or ``other``
        :param action: -1 is the low, +1 the high end of a control range, shape (n,)
        :param ctrlrange: ranges in place of the files', shape (n, 2)
        :returns: commands in the actuators' units, shape (n,), a copy
        :raises UnknownNameError: if the subsystem is unknown
        :raises CommandError: if the length is wrong or a number is not finite
        """
        names = self.actuators_of(subsystem)
        checked = finite_numbers(action, len(names), f'an action of the {subsystem} of '
                                 f'{self.name}', CommandError)
        low, high = np.asarray(self._ctrlrange(names) if ctrlrange is None else ctrlrange,
                               dtype=float).reshape(-1, 2).T
        commands = low + (np.clip(checked, -1.0, 1.0) + 1.0) / 2.0 * (high - low)
        # Rounding may exceed an end of the range.
        return np.asarray(np.clip(commands, low, high))

    def _ctrlrange(self, names: list[str]) -> FloatArray:
        ranges = {name: range_ for part in self._own_parts()
                  for name, range_ in part.control_ranges.items()}
        return np.array([ranges[name] for name in names])


@lru_cache(maxsize=1024)
def classify(name: str) -> str:
    """
    Return the subsystem of an unprefixed name of a joint or actuator.

    robosuite's keywords torso, mobile, head and leg, or legs, decide in this order, but only as
    whole words, in lower or upper case: ``head_pan`` is head, ``overhead_joint`` is arm.
    """
    words = {word.lower() for word in _WORD.findall(name)}
    for keyword, subsystem in KEYWORDS.items():
        if keyword in words or subsystem in words - {'base'}:
            return subsystem
    return 'arm'


def driven_joint(model: mujoco.MjModel, actuator: int) -> str | None:
    """Return the name of the hinge or slide that an actuator drives, or None."""
    kind = int(model.actuator_trntype[actuator])
    if kind not in (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)):
        return None
    joint = int(model.actuator_trnid[actuator, 0])
    if int(model.jnt_type[joint]) not in SCALAR:
        return None
    name: str = model.joint(joint).name
    return name
