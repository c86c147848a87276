# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The state of a robot at one instant, as plain copies that are safe to keep."""

from __future__ import annotations

from dataclasses import dataclass, field

from manip_sim.arrays import BoolArray, FloatArray
from manip_sim.simulation.poses import Pose, Twist


@dataclass(frozen=True)
class Wrench:
    """
    A force and a torque in one frame.

    :ivar force: [N], shape (3,)
    :ivar torque: about the frame's origin [N m], shape (3,)
    """

    force: FloatArray
    torque: FloatArray


@dataclass(frozen=True)
class EndEffector:
    """
    A gripper as seen from the world and from its force/torque sensor.

    :ivar pose: of ``grip_site``
    :ivar twist: of ``grip_site``
    :ivar wrench: what ``force_ee`` and ``torque_ee`` measure, in ``ft_frame``
    :ivar external_wrench: what the world exerts on the tool, the mean over the last control
        period, filtered and tared, in ``ft_frame``
    """

    pose: Pose
    twist: Twist
    wrench: Wrench
    external_wrench: Wrench


@dataclass(frozen=True)
class JointReference:
    """
    Setpoints and commanded efforts of some joints at one instant.

    :ivar position: [rad or m], shape (n,)
    :ivar velocity: [rad/s or m/s], shape (n,)
    :ivar acceleration: [rad/s^2 or m/s^2], shape (n,)
    :ivar effort: commanded, zero for joints that follow setpoints [N m or N], shape (n,)
    :ivar gives_effort: whether a joint has a commanded effort and no setpoint, shape (n,)
    """

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    effort: FloatArray
    gives_effort: BoolArray


@dataclass(frozen=True)
class ControllerState:
    """
    Reference and measured state of some joints.

    :ivar names: of the driven joints, n of them
    :ivar reference: their setpoints and commanded efforts
    :ivar position: measured [rad or m], shape (n,)
    :ivar velocity: measured [rad/s or m/s], shape (n,)
    :ivar effort: of the actuators at the joint in the last physics step [N m or N], shape (n,)
    """

    names: tuple[str, ...]
    reference: JointReference
    position: FloatArray
    velocity: FloatArray
    effort: FloatArray


@dataclass(frozen=True)
class State:
    """
    A snapshot of one instant.

    :ivar time_ns: simulation time [ns], a whole number of steps
    :ivar position: of all scalar joints, in the order of the robot's ``joint_names``
        [rad or m], shape (n,)
    :ivar velocity: [rad/s or m/s], shape (n,)
    :ivar effort: of the actuators at the joint in the last physics step, gravity compensation
        included [N m or N], shape (n,)
    :ivar end_effectors: by arm, of the arms with a gripper
    """

    time_ns: int
    position: FloatArray
    velocity: FloatArray
    effort: FloatArray
    end_effectors: dict[str, EndEffector] = field(default_factory=dict)
