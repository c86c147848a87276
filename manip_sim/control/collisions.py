# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Collisions of a robot, from the torques of its joints: a momentum observer, and thresholds."""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.clamping import command_numbers, finite_command_numbers, numbers_of
from manip_sim.control.joint_controller import JointController
from manip_sim.derived import Derived
from manip_sim.errors import CommandError
from manip_sim.physics.body_forces import RobotForces, subtree_size
from manip_sim.physics.end_effectors import EndEffectorReader
from manip_sim.physics.physics import Physics
from manip_sim.quoting import format_value
from manip_sim.validation import positive_number

_SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)
#: Words for thresholds: there are none, or those that every robot has.
OFF, DEFAULT = 'none', 'default'
#: The default thresholds, as a share of the effort limits of the joints.
_DEFAULT_SHARE = 0.25
#: Gain of the observer [1/s].
_GAIN_PER_S = 100.0


class CollisionObserver:
    """
    The residual ``r = K (p - integral of (tau + C^T v - g + r))`` of the momentum of a robot.

    With the torques behind the gears, so that friction is known, it is the torque that the world
    exerts at joints after a low-pass of first order with the rate ``K``. MuJoCo has the forces on
    bodies in each step; what they exert at joints is computed from their means over a control
    period, and equals the integrand. Payloads that are declared are part of the robot.

    :param physics: of the world
    :param joints: controller of all joints
    :param readers: of the grippers, by arm
    :ivar forces: on the bodies of the robot
    :ivar residual: of all joints [N m or N], shape (n,)
    """

    remembered = ('residual',)

    def __init__(self, physics: Physics, joints: JointController,
                 readers: Mapping[str, EndEffectorReader]) -> None:
        self._physics, self._joints, self._readers = physics, joints, readers
        self.forces = RobotForces(physics, joints.names)
        self.residual: FloatArray = np.zeros(len(joints.names))
        self._derived = Derived()
        physics.on_change(self._derived.of.clear)

    def restart(self) -> None:
        """Forget all forces."""
        self.residual = np.zeros(len(self.residual))

    def unit_of(self, joint: str) -> str:
        """Return the unit of the torque at a joint."""
        return 'N' if int(self._physics.model.joint(joint).type[0]) == _SLIDE else 'N m'

    def observe(self, data: mujoco.MjData, period_s: float) -> None:
        """
        Take over the forces of a control period, when it has ended.

        :param data: the ``mujoco.MjData``
        :param period_s: length of the period [s]
        """
        weight = -math.expm1(-_GAIN_PER_S * period_s)
        self.residual = self.residual + weight * (self._exerted(data) - self.residual)

    def _exerted(self, data: mujoco.MjData) -> FloatArray:
        """Return the mean torques that the world exerts at joints, shape (n,)."""
        forces, tools = self.forces.mean, [
            reader.external for reader in self._readers.values()]
        if not (forces.any() or any([tool.mean.any() for tool in tools])):
            return np.zeros(len(self.residual))
        dofs, moved = self._derived.made_of(self._make_moved, self._physics.arrays)
        wrenches, first = forces.copy(), self.forces.bodies.start
        for tool in tools:
            bodies = slice(tool.bodies.start - first, tool.bodies.stop - first)
            wrenches[bodies] = 0.0
            wrenches[bodies.start] = tool.mean
        force, torque = np.einsum('nm,mk->nk', moved, wrenches).reshape(-1, 2, 3).transpose(
            1, 0, 2)
        x, y, z = data.subtree_com[self._physics.model.body_rootid[first]].tolist()
        torque = torque - np.stack([y * force[:, 2] - z * force[:, 1],
                                    z * force[:, 0] - x * force[:, 2],
                                    x * force[:, 1] - y * force[:, 0]], axis=1)
        motions = data.cdof[dofs]
        exerted: FloatArray = np.einsum('nk,nk->n', motions, np.hstack([torque, force]))
        return exerted

    def _make_moved(self, _: Any) -> tuple[IntArray, FloatArray]:
        """Return the degrees of freedom, and 1 for each body that they move, shape (n, m)."""
        model, bodies = self._physics.model, self.forces.bodies
        dofs = self._joints.dofs(np.arange(len(self.residual)))
        moved = np.zeros((len(dofs), bodies.stop - bodies.start))
        for row, body in zip(moved, model.dof_bodyid[dofs].tolist()):
            row[body - bodies.start:body - bodies.start + subtree_size(model, body)] = 1.0
        return dofs, moved


def read_thresholds(value: ArrayLike, limits: FloatArray) -> tuple[float, ...]:
    """
    Return thresholds of joints [N m or N], 0 where there is none.

    :param value: :data:`OFF`, :data:`DEFAULT`, a number, one for each joint, or the text of such
    :param limits: effort limits of the joints, shape (n,)
    :raises CommandError: if it is something else, or a number is negative or not finite
    """
    if isinstance(value, str):
        value = value.strip()
        if value == OFF:
            return ()
        if value == DEFAULT:
            return tuple((_DEFAULT_SHARE * limits).tolist())
        value = _thresholds_of(value)
    if isinstance(value, (bool, int, float)):
        value = [positive_number(value, 'a limit', CommandError, or_zero=True)]
    numbers = command_numbers(value, 'thresholds of collisions')
    if numbers.size == 1 and numbers.ndim < 2:
        numbers = np.broadcast_to(numbers, len(limits))
    thresholds = finite_command_numbers(numbers, len(limits), 'thresholds of collisions')
    if (thresholds < 0.0).any():
        raise CommandError(f'thresholds of collisions must be positive, or 0 for none, '
                           f'got {format_value(value)}')
    return tuple(thresholds.tolist()) if thresholds.any() else ()


def _thresholds_of(text: str) -> list[float]:
    try:
        return numbers_of(text)
    except ValueError:
        raise CommandError(f"thresholds of collisions must be '{OFF}', '{DEFAULT}', a number or "
                           f'one for each joint such as [20, 20, 10], '
                           f'got {format_value(text)}') from None
