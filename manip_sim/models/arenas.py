# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Arenas: floor, light and furniture; the world of a simulation before a robot is in it."""

from __future__ import annotations

from collections.abc import Mapping
import inspect
from os import PathLike
from typing import Any, ClassVar

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.arena_parameters import ArenaParameter, check_arguments
from manip_sim.models.mjcf import MujocoXMLModel
from manip_sim.models.object_model import ObjectModel, SHAPE_GEOM
from manip_sim.models.registry import Registry
from manip_sim.models.robots.robot_model import RobotModel
from manip_sim.models.sources import check_no_parameters
from manip_sim.models.validation import finite_numbers
from manip_sim.resources import asset_path

CUBE_EDGE_M = 0.05
CUBE_MASS_KG = 0.1
#: Distance from the edges of a table to the middle of its legs [m].
_LEG_INSET_M = 0.1
#: Height of the bins' floors above the floor in their file [m].
_BIN_HEIGHT_M = 0.82
#: Height of the table that the cameras in the file look at [m].
_TABLE_HEIGHT_M = 0.8


class Arena(MujocoXMLModel):
    """
    What is around the robots; its names have no prefix.

    A subclass declares :attr:`arena_name`, its key in a robot's ``base_xpos_offset``, and
    :attr:`parameters`, those of its constructor. It is created by its name; one that inherits the
    name cannot be created by it.

    :param fname: path of an MJCF file; by default that in ``assets/arenas`` with the arena's name
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

    @property
    def objects(self) -> list[ObjectModel]:
        """The objects that belong to this arena, which worlds attach after the robots; a copy."""
        return list(self._objects)

    @property
    def naming_prefix(self) -> str:
        """Empty: the names of an arena have no prefix."""
        return ''

    def robot_position(self, robot: RobotModel) -> FloatArray:
        """
        Return the place of a robot in ``world`` [m], shape (3,).

        :param robot: the robot to place
        """
        placement = robot.base_xpos_offset.get(self.arena_name, (0.0, 0.0, 0.0))
        return finite_numbers(
            placement(self.table_length_m) if callable(placement) else placement, 3,
            f"base_xpos_offset['{self.arena_name}'] of {robot.name}")

    @property
    def table_length_m(self) -> float:
        """Edge of the table along x [m], zero if there is none."""
        return 0.0

    def _lift_cameras(self, higher_m: float) -> None:
        """Raise the cameras by as much as the furniture is higher than in the file."""
        for camera in self.spec.cameras:
            camera.pos[2] += higher_m

    def compose(self) -> mujoco.MjSpec:
        """Return a new spec of the arena with its objects."""
        spec = self._spec.copy()
        for item in self._objects:
            item.attach(spec)
        return spec


ARENAS: Registry[Arena] = Registry(
    'arena', Arena, takes=(), key=lambda cls: cls.__dict__.get('arena_name'))


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
        ArenaParameter('table_length', 0.8, 'edge of the table along x', 'm', 0.3, 5.0,
                       'table_length_m'),
        ArenaParameter('table_width', 0.8, 'edge of the table along y', 'm', 0.3, 5.0,
                       'table_width_m'),
        ArenaParameter('table_height', 0.8, 'height of the top surface above the floor', 'm',
                       0.1, 2.0, 'table_height_m'),
        ArenaParameter('friction', 1.0, 'sliding friction of the top', '', 0.0, 10.0),
        ArenaParameter('cube', False, 'put a free cube of 0.05 m and 0.1 kg on the table'))

    def __init__(self, table_length_m: float = 0.8, table_height_m: float = 0.8,
                 cube: bool = False, *, table_width_m: float = 0.8, friction: float = 1.0) -> None:
        check_arguments(self.parameters, self.arena_name, table_length_m=table_length_m,
                        table_height_m=table_height_m, cube=cube, table_width_m=table_width_m,
                        friction=friction)
        super().__init__(asset_path('arenas', 'table'))
        self._length_m = table_length_m
        self._fit_table(np.array([table_length_m, table_width_m]), table_height_m)
        self._lift_cameras(table_height_m - _TABLE_HEIGHT_M)
        self.spec.geom('table_collision').friction[0] = friction
        if cube:
            self._objects.append(_cube(table_height_m))
        self.refresh()

    def _fit_table(self, edges_m: FloatArray, height_m: float) -> None:
        spec = self.spec
        thickness = 2.0 * spec.geom('table_collision').size[2]
        spec.body('table').pos[2] = height_m - thickness / 2.0
        spec.geom('table_collision').size[:2] = edges_m / 2.0
        half_leg = (height_m - thickness) / 2.0
        for leg in (geom for geom in spec.geoms if geom.name.startswith('table_leg')):
            leg.pos[:2] = np.sign(leg.pos[:2]) * (edges_m / 2.0 - _LEG_INSET_M)
            leg.pos[2] = -thickness / 2.0 - half_leg
            leg.size[1] = half_leg

    @property
    def table_length_m(self) -> float:
        """Edge of the table along x [m]."""
        return self._length_m


def _cube(table_height_m: float) -> ObjectModel:
    spec, half = mujoco.MjSpec(), CUBE_EDGE_M / 2.0
    body = spec.worldbody.add_body(name='body', pos=[0.0, 0.0, table_height_m + half])
    body.add_geom(name=SHAPE_GEOM, type=mujoco.mjtGeom.mjGEOM_BOX, size=[half] * 3,
                  mass=CUBE_MASS_KG, rgba=[0.8, 0.2, 0.15, 1.0], friction=[1.0, 0.005, 0.0001])
    return ObjectModel('cube', spec)


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
        for bin_ in (self.spec.body('bin1'), self.spec.body('bin2')):
            bin_.pos[2] += higher
            for geom in bin_.geoms:
                if geom.name.endswith('_visual'):
                    geom.pos[2] -= higher / 2.0
                    geom.size[1] += higher / 2.0
                else:
                    geom.friction[0] = friction
        self._record()


def arena_names() -> list[str]:
    """Return the names that :func:`create_arena` takes, also those in the user's folders."""
    return ARENAS.all_names()


