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
        :raises CommandError: if they are not finite, the mass is negative, or no body has such an
            inertia
        :raises UnknownNameError: if the number is unknown
        """
        names = [field.name for field in fields(self)]
        if name not in names:
            raise UnknownNameError('number of a payload', name, names)
        if name == 'mass':
            return replace(self, mass=positive_number(
                value, 'the mass of a payload', CommandError, or_zero=True))
        count = len(getattr(self, name))
        numbers = tuple(finite_command_numbers(value, count, f'the {name} of a payload').tolist())
        if name == 'center_of_mass':
            return replace(self, center_of_mass=numbers)
        _check_inertia(numbers)
        return replace(self, inertia=numbers)

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
