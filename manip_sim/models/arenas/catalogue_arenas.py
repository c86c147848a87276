# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The arenas of the catalogue: a floor, a table, a cabinet with a drawer, a belt, and bins."""

from __future__ import annotations

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.models.arenas.arena import Arena, ArenaParameter, check_arguments, position_at
from manip_sim.models.object_model import ObjectModel, SHAPE_GEOM
from manip_sim.models.robots.robot_model import RobotModel
from manip_sim.resources import asset_path

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
