# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Divide control periods into intervals of physics, before each of which control acts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.simulation.free_base import FreeRoots
from manip_sim.simulation.physics_steps import PhysicsSteps
from manip_sim.simulation.robot import SimulatedRobot

#: Longest interval in which moving setpoints are linear [s].
_INTERVAL_S = 0.004


class Interval:
    """
    An interval of a control period: what control has to do in it, and then physics.

    :param robots: whose controls are written
    :param duration_s: length of the interval [s]
    :param compute: computes the physics; it may be called in another thread, and spends most of
        its time without Python's global interpreter lock
    """

    __slots__ = ('robots', 'duration_s', 'compute')

    def __init__(self, robots: Sequence[SimulatedRobot], duration_s: float,
                 compute: Callable[[], None]) -> None:
        self.robots, self.duration_s, self.compute = robots, duration_s, compute

    def run(self) -> None:
        """Run control and physics."""
        for robot in self.robots:
            robot.tick(self.duration_s)
        self.compute()


class ControlPeriods:
    """
    The way from the commands of robots through a control period.

    :param steps: runs the physics
    :param robots: whose control acts
    :param free_roots: the weight of free robots
    :param timestep_s: length of a physics step [s]
    :ivar robots: the same; other ones may be assigned between two periods
    """

    def __init__(self, steps: PhysicsSteps, robots: Sequence[SimulatedRobot],
                 free_roots: FreeRoots, timestep_s: float) -> None:
        self._steps, self.robots = steps, tuple(robots)
        self._free_roots, self._timestep_s = free_roots, timestep_s
        self._interval_steps = max(1, round(_INTERVAL_S / timestep_s))
        #: When the intervals of a control period end, by its number of steps: the last one used.
        self._ends_of: dict[int, FloatArray] = {}

    @property
    def rest(self) -> bool:
        """Whether control has nothing to do."""
        return not self._free_roots.is_needed and all([robot.resting for robot in self.robots])

    def intervals(self, steps: int) -> Iterator[Interval]:
        """
        Begin a control period, and yield its intervals; each has to be run before the next.

        :param steps: number of physics steps of the period
        """
        period_s, ends_s = steps * self._timestep_s, self._ends_s(steps)
        for robot in self.robots:
            robot.begin_period(period_s, ends_s)
        physics = self._steps
        untouched = physics.begin() and self.rest and physics.stays_untouched
        if untouched:
            yield Interval((), period_s, partial(physics.run_untouched, steps))
            untouched = physics.was_untouched
            if not untouched:
                physics.undo()
        if not untouched:
            yield from self._intervals(steps)

    def _intervals(self, steps: int) -> Iterator[Interval]:
        """Divide a period into intervals, each of which control begins."""
        self._steps.begin_run()
        left = steps
        while left:
            awake = [robot for robot in self.robots if not robot.resting]
            if left < steps and awake and all([robot.plans for robot in awake]):
                yield Interval((), left * self._timestep_s,
                               partial(self._compute_plans, awake, left))
                return
            chunk = left
            if any([robot.moving for robot in awake]):
                chunk = self._chunk(left)
            left -= chunk
            yield Interval(awake, chunk * self._timestep_s,
                           partial(self._compute, chunk, not left))

    def _compute_plans(self, robots: Sequence[SimulatedRobot], left: int) -> None:
        """Compute the rest of a period, in whose intervals robots do what they have planned."""
        for writes in zip(*[robot.joints.take_plan() for robot in robots]):
            for write in writes:
                write()
            chunk = self._chunk(left)
            left -= chunk
            self._compute(chunk, not left)

    def _chunk(self, left: int) -> int:
        """Return the steps of the next interval; they divide what is left of a period evenly."""
        return -(-left // -(-left // self._interval_steps))

    def _ends_s(self, steps: int) -> FloatArray:
        """Return when the intervals of a period end in which setpoints move [s], shape (k, 1)."""
        if steps not in self._ends_of:
            ends, left = [], steps
            while left:
                left -= self._chunk(left)
                ends.append([(steps - left) * self._timestep_s])
            self._ends_of = {steps: np.array(ends)}
        return self._ends_of[steps]

    def _compute(self, steps: int, ends: bool) -> None:
        """Compute the physics of an interval, and all of the new instant if a period ends."""
        self._free_roots.apply()
        self._steps.run(steps)
        if ends:
            self._steps.finish()
