# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The joints of a gripper that take position commands, and the joints coupled to them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.gripper_actuators import GripperActuators
from manip_sim.errors import CommandError
from manip_sim.physics.physics import Physics

#: A finger stands still if it would take longer than this to cross its range [s].
_STILL_S = 40.0


class GripperJoints:
    """
    The joints of a gripper.

    :param physics: of the world
    :param part: the name of the gripper's part, for errors
    :param actuators: of the gripper
    :ivar names: of the joints that a position command may name
    """

    def __init__(self, physics: Physics, part: str, actuators: GripperActuators) -> None:
        self._physics = physics
        self._part = part
        self._actuators = actuators
        physics.on_change(self._find)
        self.names: tuple[str, ...] = tuple(self._name(joint) for joint in self._ids)

    def _find(self) -> None:
        actuators = self._actuators
        self._ids = list(dict.fromkeys(
            joint for terms, servo in zip(actuators.terms, actuators.is_servo) if servo
            for joint, _ in terms))

    def _name(self, joint: int) -> str:
        return str(self._physics.model.joint(joint).name)

    def _id(self, name: str) -> int:
        return int(self._physics.model.joint(name).id)

    def ranges(self, names: Sequence[str]) -> FloatArray:
        """Return the ranges of joints [rad or m], infinite where there is none, shape (n, 2)."""
        joints = [self._physics.model.joint(name) for name in names]
        return np.array([j.range if j.limited[0] else (-np.inf, np.inf) for j in joints])

    def reach(self, name: str) -> tuple[float, float]:
        """Return the range that a joint can move in [rad or m], infinite if it is unknown."""
        return self._actuators.joint_range(self._id(name))

    def followers(self, name: str) -> frozenset[str]:
        """Return the joints that follow a commanded joint because they are coupled to it."""
        group = self._actuators.couplings.group(self._id(name))
        return frozenset(self._name(other) for other in group) - {name}

    def actuators_of(self, names: Sequence[str]) -> IntArray:
        """Return the indices of the actuators that move these joints or joints coupled to them."""
        moved = set(names).union(*(self.followers(name) for name in names))
        return np.array([index for index, terms in enumerate(self._actuators.terms)
                         if moved & {self._name(joint) for joint, _ in terms}], dtype=np.int64)

    def check_take_positions(self, names: Sequence[str]) -> None:
        """
        Check that no joint is driven only by actuators that take no position.

        :raises CommandError: naming such an actuator
        """
        for index, terms in enumerate(self._actuators.terms):
            driven = {self._name(joint) for joint, _ in terms}
            for name in names:
                if name in driven and name not in self.names:
                    raise CommandError(f"{self._part}: joint '{name}' takes no position, "
                                       f'{self._actuators.why_no_setpoint(index)}: use actions')

    def with_followers(self, positions: Mapping[str, float]) -> dict[int, float]:
        """
        Return the positions of joints and of those that are coupled to them, by the joint's id.

        :param positions: by name [rad or m]
        """
        following = self._actuators.couplings.follow(
            {self._id(name): position for name, position in positions.items()})
        return {joint: value for joint, value in following.items() if joint in self._ids}

    def are_still(self, data: mujoco.MjData) -> bool:
        """Return whether all of them have stopped, or nearly so."""
        low, high = self.ranges(self.names).T
        span = np.where(np.isfinite(high - low), high - low, 1.0)
        speed = np.array([data.joint(name).qvel[0] for name in self.names])
        return bool((np.abs(speed) < span / _STILL_S).all())
