# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Poses and twists of frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.errors import CommandError
from manip_sim.validation import finite_command_numbers, norm_of_unit_quaternion

#: Largest coordinate of a position that is accepted [m].
MAX_DISTANCE_M = 1e4
#: Largest component of a velocity that is accepted; faster ones tunnel in a step [m/s, rad/s].
MAX_VELOCITY = 1e3
#: Largest component of a wrench that is accepted [N, N m].
MAX_WRENCH = 1e6


@dataclass(frozen=True)
class Pose:
    """
    The pose of a frame, in ``world`` unless another frame is named.

    :ivar position: [m], shape (3,)
    :ivar quat_xyzw: of unit length, shape (4,)
    """

    position: FloatArray
    quat_xyzw: FloatArray

    @classmethod
    def checked(cls, position: ArrayLike, quat_xyzw: ArrayLike) -> Pose:
        """
        Return a pose of numbers from outside.

        :raises CommandError: if a number is not finite, the position is too far away or the
            quaternion is not of unit length
        """
        place = finite_command_numbers(position, 3, 'position')
        quat = finite_command_numbers(quat_xyzw, 4, 'orientation')
        if np.abs(place).max() > MAX_DISTANCE_M:
            raise CommandError(f'position must be within {MAX_DISTANCE_M:g} m of the origin, got '
                               f'{place.tolist()}')
        return cls(place, quat / norm_of_unit_quaternion(
            quat.tolist(), 'orientation', CommandError))


@dataclass(frozen=True)
class Twist:
    """
    The velocity of a frame, in the axes of ``world`` unless another frame is named.

    :ivar linear: of the frame's origin [m/s], shape (3,)
    :ivar angular: [rad/s], shape (3,)
    """

    linear: FloatArray
    angular: FloatArray

    @classmethod
    def checked(cls, linear: ArrayLike, angular: ArrayLike) -> Twist:
        """
        Return a twist of numbers from outside.

        :raises CommandError: if a number is not finite or too great
        """
        speeds = {'linear velocity': finite_command_numbers(linear, 3, 'linear velocity'),
                  'angular velocity': finite_command_numbers(angular, 3, 'angular velocity')}
        for quantity, values in speeds.items():
            if np.abs(values).max() > MAX_VELOCITY:
                raise CommandError(f'{quantity} must be within {MAX_VELOCITY:g}, got '
                                   f'{values.tolist()}')
        return cls(*speeds.values())
