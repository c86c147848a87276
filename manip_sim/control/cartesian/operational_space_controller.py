# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Operational space control of end effectors, on the measured joints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from manip_sim.algebra import dot, product
from manip_sim.arrays import as_slice, FloatArray, IntArray
from manip_sim.control.cartesian.cartesian_settings import CartesianSettings
from manip_sim.control.cartesian.inverse_kinematics import Displacement, way_to_posture
from manip_sim.control.cartesian.operational_space_law import WantedMotions
from manip_sim.control.cartesian.targets import Target, pose_error
from manip_sim.control.servos import Servos
from manip_sim.physics.physics import Physics
from manip_sim.physics.robot_frames import Frame

#: A pose is reached within this [m, rad], by an end effector that is slower [m/s, rad/s].
_REACHED = np.array([1e-3] * 3 + [1e-2] * 3)
_SLOW_TWIST = 2e-3


class EffortSolution(NamedTuple):
    """
    How near an end effector is to its target, and what limits it.

    :ivar error: translation [m] and rotation vector [rad] to the target, shape (6,)
    :ivar found: displacements of the joints that spring and damper want
    :ivar slowed: whether joint velocity limits slow them down
    :ivar still: whether the target rests
    :ivar velocity: of the joints [rad/s], shape (n,)
    """

    error: FloatArray
    found: Displacement
    slowed: bool
    still: bool
    velocity: FloatArray

    @property
    def moved(self) -> FloatArray:
        """Velocity of the end effector [m/s, rad/s], shape (6,)."""
        return product(self.found.jacobian, self.velocity)

    @property
    def rests(self) -> bool:
        """Whether the end effector is at the target and rests."""
        return self.still and bool((np.abs(self.error) <= _REACHED).all()
                                   and (np.abs(self.moved) < _SLOW_TWIST).all())

    def progress(self, settings: CartesianSettings) -> float:
        """Return which share of the motion that spring and damper want the end effector makes."""
        goes = settings.stiffness / settings.damping * self.error
        return dot(self.moved, goes) / max(dot(goes, goes), 1e-12)


class ArmJoints(NamedTuple):
    """
    The joints of an arm.

    :ivar joints: where they are in arrays of all of them; ``qpos`` and ``dofs`` in those of MuJoCo
    :ivar limits: lowest and highest position, highest velocity, lowest and highest effort, and
        damping, each of shape (n,)
    :ivar turn: 2 pi for joints without a range that turn, 0 for others, shape (n,)
    :ivar all_limits: the same as one array, shape (6, n)
    """

    joints: slice | IntArray
    qpos: slice | IntArray
    dofs: slice | IntArray
    limits: tuple[FloatArray, ...]
    all_limits: FloatArray
    turn: FloatArray


class FollowingEndEffector(NamedTuple):
    """
    An end effector that follows a target in the next interval; a twist moves the target's goal.

    :ivar own: controller of the end effectors of its robot
    :ivar tip: frame of the end effector
    :ivar target: changed when efforts are computed
    :ivar arm: the joints of its arm
    :ivar settings: of the arm
    :ivar now_s: simulation time [s]
    :ivar duration_s: length of the interval [s]
    """

    own: OperationalSpaceController
    tip: Frame
    target: Target
    arm: ArmJoints
    settings: CartesianSettings
    now_s: float
    duration_s: float

    def forces(self, acceleration: FloatArray) -> FloatArray:
        """Return the forces of the joints for an acceleration, beside their damping, (n,)."""
        own, dofs = self.own, self.arm.dofs
        physics = own.physics
        own.accelerations[dofs] = acceleration
        mujoco.mj_mulM(physics.model, physics.data, own.forces, own.accelerations)
        own.accelerations[dofs] = 0.0
        # Gravity that is compensated needs no effort here.
        result: FloatArray = physics.bias[dofs] - physics.gravcomp[dofs]
        result += own.forces[dofs]
        return result

    def look(self) -> tuple[bool, FloatArray | None, FloatArray, FloatArray, FloatArray,
                            FloatArray, FloatArray]:
        """
        Return whether the target rests, and how it and the arm are and move; some are views.

        :returns: whether it rests; its velocity [m/s, rad/s], shape (6,), or None; translation and
            rotation vector to it [m, rad], shape (6,); Jacobian of the end effector, shape (6, n);
            position and velocity of the joints and displacement to their posture, each (n,)
        """
        own, target, arm, now_s = self.own, self.target, self.arm, self.now_s
        physics = own.physics
        data = physics.data
        twist, damping = None, self.settings.damping
        if target.twists is not None:
            twist = target.in_world(target.twists.at(now_s + self.duration_s / 2.0), data)
            target.move(data, self.tip, twist, self.duration_s)
            twist += target.in_world(target.twists.acceleration(now_s), data) / damping
        still = target.ends_stream(now_s)
        if still:
            goal = target.goal(data)
        else:
            goal, along, acceleration = target.reference(data, now_s)
            along = along + acceleration / damping
            twist = along if twist is None else twist + along
        position = physics.qpos[arm.qpos]
        return (still, twist, pose_error(goal, self.tip.view(data)),
                self.tip.jacobian(physics.model, data, arm.dofs), position,
                physics.qvel[arm.dofs],
                way_to_posture(own.posture[arm.joints], position, arm.turn))


