# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A payload: mass, centre of mass and inertia of what an arm holds, as its user declares them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.validation import finite_command_numbers, positive_number

#: Greatest numbers of a payload [kg, m, kg m^2]; far greater ones make the physics diverge.
LARGEST = {'mass': 1000.0, 'center_of_mass': 10.0, 'inertia': 1000.0}
#: Share by which moments of inertia may miss what a body can have, as they are rounded.
_ROUNDED = 1e-6


@dataclass(frozen=True)
class Payload:
    """
    Load that an arm holds, beside its gripper.

    :ivar mass: [kg]; 0 for nothing
    :ivar center_of_mass: in ``ft_frame``, the flange between wrist and gripper [m]
    :ivar inertia: about the centre of mass, in the axes of ``ft_frame``: ixx, ixy, ixz, iyy, iyz,
        izz, as in ``geometry_msgs/Inertia`` [kg m^2]
    """

    mass: float = 0.0
    center_of_mass: tuple[float, ...] = (0.0,) * 3
    inertia: tuple[float, ...] = (0.0,) * 6

    def changed(self, name: str, value: Any) -> Payload:
        """
        Return the payload with another value for one of its numbers.

        :param name: of one of the fields
        :param value: a number for ``mass``, three for ``center_of_mass``, six for ``inertia``
        :raises CommandError: if they are not finite or too great, the mass is negative, or no body
            has such an inertia
        :raises UnknownNameError: if the number is unknown
        """
        names = [field.name for field in fields(self)]
        if name not in names:
            raise UnknownNameError('number of a payload', name, names)
        what = f'the {name} of a payload'
        if name == 'mass':
            numbers = [positive_number(value, what, CommandError, or_zero=True)]
        else:
            count = len(getattr(self, name))
            numbers = finite_command_numbers(value, count, what).tolist()
        if np.abs(numbers).max() > LARGEST[name]:
            raise CommandError(f'{what} must be within {LARGEST[name]:g}, got {value!r:.60}')
        if name == 'inertia':
            _check_inertia(numbers)
        changed: Any = numbers[0] if name == 'mass' else tuple(numbers)
        return replace(self, **{name: changed})

    @classmethod
    def checked(cls, mass: float, center_of_mass: ArrayLike = (0.0,) * 3,
                inertia: ArrayLike = (0.0,) * 6) -> Payload:
        """
        Return a payload.

        :param mass: [kg]; 0 for nothing
        :param center_of_mass: in ``ft_frame`` [m], shape (3,)
        :param inertia: about that, as of :class:`Payload` [kg m^2], shape (6,)
        :raises CommandError: as of :meth:`changed`
        """
        return cls().changed('mass', mass).changed('center_of_mass', center_of_mass).changed(
            'inertia', inertia)

    @property
    def inertia_matrix(self) -> FloatArray:
        """The inertia as a matrix [kg m^2], shape (3, 3)."""
        return _matrix(self.inertia)


def _matrix(inertia: Sequence[float]) -> FloatArray:
    ixx, ixy, ixz, iyy, iyz, izz = inertia
    return np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])


def _check_inertia(inertia: Sequence[float]) -> None:
    """Reject an inertia that no distribution of masses has."""
    small, middle, large = np.linalg.eigvalsh(_matrix(inertia)).tolist()
    if small < -_ROUNDED * large or small + middle < (1.0 - _ROUNDED) * large:
        raise CommandError(
            f'no body has the inertia {list(inertia)} (ixx, ixy, ixz, iyy, iyz, izz): its '
            f'principal moments would be {small:g}, {middle:g} and {large:g} kg m^2')
