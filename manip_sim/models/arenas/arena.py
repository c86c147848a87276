# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Common parts of all arenas: parameters, objects of their own, and the places of robots."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
import math
import numbers
from os import PathLike
from typing import Any, ClassVar, Union

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.errors import ModelError
from manip_sim.models.mjcf import MujocoXMLModel
from manip_sim.models.object_model import FixtureModel, ObjectModel
from manip_sim.models.placements import Placement
from manip_sim.models.registry import Registry
from manip_sim.models.robots.robot_model import RobotModel
from manip_sim.models.spec_edits import begin_like, TakenNames
from manip_sim.quoting import format_value
from manip_sim.resources import asset_path
from manip_sim.validation import finite_numbers

Value = Union[bool, float]


@dataclass(frozen=True)
class ArenaParameter:
    """
    A number or a flag that an arena can be created with.

    :ivar name: such as ``table_length``
    :ivar default: of the type of the parameter, bool or float
    :ivar description: a phrase, without a full stop
    :ivar unit: such as ``m``, empty if there is none
    :ivar low: the least value of a number
    :ivar high: the greatest value of a number
    :ivar keyword: of the arena's constructor, if it is not the name
    """

    name: str
    default: Value
    description: str
    unit: str = ''
    low: float = -math.inf
    high: float = math.inf
    keyword: str = ''

    @property
    def argument(self) -> str:
        """The keyword of the arena's constructor."""
        return self.keyword or self.name

    @property
    def limits(self) -> str:
        """The values that can be given, such as ``0.3 to 5 m``."""
        if isinstance(self.default, bool):
            return 'true or false'
        return f'{self.low:g} to {self.high:g} {self.unit}'.rstrip()

    def check(self, value: Any, arena: str) -> None:
        """
        Reject a value of the wrong type or outside the limits.

        :param value: of the parameter
        :param arena: its name, for the message
        :raises ModelError: naming the limits
        """
        if isinstance(self.default, bool):
            fits = isinstance(value, bool)
        else:
            fits = (not isinstance(value, bool) and isinstance(value, numbers.Real)
                    and self.low <= float(value) <= self.high)
        if not fits:
            raise ModelError(f"parameter '{self.name}' of the arena {arena} must be "
                             f'{self.limits}, got {format_value(value)}')


def check_arguments(parameters: Iterable[ArenaParameter], arena: str, **arguments: Any) -> None:
    """Check arguments of an arena's constructor."""
    for parameter in parameters:
        if parameter.argument in arguments:
            parameter.check(arguments[parameter.argument], arena)


def position_at(robot: RobotModel, arena: str, table_length_m: float) -> FloatArray:
    """
    Return the place that a robot declares for an arena, in ``world`` [m], else zero, shape (3,).

    :param arena: its name
    :param table_length_m: edge of its table along x [m]
    """
    placement = robot.placement_in(arena)
    if placement is None:
        return np.zeros(3)
    return finite_numbers(placement(table_length_m) if callable(placement) else placement, 3,
                          f"base_xpos_offset['{arena}'] of {robot.name}")


class Arena(MujocoXMLModel):
    """
    The environment of the robots; its names have no prefix.

    A subclass declares :attr:`arena_name`, its key in a robot's ``base_xpos_offset``, and
    :attr:`parameters`, the arguments of its constructor. It is created by its name; one that
    inherits the name cannot be created by it.

    :param fname: path of an MJCF file; by default that in ``assets/arenas`` with the arena's name
    :ivar placements: areas where objects are placed at each reset with a seed
    """

    arena_name: ClassVar[str]
    parameters: ClassVar[tuple[ArenaParameter, ...]] = ()

    def __init_subclass__(cls, registered: bool = True, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if registered:
            ARENAS.register(cls)

    def __init__(self, fname: str | PathLike[str] | None = None) -> None:
        super().__init__(fname or asset_path('arenas', self.arena_name))
        self._objects: list[ObjectModel] = []
        self.placements: list[Placement] = []

    @property
    def objects(self) -> list[ObjectModel]:
        """The objects that belong to this arena, which worlds attach after the robots; a copy."""
        return list(self._objects)

    def add_fixture(self, fixture: FixtureModel) -> None:
        """
        Weld furniture to the arena, which its joints, actuators and cameras belong to from now on.

        :param fixture: with names of its own
        :raises ModelError: if the arena has one of its names already
        """
        fixture.attach(self._spec, TakenNames(self._spec))
        self.refresh()

    def add_object(self, item: ObjectModel) -> None:
        """
        Add an object, which worlds with this arena have after the robots.

        :param item: with a name of its own
        """
        self._objects.append(item)

    @property
    def naming_prefix(self) -> str:
        """Empty: the names of an arena have no prefix."""
        return ''

    def robot_position(self, robot: RobotModel) -> FloatArray:
        """
        Return the place of a robot in ``world`` [m], shape (3,).

        :param robot: the robot to place
        """
        return position_at(robot, self.arena_name, self.table_length_m)

    @property
    def table_length_m(self) -> float:
        """Edge of the table along x [m], zero if there is none."""
        return 0.0

    def _lift_cameras(self, higher_m: float) -> None:
        """Raise the cameras by as much as the furniture is higher than in the file."""
        for camera in self._spec.cameras:
            camera.pos[2] += higher_m

    def shift_camera(self, name: str, by: ArrayLike) -> None:
        """
        Move one of the cameras of the arena without turning it; nothing if there is none.

        :param name: of the camera
        :param by: in ``world`` [m], shape (3,)
        """
        camera = self._spec.camera(name)
        if camera is not None:
            camera.pos = np.add(camera.pos, by)
            self.refresh()

    def aim_camera(self, name: str, position: ArrayLike, look_at: ArrayLike) -> None:
        """
        Move one of the cameras of the arena, and let it look at a point, upright.

        :param name: of the camera
        :param position: in ``world`` [m], shape (3,)
        :param look_at: in ``world`` [m], shape (3,); not straight above or below
        """
        camera = self._spec.camera(name)
        back = np.subtract(position, look_at)
        right = np.cross([0.0, 0.0, 1.0], back)
        camera.pos = position
        camera.alt.type = mujoco.mjtOrientation.mjORIENTATION_XYAXES
        camera.alt.xyaxes = [*right, *np.cross(back, right)]
        self.refresh()

    def empty_spec(self) -> mujoco.MjSpec:
        """Return a new spec with the options and visual settings of the arena and nothing else."""
        return begin_like(self._spec)

    def compose(self) -> mujoco.MjSpec:
        """Return a new spec of the arena with its objects."""
        spec = self._spec.copy()
        for item in self._objects:
            item.attach(spec)
        return spec


ARENAS: Registry[Arena] = Registry(
    'arena', Arena, takes=(), key=lambda cls: cls.__dict__.get('arena_name'))
