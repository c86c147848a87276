# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Run control periods: intervals of physics, before each of which control acts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.control.planned_controls import PlannedRates
from manip_sim.errors import DivergenceError
from manip_sim.physics.clock import Clock
from manip_sim.physics.free_base import FreeRoots
from manip_sim.physics.physics_steps import PhysicsSteps
from manip_sim.physics.pulls import Pulls
from manip_sim.simulation.robot import SimulatedRobot

#: Longest interval in which moving setpoints are linear [s].
_INTERVAL_S = 0.004
#: Of how many lengths of periods the intervals are kept.
_REMEMBERED = 64
#: Compiled code runs so many steps at most, as there is room for notes of each.
_MOST_STEPS = 1000
_NOTHING = PlannedRates(np.zeros(0, dtype=np.int64), np.zeros((0, 0)))


class Interval:
    """
    An interval of a control period: what control has to do in it, and then physics.

    :param robots: whose controls are written
    :param duration_s: length of the interval [s]
    :param compute: computes the physics of this interval, and of those after it for which control
        is planned; it may be called in another thread, and spends most of its time without
        Python's global interpreter lock
    """

    __slots__ = ('robots', 'duration_s', 'compute')

    def __init__(self, robots: Sequence[SimulatedRobot], duration_s: float,
                 compute: Callable[[], object]) -> None:
        self.robots, self.duration_s, self.compute = robots, duration_s, compute

    def control(self) -> None:
        """Write the controls."""
        for robot in self.robots:
            robot.tick(self.duration_s)

    def run(self) -> None:
        """Run control and physics."""
        self.control()
        self.compute()


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
        #: When the intervals of a control period end, by its number of steps: the last one used.
        self._ends_of: dict[int, FloatArray] = {}
        self._cuts: dict[int, tuple[int, ...]] = {}
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
            for interval in self._intervals(steps):
                interval.run()
        self._end(steps)
        self._check_not_diverged()

    def run(self, steps: int) -> Iterator[Interval]:
        """
        Begin a control period, yield its intervals, and end it.

        Each interval has to be run before the next one is asked for.

        :param steps: number of physics steps of the period
        :raises DivergenceError: if the physics diverges, or is on hold
        """
        untouched = self._begin(steps)
        if untouched:
            yield Interval((), steps * self._timestep_s, partial(
                self._steps.run_untouched, steps))
        if not (untouched and self._steps.was_untouched):
            yield from self._intervals(steps)
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
        ends_s = self.ends_s(self._left)
        for robot in self._robots:
            robot.begin_period(period_s, ends_s)

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

    def run_planned(self, steps: int, plan: PlannedRates) -> None:
        """
        Run a whole control period in which control only writes what was planned.

        If the physics diverges, :attr:`diverged` tells why.

        :param steps: number of physics steps of the period
        :param plan: for all of its intervals
        """
        if self._pulls:
            self._pulls.apply(steps * self._timestep_s)
        self._plan_measuring(steps)
        self._steps.begin()
        self._steps.begin_run()
        self._run([plan], self._cut(steps))
        self._steps.finish()
        self._end(steps)

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

    def _intervals(self, steps: int) -> Iterator[Interval]:
        """Divide a period into intervals, each of which control begins; so do late commands."""
        self._steps.begin_run()
        while self._left or self._later:
            if not self._left:
                self._left = self._until_command(self._later)
                self._later -= self._left
                self._begin_control(steps * self._timestep_s)
            awake, chunk = [robot for robot in self._robots if not robot.resting], self._left
            if any([robot.moving for robot in awake]):
                chunk = self._chunk(chunk)
            yield Interval(awake, chunk * self._timestep_s, partial(self._compute, awake, chunk))

    def _compute(self, awake: Sequence[SimulatedRobot], steps: int) -> None:
        """
        Compute the physics of an interval, and of those after it for which control is planned.

        :param awake: robots whose control acts in it
        :param steps: of the interval
        """
        planned = min([robot.joints.planned for robot in awake], default=1)
        if planned > 1 and steps < self._left:
            chunks = self._cut(self._left)[:planned]
            steps = sum(chunks)
            self._run_plans([robot.joints.plan.take(planned) for robot in awake], chunks, awake)
        else:
            self._run((), (steps,), bool(awake))
            if steps < self._left and len(awake) == 1:
                steps += self._exert(awake[0], self._cut(self._left - steps))
        self._left -= steps
        if not (self._left or self._later):
            self._steps.finish()

    def _run_plans(self, plans: Sequence[PlannedRates], chunks: Sequence[int],
                   awake: Sequence[SimulatedRobot]) -> None:
        """Run intervals as planned for joints; before each of them, grippers that move act."""
        done = 0
        while done < len(chunks):
            moves = any([robot.grippers_move for robot in awake])
            end = done + 1 if moves else len(chunks)
            self._run([PlannedRates(where, rates[done:end]) for where, rates in plans],
                      chunks[done:end])
            done = end
            if moves and done < len(chunks):
                for robot in awake:
                    robot.tick_grippers(chunks[done] * self._timestep_s)

    def _exert(self, robot: SimulatedRobot, intervals: Sequence[int]) -> int:
        """
        Run intervals in compiled code in which joints follow operational space control of an arm.

        Grippers that move act before each of them.

        :returns: how many steps were run
        """
        command, done = robot.joints.exerts_alone, 0
        if command is None or not self._steps.lets_laws_step or self._free_roots.is_needed:
            return 0
        while intervals:
            chunks = intervals[:1] if robot.grippers_move else intervals
            steps, last_s = sum(chunks), chunks[-1] * self._timestep_s
            notes = self._notes(steps)
            if notes is None:
                break
            robot.tick_grippers(last_s)
            begin_s = self._clock.in_steps_s(steps - chunks[-1])
            robot.joints.step(command, np.array(chunks), notes, (begin_s, last_s))
            self._took_steps(steps, notes)
            intervals, done = intervals[len(chunks):], done + steps
        return done

    def _notes(self, steps: int) -> Any:
        """Return empty notes for steps, or None where compiled code cannot run them."""
        from manip_sim.control.law.stepping import may_step, notes_of  # It imports numba.
        physics = self._steps
        if steps > _MOST_STEPS or not may_step(physics.data):
            return None
        key = physics.data._address, steps  # A copy of this world has other data.
        notes = physics.notes.get(key)
        if notes is None:
            if len(physics.notes) == _REMEMBERED:
                physics.notes.clear()
            notes = physics.notes[key] = notes_of(physics.data, physics.tool_bodies, steps)
        notes.present[:], notes.counts[:] = (physics.contacts, 0), 0
        return notes

    def _took_steps(self, steps: int, notes: Any) -> None:
        self._steps.took_steps(
            steps, bool(notes.present[1]), notes.counts, notes.rows, notes.roots)

    def _run(self, plans: Sequence[PlannedRates], chunks: Sequence[int], by_law: bool = True
             ) -> None:
        """
        Run intervals, before each of which only what was planned is written.

        :param by_law: whether compiled laws may run them
        """
        lifts = self._free_roots.is_needed
        if lifts or not (by_law and self._steps.lets_laws_step and self._step(plans, chunks)):
            self._steps.run(self._written(plans, chunks) if plans or lifts else chunks)

    def _step(self, plans: Sequence[PlannedRates], chunks: Sequence[int]) -> bool:
        """Run intervals as planned in compiled code; return whether that is possible."""
        steps = sum(chunks)
        notes = self._notes(steps)
        if notes is None:
            return False
        from manip_sim.control.law.stepping import addresses, step_as_planned
        physics = self._steps
        where, rates = _NOTHING
        if plans:
            where, rates = plans[0] if len(plans) == 1 else (
                np.concatenate([plan.where for plan in plans]),
                np.concatenate([plan.rates for plan in plans], axis=1))
        step_as_planned(
            *addresses(physics.model, physics.data), physics.take_resumes(), np.array(chunks),
            physics.data.ctrl, where, rates, notes)
        self._took_steps(steps, notes)
        return True

    def _written(self, plans: Sequence[PlannedRates], chunks: Sequence[int]) -> Iterator[int]:
        """Write what was planned for each interval, and yield its steps."""
        lifts = self._free_roots.is_needed
        for number, chunk in enumerate(chunks):
            for where, rates in plans:
                self._steps.data.ctrl[where] = rates[number]
            if lifts:
                self._free_roots.apply()
            yield chunk

    def _chunk(self, left: int) -> int:
        """Return the steps of the next interval; they divide what is left of a period evenly."""
        return -(-left // -(-left // self._interval_steps))

    def _cut(self, steps: int) -> tuple[int, ...]:
        """Return the steps of all intervals in which setpoints move, of what is left."""
        if steps not in self._cuts:
            if len(self._cuts) == _REMEMBERED:
                self._cuts.clear()
            chunks, left = [], steps
            while left:
                chunks.append(self._chunk(left))
                left -= chunks[-1]
            self._cuts[steps] = tuple(chunks)
        return self._cuts[steps]

    def ends_s(self, steps: int) -> FloatArray:
        """Return when the intervals of a period end in which setpoints move [s], shape (k, 1)."""
        if steps not in self._ends_of:
            ends = np.cumsum(self._cut(steps))[:, None] * self._timestep_s
            self._ends_of = {steps: ends}
        return self._ends_of[steps]


def _record(robots: Sequence[SimulatedRobot]) -> None:
    for robot in robots:
        robot.sensing.record()
