# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Control the joints of one robot in several worlds at once, where they follow setpoints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from manip_sim.control.commands import JointSetpoint
from manip_sim.control.joint_controller import JointController
from manip_sim.control.motion_profiles import Plan
from manip_sim.simulation import SimulatedRobot
from manip_sim.worlds.servo_rows import ServoRows
from manip_sim.worlds.setpoint_rows import SetpointRows


def takes(joints: JointController) -> bool:
    """Return whether :class:`JointRows` can control joints until the next command."""
    return (joints._setpoints.moving and not joints._efforts_due
            and not joints.commands.waiting and not joints._servos._sources
            and all([type(command) is JointSetpoint for command in joints.commands.running]))


class JointRows:
    """
    The joints of one robot in several worlds, each a row, in one control period.

    :param robots: the robot in each of these worlds, whose joints are those that :func:`takes`
        accepts, in models of the same size
    :ivar planned: whether joints of several robots have begun to follow plans
    """

    def __init__(self, robots: Sequence[SimulatedRobot]) -> None:
        self._robots = robots
        self._clocks = [robot._clock for robot in robots]
        self._own = [True] * len(robots)
        self.planned = False
        generators = []
        for robot, clock in zip(robots, self._clocks):
            generators.append(robot.joints._setpoints)
            robot.joints._setpoints.now_s = clock.control_s
            robot.joints._written = True
        self._setpoints = SetpointRows(generators)
        self._servos = ServoRows(robots)

    def release(self) -> None:
        """Give the joints back to their controllers."""
        self._setpoints.release([row for row, own in enumerate(self._own) if own])
        self._own = [False] * len(self._own)

    def tick(self, duration_s: float) -> list[SimulatedRobot]:
        """
        Write the controls of the next interval.

        :param duration_s: length of the interval [s]
        :returns: robots whose setpoints have come to rest, or follow a plan for the rest of the
            period, so their joints were given back
        """
        setpoints, servos = self._setpoints, self._servos
        setpoints.set_time(np.array([clock.control_s for clock in self._clocks]))
        setpoints.advance(duration_s)
        setpoints.hold_back(servos.measured(duration_s), servos.lead)
        plans = {row: plan for row, plan in setpoints.plans.items() if self._own[row]}
        if len(plans) < sum(self._own):
            rates = servos.rates(range(len(self._own)), np.asarray(duration_s), *(
                of[:, None] for of in (
                    setpoints.position, setpoints.velocity, setpoints.acceleration)))
            for row, (own, rate) in enumerate(zip(self._own, rates[:, 0])):
                if own and row not in plans:
                    servos.write(row, rate)
        if setpoints.moves.all() and not plans:
            return []
        done = [row for row, (own, moves) in enumerate(zip(self._own, setpoints.moves))
                if own and (row in plans or not moves)]
        setpoints.release(done)
        for row in done:
            self._own[row] = False
        self._begin_plans(plans)
        self.planned |= len(plans) > 1
        return [self._robots[row] for row in done]

    def _begin_plans(self, plans: Mapping[int, Plan]) -> None:
        """Let robots follow plans, by row, which have been released; compute what servos need."""
        # Where the period has been cut differently, they differ in their number of intervals.
        for count in {len(plan.positions) for plan in plans.values()}:
            rows = [row for row, plan in plans.items() if len(plan.positions) == count]
            durations, position, velocity, acceleration = (
                np.stack(of) for of in zip(*(plans[row] for row in rows)))
            rates = self._servos.rates(rows, durations, position, velocity, acceleration)
            for row, own in zip(rows, rates):
                self._robots[row].joints.plan.begin(own)
