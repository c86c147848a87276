# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Settings of the Cartesian control of an arm, which may change while it runs."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
import math

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.validation import positive_number


@dataclass(frozen=True)
class CartesianSettings:
    """
    Settings of an arm; stiffness and damping are those of effort mode.

    :ivar stiffness: acceleration of ``grip_site`` per error, robosuite's kp [1/s^2]
    :ivar damping_ratio: 1 is critical damping
    :ivar linear_velocity: limit for ``grip_site`` [m/s]
    :ivar angular_velocity: limit for ``grip_site`` [rad/s]
    :ivar twist_timeout: how long a twist lasts if no fresh one comes, simulation time [s]
    """

    stiffness: float = 150.0
    damping_ratio: float = 1.0
    linear_velocity: float = 1.0
    angular_velocity: float = 3.2
    twist_timeout: float = 0.1

    @property
    def limits(self) -> FloatArray:
        """Limits of linear and angular velocity [m/s, rad/s], shape (2,)."""
        return np.array([self.linear_velocity, self.angular_velocity])

    @property
    def damping(self) -> float:
        """Acceleration of ``grip_site`` per velocity [1/s]."""
        return 2.0 * math.sqrt(self.stiffness) * self.damping_ratio

    def changed(self, name: str, value: float) -> CartesianSettings:
        """
        Return the settings with another value for one of them.

        :raises CommandError: if the value is not positive and finite
        :raises UnknownNameError: if there is no such setting
        """
        names = [field.name for field in fields(self)]
        if name not in names:
            raise UnknownNameError('Cartesian setting', name, names)
        return replace(self, **{name: positive_number(value, name, CommandError)})
