# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Validated Cartesian commands; the poses of frames are looked up when they take effect."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from manip_sim.arrays import BoolArray, FloatArray
from manip_sim.control.commands import Command
from manip_sim.physics.robot_frames import Frame


@dataclass(frozen=True, kw_only=True, eq=False)
class CartesianCommand(Command):
    """
    A command for the ``grip_site`` of an arm, carried out by the joints of the arm alone.

    A newer command may take some of the joints; the others go on as well as they can.

    :ivar arm: ``right`` or ``left``
    """

    arm: str


@dataclass(frozen=True, kw_only=True, eq=False)
class CartesianPose(CartesianCommand):
    """
    A pose that ``grip_site`` comes to and keeps.

    The frame's pose is taken when the command takes effect. From then on the goal is fixed in that
    frame if the arm does not move it (such as a mobile base), otherwise in ``world``.

    :ivar frame: of the pose
    :ivar position: [m], shape (3,)
    :ivar rotation: rotation matrix, shape (3, 3)
    """

    shapes = {'position': ('d', 3), 'rotation': ('d', 3, 3)}

    frame: Frame
    position: FloatArray
    rotation: FloatArray

    @property
    def goal(self) -> FloatArray:
        """Position and rotation."""
        return np.concatenate([self.position, self.rotation.ravel()])


@dataclass(frozen=True, kw_only=True, eq=False)
class CartesianTwist(CartesianCommand):
    """
    A velocity of ``grip_site``, which lasts until the timeout passes without a fresh one.

    :ivar frame: whose axes the twist is in; the linear velocity is that of ``grip_site``
    :ivar twist: linear [m/s] and angular [rad/s], shape (6,)
    """

    shapes = {'twist': ('d', 6)}

    frame: Frame
    twist: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class GuardedTwist(CartesianTwist):
    """
    A velocity of ``grip_site`` until contact, which needs no fresh ones.

    :ivar force: size of the external force on the tool that ends it [N]
    :ivar distance: of ``grip_site`` from where it was, which ends it [m]
    :ivar duration_s: simulation time that ends it [s]
    """

    force: float
    distance: float
    duration_s: float


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseAction(CartesianCommand):
    """
    An action of robosuite's controller OSC_POSE, in its default configuration.

    The goal is the present measured pose of ``grip_site``, not the last goal, moved by 0.05 m and
    turned by 0.5 rad for an action of 1, along and about the axes of the arm's site
    ``<arm>_center``, in which it stays fixed. The turn is a rotation vector. This is
    ``input_type`` delta, ``input_ref_frame`` base, ``goal_update_mode`` achieved (robosuite 1.5,
    ``controllers/parts/arm/osc.py``).

    :ivar action: in [-1, 1], shape (6,)
    """

    shapes = {'action': ('d', 6)}

    action: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class CartesianWrench(CartesianCommand):
    """
    A force and torque that an impedance exerts at ``grip_site``, in addition to its springs.

    The target stays; without one the end effector is to stay where it is. It lasts until the
    timeout of the arm passes without a fresh one.

    :ivar frame: whose axes the wrench is in
    :ivar wrench: force [N] and torque [N m], shape (6,)
    """

    adds: ClassVar[bool] = True
    shapes = {'wrench': ('d', 6)}

    frame: Frame
    wrench: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class ForceMode(CartesianWrench):
    """
    A wrench along and about chosen axes of an impedance, whose springs do not act there.

    :ivar selection: true for the axes of the springs that are chosen, shape (6,)
    :ivar limits: velocities along and about these [m/s, rad/s], shape (6,)
    """

    shapes = {'selection': ('?', 6), 'limits': ('d', 6)}

    selection: BoolArray
    limits: FloatArray
