# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Inputs and outputs of operational space control of an arm; numba is not needed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from manip_sim.arrays import BoolArray, FloatArray, IntArray


class Arm(NamedTuple):
    """
    The joints of an arm.

    :ivar joints: their indices in ``postures``, shape (n,)
    :ivar qpos: addresses in ``qpos``, shape (n,)
    :ivar dofs: addresses in ``qvel``, shape (n,)
    :ivar moves: whether a joint moves the end effector, shape (n,)
    :ivar places: of the inertia in ``M``, -1 where it is zero, shape (n, n)
    :ivar low: lowest positions [rad], shape (n,)
    :ivar high: highest positions [rad], shape (n,)
    :ivar velocity_limit: [rad/s], shape (n,)
    :ivar weakest: lowest efforts [N m], shape (n,)
    :ivar strongest: highest efforts [N m], shape (n,)
    :ivar damping: of the joints themselves [N m s/rad], shape (n,)
    :ivar turn: 2 pi where whole turns make no difference, 0 elsewhere [rad], shape (n,)
    :ivar root: body at the root of the tree of bodies
    """

    joints: IntArray
    qpos: IntArray
    dofs: IntArray
    moves: BoolArray
    places: IntArray
    low: FloatArray
    high: FloatArray
    velocity_limit: FloatArray
    weakest: FloatArray
    strongest: FloatArray
    damping: FloatArray
    turn: FloatArray
    root: int


class Spring(NamedTuple):
    """
    Settings of an end effector.

    :ivar stiffness: acceleration per error [1/s^2]
    :ivar damping: acceleration per velocity [1/s]
    :ivar linear_velocity: limit [m/s]
    :ivar angular_velocity: limit [rad/s]
    """

    stiffness: float
    damping: float
    linear_velocity: float
    angular_velocity: float


class Goal(NamedTuple):
    """
    Pose and velocity of the goal of an end effector.

    :ivar position: in its frame [m], shape (3,)
    :ivar rotation: in its frame, shape (3, 3)
    :ivar origin: of the frame in the world [m], shape (3,), a view
    :ivar axes: of the frame in the world, shape (3, 3), a view
    :ivar along: velocity in the world, and acceleration / damping [m/s, rad/s], shape (6,)
    """

    position: FloatArray
    rotation: FloatArray
    origin: FloatArray
    axes: FloatArray
    along: FloatArray


class Motion(NamedTuple):
    """
    Arrays into which the law writes.

    :ivar efforts: of the joints [N m], shape (n,)
    :ivar error: translation [m] and rotation vector [rad] to the goal, shape (6,)
    :ivar twist: of the end effector [m/s, rad/s], shape (6,)
    :ivar held: whether the range of a joint keeps it from doing more, shape (n,)
    """

    efforts: FloatArray
    error: FloatArray
    twist: FloatArray
    held: BoolArray

    @classmethod
    def of(cls, count: int) -> Motion:
        """Return arrays for a number of joints."""
        return cls(np.zeros(count), np.zeros(6), np.zeros(6), np.zeros(count, dtype=np.bool_))


class ArmMotion(NamedTuple):
    """
    Setpoints and limits of the joints of an arm, all of shape (n,).

    :ivar position: where the present velocities bring the joints in the interval [rad]
    :ivar velocity: at present [rad/s]
    :ivar low: lowest position, may be infinite [rad]
    :ivar high: highest position [rad]
    :ivar velocity_limit: [rad/s]
    :ivar acceleration_limit: [rad/s^2]
    :ivar posture: to which a redundant arm tends [rad]
    :ivar turn: 2 pi where whole turns make no difference, 0 elsewhere [rad]
    """

    position: FloatArray
    velocity: FloatArray
    low: FloatArray
    high: FloatArray
    velocity_limit: FloatArray
    acceleration_limit: FloatArray
    posture: FloatArray
    turn: FloatArray


class Velocities(NamedTuple):
    """
    Arrays into which the law writes, all of shape (n,).

    :ivar velocity: of the joints at the end of the interval [rad/s]
    :ivar acceleration_limit: of the joints, if the motion needs more than their own [rad/s^2]
    :ivar held: whether the range of a joint keeps it from doing more
    """

    velocity: FloatArray
    acceleration_limit: FloatArray
    held: BoolArray

    @classmethod
    def of(cls, count: int) -> Velocities:
        """Return arrays for a number of joints."""
        return cls(np.zeros(count), np.zeros(count), np.zeros(count, dtype=np.bool_))
