# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The task to put a square peg into a square hole."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
import math
from types import MappingProxyType

import mujoco
import numpy as np

from manip_sim.algebra import length, product
from manip_sim.arrays import FloatArray
from manip_sim.models.arenas import Arena
from manip_sim.models.object_creation import Description
from manip_sim.simulation import Simulation
from manip_sim.tasks.expert import Expert, pointing_down, sides
from manip_sim.tasks.placing import (
    draw_apart, draw_yaw, move_mocap, nearness, place, position_of, rotation_of)
from manip_sim.tasks.task import TABLE_M, Task, TOO_SHORT

#: Edge and length of the peg, and play of the hole on each side [m].
_PEG_M, _PEG_LENGTH_M, _PLAY_M = 0.024, 0.1, 0.002
#: Depth of the hole, how deep the tip must be, and thickness of the walls [m].
_HOLE_DEPTH_M, _DEEP_M, _WALL_M = 0.05, 0.04, 0.02
#: Peg and hole are on an area of these half extents, this far apart [m].
_AREA, _APART_M = (0.08, 0.16), 0.15


class InsertPeg(Task):
    """Put the tip of a peg 4 cm deep into a hole with 2 mm of play on each side."""

    name = 'insert_peg'
    instruction = 'Put the orange peg into the hole.'
    horizon_s = 10.0
    unable = TOO_SHORT
    expert_fails = MappingProxyType({'Tiago': '0 of 4'})

    def arena(self) -> Arena:
        """Return the table with the block that has the hole."""
        arena = super().arena()
        block = arena.spec.worldbody.add_body(name='hole', mocap=True)
        inside = _PEG_M / 2.0 + _PLAY_M
        half, middle = _HOLE_DEPTH_M / 2.0, inside + _WALL_M / 2.0
        for number, (x, y) in enumerate(((1, 0), (-1, 0), (0, 1), (0, -1))):
            # The walls along x reach over the ends of the others.
            size = [_WALL_M / 2.0, inside + _WALL_M] if x else [inside, _WALL_M / 2.0]
            block.add_geom(
                name=f'hole_wall{number}', type=mujoco.mjtGeom.mjGEOM_BOX, size=[*size, half],
                pos=[x * middle, y * middle, half], rgba=[0.35, 0.4, 0.5, 1.0],
                friction=[0.3, 0.005, 0.0001])
        return arena

    def objects(self) -> Iterable[Description]:
        """Return the peg."""
        return [{'name': 'peg', 'shape': 'box', 'size': [_PEG_M, _PEG_M, _PEG_LENGTH_M],
                 'mass': 0.05, 'rgba': [0.9, 0.5, 0.1, 1.0], 'condim': 4,
                 'friction': [0.5, 0.005, 0.0001]}]

    def start(self, simulation: Simulation, random: np.random.Generator) -> None:
        """Draw where peg and hole are and how they are turned; the peg stands on the table."""
        peg, hole = draw_apart(random, 2, _AREA, _APART_M)
        place(simulation, 'peg', self.work_area + [*peg, _PEG_LENGTH_M / 2.0],
              draw_yaw(random, math.pi / 4.0))
        move_mocap(simulation, 'hole', self.work_area + [*hole, 0.0],
                   draw_yaw(random, math.pi / 4.0))

    def _tip(self, simulation: Simulation) -> FloatArray:
        """Return the lower end of the peg in the frame of the mouth of the hole [m], (3,)."""
        peg = rotation_of(simulation, 'peg')
        end = np.array([0.0, 0.0, -np.sign(peg[2, 2]) * _PEG_LENGTH_M / 2.0])
        tip = position_of(simulation, 'peg') + product(peg, end)
        mouth = position_of(simulation, 'hole') + [0.0, 0.0, _HOLE_DEPTH_M]
        return product(rotation_of(simulation, 'hole').T, tip - mouth)

    def success(self, simulation: Simulation) -> bool:
        """Return whether the tip of the peg is deep in the hole."""
        x, y, z = self._tip(simulation)
        return bool(max(abs(x), abs(y)) < _PEG_M / 2.0 and z < -_DEEP_M)

    def progress(self, simulation: Simulation) -> float:
        """Return a quarter for the gripper at the peg, the rest for the tip at its place."""
        near = nearness(length(self._end_effector(simulation) - position_of(simulation, 'peg')))
        return 0.25 * near + 0.75 * nearness(
            length(self._tip(simulation) + [0.0, 0.0, _DEEP_M]), 0.05)

    def goal(self, simulation: Simulation) -> FloatArray:
        """Return the pose of the hole on the table: position [m], quaternion w, x, y, z, (7,)."""
        body = simulation.data.body('hole')
        return np.concatenate([body.xpos, body.xquat])

    def expert(self, simulation: Simulation) -> Expert:
        """Return an expert that holds the peg near its upper end."""
        return _Inserter(simulation)


class _Inserter(Expert):
    """Grasps the peg from above, turns it as the hole is, and lets it down."""

    def script(self) -> Iterator[None]:
        arm, simulation = self.arms[0], self.simulation
        upper = position_of(simulation, 'peg') + [0.0, 0.0, _PEG_LENGTH_M / 2.0 - 0.02]
        down = pointing_down(sides(rotation_of(simulation, 'peg')), arm.rotation)
        yield from self.move(arm, upper + [0.0, 0.0, 0.08], down, within_m=0.02)
        yield from self.open_to(arm, _PEG_M)
        yield from self.move(arm, upper)
        yield from self.grip(arm, 1.0, body='peg')
        yield from self.move(arm, upper + [0.0, 0.0, 0.09], within_m=0.02)
        hole = position_of(simulation, 'hole')
        turned = pointing_down(sides(rotation_of(simulation, 'hole')), self.end_effector(arm)[1])
        over = np.array([*hole[:2], self.end_effector(arm)[0][2]])
        yield from self.move(arm, over, turned)
        for height_m in (_HOLE_DEPTH_M + 0.02, 0.0):
            # The middle of the peg goes over that of the hole, whatever it did in the gripper.
            way = hole - position_of(simulation, 'peg')
            way[2] = height_m - (position_of(simulation, 'peg')[2] - TABLE_M
                                 - _PEG_LENGTH_M / 2.0)
            yield from self.move(arm, self.end_effector(arm)[0] + way, longest_m=0.015,
                                 within_m=0.002)
