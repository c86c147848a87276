# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Operational space control of end effectors, on the measured joints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from manip_sim.algebra import dot
from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.control.cartesian.cartesian_settings import CartesianSettings
from manip_sim.control.cartesian.targets import Target
from manip_sim.control.law.arm_records import Arm, Goal, Motion, Spring
from manip_sim.control.servos import Servos
from manip_sim.physics.physics import Physics, places_of_inertia
from manip_sim.physics.robot_frames import Frame

#: A pose is reached within this [m, rad], by an end effector that is slower [m/s, rad/s].
_REACHED = np.array([1e-3] * 3 + [1e-2] * 3)
_SLOW_TWIST = 2e-3
_RESTING = np.zeros(6)


@dataclass(frozen=True)
class EffortSolution:
    """
    Efforts of an arm, how near its end effector is to its target, and what limits it.

    :ivar efforts: of the joints [N m], shape (n,)
    :ivar error: translation [m] and rotation vector [rad] to the target, shape (6,)
    :ivar moved: velocity of the end effector [m/s, rad/s], shape (6,)
    :ivar held: whether the range of a joint keeps it from doing more, shape (n,)
    :ivar singular: whether a motion is wanted in a direction in which it can hardly move
    :ivar slowed: whether joint velocity limits slow it down
    :ivar still: whether the target rests
    """

    efforts: FloatArray
    error: FloatArray
    moved: FloatArray
    held: BoolArray
    singular: bool
    slowed: bool
    still: bool

    @property
    def rests(self) -> bool:
        """Whether the end effector is at the target and rests."""
        return self.still and bool((np.abs(self.error) <= _REACHED).all()
                                   and (np.abs(self.moved) < _SLOW_TWIST).all())

    def progress(self, settings: CartesianSettings) -> float:
        """Return which share of the motion that spring and damper want the end effector makes."""
        goes = settings.stiffness / settings.damping * self.error
        return dot(self.moved, goes) / max(dot(goes, goes), 1e-12)


class OperationalSpaceController:
    """
    Computes the efforts of the end effectors of a robot.

    :param physics: of the world
    :param servos: of all driven joints
    :param posture: positions that redundant arms are drawn to [rad], shape (n,)
    """

    #: Derived from the other attributes.
    not_in_digest = ('_arms',)

    def __init__(self, physics: Physics, servos: Servos, posture: FloatArray) -> None:
        self._physics = physics
        self._servos = servos
        self._posture = posture
        self._low, self._high = servos.position_clamp().T
        self._arms: dict[tuple[str, bytes], Arm] = {}
        physics.on_change(self.look_at_joints)  # They may have other addresses.

    def look_at_joints(self) -> None:
        """Take over addresses and damping of the joints, which were changed."""
        self._arms.clear()

    def solve(self, tip: Frame, target: Target, indices: IntArray, settings: CartesianSettings,
              now_s: float, duration_s: float) -> EffortSolution:
        """
        Return the efforts with which an end effector follows a target in the next interval.

        :param tip: frame of the end effector
        :param target: changed; a twist moves its goal
        :param indices: of the joints of the arm, shape (n,)
        :param now_s: simulation time [s]
        :param duration_s: length of the interval [s]
        """
        from manip_sim.control.law.operational_space import exert  # It imports numba.
        arm, data = self._arm(tip, indices), self._physics.data
        still, position, rotation, along = target.motion(
            data, tip, settings.damping, now_s, duration_s)
        origin, axes = target.anchor.view(data)
        motion = Motion.of(len(indices))
        target.rests, singular, slowed = exert(
            self._physics.arrays, arm, *tip.view(data),
            Goal(position, rotation, origin, axes, _RESTING if along is None else along),
            self._posture, self._spring(settings), target.rests, motion)
        return EffortSolution(motion.efforts, motion.error, motion.twist, motion.held, singular,
                              slowed, still)

    def step(self, tip: Frame, target: Target, indices: IntArray, settings: CartesianSettings,
             intervals: IntArray, notes: Any) -> FloatArray:
        """
        Run the physics of intervals in which an end effector follows a target that rests.

        :param intervals: physics steps of each, shape (k,)
        :param notes: of the steps, see ``law.stepping.Notes``
        :returns: the last efforts of the joints [N m], shape (n,)
        """
        from manip_sim.control.law.stepping import addresses, step_and_exert  # It imports numba.
        physics, servos, motion = self._physics, self._servos, Motion.of(len(indices))
        origin, axes = target.anchor.view(physics.data)
        drives = servos.drives
        target.rests = step_and_exert(
            *addresses(physics.model, physics.data), intervals, physics.arrays,
            self._arm(tip, indices), *tip.view(physics.data),
            Goal(target.position, target.rotation, origin, axes, _RESTING), self._posture,
            self._spring(settings), target.rests, motion, drives.activations[indices],
            drives.gear[indices], notes)
        return motion.efforts

    @staticmethod
    def _spring(settings: CartesianSettings) -> Spring:
        return Spring(settings.stiffness, settings.damping, settings.linear_velocity,
                      settings.angular_velocity)

    def _arm(self, tip: Frame, indices: IntArray) -> Arm:
        key = tip.name, indices.tobytes()
        if key not in self._arms:
            self._arms[key] = self._make_arm(tip, indices)
        return self._arms[key]

    def _make_arm(self, tip: Frame, indices: IntArray) -> Arm:
        servos, model, dofs = self._servos, self._physics.model, self._servos.dofs[indices]
        weakest, strongest = np.ascontiguousarray(servos.ranges['effort'][indices].T)
        return Arm(
            indices, servos.qpos[indices], dofs, _moving(model, tip.body)[dofs],
            places_of_inertia(model, dofs), self._low[indices], self._high[indices],
            servos.velocity_limit[indices], weakest, strongest, servos.passive_damping[indices],
            servos.turn[indices], int(model.body_rootid[tip.body]))


def _moving(model: mujoco.MjModel, body: int) -> BoolArray:
    """Return which degrees of freedom move a body, shape (nv,)."""
    bodies = {body}
    while body:
        body = int(model.body_parentid[body])
        bodies.add(body)
    return np.isin(model.dof_bodyid, list(bodies))
