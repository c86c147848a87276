# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Streams of positions for one robot in several worlds, kept in arrays over control periods.

Here is what joints do that follow plans through whole periods, while nothing else acts. Whoever
asks a controller for its setpoints or commands gets those of all rows back before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np

from manip_sim.arrays import BoolArray, FloatArray
from manip_sim.control.commands import JointSetpoint, Status
from manip_sim.control.joint_controller import JointController
from manip_sim.control.law.joint_records import records
from manip_sim.control.modes import POSITION
from manip_sim.control.planned_controls import PlannedRates
from manip_sim.simulation import SimulatedRobot, Simulation

#: With fewer worlds, one by one is as fast.
_LEAST = 3


class StreamRows:
    """
    The joints of the only robot of several worlds, each a row, while they are held here.

    :param simulations: the worlds, as :func:`stream_rows` has found them
    :ivar simulations: the same
    :ivar holds: whether the joints are held here
    """

    def __init__(self, simulations: Sequence[Simulation]) -> None:
        self.simulations = tuple(simulations)
        self._robots = [simulation.robot for simulation in simulations]
        self._physics = [robot._physics for robot in self._robots]
        self._models = [physics.model for physics in self._physics]
        self._grippers = [gripper for robot in self._robots
                          for gripper in robot.grippers.values()]
        self._joints = [robot.joints for robot in self._robots]
        first = self._joints[0]
        self._names, self._everything = tuple(first.names), np.arange(len(first.names))
        self._low, self._high = first.clamps(self._everything).T
        #: Of all rows: simulation time, and the period that new goals are meant for.
        self._clock, self._period_s = self._robots[0]._clock, self._robots[0]._period_s
        self._ran_s = 0.0
        self._setpoints = [joints._setpoints for joints in self._joints]
        self._servos = [joints._servos for joints in self._joints]
        #: Until when setpoints were advanced before a plan.
        self._now_s = self._clock.control_s
        #: The records of all setpoints, shape (rows, n, fields).
        self._state = np.stack([setpoints._state for setpoints in self._setpoints])
        #: The goals that came last: those that wait, and those that were taken, and when.
        self._waiting: FloatArray | None = None
        self._taken: tuple[FloatArray, float] | None = None
        self.holds = True
        for joints in self._joints:
            joints.holder = self

    # ------------------------------------------------------------------ commands

    def accept(self, names: Sequence[str], goals: FloatArray, part: str | None,
               period_s: float | None) -> bool:
        """
        Return whether :meth:`command` may be called, as each robot would take goals as they are.

        :param names: of the joints
        :param goals: positions of them [rad or m], shape (rows, n)
        :param part: whose joints may be named; None for all
        :param period_s: length of a control period [s]; None for that of the last one
        """
        own = self._everything if part is None else self._joints[0]._indices_of.get(part)
        return (self._waiting is None and own is not None and len(own) == len(self._names)
                and isinstance(names, (list, tuple)) and tuple(names) == self._names
                and (period_s is None
                     or isinstance(period_s, float) and period_s == self._period_s)
                and goals.shape == (len(self._joints), len(names))
                and bool((np.isfinite(goals) & (goals >= self._low)
                          & (goals <= self._high)).all())
                and not any([robot.reflexes.tripped or robot.sensing.settings.delays_commands
                             for robot in self._robots]))

    def command(self, goals: FloatArray) -> None:
        """
        Let all joints of all rows come to goals, or follow a stream of them.

        :param goals: as for :meth:`accept`
        """
        if self._taken is None:
            for joints in self._joints:
                joints._ledger.end(Status.REPLACED)
        self._waiting = goals

    def give_back(self) -> None:
        """Bring setpoints and commands up to date in the controllers they belong to."""
        self.holds = False
        for joints in self._joints:
            joints.holder = None
        for setpoints, state in zip(self._setpoints, self._state):
            setpoints._state[:] = state
            setpoints.now_s = self._now_s
            setpoints.planned, setpoints.row = 1, 0
            setpoints.find_moving()
        if self._waiting is not None:
            for robot, command in self._commands(self._waiting):
                robot.joints.apply(
                    command, robot._physics.data, self._clock.control_s, self._period_s)
        elif self._taken is not None:
            goals, at_s = self._taken
            for robot, command in self._commands(goals):
                command.handle.status = Status.RUNNING
                robot.joints.commands.take(command)
                robot.joints.commands.begin(command)
                robot.joints._timeouts.renew(command.parts, at_s)

    def _commands(self, goals: FloatArray) -> Iterator[tuple[SimulatedRobot, JointSetpoint]]:
        """Yield each robot with its command for goals."""
        first = self._joints[0]
        parts = first.parts_of(self._everything)
        for robot, values in zip(self._robots, goals):
            yield robot, JointSetpoint(
                robot=robot.robot_model, parts=parts, indices=self._everything,
                modes=first.modes, values=values.copy())

    # ------------------------------------------------------------------ control periods

    def begin_period(self, steps: int) -> list[Callable[[], None]] | None:
        """
        Control a whole period.

        :param steps: number of physics steps of the period
        :returns: what computes the physics of each world, in any threads; None if joints do
            something else, and are given back, with nothing done
        """
        rates = self._plan(steps) if self._undisturbed() else None
        if rates is None:
            self.give_back()
            return None
        return [partial(simulation._periods.run_planned, steps,
                        PlannedRates(joints._servos.controls, own))
                for simulation, joints, own in zip(self.simulations, self._joints, rates)]

    def _undisturbed(self) -> bool:
        """Return whether only the joints move, in the models that there were."""
        return (all([of.model is model for of, model in zip(self._physics, self._models)])
                and not any([gripper.moving for gripper in self._grippers]))

    def _plan(self, steps: int) -> FloatArray | None:
        """Return the rates of servos in the intervals of a period, or None without a plan."""
        from manip_sim.control.law.setpoint_motion import advance_rows  # It imports numba.
        from manip_sim.control.law.stream_timing import wait
        now_s, ends_s = self._clock.control_s, self.simulations[0]._periods.ends_s(steps)[:, 0]
        before, joints = self._state.copy(), records(self._state)
        if self._waiting is not None:
            for row, goals in zip(joints, self._waiting):
                wait(row, self._everything, goals, self._period_s, 1.0, 0.0, False)
        states = np.empty((len(joints), len(ends_s), *self._state.shape[1:]))
        ahead, now = records(states), np.full(len(joints), now_s)
        rates = None
        if len(ends_s) > 1 and advance_rows(joints, ahead, now, ends_s):
            rates = self._rates(ahead, ends_s)
        if rates is None:
            self._state = before
            return None
        if self._waiting is not None:
            self._taken, self._waiting = (self._waiting, now_s), None
        self._follow(states)
        self._now_s = now_s + float(ends_s[0])
        period_s = steps * self.simulations[0].timestep_s
        if period_s != self._ran_s:
            self._ran_s = self._period_s = period_s
            for robot in self._robots:
                robot._period_s = robot.joints.cartesian.period_s = period_s
        return rates

    def _rates(self, ahead: Any, ends_s: FloatArray) -> FloatArray | None:
        """Return the rates of servos, (rows, k, n), or None where joints have to be watched."""
        rates = np.empty(ahead.shape)
        for row, servos in enumerate(self._servos):
            found = servos.find_rates(ahead[row, 0], ahead[row], ends_s)
            if len(found) < len(ends_s):
                return None
            rates[row] = found
        return rates

    def _follow(self, states: FloatArray) -> None:
        """Take over where a plan ends, and count what has been limited and lost."""
        first = records(states[:, 0])
        for setpoints, joints in zip(self._setpoints, first):
            if np.count_nonzero(joints['limited']) or np.count_nonzero(joints['lost']):
                setpoints.limited += joints['limited'].astype(np.int64)
                setpoints.lost += joints['lost'].astype(np.int64)
        self._state = states[:, -1].copy()
        joints = records(self._state)
        joints['limited'] = joints['lost'] = 0.0


