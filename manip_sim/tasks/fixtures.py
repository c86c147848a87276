# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tasks at fixtures of an arena: a drawer, a hole, spots of dirt, and a point in the air."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
import math
from types import MappingProxyType

import mujoco
import numpy as np

from manip_sim.algebra import length, product
from manip_sim.arrays import BoolArray, FloatArray
from manip_sim.models.arenas import Arena, create_arena
from manip_sim.models.object_creation import Description
from manip_sim.physics.entities import read_contacts
from manip_sim.simulation import Simulation
from manip_sim.tasks.expert import Expert, fingers_side_by_side, Hold, pointing_down, sides
from manip_sim.tasks.placing import (
    add_goal, bodies_of_gripper, draw, draw_apart, draw_yaw, move_mocap, nearness, place,
    position_of, rotation_of)
from manip_sim.tasks.task import TABLE_M, Task, TOO_SHORT

#: It is open if it is pulled out by this [m].
_OPEN_M = 0.12
#: The middle of the cabinet is in this box from the middle of the work area, turned by at most so.
_CABINET_BOX, _TURN_RAD = ((0.13, -0.1, 0.0), (0.19, 0.1, 0.0)), 0.25
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
        move_mocap(simulation, 'cabinet', self.work_area + draw(random, *_CABINET_BOX),
                   draw_yaw(random, _TURN_RAD))

    def _opened(self, simulation: Simulation) -> float:
        return float(simulation.data.joint('drawer_slide').qpos[0])

    def success(self, simulation: Simulation) -> bool:
        """Return whether the drawer is open."""
        return self._opened(simulation) > _OPEN_M

    def progress(self, simulation: Simulation) -> float:
        """Return a quarter for the gripper at the handle, the rest for opening."""
        near = self._near(simulation, simulation.data.site('handle').xpos)
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


#: Edge and length of the peg, and play of the hole on each side [m].
_PEG_M, _PEG_LENGTH_M, _PLAY_M = 0.024, 0.1, 0.002
#: Depth of the hole, how deep the tip must be, and thickness of the walls [m].
_HOLE_DEPTH_M, _DEEP_M, _WALL_M = 0.05, 0.04, 0.02
#: Peg and hole are on an area of these half extents, this far apart [m].
_PEG_AREA, _PEG_APART_M = (0.08, 0.16), 0.15


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
        peg, hole = draw_apart(random, 2, _PEG_AREA, _PEG_APART_M)
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
        near = self._near(simulation, position_of(simulation, 'peg'))
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


#: Rows and columns of spots, the distance between them, and how far each may be off [m].
_ROWS, _COLUMNS, _SPOT_APART_M, _OFF_M = 4, 3, 0.05, 0.015
#: Their middle is within this of the middle of the work area [m].
_SPOT_AREA = np.array([0.04, 0.06])
_SPOT_M = 0.012
#: Height of spots that are wiped off: below the floor [m].
_GONE_M = -1.0
#: The gripper wipes what it covers while it presses with more than this [N], and this around [m].
_PRESSES_N, _AROUND_M = 1.0, 0.005
#: With how much force the expert presses [N], and how much deeper that takes a gripper [m/N].
_PRESS_N, _GIVE_M_N = 8.0, 0.00015


