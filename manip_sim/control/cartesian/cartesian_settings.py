# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Settings of the Cartesian control of an arm, which may change while it runs."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
import functools
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.quoting import format_value
from manip_sim.validation import (
    command_numbers, finite_command_numbers, numbers_of, positive_number)

#: Frames whose axes the springs of an impedance may have: that of the base of the arm,
#: ``<arm>_center``, that of the end effector, ``grip_site``, and the world.
FRAMES = BASE, TOOL, WORLD = 'base', 'tool', 'world'
#: Settings of an impedance, which have a parameter each for each arm.
IMPEDANCE = ('cartesian_stiffness', 'cartesian_damping', 'cartesian_damping_ratio',
             'null_space_stiffness', 'null_space_posture', 'cartesian_frame')
#: Word for the posture in which an episode begins.
INITIAL = 'initial'


@dataclass(frozen=True)
class CartesianSettings:
    """
    Settings of an arm; all but limits, timeout and posture apply to effort mode only.

    :ivar stiffness: acceleration of ``grip_site`` per error, robosuite's kp [1/s^2]
    :ivar damping_ratio: 1 is critical damping
    :ivar linear_velocity: limit for ``grip_site`` [m/s]
    :ivar angular_velocity: limit for ``grip_site`` [rad/s]
    :ivar twist_timeout: how long a twist lasts if no fresh one comes, simulation time [s]
    :ivar cartesian_stiffness: along and about the axes [N/m x 3, N m/rad x 3]; six zeros for
        ``stiffness`` and ``damping_ratio`` instead of an impedance
    :ivar cartesian_damping: of an impedance, along and about the axes, beside that of the ratio
        [N s/m x 3, N m s/rad x 3]
    :ivar cartesian_damping_ratio: of an impedance, of each of its modes; 1 is critical damping
    :ivar null_space_stiffness: of an impedance, towards the posture [N m/rad]
    :ivar null_space_posture: that a redundant arm tends to, :data:`INITIAL` or the text of the
        positions of its joints [rad]
    :ivar cartesian_frame: whose axes these are, one of :data:`FRAMES`
    """

    stiffness: float = 150.0
    damping_ratio: float = 1.0
    linear_velocity: float = 1.0
    angular_velocity: float = 3.2
    twist_timeout: float = 0.1
    cartesian_stiffness: tuple[float, ...] = (0.0,) * 6
    cartesian_damping: tuple[float, ...] = (0.0,) * 6
    cartesian_damping_ratio: float = 1.0
    null_space_stiffness: float = 10.0
    null_space_posture: str = INITIAL
    cartesian_frame: str = BASE

    @property
    def impedes(self) -> bool:
        """True if the arm is an impedance in effort mode."""
        return any(self.cartesian_stiffness)

    @property
    def limits(self) -> FloatArray:
        """Limits of linear and angular velocity [m/s, rad/s], shape (2,)."""
        return np.array([self.linear_velocity, self.angular_velocity])

    @property
    def damping(self) -> float:
        """Acceleration of ``grip_site`` per velocity [1/s]."""
        return 2.0 * math.sqrt(self.stiffness) * self.damping_ratio

    def changed(self, name: str, value: ArrayLike | str) -> CartesianSettings:
        """
        Return the settings with another value for one of them.

        :param value: a number, six numbers for ``cartesian_stiffness`` and ``cartesian_damping``,
            positions of joints, their text or :data:`INITIAL` for ``null_space_posture``, or the
            name of a frame
        :raises CommandError: if a number is not finite, or not positive where it has to be
        :raises UnknownNameError: if the setting or frame is unknown
        """
        names = [field.name for field in fields(self)]
        if name not in names:
            raise UnknownNameError('Cartesian setting', name, names)
        checked: Any
        if name == 'cartesian_frame':
            if value not in FRAMES:
                raise UnknownNameError('frame of a Cartesian stiffness', str(value), FRAMES)
            checked = value
        elif name == 'null_space_posture':
            checked = (value.strip() if isinstance(value, str) else
                       str(command_numbers(value, name).tolist()))
        elif name in ('cartesian_stiffness', 'cartesian_damping'):
            checked = tuple(finite_command_numbers(value, 6, name).tolist())
            if min(checked) < 0.0:
                raise CommandError(f'{name} must not be negative, got {list(checked)}')
        else:
            checked = positive_number(value, name, CommandError, name == 'null_space_stiffness')
        return replace(self, **{name: checked})


@functools.lru_cache
def posture_of(text: str, joints: int) -> FloatArray | None:
    """
    Return the positions of the joints of an arm that a text has [rad], or None if it is initial.

    :param joints: their number
    :returns: shape (n,), not to be changed
    :raises CommandError: if the text is something else
    """
    if text == INITIAL:
        return None
    try:
        numbers = numbers_of(text)
    except ValueError:
        raise CommandError(f"null_space_posture must be '{INITIAL}' or a position for each joint "
                           f'such as [0.0, 0.5, 1.0], got {format_value(text)}') from None
    return finite_command_numbers(numbers, joints, 'null_space_posture')
