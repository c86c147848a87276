# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A table, and the cube on it."""

from __future__ import annotations

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.models.arena_parameters import ArenaParameter, check_arguments
from manip_sim.models.arenas.arena import Arena
from manip_sim.models.object_model import ObjectModel, SHAPE_GEOM
from manip_sim.resources import asset_path

_CUBE_EDGE_M = 0.05
_CUBE_MASS_KG = 0.1
#: Distance from the edges of a table to the middle of its legs [m].
_LEG_INSET_M = 0.1
#: Height of the table that the cameras in the file look at [m].
_TABLE_HEIGHT_M = 0.8


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
        ArenaParameter('cube', True, 'put a free cube of 0.05 m and 0.1 kg on the table'))

    def __init__(self, table_length_m: float = 0.8, table_height_m: float = 0.8,
                 cube: bool = True, *, table_width_m: float = 0.8, friction: float = 1.0) -> None:
        check_arguments(self.parameters, self.arena_name, table_length_m=table_length_m,
                        table_height_m=table_height_m, cube=cube, table_width_m=table_width_m,
                        friction=friction)
        super().__init__(asset_path('arenas', 'table'))
        self._length_m = table_length_m
        self._fit_table(np.array([table_length_m, table_width_m]), table_height_m)
        self._lift_cameras(table_height_m - _TABLE_HEIGHT_M)
        self._spec.geom('table_collision').friction[0] = friction
        if cube:
            self._objects.append(_cube(table_height_m))
        self.refresh()

    def _fit_table(self, edges_m: FloatArray, height_m: float) -> None:
        spec = self._spec
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
    spec, half = mujoco.MjSpec(), _CUBE_EDGE_M / 2.0
    body = spec.worldbody.add_body(name='body', pos=[0.0, 0.0, table_height_m + half])
    body.add_geom(name=SHAPE_GEOM, type=mujoco.mjtGeom.mjGEOM_BOX, size=[half] * 3,
                  mass=_CUBE_MASS_KG, rgba=[0.8, 0.2, 0.15, 1.0], friction=[1.0, 0.005, 0.0001])
    return ObjectModel('cube', spec)