class WipeTable(Task):
    """Wipe twelve spots off the table; one goes when the gripper covers it and presses."""

    name = 'wipe_table'
    instruction = 'Wipe the brown spots off the table.'
    horizon_s = 12.0
    unable = TOO_SHORT
    needs_fingers = False
    own_gripper = 'WipingGripper'

    def arena(self) -> Arena:
        """Return the table with the spots."""
        arena = super().arena()
        for number in range(_ROWS * _COLUMNS):
            spot = arena.spec.worldbody.add_body(name=f'spot{number}', mocap=True)
            spot.add_geom(name=f'spot{number}_visual', type=mujoco.mjtGeom.mjGEOM_CYLINDER,
                          size=[_SPOT_M, 0.0005, 0.0], rgba=[0.35, 0.2, 0.1, 1.0], contype=0,
                          conaffinity=0, group=2)
        return arena

    def start(self, simulation: Simulation, random: np.random.Generator) -> None:
        """Draw where the spots are."""
        middle = self.work_area
        middle[:2] += draw(random, -_SPOT_AREA, _SPOT_AREA)
        for number in range(_ROWS * _COLUMNS):
            row, column = divmod(number, _COLUMNS)
            place = np.array([row - (_ROWS - 1) / 2.0, column - (_COLUMNS - 1) / 2.0])
            off = draw(random, [-_OFF_M] * 2, [_OFF_M] * 2)
            move_mocap(simulation, f'spot{number}',
                       middle + [*(place * _SPOT_APART_M + off), 0.0])

    def spots(self, simulation: Simulation) -> FloatArray:
        """
        Return where the spots are, those that were wiped off below the floor.

        :returns: in ``world`` [m], shape (n, 3), a view
        """
        first = int(simulation.model.body('spot0').mocapid[0])
        spots: FloatArray = simulation.data.mocap_pos[first:first + _ROWS * _COLUMNS]
        return spots

    def left(self, simulation: Simulation) -> BoolArray:
        """Return which spots are still on the table, shape (n,)."""
        is_left: BoolArray = self.spots(simulation)[:, 2] > 0.0
        return is_left

    def end_period(self, simulation: Simulation) -> None:
        """Remove the spots that a gripper covers while it presses on the table."""
        for robot in simulation.robots.values():
            for arm, reader in robot.end_effectors.items():
                contacts = read_contacts(simulation.model, simulation.data)
                touching = np.isin(contacts.body, list(bodies_of_gripper(simulation, robot, arm)))
                if contacts.force[touching, 2].sum() <= _PRESSES_N:
                    continue
                site = simulation.data.site(reader.grip_site)
                origin, axes = site.xpos, site.xmat.reshape(3, 3)
                covered = np.einsum('ni,ij->nj', contacts.position[touching] - origin, axes)[:, :2]
                spots = self.spots(simulation)
                inside = np.einsum('ni,ij->nj', spots - origin, axes)[:, :2]
                wiped = ((inside >= covered.min(axis=0) - _AROUND_M)
                         & (inside <= covered.max(axis=0) + _AROUND_M)).all(axis=1)
                spots[wiped, 2] = _GONE_M

    def success(self, simulation: Simulation) -> bool:
        """Return whether no spot is left."""
        return not self.left(simulation).any()

    def progress(self, simulation: Simulation) -> float:
        """Return the share of spots wiped off, and a little for the gripper at the rest."""
        left = self.left(simulation)
        ways = self.spots(simulation)[left] - self._end_effector(simulation)
        nearest = np.sqrt((ways * ways).sum(axis=1)).min(initial=1.0)
        return 0.9 * float(1.0 - left.mean()) + 0.1 * nearness(float(nearest))

    def goal(self, simulation: Simulation) -> FloatArray:
        """Return x, y [m] and 1 of each spot that is left; zeros of one that is not; (3 n,)."""
        left = self.left(simulation)
        rows = np.column_stack([self.spots(simulation)[:, :2], np.ones(len(left))])
        return np.where(left[:, None], rows, 0.0).ravel()

    def expert(self, simulation: Simulation) -> Expert:
        """Return an expert that wipes in two strokes, there and back."""
        return _Wiper(simulation, self)


class _Wiper(Expert):
    """Presses on the table and moves along it."""

    def __init__(self, simulation: Simulation, task: WipeTable) -> None:
        self._task = task
        super().__init__(simulation)

    def script(self) -> Iterator[None]:
        arm = self.arms[0]
        across = np.array([0.0, 1.0, 0.0])
        down = pointing_down([across, -across], arm.rotation)
        while True:
            spots = self._task.spots(self.simulation)[self._task.left(self.simulation)]
            if not len(spots):
                spots = arm.position[None]
            low, high = spots.min(axis=0), spots.max(axis=0)
            table = self._task.work_area[2]
            # The eraser is 12 cm long across, so two strokes cover 20 cm.
            for y, begin, end in ((0.7 * low[1] + 0.3 * high[1], low[0], high[0]),
                                  (0.3 * low[1] + 0.7 * high[1], high[0], low[0])):
                onward = 0.02 if end > begin else -0.02
                yield from self.move(
                    arm, np.array([begin - onward, y, table + 0.03]), down, within_m=0.015)
                yield from self._stroke(arm, np.array([end + onward, y, table]))
                yield from self.move(arm, self.end_effector(arm)[0] + [0.0, 0.0, 0.04],
                                     within_m=0.02)

    def _stroke(self, arm: Hold, end: FloatArray) -> Iterator[None]:
        """Press down where the gripper is, move along the table to a point, and keep pressing."""
        deep, begin = 0.0, self.end_effector(arm)[0]
        along, way = 0.0, end[:2] - begin[:2]
        length_m = float(np.sqrt((way * way).sum()))
        for _ in range(80):
            reader = arm.item.robot.end_effectors[arm.item.arm]
            force = -float(reader.external_wrench(self.simulation.data)[2])
            deep = min(max(deep + _GIVE_M_N * (_PRESS_N - force), -0.005), 0.02)
            if force > _PRESSES_N:
                along = min(along + 0.012, length_m)
            arm.position = np.array([*(begin[:2] + way * (along / length_m)), end[2] - deep])
            yield
            here = self.end_effector(arm)[0][:2] - end[:2]
            if (here * here).sum() < 0.008 ** 2:
                return


#: An end effector nearer than this is there [m].
NEAR_M = 0.02
#: The points are in a box of these half extents, whose middle is this high above the table [m].
_POINT_BOX, _POINT_HEIGHT_M = np.array([0.12, 0.15, 0.1]), 0.2


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
        middle = self.work_area + [0.0, 0.0, _POINT_HEIGHT_M]
        move_mocap(simulation, 'goal', draw(random, middle - _POINT_BOX, middle + _POINT_BOX))

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
