# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Control the robots of several worlds: many at once where they do the same, others alone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import contextlib

from manip_sim.control.cartesian.cartesian_commands import CartesianCommand
from manip_sim.simulation import SimulatedRobot, Simulation
from manip_sim.simulation.control_period import Interval
from manip_sim.worlds.joint_rows import JointRows, takes

#: With fewer worlds, one by one is as fast.
_LEAST = 3


def has_cartesian_commands(simulation: Simulation) -> bool:
    """Return whether a robot has Cartesian commands, for which control acts in each interval."""
    return any([isinstance(command, CartesianCommand) for robot in simulation.robots.values()
                for command in robot.joints.commands.running])


class ControlTogether:
    """
    The control of robots in several worlds.

    :ivar planned: whether joints of several worlds followed plans in the last period
    """

    def __init__(self) -> None:
        self._began = self.planned = False
        #: By id of the robot, which rows its joints are in.
        self._rows_of: dict[int, JointRows] = {}

    @contextlib.contextmanager
    def period(self) -> Iterator[None]:
        """Control one period; at its end all joints are given back to their controllers."""
        self._began = self.planned = False
        try:
            yield
        finally:
            for rows in set(self._rows_of.values()):
                rows.release()
            self._rows_of.clear()

    def run(self, intervals: Sequence[Interval]) -> None:
        """Write the controls of the next interval of each world."""
        if not self._began:
            self._began = True
            self._begin([robot for interval in intervals for robot in interval.robots])
        arrived: list[SimulatedRobot] = []
        ticked: set[JointRows] = set()
        for interval in intervals:
            for robot in interval.robots:
                rows = self._rows_of.get(id(robot))
                if rows is None:
                    robot.tick(interval.duration_s)
                    continue
                if rows not in ticked:
                    ticked.add(rows)
                    arrived += rows.tick(interval.duration_s)
                    self.planned |= rows.planned
                robot.tick_grippers(interval.duration_s)
        for robot in arrived:
            del self._rows_of[id(robot)]

    def _begin(self, robots: Sequence[SimulatedRobot]) -> None:
        """Find robots that can be controlled together: of one name, in models of one size."""
        groups: dict[object, list[SimulatedRobot]] = {}
        for robot in robots:
            if takes(robot.joints) and not robot.has_late_commands:
                physics = robot._physics
                key = robot.name, len(physics.qpos), len(physics.qvel), len(physics.act)
                groups.setdefault(key, []).append(robot)
        for group in groups.values():
            if len(group) >= _LEAST:
                rows = JointRows(group)
                self._rows_of.update((id(robot), rows) for robot in group)
