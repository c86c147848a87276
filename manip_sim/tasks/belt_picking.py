# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The task to pick a part off a belt that moves."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
import math

import numpy as np

from manip_sim.algebra import length, wxyz_to_xyzw
from manip_sim.arrays import FloatArray
from manip_sim.control.surroundings import ARENA
from manip_sim.errors import ModelError
from manip_sim.models.arenas import Arena, create_arena
from manip_sim.models.object_creation import Description
from manip_sim.physics.poses_and_twists import Pose, Twist
from manip_sim.simulation import Simulation
from manip_sim.tasks.expert import Expert, Hold, pointing_down, sides
from manip_sim.tasks.grasping import held_only_by
from manip_sim.tasks.placing import draw, draw_yaw, nearness, position_of, rotation_of
from manip_sim.tasks.task import Task, TOO_SHORT

BELT, PART = 'belt', 'part'
#: Edges and mass of the part [m, kg].
_SIZE_M, _MASS_KG = np.array([0.07, 0.07, 0.05]), 0.2
#: Least and greatest speed of the belt [m/s], and place of the part from the middle [m].
_SPEEDS, _PLACES = (0.05, 0.15), ((-0.04, 0.2), (0.04, 0.3))
#: It is picked if it is higher than on the belt by this [m].
_LIFT_M = 0.1
#: The expert waits so high above the part, is over it within this, and presses the cup so deep
#: into it [m]. Nearer than that [m], it corrects this share of its distance in each period.
_ABOVE_M, _OVER_M, _PRESS_M, _NEAR_M, _CORRECTS = 0.05, 0.006, 0.003, 0.03, 0.3
#: The expert lifts the part after so many periods on it, and gives up after the most.
_HELD, _MOST = 8, 120


class PickFromBelt(Task):
    """Pick a part off a running belt, with nothing but one gripper touching it."""

    name = 'pick_from_belt'
    instruction = 'Pick the blue part off the belt.'
    horizon_s = 8.0
    unable = TOO_SHORT
    own_gripper = 'VacuumGripper'

    def arena(self) -> Arena:
        """Return the conveyor."""
        return create_arena('conveyor')

    def objects(self) -> Iterable[Description]:
        """Return the part."""
        return [{'name': PART, 'shape': 'box', 'size': _SIZE_M.tolist(), 'mass': _MASS_KG,
                 'rgba': [0.15, 0.35, 0.8, 1.0], 'condim': 4, 'friction': [1.0, 0.005, 0.0001]}]

    def start(self, simulation: Simulation, random: np.random.Generator) -> None:
        """Draw how fast the belt runs, where the part is on it and how it is turned."""
        speed, x, y = draw(random, [_SPEEDS[0], *_PLACES[0]], [_SPEEDS[1], *_PLACES[1]])
        simulation.surroundings.commands[ARENA].command({BELT: float(speed)})
        position = self.work_area + [x, y, _SIZE_M[2] / 2.0]
        simulation.entities.place(
            simulation.data, PART, Pose(position, wxyz_to_xyzw(draw_yaw(random, math.pi / 4.0))),
            Twist(np.array([0.0, -speed, 0.0]), np.zeros(3)))

    def _lifted(self, simulation: Simulation) -> float:
        return float(position_of(simulation, PART)[2] - self.work_area[2] - _SIZE_M[2] / 2.0)

    def success(self, simulation: Simulation) -> bool:
        """Return whether the part is in the air, held by the arm alone."""
        return self._lifted(simulation) > _LIFT_M and held_only_by(
            simulation, PART, simulation.robot, self.arm)

    def progress(self, simulation: Simulation) -> float:
        """Return a half for being at the part, and a half for lifting it."""
        near = nearness(length(self._end_effector(simulation) - position_of(simulation, PART)))
        return 0.5 * near + 0.5 * min(max(self._lifted(simulation) / _LIFT_M, 0.0), 1.0)

    def goal(self, simulation: Simulation) -> FloatArray:
        """Return the velocity of the belt along y of ``world`` [m/s], shape (1,)."""
        return np.array([-simulation.data.actuator(BELT).ctrl[0]])

    def expert(self, simulation: Simulation) -> Expert:
        """
        Return an expert that follows the part, comes down on it and lifts it.

        :raises ModelError: if the gripper has no suction cup
        """
        if not simulation.robot.grippers[f'{self.arm}/gripper'].cups.names:
            raise ModelError(f'the expert of {self.name} needs a suction cup, such as that of '
                             f'{self.own_gripper}')
        return _BeltPicker(simulation)


class _BeltPicker(Expert):
    """Follows the part from above, comes down on it, and lifts what it holds."""

    def script(self) -> Iterator[None]:
        arm, simulation = self.arms[0], self.simulation
        arm.rotation = pointing_down(sides(rotation_of(simulation, PART)), arm.rotation)
        arm.closing = 1.0
        above, held, lead = _ABOVE_M, 0, np.zeros(3)
        for _ in range(_MOST):
            top = position_of(simulation, PART) + [0.0, 0.0, _SIZE_M[2] / 2.0]
            way = self.end_effector(arm)[0] - top
            way[2] = 0.0
            if length(way) < _NEAR_M:
                lead = lead - _CORRECTS * way
            if above > 0.0 and length(way) < _OVER_M and self.end_effector(arm)[0][2] < (
                    top[2] + _ABOVE_M + _OVER_M):
                above = -_PRESS_M
            arm.position = top + lead + [0.0, 0.0, above]
            held = held + 1 if self._seals(arm) else 0
            if held >= _HELD:
                break
            yield
        yield from self.move(arm, self.end_effector(arm)[0] + [0.0, 0.0, _LIFT_M + 0.03])

    def _seals(self, arm: Hold) -> bool:
        """Return whether the cup of an arm is on the part."""
        cups = arm.item.robot.grippers[f'{arm.item.arm}/gripper'].cups
        return self.simulation.model.body(PART).id in cups.held(self.simulation.data)
