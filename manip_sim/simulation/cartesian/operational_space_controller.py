# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Operational space control of hands, on the measured joints."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.algebra import dot, product
from manip_sim.simulation.cartesian.frames import Frame
from manip_sim.simulation.cartesian.operational_space import wanted_motion
from manip_sim.simulation.cartesian.settings import CartesianSettings
from manip_sim.simulation.cartesian.targets import pose_error, Target
from manip_sim.simulation.physics import Physics
from manip_sim.simulation.servos import Servos

#: A pose is reached within this [m, rad], by a hand that is slower than this [m/s, rad/s].
_REACHED = np.array([1e-3] * 3 + [1e-2] * 3)
_SLOW_TWIST = 2e-3


@dataclass(frozen=True)
class EffortSolution:
    """
    Efforts of the joints of an arm, and how near its hand is to its target.

    :ivar effort: [N m], shape (n,)
    :ivar error: translation [m] and rotation vector [rad] to the target, shape (6,)
    :ivar rests: whether the hand is at the target and rests
    :ivar progress: share of the wanted motion that the hand makes
    :ivar held: whether the range of a joint keeps it from doing more, shape (n,)
    :ivar singular: whether a motion is wanted in a direction in which the hand can hardly move
    :ivar slowed: whether joint velocity limits slow the motion down
    """

    effort: FloatArray
    error: FloatArray
    rests: bool
    progress: float
    held: BoolArray
    singular: bool
    slowed: bool


class OperationalSpaceController:
    """
    A controller that computes the efforts with which hands follow targets.

    :param physics: of the world
    :param servos: of all driven joints
    :param posture: positions that redundant arms are drawn to [rad], shape (n,)
    """

    #: Where results are written.
    not_in_digest = ('_forces', '_accelerations')

    def __init__(self, physics: Physics, servos: Servos, posture: FloatArray) -> None:
        self._physics = physics
        self._servos = servos
        self._posture = posture
        self._low, self._high = servos.position_clamp().T
        self._torque = servos.ranges['effort']
        physics.on_change(self._make_room)

    def _make_room(self) -> None:
        self._accelerations, self._forces = np.zeros((2, self._physics.model.nv))

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
        dofs, position = self._servos.dofs[indices], data.qpos[self._servos.qpos[indices]]
        twist = target.twist_in_world(data)
        if target.twist is not None:
            target.move(data, tip, twist, duration_s)
        still = target.ends_stream(now_s)
        goal, along, acceleration = target.reference(data, now_s)
        twist = twist + along + acceleration / settings.damping
        error = pose_error(goal, tip.pose(data))
        jacobian, velocity = tip.jacobian(self._physics.model, data, dofs), data.qvel[dofs]
        wanted = wanted_motion(
            jacobian, error, twist, settings, self._servos.velocity_limit[indices],
            self._low[indices] - position, self._high[indices] - position,
            self._posture[indices] - position, target.rests)
        target.rests = wanted.found.rests
        self._accelerations[dofs] = wanted.acceleration(velocity, settings.damping)
        mujoco.mj_mulM(self._physics.model, data, self._forces, self._accelerations)
        self._accelerations[dofs] = 0.0
        given = self._forces[dofs]
        # Gravity that is compensated needs no effort here.
        given += data.qfrc_bias[dofs] - data.qfrc_gravcomp[dofs]
        given += self._servos.passive_damping[indices] * velocity
        moved, goes = product(jacobian, velocity), settings.stiffness / settings.damping * error
        rests = still and bool((np.abs(error) <= _REACHED).all()
                               and (np.abs(moved) < _SLOW_TWIST).all())
        return EffortSolution(
            np.clip(given, *self._torque[indices].T), error, rests,
            dot(moved, goes) / max(dot(goes, goes), 1e-12), wanted.held & (not rests),
            wanted.singular and not rests, wanted.slowed)
