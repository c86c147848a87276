# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Arenas: floor, light and furniture; the world of a simulation before a robot is in it.

The catalogue has a floor, a table, a cabinet with a drawer, a belt, and bins. Every module here is
imported, which registers its arenas.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
import inspect
import math
from os import PathLike
from typing import Any, ClassVar, Union

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.mjcf import MujocoXMLModel
from manip_sim.models.object_model import FixtureModel, ObjectModel, SHAPE_GEOM
from manip_sim.models.randomization import Placement
from manip_sim.models.registry import check_no_parameters, import_submodules, Registry
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
            fits = isinstance(value, (bool, np.bool_))
        else:
            numbers = (int, float, np.integer, np.floating)
            fits = (not isinstance(value, bool) and isinstance(value, numbers)
                    and bool(self.low <= value <= self.high))
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
Arena.registry = ARENAS


_CUBE_EDGE_M = 0.05
_CUBE_MASS_KG = 0.1
#: Distance from the edges of a table to the middle of its legs [m].
_LEG_INSET_M = 0.1
#: Edge of a table along x unless another is given [m].
_TABLE_LENGTH_M = 0.8
#: Height of the table that the cameras in the file look at [m].
_TABLE_HEIGHT_M = 0.8
#: Speed of the belt at the start unless another is given [m/s].
_BELT_SPEED_M_S = 0.1
#: Height of the bins' floors above the floor in their file [m].
_BIN_HEIGHT_M = 0.82


class EmptyArena(Arena):
    """A floor without furniture."""

    arena_name = 'empty'


class TableArena(Arena):
    """
    A table in front of the robot, with its middle at the origin.

    :param table_length_m: edge along x [m]
    :param table_height_m: height of the top surface above the floor [m]
    :param cube: put a free cube of 0.05 m and 0.1 kg, ``cube``, on the middle of the table
    :param table_width_m: edge along y [m]
    :param friction: sliding friction of the top
    :raises ModelError: naming parameter and limits
    """

    arena_name = 'table'
    parameters = (
        ArenaParameter('table_length', _TABLE_LENGTH_M, 'edge of the table along x', 'm', 0.3, 5.0,
                       'table_length_m'),
        ArenaParameter('table_width', 0.8, 'edge of the table along y', 'm', 0.3, 5.0,
                       'table_width_m'),
        ArenaParameter('table_height', 0.8, 'height of the top surface above the floor', 'm',
                       0.1, 2.0, 'table_height_m'),
        ArenaParameter('friction', 1.0, 'sliding friction of the top', '', 0.0, 10.0),
        ArenaParameter('cube', True, 'put a free cube of 0.05 m and 0.1 kg on the table'))

    def __init__(self, table_length_m: float = _TABLE_LENGTH_M, table_height_m: float = 0.8,
                 cube: bool = True, *, table_width_m: float = 0.8, friction: float = 1.0) -> None:
        check_arguments(self.parameters, self.arena_name, table_length_m=table_length_m,
                        table_height_m=table_height_m, cube=cube, table_width_m=table_width_m,
                        friction=friction)
        super().__init__(asset_path('arenas', 'table'))
        self._length_m = table_length_m
        spec, edges_m = self._spec, np.array([table_length_m, table_width_m])
        thickness = 2.0 * spec.geom('table_collision').size[2]
        spec.body('table').pos[2] = table_height_m - thickness / 2.0
        spec.geom('table_collision').size[:2] = edges_m / 2.0
        half_leg = (table_height_m - thickness) / 2.0
        for leg in (geom for geom in spec.geoms if geom.name.startswith('table_leg')):
            leg.pos[:2] = np.sign(leg.pos[:2]) * (edges_m / 2.0 - _LEG_INSET_M)
            leg.pos[2] = -thickness / 2.0 - half_leg
            leg.size[1] = half_leg
        self._lift_cameras(table_height_m - _TABLE_HEIGHT_M)
        spec.geom('table_collision').friction[0] = friction
        if cube:
            self._objects.append(_cube(table_height_m))
        self.refresh()

    @property
    def table_length_m(self) -> float:
        """Edge of the table along x [m]."""
        return self._length_m


def _cube(table_height_m: float) -> ObjectModel:
    spec, half = mujoco.MjSpec(), _CUBE_EDGE_M / 2.0
    body = spec.worldbody.add_body(name='body', pos=[0.0, 0.0, table_height_m + half])
    body.add_geom(name=SHAPE_GEOM, type=mujoco.mjtGeom.mjGEOM_BOX, size=[half] * 3,
                  mass=_CUBE_MASS_KG, rgba=[0.8, 0.2, 0.15, 1.0], friction=[1.0, 0.005, 0.0001])
    return ObjectModel('cube', spec)


class _LikeTable(Arena, registered=False):
    """Furniture that is where the table would be."""

    def robot_position(self, robot: RobotModel) -> FloatArray:
        """Return the place of a robot in ``world`` [m], shape (3,), by default as at a table."""
        if robot.placement_in(self.arena_name) is not None:
            return super().robot_position(robot)
        return position_at(robot, TableArena.arena_name, _TABLE_LENGTH_M)


