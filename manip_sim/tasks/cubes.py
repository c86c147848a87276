# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tasks with cubes on a table."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
import math

import numpy as np

from manip_sim.algebra import length
from manip_sim.models.objects import Description
from manip_sim.simulation import Simulation
from manip_sim.tasks.expert import Expert, pointing_down, sides
from manip_sim.tasks.grasping import held_only_by
from manip_sim.tasks.placing import (
    draw, draw_yaw, nearness, place, position_of, rotation_of)
from manip_sim.tasks.task import Task

CUBE_M = 0.04
#: The cube is on an area of these half extents [m].
_HALF_AREA = np.array([0.08, 0.12])
#: It is picked up if it is higher than at the start by this [m].
_LIFT_M = 0.1


class PickCube(Task):
    """Hold a cube 0.1 m above the table, with nothing but one gripper touching it."""

    name = 'pick_cube'
    instruction = 'Pick up the red cube.'
    horizon_s = 6.0

    def objects(self) -> Iterable[Description]:
        """Return the cube."""
        return [cube('cube', (0.8, 0.15, 0.1))]

    def start(self, simulation: Simulation, random: np.random.Generator) -> None:
        """Draw where the cube is and how it is turned."""
        middle = self.work_area
        xy = draw(random, middle[:2] - _HALF_AREA, middle[:2] + _HALF_AREA)
        place(simulation, 'cube', np.array([*xy, middle[2] + CUBE_M / 2.0]),
              draw_yaw(random, math.pi / 4.0))

    def _lifted(self, simulation: Simulation) -> float:
        return float(position_of(simulation, 'cube')[2] - self.work_area[2] - CUBE_M / 2.0)

    def success(self, simulation: Simulation) -> bool:
        """Return whether the cube is in the air, held by the arm alone."""
        return self._lifted(simulation) > _LIFT_M and held_only_by(simulation, 'cube', self.arm)

    def progress(self, simulation: Simulation) -> float:
        """Return a half for being at the cube, and a half for lifting it."""
        hand = simulation.robot.end_effectors[self.arm].pose(simulation.data)[:3]
        near = nearness(length(hand - position_of(simulation, 'cube')))
        lifted = min(max(self._lifted(simulation) / _LIFT_M, 0.0), 1.0)
        return 0.5 * near + 0.5 * lifted

    def expert(self, simulation: Simulation) -> Expert:
        """Return an expert that grasps the cube from above."""
        return _Picker(simulation)


class _Picker(Expert):
    """Grasps the cube from above and lifts it."""

    def script(self) -> Iterator[None]:
        arm = self.arms[0]
        cube = position_of(self.simulation, 'cube')
        down = pointing_down(sides(rotation_of(self.simulation, 'cube')), arm.rotation)
        yield from self.move(arm, cube + [0.0, 0.0, 0.08], down, within_m=0.02)
        yield from self.move(arm, cube)
        yield from self.grip(arm, 1.0)
        yield from self.move(arm, cube + [0.0, 0.0, _LIFT_M + 0.03])


def cube(name: str, rgb: Iterable[float], edge_m: float = CUBE_M) -> Description:
    """
    Return the description of a light cube.

    :param rgb: its colour
    :param edge_m: [m]
    """
    return {'name': name, 'shape': 'box', 'size': [edge_m] * 3, 'mass': 0.1, 'rgba': [*rgb, 1.0],
            'condim': 4, 'friction': [1.0, 0.005, 0.0001]}