def takes(joints: JointController) -> bool:
    """Return whether joints do nothing but follow setpoints, until the next command."""
    return (joints._setpoints.moving and not joints._efforts_due
            and not joints.commands.waiting and not joints._servos._sources
            and all([type(command) is JointSetpoint for command in joints.commands.running]))


def stream_rows(simulations: Iterable[Simulation]) -> StreamRows | None:
    """
    Return the worlds whose robots follow streams in step, as rows that hold them, if any.

    :param simulations: worlds that begin a control period
    """
    groups: dict[object, list[Simulation]] = {}
    for simulation in simulations:
        if len(simulation.robots) == 1:
            key = _stream_of(simulation.robot)
            if key is not None:
                groups.setdefault(key, []).append(simulation)
    largest = max(groups.values(), key=len, default=[])
    return StreamRows(largest) if len(largest) >= _LEAST else None


def _stream_of(robot: SimulatedRobot) -> object:
    """Return what is the same for robots that follow a stream in step, None for others."""
    joints, physics = robot.joints, robot._physics
    everything = np.arange(len(joints.names))
    running = joints.commands.running
    if (len(running) != 1 or not isinstance(running[0], JointSetpoint)
            or not np.array_equal(running[0].indices, everything)
            or set(joints.modes) != {POSITION.name} or not takes(joints)
            or robot._late or robot.reflexes.armed or joints._timeouts.pending
            or joints._setpoints.at_rest(everything)):
        return None
    return (robot.name, robot._clock.control_steps, robot._period_s, len(physics.qpos),
            len(physics.qvel), len(physics.act))


