# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The task to open a drawer."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from manip_sim.algebra import length
from manip_sim.arrays import FloatArray
from manip_sim.models.arenas import Arena, create_arena
from manip_sim.simulation import Simulation
from manip_sim.tasks.expert import Expert, fingers_side_by_side, pointing_down
from manip_sim.tasks.placing import draw, draw_yaw, move_mocap, nearness, rotation_of
from manip_sim.tasks.task import Task, TOO_SHORT

#: It is open if it is pulled out by this [m].
_OPEN_M = 0.12
#: The middle of the cabinet is in this box from the middle of the work area, turned by at most so.
_PLACES, _TURN_RAD = ((0.13, -0.1, 0.0), (0.19, 0.1, 0.0)), 0.25
#: The fingertips are this far below the handle, and between it and the front [m].
_BELOW_M, _BEHIND_M = 0.03, 0.028


class OpenDrawer(Task):
    """Pull a drawer open by 12 cm."""

    name = 'open_drawer'
    instruction = 'Open the drawer.'
    horizon_s = 8.0
    unable = TOO_SHORT
    needs_fingers = False

    def arena(self) -> Arena:
        """Return the table with the cabinet."""
        return create_arena('drawer')

    def start(self, simulation: Simulation, random: np.random.Generator) -> None:
        """Draw where the cabinet is and how it is turned."""
        move_mocap(simulation, 'cabinet', self.work_area + draw(random, *_PLACES),
                   draw_yaw(random, _TURN_RAD))

    def _opened(self, simulation: Simulation) -> float:
        return float(simulation.data.joint('drawer_slide').qpos[0])

    def success(self, simulation: Simulation) -> bool:
        """Return whether the drawer is open."""
        return self._opened(simulation) > _OPEN_M

    def progress(self, simulation: Simulation) -> float:
        """Return a quarter for the gripper at the handle, the rest for opening."""
        near = nearness(length(
            self._end_effector(simulation) - simulation.data.site('handle').xpos))
        return 0.25 * near + 0.75 * min(max(self._opened(simulation) / _OPEN_M, 0.0), 1.0)

    def goal(self, simulation: Simulation) -> FloatArray:
        """Return the place of the handle [m], the direction of opening, and how far it is open."""
        return np.concatenate([simulation.data.site('handle').xpos,
                               -rotation_of(simulation, 'cabinet')[:, 0],
                               [self._opened(simulation)]])

    def expert(self, simulation: Simulation) -> Expert:
        """Return an expert that pulls with closed fingers behind the handle."""
        return _Puller(simulation)


class _Puller(Expert):
    """Closes the fingers, lowers them behind the handle and pulls."""

    def script(self) -> Iterator[None]:
        arm, up = self.arms[0], np.array([0.0, 0.0, 0.1])
        out, along, _ = -rotation_of(self.simulation, 'cabinet').T
        # Closed, two fingers are narrow across the way in which they close; fingers side by side
        # are narrow along it.
        across = out if fingers_side_by_side(self.simulation.model, arm) else along
        down = pointing_down([across, -across], arm.rotation)
        arm.closing = 1.0
        # Fingers that slip off the handle try again, where it is then.
        while True:
            behind = (np.array(self.simulation.data.site('handle').xpos) - _BEHIND_M * out
                      - [0.0, 0.0, _BELOW_M])
            yield from self.move(arm, behind + up, down)
            yield from self.move(arm, behind, longest_m=0.03)
            yield from self.move(arm, behind + 0.17 * out, longest_m=0.03)
            yield from self.move(arm, self.end_effector(arm)[0] + up)
