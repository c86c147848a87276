# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Run control periods: intervals of physics, before each of which control acts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from manip_sim.arrays import IntArray
from manip_sim.control.law.arm_records import MOST_SOLUTIONS
from manip_sim.errors import DivergenceError
from manip_sim.physics.clock import Clock
from manip_sim.physics.free_base import FreeRoots
from manip_sim.physics.physics_steps import PhysicsSteps
from manip_sim.physics.pulls import Pulls
from manip_sim.simulation.robot import RobotRun, SimulatedRobot

#: Longest interval in which moving setpoints are linear [s].
_INTERVAL_S = 0.004
#: Of how many lengths of periods the intervals are kept.
_REMEMBERED = 64
#: Compiled code runs so many steps at most, as there is room for notes of each.
_MOST_STEPS = 1000


class ControlPeriods:
    """
    The way from the commands of robots through a control period.

    :param steps: runs the physics
    :param robots: whose control acts, by name
    :param free_roots: the weight of free robots
    :param pulls: on bodies, for a number of periods
    :param clock: of the simulation
    :param timestep_s: length of a physics step [s]
    :ivar diverged: why the physics is on hold, or None
    """

    def __init__(self, steps: PhysicsSteps, robots: Mapping[str, SimulatedRobot],
                 free_roots: FreeRoots, pulls: Pulls, clock: Clock, timestep_s: float) -> None:
        self._steps, self._robots_by_name = steps, robots
        self._free_roots, self._pulls, self._clock = free_roots, pulls, clock
        self._timestep_s = timestep_s
        self.diverged: str | None = None
        self.look_at_robots()
        self._interval_steps = max(1, round(_INTERVAL_S / timestep_s))
        self._cuts: dict[int, IntArray] = {}
        #: Steps left until a late command takes effect, or until the end of the period.
        self._left = 0
        #: Steps of the period after that.
        self._later = 0

    def look_at_robots(self) -> None:
        """Take over which robots there are now."""
        self._robots = tuple(self._robots_by_name.values())

    @property
    def idle(self) -> bool:
        """Whether nothing but physics happens until the next command."""
        return (self.diverged is None and not self._pulls
                and self._steps.resumes() and self.resting
                and not any([robot.sensing.settings.measures for robot in self._robots]))

    @property
    def resting(self) -> bool:
        """Whether control has nothing to do."""
        return not self._free_roots.is_needed and all([robot.resting for robot in self._robots])

    def advance(self, steps: int) -> None:
        """
        Run a control period.

        :param steps: number of physics steps of the period
        :raises DivergenceError: if the physics diverges, or is on hold
        """
        if not (self._begin(steps) and self._steps.run_untouched(steps)):
            self._run(steps)
        self._end(steps)
        self._check_not_diverged()

    def _begin(self, steps: int) -> bool:
        """Begin a period; return whether only physics happens in it, if nothing is touched."""
        self._check_not_diverged()
        if self._pulls:
            self._pulls.apply(steps * self._timestep_s)
        self._left = self._until_command(steps)
        self._later = steps - self._left
        self._begin_control(steps * self._timestep_s)
        self._plan_measuring(steps)
        return self._steps.begin() and self.resting and self._steps.stays_untouched

    def _begin_control(self, period_s: float) -> None:
        interval_s = self._chunk(self._left) * self._timestep_s
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
        return min([steps, *(arrival - now for robot in self._robots
                             if (arrival := robot.next_arrival(now)) is not None)])

    def _end(self, steps: int) -> None:
        """End a period; hold the last good state if the physics has diverged in it."""
        reason = self._steps.divergence.reason()
        if reason is None:
            self._steps.end_period(steps, steps * self._timestep_s)
            for robot in self._robots:
                if robot.sensing.settings.measures:
                    robot.reader.end_period(steps, steps * self._timestep_s)
            self._pulls.release()
        else:
            self._hold(reason)

    def run_idle(self, steps: int, periods: int) -> None:
        """
        Run several control periods at once; only while :attr:`idle`.

        :param steps: number of physics steps of a period
        :param periods: number of control periods
        :raises DivergenceError: if the physics diverges
        """
        physics = self._steps
        if physics.stays_untouched and all([tool.settled for tool in physics.tools]):
            physics.begin()
            if physics.run_untouched(steps * periods):
                if physics.divergence.reason() is None:
                    return
                physics.undo()
        # One by one, the periods show in which of them that happens.
        for _ in range(periods):
            self.advance(steps)

    def _hold(self, reason: str) -> None:
        self.diverged = f'the physics diverged at {self._clock.time_ns / 1e9:.3f} s: {reason}'
        self._steps.divergence.hold()
        self._pulls.release()
        self._steps.restart()

    def _check_not_diverged(self) -> None:
        if self.diverged is not None:
            raise DivergenceError(f'{self.diverged}; its last good state is held until reset()')

    def _run(self, steps: int) -> None:
        """Run a period, in parts each of which control begins; so do late commands."""
        self._steps.begin_run()
        while self._left or self._later:
            if not self._left:
                self._left = self._until_command(self._later)
                self._later -= self._left
                self._begin_control(steps * self._timestep_s)
            awake = [robot for robot in self._robots if not robot.resting]
            runs = self._begin_runs(awake)
            self._left -= self._run_law(awake, runs) if runs else self._tick(awake)
        self._steps.finish()

    def _begin_runs(self, awake: Sequence[SimulatedRobot]) -> list[RobotRun]:
        """Begin a run of compiled control and physics of robots, if there can be one."""
        if not awake or not self._steps.lets_laws_step or self._free_roots.is_needed:
            return []
        if not self._may_step(self._left):
            return []
        runs, intervals = [], self._cut(self._left)
        for robot in awake:
            run = robot.begin_run(intervals)
            if run is None:
                return []
            runs.append(run)
        return runs

    def _run_law(self, robots: Sequence[SimulatedRobot], runs: Sequence[RobotRun]) -> int:
        """Run intervals by the compiled law, as ticks would; return how many steps."""
        intervals = min([run.intervals for run in runs], key=len)
        if len(runs) == 1:
            steps, moved_s = self._run_alone(runs[0])
            robots[0].end_run(runs[0], moved_s)
        else:
            intervals = intervals[:MOST_SOLUTIONS]
            steps = int(intervals.sum())
            for robot, run, moved_s in zip(robots, runs, self._run_together(runs, intervals)):
                robot.end_run(run, moved_s)
        return steps

    def _run_alone(self, run: RobotRun) -> tuple[int, float]:
        """Run intervals of a robot; return how many steps, and when setpoints stopped to move."""
        from manip_sim.control.law.compiling import direct  # It imports numba.
        from manip_sim.control.law.period import run as run_intervals, Time
        physics, clock = self._steps, self._clock
        where, kinematics = physics.addresses, physics.scratch.kinematics
        notes = self._notes(self._left)
        steps, moved_s = direct(run_intervals)(
            where, Time(clock.control_steps, clock.step_ns, self._timestep_s), run.intervals,
            physics.take_resumes(), physics.arrays, kinematics, run.joints, run.targets,
            run.grippers, notes)
        self._took_steps(steps, notes)
        return steps, moved_s

    def _run_together(self, runs: Sequence[RobotRun], intervals: IntArray) -> list[float]:
        """Run intervals of several robots; return when the setpoints of each stopped to move."""
        from manip_sim.control.law.compiling import direct  # It imports numba.
        from manip_sim.control.law.period import act
        physics = self._steps
        where, kinematics = physics.addresses, physics.scratch.kinematics
        moved_s = [-1.0] * len(runs)
        for k, steps in enumerate(intervals.tolist()):
            now_s, duration_s = self._clock.control_s, steps * self._timestep_s
            for number, run in enumerate(runs):
                if direct(act)(where, k, now_s, duration_s, physics.arrays, kinematics,
                               run.joints, run.targets, run.grippers):
                    moved_s[number] = now_s + duration_s
            self._step(steps)
        return moved_s

    def _step(self, steps: int) -> None:
        """Run steps in compiled code."""
        from manip_sim.control.law.compiling import direct  # It imports numba.
        from manip_sim.control.law.stepping import step
        physics, notes = self._steps, self._notes(steps)
        direct(step)(physics.addresses, steps, physics.take_resumes(), notes)
        self._took_steps(steps, notes)

    def _tick(self, awake: Sequence[SimulatedRobot]) -> int:
        """Let robots act and run the physics until they act again; return how many steps."""
        steps = self._left
        if any([robot.moving for robot in awake]):
            steps = self._chunk(steps)
        for robot in awake:
            robot.tick(steps * self._timestep_s)
        physics, lifts = self._steps, self._free_roots.is_needed
        # Without a robot that acts, nothing is compiled.
        if awake and not lifts and physics.lets_laws_step and self._may_step(steps):
            self._step(steps)
        else:
            if lifts:
                self._free_roots.apply()
            physics.run((steps,))
        return steps

    def _may_step(self, steps: int) -> bool:
        """Return whether compiled code may run steps."""
        from manip_sim.control.law.stepping import may_step  # It imports numba.
        return steps <= _MOST_STEPS and may_step(self._steps.data)

    def _notes(self, steps: int) -> Any:
        """Return room for the notes of steps."""
        from manip_sim.control.law.stepping import notes_of  # It imports numba.
        physics = self._steps
        key = physics.data._address, steps  # A copy of this world has other data.
        notes = physics.notes.get(key)
        if notes is None:
            if len(physics.notes) == _REMEMBERED:
                physics.notes.clear()
            notes = physics.notes[key] = notes_of(physics.data, physics.tool_bodies, steps)
        return notes

    def _took_steps(self, steps: int, notes: Any) -> None:
        self._steps.took_steps(
            steps, bool(notes.present[1]), notes.counts, notes.rows, notes.roots)

    def _chunk(self, left: int) -> int:
        """Return the steps of the next interval; they divide what is left of a period evenly."""
        return -(-left // -(-left // self._interval_steps))

    def _cut(self, steps: int) -> IntArray:
        """Return the steps of all intervals in which setpoints move, of what is left."""
        if steps not in self._cuts:
            if len(self._cuts) == _REMEMBERED:
                self._cuts.clear()
            chunks, left = [], steps
            while left:
                chunks.append(self._chunk(left))
                left -= chunks[-1]
            self._cuts[steps] = np.array(chunks)
        return self._cuts[steps]


def _record(robots: Sequence[SimulatedRobot]) -> None:
    for robot in robots:
        robot.sensing.record()