class Streams:
    """
    The streams of several worlds that are held in rows, if any.

    :param simulations: all worlds
    :ivar likely: whether it is worth while to look for some
    """

    def __init__(self, simulations: Sequence[Simulation]) -> None:
        self._world_of = {id(simulation): world for world, simulation in enumerate(simulations)}
        self._rows: StreamRows | None = None
        #: The worlds of the rows.
        self._worlds = np.zeros(0, dtype=np.int64)
        self.likely = False

    def begin_period(self, simulations: list[Simulation], steps: int
                     ) -> tuple[list[Callable[[], None]], list[Simulation]]:
        """
        Control a period of the worlds whose streams are held in rows, or can be.

        :param simulations: worlds that begin a period
        :param steps: number of physics steps of the period
        :returns: what computes the physics of some of them, and the others
        """
        if self._rows is not None and not {*self._rows.simulations} <= {*simulations}:
            self._rows.give_back()
        if (self._rows is None or not self._rows.holds) and self.likely:
            self._rows = stream_rows(simulations)
        rows = self._rows
        physics = rows.begin_period(steps) if rows is not None and rows.holds else None
        self.likely = physics is not None
        if rows is None or physics is None:
            self._rows = None
            return [], simulations
        self._worlds = np.array([self._world_of[id(held)] for held in rows.simulations])
        held = {*rows.simulations}
        return physics, [other for other in simulations if other not in held]

    def command(self, names: Sequence[str], goals: FloatArray, part: str | None,
                mask: BoolArray, period_s: float | None) -> Callable[[], None] | None:
        """
        Return what commands goals in the worlds that are held, all of which it is for, if any.

        :param goals: positions, shape (count, n)
        :param mask: the worlds that it is for, shape (count,), of which these are taken out
        """
        rows, worlds = self._rows, self._worlds
        if rows is None or not rows.holds or not mask[worlds].all():
            return None
        own = goals[worlds]
        if not rows.accept(names, own, part, period_s):
            return None
        mask[worlds] = False
        return partial(rows.command, own)
