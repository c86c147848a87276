# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tasks that take an object from where it is brought: off a belt that moves, from another arm."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
import math
from os import PathLike
from types import MappingProxyType
from typing import Any

import numpy as np

from manip_sim.algebra import length, wxyz_to_xyzw
from manip_sim.arrays import FloatArray
from manip_sim.control.surroundings import ARENA
from manip_sim.errors import ModelError
from manip_sim.models import Arena, create_arena, World
from manip_sim.models.grippers import GripperModel
from manip_sim.models.object_creation import Description
from manip_sim.models.world import compose_robot, DEFAULT, Gripper, Grippers, Robot
from manip_sim.physics.poses_and_twists import Pose, Twist
from manip_sim.simulation import SimulatedRobot, Simulation
from manip_sim.tasks.expert import Expert, Hold, pointing_down, sides
from manip_sim.tasks.placing import (
    draw, draw_yaw, held_only_by, nearness, place, position_of, rotation_of)
from manip_sim.tasks.task import TABLE_M, Task, TOO_SHORT, usable_arms

BELT, PART = 'belt', 'part'
#: Edges and mass of the part [m, kg].
_SIZE_M, _MASS_KG = np.array([0.07, 0.07, 0.05]), 0.2
#: Least and greatest speed of the belt [m/s], and place of the part from the middle [m].
_SPEEDS, _PART_PLACES = (0.05, 0.15), ((-0.04, 0.2), (0.04, 0.3))
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
        speed, x, y = draw(random, [_SPEEDS[0], *_PART_PLACES[0]], [_SPEEDS[1], *_PART_PLACES[1]])
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
        near = self._near(simulation, position_of(simulation, PART))
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


#: Length and edge of the bar, and how far from its middle it is held [m].
_BAR_M, _EDGE_M, _HELD_AT_M = 0.28, 0.03, 0.105
#: Distance of the bar on the giver's side, and its variation along and across [m].
_ASIDE_M, _BAR_AREA, _TURN_RAD = 0.02, np.array([0.03, 0.06]), 0.3
#: Heights above the table at which the bar must be held, and changes grippers [m].
_HIGH_M, _HANDED_AT_M = 0.1, 0.16
#: Position and aim of the camera in ``world`` [m], for one robot that looks along x and
#: for two that look at each other: both grippers and the fronts of their arms are seen.
_IN_FRONT = (1.7, 0.0, 1.75), (0.0, 0.0, 1.0)
_BESIDE = (0.0, -2.1, 1.65), (0.0, 0.0, 1.05)


