# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tasks with cubes on a table."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
import math

import numpy as np

from manip_sim.algebra import length
from manip_sim.arrays import FloatArray
from manip_sim.models.arenas import Arena, create_arena
from manip_sim.models.object_creation import Description
from manip_sim.simulation import Simulation
from manip_sim.tasks.expert import Expert, Hold, pointing_down, sides
from manip_sim.tasks.placing import (
    add_goal, draw, draw_apart, draw_yaw, held_only_by, move_mocap, nearness, place, position_of,
    rotation_of, speed, touching)
from manip_sim.tasks.task import TABLE_M, Task, TOO_SHORT

CUBE_M = 0.04
#: The cube is on an area of these half extents [m].
_HALF_AREA = np.array([0.08, 0.12])
#: It is picked up if it is higher than at the start by this [m].
_LIFT_M = 0.1
#: Edge of the lower of two cubes, and of the one that is pushed [m].
_BASE_M = 0.05
#: Two cubes are on an area of these half extents, this far apart [m].
_STACK_AREA, _APART_M = (0.08, 0.16), 0.14
#: Slower is at rest [m/s].
_STILL_M_S = 0.02
#: Edge of the cube that is pushed, and height of the fingertips that push it [m].
_PUSHED_M, _PUSH_AT_M = 0.06, TABLE_M + 0.04
#: Friction between it and the table; with more, a push at its upper half would tip it over.
_SLIPPERY = 0.3
#: Radius of the disc that a cube is pushed to [m].
_DISC_M = 0.03
#: Place of a cube to be pushed, and distance: least and greatest x and y [m].
_PUSH_FROM = (-0.08, -0.1), (0.0, 0.1)
_PUSH_BY = (0.1, -0.06), (0.16, 0.06)


class PickCube(Task):
    """Hold a cube 0.1 m above the table, with nothing but one gripper touching it."""

    name = 'pick_cube'
    instruction = 'Pick up the red cube.'
    horizon_s = 6.0
    unable = TOO_SHORT

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
        return self._lifted(simulation) > _LIFT_M and held_only_by(
            simulation, 'cube', simulation.robot, self.arm)

    def progress(self, simulation: Simulation) -> float:
        """Return a half for being at the cube, and a half for lifting it."""
        near = self._near(simulation, position_of(simulation, 'cube'))
        lifted = min(max(self._lifted(simulation) / _LIFT_M, 0.0), 1.0)
        return 0.5 * near + 0.5 * lifted

    def expert(self, simulation: Simulation) -> Expert:
        """Return an expert that grasps the cube from above."""
        return _Picker(simulation)


class _Picker(Expert):
    """Grasps the cube from above and lifts it."""

    def script(self) -> Iterator[None]:
        arm = self.arms[0]
        yield from self.grasp(arm)
        yield from self.move(arm, self.end_effector(arm)[0] + [0.0, 0.0, _LIFT_M + 0.03])

    def grasp(self, arm: Hold) -> Iterator[None]:
        """Grasp the cube by two of its sides."""
        cube = position_of(self.simulation, 'cube')
        down = pointing_down(sides(rotation_of(self.simulation, 'cube')), arm.rotation)
        yield from self.move(arm, cube + [0.0, 0.0, 0.08], down, within_m=0.02)
        yield from self.open_to(arm, CUBE_M)
        yield from self.move(arm, cube)
        yield from self.grip(arm, 1.0, body='cube')


class StackCubes(Task):
    """Put a cube onto another one and let go of it."""

    name = 'stack_cubes'
    instruction = 'Put the red cube onto the green cube.'
    horizon_s = 8.0
    unable = TOO_SHORT

    def objects(self) -> Iterable[Description]:
        """Return both cubes."""
        return [cube('cube', (0.8, 0.15, 0.1)), cube('base', (0.1, 0.6, 0.2), _BASE_M)]

    def start(self, simulation: Simulation, random: np.random.Generator) -> None:
        """Draw where the cubes are and how they are turned."""
        points = draw_apart(random, 2, _STACK_AREA, _APART_M)
        for name, edge_m, point in zip(('cube', 'base'), (CUBE_M, _BASE_M), points):
            place(simulation, name, self.work_area + [*point, edge_m / 2.0],
                  draw_yaw(random, math.pi / 4.0))

    def _off(self, simulation: Simulation) -> FloatArray:
        """Return how far the cube is from its place on the other one [m], shape (3,)."""
        return (position_of(simulation, 'cube') - position_of(simulation, 'base')
                - [0.0, 0.0, (CUBE_M + _BASE_M) / 2.0])

    def success(self, simulation: Simulation) -> bool:
        """Return whether the cube lies on the other one, and only that touches it."""
        off = self._off(simulation)
        return (bool(np.abs(off).max() < _BASE_M / 2.0) and abs(off[2]) < 0.005
                and touching(simulation, 'cube') == {simulation.model.body('base').id}
                and max(speed(simulation, 'cube'), speed(simulation, 'base')) < _STILL_M_S)

    def progress(self, simulation: Simulation) -> float:
        """Return a third for the gripper at the cube, and two thirds for the cube at its place."""
        near = self._near(simulation, position_of(simulation, 'cube'))
        return near / 3.0 + nearness(length(self._off(simulation)), 0.05) * 2.0 / 3.0

    def expert(self, simulation: Simulation) -> Expert:
        """Return an expert that grasps the cube from above."""
        return _Stacker(simulation)