class EndEffectorEfforts:
    """
    The efforts with which end effectors follow their targets, each a row if there are several.

    :param end_effectors: of arms of as many joints, of one robot or of several in worlds of their
        own, after ``mj_forward``
    """

    def __init__(self, end_effectors: Sequence[FollowingEndEffector]) -> None:
        one = self._one = len(end_effectors) == 1
        seen = [each.look() for each in end_effectors]
        twists: Sequence[FloatArray | None]
        self._still: Sequence[bool]
        if one:
            still, twist, *arrays = seen[0]
            self._still, twists, limits = [still], [twist], end_effectors[0].arm.limits
        else:
            self._still, twists, *lists = zip(*seen)
            arrays = [_together(rows) for rows in lists]
            limits = tuple(
                _together([each.arm.all_limits for each in end_effectors]).swapaxes(0, 1))
        self._errors, jacobians, position, self._velocity, away = arrays
        low, high, fastest, weakest, strongest, damping = limits
        wanted = self._wanted = WantedMotions(
            jacobians, self._errors, twists, [each.settings for each in end_effectors], fastest,
            low - position, high - position, away,
            [each.target.rests for each in end_effectors])
        accelerations, forces = wanted.accelerations(self._velocity), []
        for each, rests, acceleration in zip(
                end_effectors, wanted.found.rests, (accelerations,) if one else accelerations):
            each.target.rests = rests
            forces.append(each.forces(acceleration))
        self._efforts = forces[0] if one else _together(forces)
        self._efforts += damping * self._velocity
        np.maximum(self._efforts, weakest, out=self._efforts)
        np.minimum(self._efforts, strongest, out=self._efforts)

    def efforts_of(self, row: int) -> FloatArray:
        """Return the efforts of the joints of an arm [N m], shape (n,)."""
        return self._efforts if self._one else self._efforts[row]

    def solution(self, row: int) -> EffortSolution:
        """Return how near an end effector is to its target, and what limits it."""
        error, velocity = self._errors, self._velocity
        if not self._one:
            error, velocity = error[row], velocity[row]
        return EffortSolution(error, self._wanted.found.row(row), self._wanted.slowed(row),
                              self._still[row], velocity)


def _together(found: Sequence[FloatArray]) -> FloatArray:
    """Return arrays of one shape as one with a leading axis."""
    return np.concatenate(found).reshape(len(found), *found[0].shape)


class OperationalSpaceController:
    """
    What the efforts of the end effectors of a robot are computed from.

    :param physics: of the world
    :param servos: of all driven joints
    :param posture: positions that redundant arms are drawn to [rad], shape (n,)
    :ivar physics: of the world
    :ivar posture: the same array
    :ivar accelerations: where they are written, zero otherwise, shape (nv,); ``forces`` too
    """

    #: Where results are written, and what follows from the rest.
    not_in_digest = ('forces', 'accelerations', '_arms')

    def __init__(self, physics: Physics, servos: Servos, posture: FloatArray) -> None:
        self.physics = physics
        self._servos = servos
        self.posture = posture
        self._low, self._high = servos.position_clamp().T
        self._arms: dict[bytes, ArmJoints] = {}
        physics.on_change(self._make_room)

    def _make_room(self) -> None:
        self.accelerations, self.forces = np.zeros((2, self.physics.model.nv))
        self._arms.clear()  # Their joints may have other addresses.

    def look_at_joints(self) -> None:
        """Take over the damping of the joints, which was changed."""
        self._arms.clear()

    def _arm(self, indices: IntArray) -> ArmJoints:
        key = indices.tobytes()
        if key not in self._arms:
            servos = self._servos
            limits = np.stack([
                self._low[indices], self._high[indices], servos.velocity_limit[indices],
                *servos.ranges['effort'][indices].T, servos.passive_damping[indices]])
            self._arms[key] = ArmJoints(
                as_slice(indices), as_slice(servos.qpos[indices]), as_slice(servos.dofs[indices]),
                tuple(limits), limits, servos.turn[indices])
        return self._arms[key]

    def following(self, tip: Frame, target: Target, indices: IntArray, settings: CartesianSettings,
                  now_s: float, duration_s: float) -> FollowingEndEffector:
        """
        Return an end effector that follows a target in the next interval.

        :param tip: frame of the end effector
        :param indices: of the joints of the arm, shape (n,)
        :param now_s: simulation time [s]
        :param duration_s: length of the interval [s]
        """
        return FollowingEndEffector(
            self, tip, target, self._arm(indices), settings, now_s, duration_s)