class HandOver(Task):
    """
    Take a bar from one arm with another one; in the end only that holds it, in the air.

    A robot with two arms does it alone, from right to left. Of others there are two, face to face,
    the second one with the ``idn`` 1.
    """

    name = 'hand_over'
    instruction = 'Pick up the bar with one gripper, and take it over with the other.'
    horizon_s = 10.0
    arms_in_all = 2
    unable = MappingProxyType({
        **TOO_SHORT, 'Jaco': 'its fingers need 3 s to close, so that the time is up before'})
    expert_fails = MappingProxyType({'Tiago': '0 of 4'})

    def objects(self) -> Iterable[Description]:
        """Return the bar; its x is along it."""
        return [{'name': 'bar', 'shape': 'box', 'size': [_BAR_M, _EDGE_M, _EDGE_M], 'mass': 0.1,
                 'rgba': [0.8, 0.15, 0.1, 1.0], 'condim': 4}]

    def compose(self, robot: Robot, gripper: Gripper | Grippers, composition: dict[str, Any]
                ) -> World:
        """
        Return the world, with two robots if one has not two arms with grippers.

        :raises ModelError: as ``compose`` does, and for options of one robot if there are two
        """
        world = super().compose(robot, gripper, composition)
        (first,) = world.robots
        view = 'agentview'
        if len(usable_arms(first, self.needs_fingers)) != 1:
            world.arena.aim_camera(view, *_IN_FRONT)
            return world
        if not isinstance(robot, (str, PathLike)) or isinstance(gripper, GripperModel):
            raise ModelError(f'{self.name} has two robots of {first.type_name}: give robot and '
                             'gripper by name')
        alone = {'idn', 'prefix', 'position', 'orientation'} & composition.keys()
        if alone:
            raise ModelError(f'{self.name} has two robots of {first.type_name}, for which there '
                             'is no ' + ', '.join(sorted(alone)))
        second = compose_robot(robot, gripper, composition.get('base', DEFAULT), idn=1,
                               tactile=composition.get('tactile', False))
        world.arena.aim_camera(view, *_BESIDE)
        x, y, z = world.arena.robot_position(first)
        second.set_base_xpos([-x, -y, z], may_be_raised=True)
        second.set_base_ori([0.0, 0.0, math.pi])
        return World([first, second], world.arena, world.timestep_s, world.gravity_compensation,
                     objects=composition['objects'], cameras=world.cameras,
                     lidars=world.lidars,
                     initialization_noise=composition['initialization_noise'],
                     seed=composition['seed'])

    @property
    def onward(self) -> FloatArray:
        """The horizontal direction from the giver to the taker, in ``world``, shape (3,)."""
        return np.array([0.0, 1.0, 0.0] if len(self.world.robots) == 1 else [1.0, 0.0, 0.0])

    @property
    def work_area(self) -> FloatArray:
        """Middle of the area on the table, in ``world`` [m], shape (3,)."""
        return np.array([0.0, 0.0, TABLE_M])

    def start(self, simulation: Simulation, random: np.random.Generator) -> None:
        """Draw where the bar is, on the giver's side, and how it is turned."""
        along, across = draw(random, -_BAR_AREA, _BAR_AREA)
        onward, (w, _, _, z) = self.onward, draw_yaw(random, _TURN_RAD)
        aside = np.array([-onward[1], onward[0], 0.0])
        position = self.work_area + (along - _ASIDE_M) * onward + across * aside
        # Half a quarter turn more if the bar lies along y.
        if onward[1]:
            w, z = math.sqrt(0.5) * (w - z), math.sqrt(0.5) * (w + z)
        place(simulation, 'bar', position + [0.0, 0.0, _EDGE_M / 2.0], [w, 0.0, 0.0, z])

    def _taker(self, simulation: Simulation) -> tuple[SimulatedRobot, str]:
        robot = list(simulation.robots.values())[-1]
        return robot, usable_arms(robot.robot_model, self.needs_fingers)[-1]

    def success(self, simulation: Simulation) -> bool:
        """Return whether only the second gripper holds the bar, in the air."""
        high = position_of(simulation, 'bar')[2] - TABLE_M
        return bool(high > _HIGH_M) and held_only_by(simulation, 'bar', *self._taker(simulation))

    def progress(self, simulation: Simulation) -> float:
        """Return thirds: a gripper at the bar, the bar in the air, the other gripper at it."""
        bar, data = position_of(simulation, 'bar'), simulation.data
        giver = next(iter(simulation.robots.values())).end_effectors[self.arm].pose(data)[:3]
        robot, arm = self._taker(simulation)
        taker = robot.end_effectors[arm].pose(data)[:3]
        high = min(max(float(bar[2] - TABLE_M) / _HIGH_M, 0.0), 1.0)
        return (max(nearness(length(giver - bar)), nearness(length(taker - bar))) + high
                + nearness(length(taker - bar))) / 3.0

    def expert(self, simulation: Simulation) -> Expert:
        """Return an expert whose grippers hold the ends of the bar from above."""
        return _Giver(simulation, self.onward)


class _Giver(Expert):
    """Picks the bar up with the first gripper and takes it over with the second one."""

    def __init__(self, simulation: Simulation, onward: FloatArray) -> None:
        self._onward = onward
        super().__init__(simulation)

    def script(self) -> Iterator[None]:
        giver, taker, up = self.arms[0], self.arms[-1], np.array([0.0, 0.0, 0.07])
        along = self._along()
        end = position_of(self.simulation, 'bar') - _HELD_AT_M * along
        yield from self.move(giver, end + up, self._down(giver, along), within_m=0.02)
        yield from self.move(giver, end)
        yield from self.grip(giver, 1.0)
        yield from self.move(giver, end + up, within_m=0.02)
        middle = np.array([0.0, 0.0, TABLE_M + _HANDED_AT_M])
        # The taker comes over its end while the giver brings the bar.
        taker.position = middle + _HELD_AT_M * self._onward + up
        taker.rotation = self._down(taker, self._onward)
        yield from self.move(giver, middle - _HELD_AT_M * self._onward,
                             self._down(giver, self._onward))
        yield from self.move(taker, taker.position, within_m=0.02)
        end = position_of(self.simulation, 'bar') + _HELD_AT_M * self._along()
        yield from self.move(taker, end, longest_m=0.03)
        yield from self.grip(taker, 1.0)
        yield from self.grip(giver, -1.0, 6)
        yield from self.move(giver, self.end_effector(giver)[0] + up)

    def _down(self, arm: Hold, along: FloatArray) -> FloatArray:
        """Return the rotation of a gripper over a bar that lies along a direction."""
        across = np.array([-along[1], along[0], 0.0])
        # The arms of one robot reach less far in front of it if they are turned the other way.
        both = len(self.simulation.robots) > 1
        return pointing_down([across, -across] if both else [across], arm.rotation)

    def _along(self) -> FloatArray:
        """Return the horizontal direction of the bar towards the taker."""
        along: FloatArray = rotation_of(self.simulation, 'bar')[:, 0] * [1.0, 1.0, 0.0]
        ahead = float((along * self._onward).sum())
        return along / math.copysign(length(along), ahead)