class _Stacker(_Picker):
    """Grasps the cube from above, puts it onto the other one and lets go."""

    def script(self) -> Iterator[None]:
        arm = self.arms[0]
        yield from self.grasp(arm)
        yield from self.move(arm, self.end_effector(arm)[0] + [0.0, 0.0, 0.09], within_m=0.02)
        # Place of the end effector that brings the cube over its own.
        place_m = position_of(self.simulation, 'base') + [0.0, 0.0, (CUBE_M + _BASE_M) / 2.0]
        over = place_m - position_of(self.simulation, 'cube') + self.end_effector(arm)[0]
        yield from self.move(arm, over + [0.0, 0.0, 0.04])
        over = place_m - position_of(self.simulation, 'cube') + self.end_effector(arm)[0]
        yield from self.move(arm, over + [0.0, 0.0, 0.002], longest_m=0.02, within_m=0.004)
        yield from self.grip(arm, -1.0, 6)
        yield from self.move(arm, self.end_effector(arm)[0] + [0.0, 0.0, 0.1])


class PushCube(Task):
    """Push a cube along the table to a disc, without lifting it."""

    name = 'push_cube'
    instruction = 'Push the red cube onto the green disc.'
    horizon_s = 8.0
    unable = TOO_SHORT
    needs_fingers = False

    def arena(self) -> Arena:
        """Return the table with the disc."""
        arena = create_arena('table', cube=False, friction=_SLIPPERY)
        add_goal(arena, 'goal', _DISC_M, flat=True)
        return arena

    def objects(self) -> Iterable[Description]:
        """Return the cube."""
        return [cube('cube', (0.8, 0.15, 0.1), _PUSHED_M, _SLIPPERY)]

    def start(self, simulation: Simulation, random: np.random.Generator) -> None:
        """Draw where the cube and the disc are."""
        begin, side = draw(random, *_PUSH_FROM), draw(random, *_PUSH_BY)
        place(simulation, 'cube', self.work_area + [*begin, _PUSHED_M / 2.0],
              draw_yaw(random, math.pi / 12.0))
        move_mocap(simulation, 'goal', self.work_area + [*(begin + side), 0.0])

    def _way(self, simulation: Simulation) -> FloatArray:
        """Return the way from the cube to the disc, horizontal [m], shape (2,)."""
        return (position_of(simulation, 'goal') - position_of(simulation, 'cube'))[:2]

    def success(self, simulation: Simulation) -> bool:
        """Return whether the middle of the cube is over the disc, and it lies on the table."""
        table = simulation.model.body('table').id
        return (length(self._way(simulation)) < _DISC_M and table in touching(simulation, 'cube')
                and speed(simulation, 'cube') < _STILL_M_S)

    def progress(self, simulation: Simulation) -> float:
        """Return a quarter for the gripper at the cube, the rest for the cube at the disc."""
        near = self._near(simulation, position_of(simulation, 'cube'))
        return 0.25 * near + 0.75 * nearness(length(self._way(simulation)))

    def goal(self, simulation: Simulation) -> FloatArray:
        """Return the middle of the disc in ``world`` [m], shape (3,)."""
        return position_of(simulation, 'goal')

    def expert(self, simulation: Simulation) -> Expert:
        """Return an expert that pushes with closed fingers."""
        return _Pusher(simulation)


class _Pusher(Expert):
    """Pushes the cube straight ahead with two fingertips, which keep it from turning."""

    def script(self) -> Iterator[None]:
        arm, up = self.arms[0], np.array([0.0, 0.0, 0.1])
        while True:
            cube, ahead, far = self._way()
            behind = np.array([*(cube - 0.12 * ahead)[:2], _PUSH_AT_M])
            across = np.array([-ahead[1], ahead[0], 0.0])
            down = pointing_down([across, -across], arm.rotation)
            yield from self.move(arm, behind + up, down, within_m=0.02)
            yield from self._close(arm)
            yield from self.move(arm, behind)
            while far > 0.006:
                # Slower in the end, so that the cube does not slide on.
                along = ((self.end_effector(arm)[0] - behind) * ahead).sum()
                arm.position = behind + (along + min(0.015, 0.004 + 0.1 * far)) * ahead
                yield
                _, here, far = self._way()
                if (here * ahead).sum() < 0.5:
                    break
            yield from self.move(arm, self.end_effector(arm)[0] - 0.05 * ahead)
            yield from self.move(arm, self.end_effector(arm)[0] + up)

    def _close(self, arm: Hold) -> Iterator[None]:
        """Close the fingers until they are less than two thirds of the cube apart."""
        gripper = arm.item.robot.parts[f'{arm.item.arm}/gripper'].gripper
        assert gripper is not None
        pads = [gripper.important_geoms[f'{side}_fingerpad'] for side in ('left', 'right')]
        arm.closing = 1.0
        for _ in range(20):
            ends = [self.simulation.data.geom(names[0]).xpos for names in pads if names]
            if len(ends) == 2 and length(ends[0] - ends[1]) < _PUSHED_M * 2.0 / 3.0:
                break
            yield
        arm.closing = 0.0

    def _way(self) -> tuple[FloatArray, FloatArray, float]:
        """Return where the cube is [m], the direction to the disc, and how far that is [m]."""
        cube = position_of(self.simulation, 'cube')
        way = position_of(self.simulation, 'goal') - cube
        way[2] = 0.0
        far = length(way)
        return cube, way / far, far


def cube(name: str, rgb: Iterable[float], edge_m: float = CUBE_M, friction: float = 1.0
         ) -> Description:
    """
    Return the description of a light cube.

    :param friction: sliding; in a contact the greater one of both counts
    """
    return {'name': name, 'shape': 'box', 'size': [edge_m] * 3, 'mass': 0.1, 'rgba': [*rgb, 1.0],
            'condim': 4, 'friction': [friction, 0.005, 0.0001]}
