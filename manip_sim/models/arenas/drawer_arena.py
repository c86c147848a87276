# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A table with a cabinet whose drawer opens."""

from __future__ import annotations

from manip_sim.arrays import FloatArray
from manip_sim.models.arenas.arena import Arena
from manip_sim.models.arenas.table_arena import TableArena
from manip_sim.models.robots.robot_model import RobotModel


class DrawerArena(Arena):
    """A table in front of the robot, and a cabinet with a drawer on it, ``drawer_slide``."""

    arena_name = 'drawer'

    def robot_position(self, robot: RobotModel) -> FloatArray:
        """
        Return the place of a robot in ``world``, as beside a table [m], shape (3,).

        :param robot: the robot to place
        """
        return TableArena(cube=False).robot_position(robot)
