# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Properties of motors and gears: friction, the torque that is left at speed, rotor inertia.

The values of the catalogue are in the file ``actuators.yaml`` beside a robot's MJCF, each with its
source. How friction and torque follow the velocity is computed by the simulation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.actuators import FrictionLaw
from manip_sim.models.descriptions import BeforeValidator, checked, model_validator, Strict
from manip_sim.models.user_files import read_yaml
from manip_sim.quoting import format_value

CATALOGUE = 'catalogue'
#: Beside the MJCF file of a robot.
FILE = 'actuators.yaml'


def _per_joint(value: Any) -> tuple[float, ...]:
    values: list[Any] = list(value) if isinstance(value, (list, tuple, np.ndarray)) else [value]
    if not values or any(isinstance(item, bool) or not isinstance(item, (int, float))
                         or not 0.0 <= item < math.inf for item in values):
        raise ValueError('must be a finite number from 0, or one for each joint')
    return tuple(float(item) for item in values)


PerJoint = Annotated[tuple[float, ...], BeforeValidator(_per_joint)]


class Friction(Strict):
    """
    Friction of joints; each a number, or one for each joint.

    :ivar coulomb: dry friction at speed [N m or N]
    :ivar viscous: in place of the damping of the model [N m s/rad or N s/m]
    :ivar static: dry friction at rest [N m or N]; needs :attr:`stribeck_velocity`
    :ivar stribeck_velocity: [rad/s or m/s]
    """

    coulomb: PerJoint
    viscous: PerJoint | None = None
    static: PerJoint | None = None
    stribeck_velocity: PerJoint | None = None

    @model_validator(mode='after')
    def _check(self) -> Friction:
        if (self.static is None) != (self.stribeck_velocity is None):
            raise ValueError("'static' and 'stribeck_velocity' belong together")
        if self.stribeck_velocity is not None and not all(self.stribeck_velocity):
            raise ValueError("'stribeck_velocity' must be above 0")
        return self


class TorqueSpeed(Strict):
    """
    Torque-speed curve of joints; each a number, or one for each joint.

    :ivar knee: velocity up to which all of the torque is there [rad/s or m/s]
    :ivar no_load: velocity at which none is left [rad/s or m/s]
    """

    knee: PerJoint
    no_load: PerJoint


class _OfSubsystem(Strict):
    friction: Friction | None = None
    torque_speed: TorqueSpeed | None = None
    #: Sources of the numbers, by their names.
    sources: dict[str, str]


class JointActuation:
    """
    The actuation of the joints of one subsystem.

    :param catalogue: values by subsystem, as :func:`read_catalogue` returns them
    :ivar friction: None for that of the model
    :ivar torque_speed: None for the same torque at any speed
    """

    def __init__(self, joints: Sequence[str], source: str,
                 catalogue: Mapping[str, Any] | None) -> None:
        self.joints = list(joints)
        self._source, self._catalogue = source, catalogue
        self.friction: Friction | None = None
        self.torque_speed: TorqueSpeed | None = None

    def set_friction(self, friction: str | Mapping[str, Any]) -> None:
        """
        Choose the friction.

        :param friction: ``catalogue``, or the keys of :class:`Friction`
        """
        values = self._chosen(friction, 'friction')
        self.friction = checked(Friction, values, f'friction of {self._source}')
        coulomb, static = (self.of_each(self.friction.coulomb, 'coulomb'),
                           self.of_each(self.friction.static, 'static'))
        for name in ('viscous', 'stribeck_velocity'):
            self.of_each(getattr(self.friction, name), name)
        if self.friction.static is not None and (static < coulomb).any():
            raise ModelError(f"friction of {self._source}: 'static' must be at least 'coulomb'")

    def set_torque_speed(self, curve: str | Mapping[str, Any]) -> None:
        """
        Choose the torque-speed curve.

        :param curve: ``catalogue``, or the keys of :class:`TorqueSpeed`
        """
        values = self._chosen(curve, 'torque_speed')
        self.torque_speed = checked(TorqueSpeed, values, f'torque_speed of {self._source}')
        knee, no_load = (self.of_each(value, name) for name, value in (
            ('knee', self.torque_speed.knee), ('no_load', self.torque_speed.no_load)))
        if (no_load <= knee).any():
            raise ModelError(f"torque_speed of {self._source}: 'no_load' must be above 'knee'")

    def _chosen(self, choice: str | Mapping[str, Any], kind: str) -> Mapping[str, Any]:
        if isinstance(choice, Mapping):
            return choice
        if not isinstance(choice, str):
            raise ModelError(f'{kind} of {self._source} must be a mapping, '
                             f'got {format_value(choice)}')
        if choice != CATALOGUE:
            raise UnknownNameError(f'{kind} of {self._source}', choice, ['none', CATALOGUE])
        values = None if self._catalogue is None else self._catalogue.get(kind)
        if values is None:
            raise ModelError(f'{kind} of {self._source}: the catalogue has none; give numbers')
        return dict(values)

    def of_each(self, values: tuple[float, ...] | None, name: str) -> FloatArray:
        """
        Return one number for each joint, zeros for None, shape (n,).

        :raises ModelError: if the number of values fits neither one nor all joints
        """
        count = len(self.joints)
        if values is None:
            return np.zeros(count)
        if len(values) not in (1, count):
            raise ModelError(f"{self._source}: '{name}' needs 1 or {count} numbers, "
                             f'got {len(values)}')
        return np.broadcast_to(np.array(values), count).copy()

    def attributes(self) -> list[tuple[str, FloatArray]]:
        """Return the attributes of joints in MJCF and their values, each of shape (n,)."""
        friction = self.friction
        if friction is None:
            return []
        attributes = [('frictionloss', self.of_each(friction.coulomb, 'coulomb'))]
        if friction.viscous is not None:
            attributes.append(('damping', self.of_each(friction.viscous, 'viscous')))
        return attributes

    def laws(self) -> list[FrictionLaw]:
        """Return what depends on the velocity, for each joint."""
        friction, curve, count = self.friction, self.torque_speed, len(self.joints)
        rows = [*np.zeros((2, count)), *np.full((3, count), math.inf)]
        if friction is not None and friction.static is not None:
            rows[0] = self.of_each(friction.coulomb, 'coulomb')
            rows[1] = self.of_each(friction.static, 'static')
            rows[2] = self.of_each(friction.stribeck_velocity, 'stribeck_velocity')
        if curve is not None:
            rows[3], rows[4] = (self.of_each(speed, '') for speed in (curve.knee, curve.no_load))
        return [FrictionLaw(*(float(value) for value in values)) for values in zip(*rows)]


def single(value: float | Sequence[float], source: str) -> tuple[float, ...]:
    """
    Return a number, or one for each joint, as a tuple.

    :raises ModelError: if it is neither, or a number is negative or not finite
    """
    try:
        return _per_joint(value)
    except ValueError as error:
        raise ModelError(f'armature of {source} {error}, got {format_value(value)}') from error


def read_catalogue(folder: Path, subsystem: str) -> dict[str, Any] | None:
    """Return the values that the catalogue has for a subsystem, or None."""
    file = folder / FILE
    if not file.is_file():
        return None
    values = read_yaml(file).get(subsystem)
    if values is None:
        return None
    actuation = checked(_OfSubsystem, values, f'{file}: {subsystem}')
    return actuation.model_dump(exclude_none=True)
