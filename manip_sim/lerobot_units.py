# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Names and units of joints in LeRobot: keys, degrees, ranges; nothing of LeRobot is imported."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math
from typing import Any

from manip_sim.errors import ManipSimError
from manip_sim.quoting import quoted_names

#: End of a key of LeRobot: a position.
POSITION = '.pos'
#: Motors of LeRobot's ``so101_follower``, in its order.
SO101_MOTORS = ('shoulder_pan', 'shoulder_lift', 'elbow_flex', 'wrist_flex', 'wrist_roll',
                'gripper')


@dataclass(frozen=True)
class Scale:
    """
    A joint's position as a number of LeRobot.

    :ivar joint: its name as the node publishes it
    :ivar per_unit: of LeRobot's number, per rad or m
    :ivar zero: position where LeRobot's number is zero [rad or m]
    """

    joint: str
    per_unit: float = 1.0
    zero: float = 0.0

    def number(self, position: float) -> float:
        """Return LeRobot's number of a position [rad or m]."""
        return (position - self.zero) * self.per_unit

    def position(self, number: float) -> float:
        """Return the position [rad or m] of LeRobot's number."""
        return number / self.per_unit + self.zero


def plain_scales(ranges: Mapping[str, tuple[float, float]]) -> dict[str, Scale]:
    """Return the joints in the node's units, by their own names."""
    return {joint: Scale(joint) for joint in ranges}


def so101_scales(ranges: Mapping[str, tuple[float, float]], degrees: bool = True
                 ) -> dict[str, Scale]:
    """
    Return the joints of an SO-101 by the names and in the units of LeRobot's ``so101_follower``.

    Its zero is the middle of the calibrated range, as in the model. The gripper counts from 0
    (closed) to 100 (open); ``wrist_roll`` is calibrated over a whole turn.

    :param ranges: of the joints as the node has them, by name [rad]
    :param degrees: whether the others are in degrees; else their ranges are -100 to 100
    :raises ManipSimError: if a joint is missing
    """
    scales = {}
    for motor in SO101_MOTORS:
        joint = joint_of(motor, ranges)
        low, high = ranges[joint]
        if motor == 'gripper':
            scales[motor] = Scale(joint, 100.0 / (high - low), low)
        elif degrees:
            scales[motor] = Scale(joint, 180.0 / math.pi)
        elif motor == 'wrist_roll':
            scales[motor] = Scale(joint, 100.0 / math.pi)
        else:
            scales[motor] = Scale(joint, 200.0 / (high - low), 0.5 * (low + high))
    return scales


def joint_of(motor: str, joints: Sequence[str] | Mapping[str, Any]) -> str:
    """
    Return the joint whose name is a motor's, or ends with it after a prefix.

    :raises ManipSimError: if it is not exactly one
    """
    matches = [joint for joint in joints if joint == motor or joint.endswith(f'_{motor}')]
    if len(matches) != 1:
        raise ManipSimError(f'{len(matches)} joints are called {motor!r}, with or without a '
                            f'prefix, of {quoted_names([*joints])}')
    return matches[0]
