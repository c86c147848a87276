# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Operational space control of hands, on the measured joints."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from manip_sim.arrays import as_slice, FloatArray, IntArray
from manip_sim.algebra import dot, product
from manip_sim.simulation.cartesian.frames import Frame
from manip_sim.simulation.cartesian.inverse_kinematics import STILL
from manip_sim.simulation.cartesian.operational_space import wanted_motion, WantedMotion
from manip_sim.simulation.cartesian.settings import CartesianSettings
from manip_sim.simulation.cartesian.targets import pose_error, Target
from manip_sim.simulation.physics import Physics
from manip_sim.simulation.profiles import within
from manip_sim.simulation.servos import Servos

#: A pose is reached within this [m, rad], by a hand that is slower than this [m/s, rad/s].
_REACHED = np.array([1e-3] * 3 + [1e-2] * 3)
_SLOW_TWIST = 2e-3


class EffortSolution(NamedTuple):
    """
    Efforts of the joints of an arm, and how near its hand is to its target.

    :ivar effort: [N m], shape (n,)
    :ivar error: translation [m] and rotation vector [rad] to the target, shape (6,)
    :ivar wanted: motion of the joints that spring and damper want
    :ivar still: whether the target rests
    :ivar velocity: of the joints [rad/s], shape (n,), a view
    """

    effort: FloatArray
    error: FloatArray
    wanted: WantedMotion
    still: bool
    velocity: FloatArray

    @property
    def moved(self) -> FloatArray:
        """Velocity of the hand [m/s, rad/s], shape (6,)."""
        return product(self.wanted.found.jacobian, self.velocity)

    @property
    def rests(self) -> bool:
        """Whether the hand is at the target and rests."""
        return self.still and bool((np.abs(self.error) <= _REACHED).all()
                                   and (np.abs(self.moved) < _SLOW_TWIST).all())

    def progress(self, settings: CartesianSettings) -> float:
        """Return the share of the motion that spring and damper want which the hand makes."""
        goes = settings.stiffness / settings.damping * self.error
        return dot(self.moved, goes) / max(dot(goes, goes), 1e-12)


class _ArmJoints(NamedTuple):
    """The joints of an arm: where they are in arrays of all of them, and their limits."""

    joints: slice | IntArray
    qpos: slice | IntArray
    dofs: slice | IntArray
    low: FloatArray
    high: FloatArray
    velocity_limit: FloatArray
    lowest_effort: FloatArray
    highest_effort: FloatArray
    damping: FloatArray


class OperationalSpaceController:
    """
    A controller that computes the efforts with which hands follow targets.

    :param physics: of the world
    :param servos: of all driven joints
    :param posture: positions that redundant arms are drawn to [rad], shape (n,)
    """

    #: Where results are written, and what follows from the rest.
    not_in_digest = ('_forces', '_accelerations', '_arms')

    def __init__(self, physics: Physics, servos: Servos, posture: FloatArray) -> None:
        self._physics = physics
        self._servos = servos
        self._posture = posture
        self._low, self._high = servos.position_clamp().T
        self._arms: dict[bytes, _ArmJoints] = {}
        physics.on_change(self._make_room)

    def _make_room(self) -> None:
        self._accelerations, self._forces = np.zeros((2, self._physics.model.nv))
        self._arms.clear()  # Their joints may have other addresses.

    def look_at_joints(self) -> None:
        """Take over the damping of the joints, which was changed."""
        self._arms.clear()

    def _arm(self, indices: IntArray) -> _ArmJoints:
        key = indices.tobytes()
        if key not in self._arms:
            servos = self._servos
            lowest, highest = servos.ranges['effort'][indices].T.copy()
            self._arms[key] = _ArmJoints(
                as_slice(indices), as_slice(servos.qpos[indices]), as_slice(servos.dofs[indices]),
                self._low[indices], self._high[indices], servos.velocity_limit[indices],
                lowest, highest, servos.passive_damping[indices])
        return self._arms[key]

    def follow(self, tip: Frame, target: Target, indices: IntArray, data: mujoco.MjData,
               now_s: float, duration_s: float, settings: CartesianSettings) -> EffortSolution:
        """
        Return the efforts for the next interval; a twist moves the goal of its target.

        :param tip: of the hand
        :param indices: of the joints of the arm, shape (n,)
        :param data: after ``mj_forward``
        :param now_s: simulation time [s]
        :param duration_s: length of the interval [s]
        """
        physics, arm = self._physics, self._arm(indices)
        position, velocity = physics.qpos[arm.qpos], physics.qvel[arm.dofs]
        twist, damping = STILL, settings.damping
        if target.twists is not None:
            middle_s = now_s + duration_s / 2.0
            twist = target.in_world(target.twists.at(middle_s), data)
            target.move(data, tip, twist, duration_s)
            twist += target.in_world(target.twists.acceleration(now_s), data) / damping
        still = target.ends_stream(now_s)
        if still:
            goal = target.goal(data)
        else:
            goal, along, acceleration = target.reference(data, now_s)
            twist = twist + along + acceleration / damping
        error = pose_error(goal, tip.pose(data))
        jacobian = tip.jacobian(physics.model, data, arm.dofs)
        wanted = wanted_motion(
            jacobian, error, twist, settings, arm.velocity_limit, arm.low - position,
            arm.high - position, self._posture[arm.joints] - position, target.rests)
        target.rests = wanted.found.rests
        self._accelerations[arm.dofs] = wanted.acceleration(velocity, damping)
        mujoco.mj_mulM(physics.model, data, self._forces, self._accelerations)
        self._accelerations[arm.dofs] = 0.0
        # Gravity that is compensated needs no effort here.
        given = (self._forces[arm.dofs] + (physics.bias[arm.dofs] - physics.gravcomp[arm.dofs])
                 + arm.damping * velocity)
        return EffortSolution(
            within(given, arm.lowest_effort, arm.highest_effort), error, wanted, still, velocity)