def create_arena(name: str | PathLike[str], **parameters: Any) -> Arena:
    """
    Create an arena by its name, such as ``table``, or from a file.

    :param name: of the catalogue, or what ``manip_sim.models.sources.find_source`` takes
    :param parameters: as in the arena's :attr:`Arena.parameters`, by name or by the keyword of its
        constructor
    :raises UnknownNameError: if there is no such arena or parameter, naming the nearest ones
    :raises ModelError: if a value is not within the limits of its parameter, a file cannot be
        used, or the arena of another package cannot be imported
    """
    file = ARENAS.find_file(name)
    if file is None:
        return ARENAS.create(str(name), **_arguments(str(name), parameters))
    check_no_parameters(name, parameters)
    from manip_sim.models.files import load_arena
    return load_arena(file)


def _arguments(name: str, parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parameters of an arena of the catalogue as keywords of its constructor."""
    kind = ARENAS.get(name)
    argument_of = {parameter.name: parameter.argument for parameter in kind.parameters}
    keywords = {name: keyword for name, keyword in inspect.signature(kind).parameters.items()
                if name != 'fname'}
    takes_any = any(keyword.kind is keyword.VAR_KEYWORD for keyword in keywords.values())
    arguments: dict[str, Any] = {}
    for given, value in parameters.items():
        argument = argument_of.get(given, given)
        if argument not in keywords and not takes_any:
            raise UnknownNameError(f'parameter of the arena {name}', given,
                                   argument_of or keywords)
        if argument in arguments:
            raise ModelError(f"parameter '{given}' of the arena {name} is given twice")
        arguments[argument] = value
    return arguments


def arena_parameters(name: str | PathLike[str]) -> tuple[ArenaParameter, ...]:
    """
    Return the parameters of an arena; one from a file has none.

    :param name: of the catalogue, or a file
    :raises UnknownNameError: if there is no such arena, naming the nearest ones
    """
    if ARENAS.find_file(name) is not None:
        return ()
    return ARENAS.get(str(name)).parameters
