# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Target of an end effector: a goal pose, or a twist that moves it; made as commands begin."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import NamedTuple

import mujoco
import numpy as np

from manip_sim.algebra import product, transposed_product
from manip_sim.arrays import FloatArray
from manip_sim.control.cartesian.cartesian_commands import (
    CartesianCommand, CartesianPose, CartesianTwist, CartesianWrench, PoseAction)
from manip_sim.control.cartesian.kinematic_chains import KinematicChain
from manip_sim.control.cartesian.pose_stream import PoseStream
from manip_sim.control.velocity_stream import VelocityStream
from manip_sim.physics.physics import Kinematics
from manip_sim.physics.robot_frames import Frame, WORLD


class Guard(NamedTuple):
    """
    A motion until contact.

    :ivar start: position where it began, in the world [m], shape (3,)
    :ivar begin_s: simulation time when it began [s]
    :ivar free: position [m] and rotation matrix in the world where the force was last below its
        limit
    """

    start: FloatArray
    begin_s: float
    free: tuple[FloatArray, FloatArray]


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
    :ivar settled_in: where the arm's mount was at the beginning of the control period in which the
        setpoints came to rest, or None
    :ivar rests: whether the end effector is as near as it can come
    :ivar start: where the way of the end effector began, in the anchor [m], shape (3,), or None
    :ivar stream: of poses in the anchor, of which the goal is the last one, or None
    :ivar reference: position [m] and rotation matrix, in the anchor, to which the springs of an
        impedance pull on the way to the goal, or None
    :ivar push: wrench of an impedance beside its springs, or None
    :ivar push_until_s: simulation time when that ends [s]
    :ivar guard: of a motion until contact, or None
    """

    #: Of arrays that compiled code reads.
    shapes = {'position': ('d', 3), 'rotation': ('d', 3, 3), 'start': ('d', 3)}
    #: Each control period begins with a solution.
    undigested = ('solve_s',)

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
    reference: tuple[FloatArray, FloatArray] | None = None
    push: CartesianWrench | None = None
    push_until_s: float = math.inf
    guard: Guard | None = None

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
        self.position, self.rotation = _in_frame(self.anchor, pose, data)

    def goal(self, data: mujoco.MjData) -> tuple[FloatArray, FloatArray]:
        """Return position [m] and rotation matrix of the goal in the world."""
        return _in_world(self.anchor, (self.position, self.rotation), data)

    def go_on(self, before: Target, data: mujoco.MjData) -> None:
        """Let the springs of an impedance pull as before, and what it pushes with go on."""
        if before.reference is not None:
            self.reference = before.reference if before.anchor == self.anchor else _in_frame(
                self.anchor, _in_world(before.anchor, before.reference, data), data)
        self.push, self.push_until_s = before.push, before.push_until_s

    @property
    def known_s(self) -> float:
        """Simulation time until which it is known what moves or pushes [s]."""
        until_s = self.push_until_s
        if self.twists is not None:
            until_s = min(until_s, self.until_s)
        elif self.stream is not None:  # Which goes on at that instant.
            until_s = min(until_s, self.stream.until_s + 2e-9)
        return until_s

    def ends_stream(self, now_s: float) -> bool:
        """Return whether the goal rests now, if need be because the stream has ended."""
        if self.stream is not None:
            self.stream.update(now_s)
        return self.stream is None or not self.stream.moving


def _in_frame(frame: Frame, pose: tuple[FloatArray, FloatArray], data: mujoco.MjData
              ) -> tuple[FloatArray, FloatArray]:
    """Return position [m] and rotation matrix in a frame, of a pose in the world."""
    origin, turned = frame.pose(data)
    return transposed_product(turned, pose[0] - origin), transposed_product(turned, pose[1])


def _in_world(frame: Frame, pose: tuple[FloatArray, FloatArray], data: mujoco.MjData
              ) -> tuple[FloatArray, FloatArray]:
    """Return position [m] and rotation matrix in the world, of a pose in a frame."""
    origin, turned = frame.view(data)
    position, rotation = np.empty(3), np.empty((3, 3))
    mujoco.mju_mulMatVec(position, turned, pose[0])
    position += origin
    mujoco.mju_mulMatMat(rotation, turned, pose[1])
    return position, rotation


def target_of(command: CartesianCommand, chain: KinematicChain, model: mujoco.MjModel,
              data: mujoco.MjData, kinematics: Kinematics, before: Target | None,
              until_s: float) -> Target:
    """
    Return the target of a command.

    :param chain: of the arm that the target is for
    :param model: the ``mujoco.MjModel``
    :param data: the ``mujoco.MjData`` after ``mj_forward``
    :param kinematics: views into it
    :param before: the target that a stream of twists has moved until now, or None
    :param until_s: simulation time when a twist ends [s]
    """
    if isinstance(command, CartesianPose):
        origin, turned = command.frame.pose(data)
        anchor = Frame(WORLD, 0) if _moves(chain, command.frame, model) else command.frame
        return Target.at(anchor, origin + product(turned, command.position),
                         product(turned, command.rotation), data)
    if isinstance(command, PoseAction):
        from manip_sim.control.law.leading import act  # It imports numba.
        position, rotation = np.empty(3), np.empty((3, 3))
        act(kinematics, *chain.tip.number, *chain.origin.number, command.action, position,
            rotation)
        return Target(chain.origin, position, rotation, chain.origin)
    position, rotation = chain.tip.view(data)
    assert isinstance(command, CartesianTwist)
    if before is not None:
        position, rotation = before.goal(data)
    target = Target.at(chain.origin, position, rotation, data)
    target.axes, target.until_s = command.frame, until_s
    return target


def _moves(chain: KinematicChain, frame: Frame, model: mujoco.MjModel) -> bool:
    """Return whether an arm moves a frame."""
    body = frame.body
    while body:
        first, count = model.body_jntadr.item(body), model.body_jntnum.item(body)
        if not set(model.jnt_qposadr[first:first + count].tolist()).isdisjoint(
                chain.qpos.tolist()):
            return True
        body = model.body_parentid.item(body)
    return False
