# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tolerances of joints, as clients of FollowJointTrajectory give them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.quoting import quoted
from manip_sim.runtime.action_goals import GoalCode, GoalError

#: The value that erases a tolerance: the error is not limited.
ERASE = -1.0


@dataclass(frozen=True)
class JointTolerance:
    """
    The largest errors of a joint; 0 for the default, -1 for no limit.

    :ivar name: of the joint
    :ivar position: [rad or m]
    :ivar velocity: [rad/s or m/s]
    :ivar acceleration: validated, but not used: accelerations are not measured
    """

    name: str
    position: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0


class Tolerances:
    """
    Tolerances of joints in a given order, infinite where there is none.

    :param joints: the joints, in order
    :param part: the joints that may be named
    :param given: by the client
    :param velocity: the default [rad/s or m/s]
    :raises GoalError: if a joint is not in the part, or a number is not a tolerance
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
        """Return which joint exceeds its tolerance by the largest factor; empty if none does."""
        errors = np.abs([position_error, velocity_error])
        limits = np.array([self.position, self.velocity])
        with np.errstate(invalid='ignore', over='ignore'):
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