class DrawerArena(_LikeTable):
    """A table in front of the robot, and a cabinet with a drawer on it, ``drawer_slide``."""

    arena_name = 'drawer'


class ConveyorArena(_LikeTable):
    """
    A belt that runs past the robot from its left to its right, and a shelf between both.

    The joint ``belt`` is commanded by the velocity of the belt, and its position is the way of
    the belt.

    :param belt_speed_m_s: at the start, negative from right to left [m/s]
    :param friction: sliding friction of the belt
    :raises ModelError: naming parameter and limits
    """

    arena_name = 'conveyor'
    parameters = (
        ArenaParameter('belt_speed', _BELT_SPEED_M_S, 'speed of the belt at the start', 'm/s',
                       -1.0, 1.0, 'belt_speed_m_s'),
        ArenaParameter('friction', 1.0, 'sliding friction of the belt', '', 0.0, 10.0))

    def __init__(self, belt_speed_m_s: float = _BELT_SPEED_M_S, *, friction: float = 1.0) -> None:
        check_arguments(self.parameters, self.arena_name, belt_speed_m_s=belt_speed_m_s,
                        friction=friction)
        super().__init__()
        self._spec.actuator('belt').userdata = [belt_speed_m_s]
        self._spec.geom('belt').friction[0] = friction
        self.refresh()


class BinsArena(Arena):
    """
    An open bin, ``bin1``, and one with four compartments, ``bin2``, side by side.

    :param bin_height_m: height of the bins' floors above the floor [m]
    :param friction: sliding friction of floors and walls
    :raises ModelError: naming parameter and limits
    """

    arena_name = 'bins'
    parameters = (
        ArenaParameter('bin_height', _BIN_HEIGHT_M, "height of the bins' floors above the floor",
                       'm', 0.1, 2.0, 'bin_height_m'),
        ArenaParameter('friction', 1.0, 'sliding friction of floors and walls', '', 0.0, 10.0))

    def __init__(self, bin_height_m: float = _BIN_HEIGHT_M, *, friction: float = 1.0) -> None:
        check_arguments(self.parameters, self.arena_name, bin_height_m=bin_height_m,
                        friction=friction)
        super().__init__()
        higher = bin_height_m - _BIN_HEIGHT_M
        self._lift_cameras(higher)
        for bin_ in (self._spec.body('bin1'), self._spec.body('bin2')):
            bin_.pos[2] += higher
            for geom in bin_.geoms:
                if geom.name.endswith('_visual'):
                    geom.pos[2] -= higher / 2.0
                    geom.size[1] += higher / 2.0
                else:
                    geom.friction[0] = friction
        self._record()


import_submodules(__name__, __path__)


def arena_names() -> list[str]:
    """Return the names that :func:`create_arena` takes, also those in the user's folders."""
    return ARENAS.all_names()


def create_arena(name: str | PathLike[str], **parameters: Any) -> Arena:
    """
    Create an arena by its name, such as ``table``, or from a file.

    :param name: of the catalogue, or what ``manip_sim.models.registry.find_source`` takes
    :param parameters: as in the arena's :attr:`Arena.parameters`, by name or by the keyword of its
        constructor
    :raises UnknownNameError: if the arena or parameter is unknown, naming the nearest ones
    :raises ModelError: if a value is not within the limits of its parameter, a file cannot be
        used, or the arena of another package cannot be imported
    """
    file = ARENAS.find_file(name)
    if file is None:
        return ARENAS.create(str(name), **_arguments(str(name), parameters))
    check_no_parameters(name, parameters)
    return ARENAS.load_file(file)


def _arguments(name: str, parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parameters of an arena of the catalogue as keywords of its constructor."""
    kind = ARENAS.get(name)
    argument_of = {parameter.name: parameter.argument for parameter in kind.parameters}
    keywords = {name: keyword for name, keyword in inspect.signature(kind).parameters.items()
                if name != 'fname'}
    takes_any = any(keyword.kind is keyword.VAR_KEYWORD for keyword in keywords.values())
    arguments: dict[str, Any] = {}
    for key, value in parameters.items():
        argument = argument_of.get(key, key)
        if argument not in keywords and not takes_any:
            raise UnknownNameError(f'parameter of the arena {name}', key,
                                   argument_of or keywords)
        if argument in arguments:
            raise ModelError(f"parameter '{key}' of the arena {name} is given twice")
        arguments[argument] = value
    return arguments


def arena_parameters(name: str | PathLike[str]) -> tuple[ArenaParameter, ...]:
    """
    Return the parameters of an arena; one from a file has none.

    :param name: of the catalogue, or a file
    :raises UnknownNameError: if the arena is unknown, naming the nearest ones
    """
    if ARENAS.find_file(name) is not None:
        return ()
    return ARENAS.get(str(name)).parameters


__all__ = [
    'Arena', 'ArenaParameter', 'BinsArena', 'EmptyArena', 'TableArena', 'arena_names',
    'arena_parameters', 'create_arena']
