# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The task to wipe dirt off a table."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from manip_sim.arrays import BoolArray, FloatArray
from manip_sim.models.arenas import Arena
from manip_sim.physics.contacts import read_contacts
from manip_sim.simulation import Simulation
from manip_sim.tasks.expert import Expert, Hold, pointing_down
from manip_sim.tasks.grasping import bodies_of_gripper
from manip_sim.tasks.placing import draw, move_mocap, nearness
from manip_sim.tasks.task import Task, TOO_SHORT

#: Rows and columns of spots, the distance between them, and how far each may be off [m].
_ROWS, _COLUMNS, _APART_M, _OFF_M = 4, 3, 0.05, 0.015
#: Their middle is within this of the middle of the work area [m].
_HALF_AREA = np.array([0.04, 0.06])
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
        middle[:2] += draw(random, -_HALF_AREA, _HALF_AREA)
        for number in range(_ROWS * _COLUMNS):
            row, column = divmod(number, _COLUMNS)
            place = np.array([row - (_ROWS - 1) / 2.0, column - (_COLUMNS - 1) / 2.0])
            off = draw(random, [-_OFF_M] * 2, [_OFF_M] * 2)
            move_mocap(simulation, f'spot{number}',
                       middle + [*(place * _APART_M + off), 0.0])

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
