# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What an end effector is to do: a goal pose, or a twist that moves it; made as commands begin."""

from __future__ import annotations

from dataclasses import dataclass
import math

import mujoco
import numpy as np

from manip_sim.algebra import length, product, transposed_product
from manip_sim.arrays import FloatArray
from manip_sim.control.cartesian.cartesian_commands import (
    CartesianCommand, CartesianPose, CartesianTwist, PoseAction)
from manip_sim.control.cartesian.kinematic_chains import KinematicChain
from manip_sim.control.cartesian.pose_stream import PoseStream
from manip_sim.control.velocity_stream import VelocityStream
from manip_sim.physics.robot_frames import Frame, WORLD
from manip_sim.quaternion import matrix_of_vector, rotation_vector

#: How far a goal that a twist moves may be ahead of the end effector [m], [rad].
_LEAD, _TURN_LEAD = 0.05, 0.3
#: How far an action of 1 moves and turns the goal [m], [rad]; robosuite's defaults for OSC_POSE.
_ACTION_STEP, _ACTION_TURN = 0.05, 0.5


@dataclass
class Target:
    """
    A goal pose, or a twist that moves it.

    :ivar anchor: frame that the goal stays fixed in
    :ivar position: of the goal in the anchor [m], shape (3,)
    :ivar rotation: of the goal in the anchor, shape (3, 3)
    :ivar axes: frame of the twist
    :ivar twists: in those axes, of which the end effector follows the last one, or None
    :ivar until_s: simulation time when that ends [s]
    :ivar solve_s: simulation time of the next solution [s]
    :ivar settled_in: where the arm's mount was when the setpoints came to rest, or None
    :ivar rests: whether the end effector is as near as it can come
    :ivar start: where the way of the end effector began, in the anchor [m], shape (3,), or None
    :ivar stream: of poses in the anchor, of which the goal is the last one, or None
    """

    anchor: Frame
    position: FloatArray
    rotation: FloatArray
    axes: Frame
    twists: VelocityStream | None = None
    until_s: float = math.inf
    solve_s: float = -math.inf
    settled_in: FloatArray | None = None
    stream: PoseStream | None = None
    rests: bool = False
    start: FloatArray | None = None

    @classmethod
    def at(cls, anchor: Frame, position: FloatArray, rotation: FloatArray, data: mujoco.MjData
           ) -> Target:
        """
        Return the target of a pose that stays fixed in a frame.

        :param position: in the world [m], shape (3,)
        :param rotation: in the world, shape (3, 3)
        """
        target = cls(anchor, position, rotation, anchor)
        target.stay_at((position, rotation), data)
        return target

    def stay_at(self, pose: tuple[FloatArray, FloatArray], data: mujoco.MjData) -> None:
        """
        Set the goal.

        :param pose: position [m] and rotation matrix in the world
        """
        origin, turned = self.anchor.pose(data)
        self.position, self.rotation = (
            transposed_product(turned, pose[0] - origin), transposed_product(turned, pose[1]))

    def goal(self, data: mujoco.MjData) -> tuple[FloatArray, FloatArray]:
        """Return position [m] and rotation matrix of the goal in the world."""
        origin, turned = self.anchor.view(data)
        position, rotation = np.empty(3), np.empty((3, 3))
        mujoco.mju_mulMatVec(position, turned, self.position)
        position += origin
        mujoco.mju_mulMatMat(rotation, turned, self.rotation)
        return position, rotation

    @property
    def smooth(self) -> float:
        """Share of the acceleration of a stream of poses that is their own."""
        return self.stream.smooth if self.stream is not None else 0.0

    def ends_stream(self, now_s: float) -> bool:
        """Return whether the goal rests now, if need be because the stream has ended."""
        if self.stream is not None:
            self.stream.update(now_s)
        return self.stream is None or not self.stream.moving

    def motion(self, data: mujoco.MjData, tip: Frame, damping: float, now_s: float,
               duration_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """
        Return where the goal is in the next interval, and how it moves; a twist moves it.

        :param tip: frame of the end effector
        :param damping: acceleration of the end effector per velocity [1/s]
        :param now_s: simulation time [s]
        :param duration_s: length of the interval [s]
        :returns: position [m] and rotation matrix in the anchor; velocity and acceleration /
            damping in the world [m/s, rad/s], shape (6,)
        """
        along = np.zeros(6)
        if self.twists is not None:
            along = self.in_world(self.twists.at(now_s + duration_s / 2.0), data)
            self.move(data, tip, along, duration_s)
            along += self.in_world(self.twists.acceleration(now_s), data) / damping
        if self.ends_stream(now_s):
            return self.position, self.rotation, along
        assert self.stream is not None
        position, rotation = self.stream.pose(now_s)
        _, twist, acceleration = self.reference(data, now_s)
        return position, rotation, along + twist + acceleration / damping

    def reference(self, data: mujoco.MjData, now_s: float
                  ) -> tuple[tuple[FloatArray, FloatArray], FloatArray, FloatArray]:
        """
        Return where the end effector shall be now, and how that moves, in the world.

        :param now_s: simulation time [s]
        :returns: position [m] and rotation matrix, velocity and acceleration, each of shape (6,)
        """
        if self.stream is None or not self.stream.moving:
            return self.goal(data), np.zeros(6), np.zeros(6)
        origin, turned = self.anchor.pose(data)
        position, rotation = self.stream.pose(now_s)
        twist, acceleration = (
            np.concatenate([product(turned, half) for half in (motion[:3], motion[3:])])
            for motion in (self.stream.twist(now_s), self.stream.acceleration(now_s)))
        return ((origin + product(turned, position), product(turned, rotation)), twist,
                acceleration)

    def in_world(self, twist: FloatArray, data: mujoco.MjData) -> FloatArray:
        """Return a velocity, or an acceleration, of the twists in the world, shape (6,)."""
        _, axes = self.axes.pose(data)
        return np.concatenate([product(axes, twist[:3]), product(axes, twist[3:])])

    def move(self, data: mujoco.MjData, tip: Frame, twist: FloatArray, duration_s: float) -> None:
        """
        Move the goal with a twist, not far ahead of the end effector.

        :param twist: in the world [m/s, rad/s], shape (6,)
        :param duration_s: length of the motion [s]
        """
        position, rotation = self.goal(data)
        here, turned = tip.pose(data)
        ahead = _bounded(position + duration_s * twist[:3] - here, _LEAD)
        turn = rotation_vector(product(product(
            matrix_of_vector(duration_s * twist[3:]), rotation), turned.T))
        self.stay_at((here + ahead, product(
            matrix_of_vector(_bounded(turn, _TURN_LEAD)), turned)), data)


def _bounded(vector: FloatArray, limit: float) -> FloatArray:
    return vector * min(1.0, limit / max(length(vector), 1e-12))


def pose_error(goal: tuple[FloatArray, FloatArray], here: tuple[FloatArray, FloatArray]
               ) -> FloatArray:
    """Return translation [m] and rotation vector [rad] from here to the goal, shape (6,)."""
    error, turn, quat_wxyz = np.empty(6), np.empty((3, 3)), np.empty(4)
    np.subtract(goal[0], here[0], out=error[:3])
    mujoco.mju_mulMatMatT(turn, goal[1], here[1])
    mujoco.mju_mat2Quat(quat_wxyz, turn.reshape(9))
    mujoco.mju_quat2Vel(error[3:], quat_wxyz, 1.0)
    return error


def target_of(command: CartesianCommand, chain: KinematicChain, model: mujoco.MjModel,
              data: mujoco.MjData, before: Target | None, until_s: float) -> Target:
    """
    Return the target of a command.

    :param chain: of the arm that the target is for
    :param model: the ``mujoco.MjModel``
    :param data: the ``mujoco.MjData`` after ``mj_forward``
    :param before: the target that a stream of twists has moved until now, or None
    :param until_s: simulation time when a twist ends [s]
    """
    if isinstance(command, CartesianPose):
        origin, turned = command.frame.pose(data)
        anchor = Frame(WORLD, 0) if _moves(chain, command.frame, model) else command.frame
        return Target.at(anchor, origin + product(turned, command.position),
                         product(turned, command.rotation), data)
    position, rotation = chain.tip.pose(data)
    if isinstance(command, PoseAction):
        _, axes = chain.origin.pose(data)
        turn = matrix_of_vector(product(axes, _ACTION_TURN * command.action[3:]))
        return Target.at(chain.origin, position + product(axes, _ACTION_STEP * command.action[:3]),
                         product(turn, rotation), data)
    assert isinstance(command, CartesianTwist)
    if before is not None:
        position, rotation = before.goal(data)
    target = Target.at(chain.origin, position, rotation, data)
    target.axes, target.until_s = command.frame, until_s
    return target


def _moves(chain: KinematicChain, frame: Frame, model: mujoco.MjModel) -> bool:
    """Return whether an arm moves a frame."""
    own = set(model.jnt_bodyid[np.isin(model.jnt_qposadr, chain.qpos)].tolist())
    body = frame.body
    while body and body not in own:
        body = int(model.body_parentid[body])
    return body != 0
