# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Run control periods: intervals of physics, before each of which control acts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache, partial

import numpy as np

from manip_sim.arrays import IntArray
from manip_sim.control.robot_runs import RobotRun
from manip_sim.errors import CommandError, DivergenceError
from manip_sim.physics.clock import Clock
from manip_sim.physics.physics import BECAME, ENDED, PERIODS, ROW, STEPS, STOOD, WENT_ON
from manip_sim.physics.physics_steps import PhysicsSteps
from manip_sim.physics.state_dependent_terms import FloatingBases, SpringForces
from manip_sim.simulation.compiled_period import (
    ALONE, CompiledPeriod, go_on, is_loaded, MOST_STEPS)
from manip_sim.simulation.robot import SimulatedRobot
from manip_sim.validation import whole_number

#: Longest interval in which moving setpoints are linear [s].
_INTERVAL_S = 0.004


class ControlPeriods:
    """
    The way from the commands of robots through a control period.

    :param steps: runs the physics
    :param robots: whose control acts, by name
    :param floating_bases: the weight of free robots
    :param pulls: on bodies, for a number of periods
    :param clock: of the simulation
    :param timestep_s: length of a physics step [s]
    :ivar diverged: why the physics is on hold, or None
    :ivar compiled: what compiled code runs
    """

    def __init__(self, steps: PhysicsSteps, robots: Mapping[str, SimulatedRobot],
                 floating_bases: FloatingBases, pulls: SpringForces, clock: Clock,
                 timestep_s: float) -> None:
        self._steps, self._robots_by_name = steps, robots
        self._floating_bases, self._pulls, self._clock = floating_bases, pulls, clock
        self._timestep_s = timestep_s
        self.diverged: str | None = None
        self.sync_robots()
        self._interval_steps = max(1, round(_INTERVAL_S / timestep_s))
        self.compiled = CompiledPeriod(steps, floating_bases, clock, timestep_s)
        #: The robots and runs that it was prepared for; true if a period ends with them.
        self._prepared: tuple[
            Sequence[SimulatedRobot], Sequence[RobotRun], bool] | None = None
        #: Robots and intervals that compiled code goes on with by itself.
        self._standing: tuple[Sequence[SimulatedRobot], Sequence[RobotRun]] = (), ()
        steps.physics.catch_up = self._catch_up
        #: Of this period: whether it has begun for the physics, whether all of its last instant is
        #: computed, and whether that is known to be good.
        self._begun = self._is_computed = self._is_good = False
        #: Steps left until a late command takes effect, or until the end of the period.
        self._left = 0
        #: Steps of the period after that.
        self._later = 0

    def sync_robots(self) -> None:
        """Take over which robots there are now."""
        self._robots = tuple(self._robots_by_name.values())
        #: Robots whose momentum is observed.
        self._observed: tuple[SimulatedRobot, ...] = ()

    @property
    def idle(self) -> bool:
        """True if nothing but physics happens until the next command."""
        if self.diverged is not None or self._pulls:
            return False
        if self._steps.physics.standing.item(STEPS):
            return not self._standing[0]
        return not (self._awake()
                    or any([robot.sensing.settings.measures for robot in self._robots]))

    def advance(self, steps: int) -> None:
        """
        Run a control period.

        :param steps: number of physics steps of the period
        :raises CommandError: if that is not a whole number from 1
        :raises DivergenceError: if the physics diverges, or is on hold
        """
        steps = whole_number(steps, 1, 'steps', CommandError)
        physics = self._steps.physics
        if physics.standing.item(STEPS) == steps:
            go_on(physics.standing[ROW:ROW + 1], physics.standing[None], ALONE, steps,
                  physics.scratch)
            became = physics.standing.item(BECAME)
            if became == WENT_ON:
                return
            if became == ENDED:
                self.end_standing(steps)
                return
        if self.begin(steps):
            self.compiled.run()
        self.end(steps)

    def end_standing(self, steps: int) -> None:
        """
        End a control period in which compiled code has gone on by itself.

        :param steps: number of physics steps of the period
        :raises DivergenceError: if the physics has diverged in it
        """
        physics = self._steps.physics
        physics.interrupt()
        physics.standing[BECAME] = STOOD
        for tool in self._steps.tools:
            tool.begin_period()
        self._left, self._later, self._begun = steps, 0, True
        self._is_computed = self._is_good = False
        self._prepared = (*self._standing, True)
        self.end(steps)

    def _catch_up(self) -> None:
        """Take over what compiled code has done by itself."""
        standing, clock, begin_s = self._steps.physics.standing, self._clock, None
        if standing.item(PERIODS):
            begin_s = (clock.control_steps - standing.item(STEPS)) * clock.step_ns * 1e-9
        for tool in self._steps.tools:
            tool.catch_up()
        acting = dict(zip(*self._standing))
        for robot in self._robots:
            robot.runs.catch_up(acting.get(robot), begin_s)

    def begin(self, steps: int) -> bool:
        """
        Begin a control period, and run it unless compiled code can run all of it.

        :param steps: number of physics steps of the period
        :returns: whether :attr:`compiled` is prepared and has yet to run
        :raises DivergenceError: if the physics is on hold
        """
        self._check_not_diverged()
        self._steps.physics.interrupt()
        observed = tuple([robot for robot in self._robots if robot.reflexes.observes])
        if observed != self._observed:
            self._observed = observed
            self._steps.watch_forces([robot.reflexes.collisions.forces for robot in observed])
        if self._pulls:
            self._pulls.apply(steps * self._timestep_s)
        self._prepared, self._is_computed, self._is_good = None, False, False
        self._left, self._later, self._steps.measuring = steps, 0, {}
        if any([robot.has_latency for robot in self._robots]):
            self._plan_measuring(steps)
            self._left = self._until_command(steps)
            self._later = steps - self._left
            if self._later:
                self._steps.keep_measured()
        self._begin_control(steps * self._timestep_s)
        self._begun = False
        self._steps.begin_run()
        return self._run(steps, self._awake(), waits=True)

    def end(self, steps: int) -> None:
        """
        End a control period that has run.

        :param steps: number of physics steps of the period
        :raises DivergenceError: if the physics has diverged in it
        """
        if self._prepared is not None:
            acting, runs, _ = self._prepared
            self._take_over()
            if self._is_good:
                self._stand(steps, acting, runs)
            else:
                self._run(steps, self._awake())
        self._end(steps)
        self._check_not_diverged()

    def _stand(self, steps: int, acting: Sequence[SimulatedRobot], runs: Sequence[RobotRun]
               ) -> None:
        """Let compiled code go on by itself like in the last period, if it may."""
        if not all([robot.may_stand and robot.runs.stand(run)
                    for robot, run in zip(acting, runs)]):
            return
        if self._steps.goes_on and not self._pulls and all([
                robot in acting or robot.resting and robot.may_stand for robot in self._robots]):
            self._standing = acting, runs
            standing = dict(zip(acting, runs))
            for robot in self._robots:
                robot.runs.standing = standing.get(robot)
            self.compiled.stand(steps, len(acting) > 0)

    def _begin_control(self, period_s: float) -> None:
        interval_s = _chunk(self._left, self._interval_steps) * self._timestep_s
        for robot in self._robots:
            robot.begin_period(period_s, interval_s)

    def _plan_measuring(self, steps: int) -> None:
        """Plan the measurements within a period, which arrive at the end of a later one."""
        late: dict[int, list[SimulatedRobot]] = {}
        for robot in self._robots:
            after = robot.sensing.steps_to_measuring(steps)
            if after is not None and after < steps:
                late.setdefault(after, []).append(robot)
        self._steps.measuring = {
            after: partial(_record, robots) for after, robots in late.items()}

    def _until_command(self, steps: int) -> int:
        """Return after how many of some steps the next late command takes effect, or all."""
        now = self._clock.control_steps
        return min([steps, *(robot.next_arrival(now, now + steps) - now
                             for robot in self._robots)])

    def _end(self, steps: int) -> None:
        """End a period; hold the last good state if the physics has diverged in it."""
        divergence, period_s = self._steps.divergence, steps * self._timestep_s
        reason = None if self._is_good else divergence.reason()
        if reason is not None:
            self.diverged = f'the physics diverged at {self._clock.time_ns / 1e9:.3f} s: {reason}'
            divergence.hold()
            self._pulls.release()
            self._steps.restart()
            return
        self._steps.end_period(steps, period_s)
        for robot in self._observed:
            robot.reflexes.collisions.observe(self._steps.physics.data, period_s)
        for robot in self._robots:
            if robot.sensing.settings.measures:
                robot.reader.end_period(steps, period_s)
            robot.faults.measure()
        self._pulls.release()

    def _check_not_diverged(self) -> None:
        if self.diverged is not None:
            raise DivergenceError(f'{self.diverged}; its last good state is held until reset()')

    def _awake(self) -> list[SimulatedRobot]:
        """Return the robots that act."""
        return [robot for robot in self._robots if not robot.resting]

    def _run(self, steps: int, awake: Sequence[SimulatedRobot], waits: bool = False) -> bool:
        """
        Run the rest of a period, in parts each of which control begins; so do late commands.

        :param steps: of the period
        :param awake: the robots that act now
        :param waits: whether all of it is left to compiled code, where that can run it at once
        :returns: whether it is
        """
        while self._left or self._later:
            if not self._left:
                self._left = self._until_command(self._later)
                self._later -= self._left
                self._begin_control(steps * self._timestep_s)
                awake = self._awake()
            steps_by_law = self._lets_laws_step(awake)
            intervals = _cut(self._left, self._interval_steps)[:None if steps_by_law else 1]
            runs = [robot.runs.begin(intervals) for robot in awake]
            if not steps_by_law:
                self._step_in_python(awake, runs)
            elif self._prepare(awake, runs) and waits:
                return True
            else:
                self.compiled.run()
                self._take_over()
            awake = self._awake() if self._left else awake
        if not self._is_computed:
            self._steps.finish()
        return False

    def _lets_laws_step(self, awake: Sequence[SimulatedRobot]) -> bool:
        """Return whether compiled code runs the next steps."""
        # Without a robot that acts, nothing is compiled.
        return ((len(awake) > 0 or is_loaded()) and self._steps.lets_laws_step
                and self.compiled.may_step)

    def _prepare(self, robots: Sequence[SimulatedRobot], runs: Sequence[RobotRun]) -> bool:
        """Prepare compiled code for robots; return whether it runs the whole period."""
        whole = _cut(self._left, self._interval_steps)
        intervals = min([whole, *[run.intervals for run in runs]], key=len)
        if self._left > MOST_STEPS:
            intervals = intervals[:max(1, np.searchsorted(intervals.cumsum(), MOST_STEPS))]
        begins = not self._begun
        ends = (not self._later and len(intervals) == len(whole)
                and self._steps.efforts.room is not None)
        self.compiled.prepare(runs, intervals, min(self._left, MOST_STEPS), begins, ends)
        self._prepared, self._begun = (robots, runs, ends), True
        return begins and ends

    def _take_over(self) -> None:
        """Take over what compiled code has done."""
        assert self._prepared is not None
        (robots, runs, ends), self._prepared = self._prepared, None
        for robot, run in zip(robots, runs):
            robot.runs.end(run, self._steps.places_at_begin)
            robot.check_laws()
        steps, good, notes = self.compiled.outcome()
        self._steps.took_steps(notes.counts, notes.rows, notes.roots)
        self._left -= steps
        if ends and not self._left:
            self._is_computed, self._is_good = True, good
            self._steps.end_by_law()

    def _step_in_python(self, awake: Sequence[SimulatedRobot], runs: Sequence[RobotRun]) -> None:
        """Let compiled code write the controls of an interval, and run its steps one by one."""
        if not self._begun:
            self._steps.begin()
            self._begun = True
        # The weight of free robots is given back in each interval.
        steps = self._left
        if len(self._floating_bases.dofs):
            steps = _chunk(steps, self._interval_steps)
        if runs:
            steps = int(min([run.intervals[0] for run in runs]))
            self.compiled.prepare(runs, np.array([steps]), steps, stepping=False)
            self.compiled.run()
        for robot in awake:
            robot.runs.begin_python_steps(steps)
        self._floating_bases.apply()
        self._steps.run((steps,))
        self._left -= steps
        for robot, run in zip(awake, runs):
            robot.runs.end(run, self._steps.places_at_begin)
            robot.check_laws()


def _chunk(left: int, longest: int) -> int:
    """Return the steps of the next interval; they divide the rest of a period evenly."""
    return -(-left // -(-left // longest))


@lru_cache
def _cut(steps: int, longest: int) -> IntArray:
    """Return the steps of all intervals in which setpoints move, of the rest of a period."""
    chunks, left = [], steps
    while left:
        chunks.append(_chunk(left, longest))
        left -= chunks[-1]
    return np.array(chunks)


def _record(robots: Sequence[SimulatedRobot]) -> None:
    for robot in robots:
        robot.sensing.record()
