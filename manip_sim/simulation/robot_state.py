# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The state of a robot at one instant, as plain copies that are safe to keep."""

from __future__ import annotations

from dataclasses import dataclass, field

from manip_sim.arrays import FloatArray
from manip_sim.physics.end_effectors import EndEffector


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
