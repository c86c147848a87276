# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The task to bring the end effector to a point."""

from __future__ import annotations

from collections.abc import Iterator
from types import MappingProxyType

import numpy as np

from manip_sim.algebra import length
from manip_sim.arrays import FloatArray
from manip_sim.models.arenas import Arena
from manip_sim.simulation import Simulation
from manip_sim.tasks.expert import Expert
from manip_sim.tasks.placing import add_goal, draw, move_mocap, nearness, position_of
from manip_sim.tasks.task import Task, TOO_SHORT

#: An end effector nearer than this is there [m].
NEAR_M = 0.02
#: The points are in a box of these half extents, whose middle is this high above the table [m].
_HALF_BOX, _HEIGHT_M = np.array([0.12, 0.15, 0.1]), 0.2


class Reach(Task):
    """Bring ``grip_site`` within 2 cm of a point above the table."""

    name = 'reach'
    instruction = 'Move the end effector to the green point.'
    horizon_s = 3.0
    unable = TOO_SHORT
    expert_fails = MappingProxyType({'Tiago': '2 of 4'})
    needs_fingers = False

    def arena(self) -> Arena:
        """Return the table with the point."""
        arena = super().arena()
        add_goal(arena, 'goal', NEAR_M)
        return arena

    def start(self, simulation: Simulation, random: np.random.Generator) -> None:
        """Draw the point."""
        middle = self.work_area + [0.0, 0.0, _HEIGHT_M]
        move_mocap(simulation, 'goal', draw(random, middle - _HALF_BOX, middle + _HALF_BOX))

    def _distance(self, simulation: Simulation) -> float:
        return length(self._end_effector(simulation) - position_of(simulation, 'goal'))

    def success(self, simulation: Simulation) -> bool:
        """Return whether the end effector is at the point."""
        return self._distance(simulation) < NEAR_M

    def progress(self, simulation: Simulation) -> float:
        """Return how near the end effector is."""
        return nearness(self._distance(simulation))

    def goal(self, simulation: Simulation) -> FloatArray:
        """Return the point in ``world`` [m], shape (3,)."""
        return position_of(simulation, 'goal')

    def expert(self, simulation: Simulation) -> Expert:
        """Return an expert that moves straight to the point."""
        return _Reacher(simulation)


class _Reacher(Expert):
    """Moves the end effector to the point."""

    def script(self) -> Iterator[None]:
        yield from self.move(self.arms[0], position_of(self.simulation, 'goal'))
