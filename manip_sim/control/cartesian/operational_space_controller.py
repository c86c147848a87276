# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Operational space control of end effectors, on the measured joints."""

from __future__ import annotations

from dataclasses import dataclass
import mujoco
import numpy as np

from manip_sim.algebra import dot
from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.control.cartesian.cartesian_settings import CartesianSettings
from manip_sim.control.cartesian.targets import Target
from manip_sim.control.law.arm_records import Arm, CHAIN, Goal, Motion, Spring
from manip_sim.control.law.joint_records import readable
from manip_sim.control.servos import Servos
from manip_sim.derived import Derived
from manip_sim.physics.physics import Physics, places_of_inertia
from manip_sim.physics.robot_frames import Frame


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
    """

    efforts: FloatArray
    error: FloatArray
    moved: FloatArray
    held: BoolArray
    singular: bool
    slowed: bool

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

    def __init__(self, physics: Physics, servos: Servos, posture: FloatArray) -> None:
        self._physics = physics
        self._servos = servos
        self._posture = posture
        self._low, self._high = servos.position_clamp().T
        self._derived = Derived()
        physics.on_change(self.look_at_joints)  # They may have other addresses.

    def look_at_joints(self) -> None:
        """Take over addresses and damping of the joints, which were changed."""
        self._derived.of.clear()

    def solve(self, tip: Frame, target: Target, indices: IntArray, settings: CartesianSettings,
              now_s: float, duration_s: float) -> EffortSolution:
        """
        Return the efforts with which an end effector follows a target that moves.

        :param tip: frame of the end effector
        :param target: changed; a twist moves its goal
        :param indices: of the joints of the arm, shape (n,)
        :param now_s: simulation time [s]
        :param duration_s: length of the interval [s]
        """
        from manip_sim.control.law.operational_space import exert  # It imports numba.
        arm, data = self.arm(tip, indices), self._physics.data
        position, rotation, along = target.motion(data, tip, settings.damping, now_s, duration_s)
        origin, axes = target.anchor.view(data)
        motion = Motion.of(len(indices))
        target.rests, singular, slowed = exert(
            self._physics.arrays, arm, *tip.view(data),
            Goal(position, rotation, origin, axes, along), self._posture,
            Spring(settings.stiffness, settings.damping, settings.linear_velocity,
                   settings.angular_velocity), target.rests, motion)
        return EffortSolution(
            motion.efforts, motion.error, motion.twist, motion.held, singular, slowed)

    def arm(self, tip: Frame, indices: IntArray) -> Arm:
        """
        Return the joints of an arm as the compiled law reads them.

        :param tip: frame of the end effector
        :param indices: of the joints, shape (n,)
        """
        key = tip.name, indices.tobytes()
        found: tuple[FloatArray, Arm] | None = self._derived.of.get(key)
        if found is None or found[0] is not self._servos.passive_damping:
            # That of a restored state is another one.
            found = self._derived.of[key] = (
                self._servos.passive_damping, self._make_arm(tip, indices))
        return found[1]

    def _make_arm(self, tip: Frame, indices: IntArray) -> Arm:
        servos, model, dofs = self._servos, self._physics.model, self._servos.dofs[indices]
        efforts, joints = servos.ranges['effort'][indices], np.zeros(len(indices), CHAIN)
        for field, values in (
                ('joint', indices), ('qpos', servos.qpos[indices]), ('dof', dofs),
                ('moves', _moving(model, tip.body)[dofs]), ('low', self._low[indices]),
                ('high', self._high[indices]), ('velocity_limit', servos.velocity_limit[indices]),
                ('cruising_velocity', servos.cruising_velocity[indices]),
                ('acceleration_limit', servos.acceleration_limit[indices]),
                ('weakest', efforts[:, 0]), ('strongest', efforts[:, 1]),
                ('damping', servos.passive_damping[indices]), ('turn', servos.turn[indices])):
            joints[field] = values
        return Arm(readable(joints), places_of_inertia(model, dofs),
                   int(model.body_rootid[tip.body]))


def _moving(model: mujoco.MjModel, body: int) -> BoolArray:
    """Return which degrees of freedom move a body, shape (nv,)."""
    bodies = {body}
    while body:
        body = int(model.body_parentid[body])
        bodies.add(body)
    return np.isin(model.dof_bodyid, list(bodies))
