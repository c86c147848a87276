# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""How far joints may be from where they shall be, as clients of FollowJointTrajectory say it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.quoting import quoted
from manip_sim.simulation.goals import GoalCode, GoalError

#: What stands for no tolerance at all.
ERASE = -1.0


@dataclass(frozen=True)
class JointTolerance:
    """
    How far a joint may be from where it shall be; 0 is the default, -1 is as far as it likes.

    :ivar name: of the joint
    :ivar position: [rad or m]
    :ivar velocity: [rad/s or m/s]
    :ivar acceleration: is checked as a number, and then not used: accelerations are not measured
    """

    name: str
    position: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0


class Tolerances:
    """
    Tolerances of joints in one order, infinite where there is none.

    :param joints: in whose order they are
    :param part: the joints that may be named
    :param given: what the client asks for
    :param velocity: the default [rad/s or m/s]
    :raises GoalError: if a joint is not there, or a number is no tolerance
    """

    def __init__(self, joints: Sequence[str], part: Sequence[str],
                 given: Sequence[JointTolerance], velocity: float = math.inf) -> None:
        self._joints = joints
        self.position = np.full(len(joints), np.inf)
        self.velocity = np.full(len(joints), velocity)
        for tolerance in given:
            if tolerance.name not in part:
                raise GoalError(GoalCode.INVALID_JOINTS, 'a tolerance is for the joint '
                                f'{quoted(tolerance.name)}, which is not in the part')
            _resolved(tolerance.name, tolerance.acceleration, math.inf)
            for index in [i for i, name in enumerate(joints) if name == tolerance.name]:
                self.position[index] = _resolved(tolerance.name, tolerance.position, math.inf)
                self.velocity[index] = _resolved(tolerance.name, tolerance.velocity, velocity)

    def violated(self, position_error: FloatArray, velocity_error: FloatArray) -> str:
        """Say which joint is outside its tolerance by the largest factor; empty if none is."""
        errors = np.abs([position_error, velocity_error])
        limits = np.array([self.position, self.velocity])
        with np.errstate(invalid='ignore'):
            ratios = errors / limits
        kind, joint = divmod(int(np.argmax(ratios)), len(self._joints))
        if not ratios[kind, joint] > 1.0:
            return ''
        what = ('position', 'velocity')[kind]
        return (f"the {what} of joint '{self._joints[joint]}' is {errors[kind, joint]:.4g} off, "
                f'its tolerance is {limits[kind, joint]:.4g}')


def _resolved(joint: str, value: float, default: float) -> float:
    if value == 0.0:
        return default
    if value == ERASE:
        return math.inf
    if not (value > 0.0 and math.isfinite(value)):
        raise GoalError(GoalCode.INVALID_GOAL, f"joint '{joint}': a tolerance must be positive, 0 "
                        f'for the default or -1 for none, got {value:g}')
    return value
