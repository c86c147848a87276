# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Arenas: floor, light and furniture; the world of a simulation before a robot is in it."""

from __future__ import annotations

from os import PathLike
from typing import Any, ClassVar

import mujoco
import numpy as np

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.mjcf import MujocoXMLModel
from manip_sim.models.registry import Registry
from manip_sim.models.robots.robot_model import RobotModel
from manip_sim.models.sources import check_no_parameters, find_source, names_in_folders
from manip_sim.resources import asset_path
from manip_sim.typing import FloatArray

CUBE_EDGE_M = 0.05
CUBE_MASS_KG = 0.1


class Arena(MujocoXMLModel):
    """
    A world without robots; its names have no prefix.

    A subclass gives :attr:`arena_name`: the folder of its file and its key in a robot's
    ``base_xpos_offset``.
    """

    arena_name: ClassVar[str]

    def __init_subclass__(cls, registered: bool = True, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if registered:
            ARENAS.register(cls)

    def __init__(self) -> None:
        super().__init__(asset_path('arenas', self.arena_name))

    @property
    def naming_prefix(self) -> str:
        """Nothing."""
        return ''

    def robot_position(self, robot: RobotModel) -> FloatArray:
        """Return where the robot stands in this arena [m], shape (3,)."""
        placement = robot.base_xpos_offset.get(self.arena_name, (0.0, 0.0, 0.0))
        return np.array(placement(self.table_length_m) if callable(placement) else placement)

    @property
    def table_length_m(self) -> float:
        """Edge of the table along x [m], zero where there is none."""
        return 0.0

    def compose(self) -> Any:
        """Return a new ``mujoco.MjSpec`` of the arena alone."""
        return self._spec.copy()


ARENAS: Registry[Arena] = Registry('arena')


class EmptyArena(Arena):
    """A floor."""

    arena_name = 'empty'


class TableArena(Arena):
    """
    A table in front of the robot.

    :param table_length_m: edge along x [m]
    :param table_height_m: of the top surface above the floor [m]
    :param cube: put a free cube of 0.05 m and 0.1 kg, ``cube``, on the middle of the table
    :raises ModelError: if the table has no size
    """

    arena_name = 'table'

    def __init__(self, table_length_m: float = 0.8, table_height_m: float = 0.8,
                 cube: bool = False) -> None:
        super().__init__()
        thickness = 2.0 * self.spec.geom('table_collision').size[2]
        if not (table_length_m > 0.0 and table_height_m > thickness):
            raise ModelError(f'a table needs a length above 0 and a height above {thickness:g} m, '
                             f'got {table_length_m:g} m and {table_height_m:g} m')
        self._length_m = table_length_m
        self._fit_table(table_length_m, table_height_m, thickness)
        if cube:
            self._add_cube(table_height_m)
        self._record()

    def _fit_table(self, length_m: float, height_m: float, thickness: float) -> None:
        spec = self.spec
        spec.body('table').pos[2] = height_m - thickness / 2.0
        spec.geom('table_collision').size[0] = length_m / 2.0
        half_leg = (height_m - thickness) / 2.0
        for leg in (geom for geom in spec.geoms if geom.name.startswith('table_leg')):
            leg.pos[0] = np.sign(leg.pos[0]) * (length_m / 2.0 - 0.1)
            leg.pos[2] = -thickness / 2.0 - half_leg
            leg.size[1] = half_leg

    def _add_cube(self, table_height_m: float) -> None:
        half = CUBE_EDGE_M / 2.0
        cube = self.spec.worldbody.add_body(name='cube', pos=[0.0, 0.0, table_height_m + half])
        cube.add_freejoint(name='cube_joint')
        cube.add_geom(name='cube', type=mujoco.mjtGeom.mjGEOM_BOX, size=[half] * 3,
                      mass=CUBE_MASS_KG, rgba=[0.8, 0.2, 0.15, 1.0], friction=[1.0, 0.005, 0.0001])

    @property
    def table_length_m(self) -> float:
        """Edge of the table along x [m]."""
        return self._length_m


class BinsArena(Arena):
    """An open bin, ``bin1``, and one with four compartments, ``bin2``, side by side."""

    arena_name = 'bins'


def arena_names() -> list[str]:
    """Return the names that :func:`create_arena` takes, those of the user's folders too."""
    return sorted({*_by_name(), *names_in_folders('arenas')})


def _by_name() -> dict[str, type[Arena]]:
    return {ARENAS.get(name).arena_name: ARENAS.get(name) for name in ARENAS.names()}


def create_arena(name: str | PathLike[str], **parameters: Any) -> Arena:
    """
    Create an arena by its name, such as ``table``, or from a file.

    :param name: of the catalogue, or what ``manip_sim.models.sources.find_source`` takes
    :param parameters: of an arena of the package, such as ``table_height_m``
    :raises UnknownNameError: naming the nearest ones
    :raises ModelError: if a file cannot be used
    """
    classes = _by_name()
    if isinstance(name, str) and name in classes:
        return classes[name](**parameters)
    source = find_source(name, 'arenas')
    if source is None:
        raise UnknownNameError('arena', name, arena_names())
    check_no_parameters(name, parameters)
    from manip_sim.models.files import load_arena
    return load_arena(source)
