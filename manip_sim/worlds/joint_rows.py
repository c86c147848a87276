# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Control the joints of one robot in several worlds at once, where they follow setpoints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.simulation import SimulatedRobot
from manip_sim.simulation.commands import JointSetpoint
from manip_sim.simulation.joint_controller import JointController
from manip_sim.simulation.profiles import Plan
from manip_sim.worlds.setpoint_rows import SetpointRows
from manip_sim.worlds.shared_goals import take_goals


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
    """

    def __init__(self, robots: Sequence[SimulatedRobot]) -> None:
        self._robots = robots
        self._clocks = [robot._clock for robot in robots]
        self._physics = [robot._physics for robot in robots]
        self._own = [True] * len(robots)
        generators = []
        for robot, clock in zip(robots, self._clocks):
            generators.append(robot.joints._setpoints)
            robot.joints._setpoints.now_s = clock.control_s
            robot.joints._written = True
        shared = take_goals(generators)
        self._setpoints = SetpointRows(generators)
        for goals in shared:
            self._setpoints.take(goals)
        servos = [robot.joints._servos for robot in robots]
        self._servos, self._places = servos[0], servos[0]._places
        self._drag, self._stiffness, self._lead = (
            np.stack(of) for of in zip(*((s._drag, s._stiffness, s.lead) for s in servos)))

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
        setpoints, (_, _, activation, ids) = self._setpoints, self._places
        setpoints.set_time(np.array([clock.control_s for clock in self._clocks]))
        setpoints.advance(duration_s)
        setpoints.hold_back(self._measured(duration_s), self._lead)
        plans = {row: plan for row, plan in setpoints.plans.items() if self._own[row]}
        if len(plans) < sum(self._own):
            rates = self._goals(range(len(self._own)), *(of[:, None] for of in (
                setpoints.position, setpoints.velocity, setpoints.acceleration)))[:, 0]
            rates -= _stacked([physics.act for physics in self._physics])[:, activation]
            rates /= duration_s
            for row, (physics, own, rate) in enumerate(zip(self._physics, self._own, rates)):
                if own and row not in plans:
                    physics.ctrl[ids] = rate
        if setpoints.moves.all() and not plans:
            return []
        done = [row for row, (own, moves) in enumerate(zip(self._own, setpoints.moves))
                if own and (row in plans or not moves)]
        setpoints.release(done)
        for row in done:
            self._own[row] = False
        self._begin_plans(plans)
        return [self._robots[row] for row in done]

    def _begin_plans(self, plans: Mapping[int, Plan]) -> None:
        """Let robots follow plans, by row, which have been released; compute what servos need."""
        # Where the period has been cut differently, they differ in their number of intervals.
        for count in {len(plan.positions) for plan in plans.values()}:
            rows = [row for row, plan in plans.items() if len(plan.positions) == count]
            durations, position, velocity, acceleration = (
                np.stack(of) for of in zip(*(plans[row] for row in rows)))
            rates = self._goals(rows, position, velocity, acceleration)
            rates[:, 1:] -= rates[:, :-1].copy()
            rates[:, 0] -= _stacked([self._physics[row].act for row in rows])[
                :, self._places[2]]
            rates /= durations
            for row, own in zip(rows, rates):
                self._robots[row].joints.plan.begin(own)

    def _measured(self, duration_s: float) -> FloatArray:
        """Return where the joints are, farther on where they are too fast."""
        positions, velocities, _, _ = self._places
        position = _stacked([physics.qpos for physics in self._physics])[:, positions]
        velocity = _stacked([physics.qvel for physics in self._physics])[:, velocities]
        limit = self._servos.velocity_limit
        fast = np.asarray((np.abs(velocity) > limit).any(axis=1))
        if np.count_nonzero(fast):
            position = np.where(fast[:, None], position + duration_s * (
                velocity - np.clip(velocity, -limit, limit)), position)
        return np.asarray(position)

    def _goals(self, rows: Sequence[int], position: FloatArray, velocity: FloatArray,
               acceleration: FloatArray) -> FloatArray:
        """
        Return the activations of servos with the force that a motion needs.

        :param rows: that move
        :param position: at the ends of some intervals [rad or m], shape (rows, intervals, n)
        :param velocity: there [rad/s or m/s], of that shape
        :param acceleration: [rad/s^2 or m/s^2], of that shape
        """
        servos, (_, dofs, _, _) = self._servos, self._places
        accelerations, forces = np.zeros(
            (2, *acceleration.shape[:2], len(self._physics[0].qvel)))
        accelerations[..., dofs] = acceleration
        for row, results, vectors in zip(rows, forces, accelerations):
            model, data = self._physics[row].model, self._physics[row].data
            for result, vector in zip(results, vectors):
                mujoco.mj_mulM(model, data, result, vector)
        force = self._drag[rows][:, None] * velocity
        force += forces[..., dofs]
        frictions = [self._robots[row].joints._servos._friction for row in rows]
        if any([friction.acts for friction in frictions]):
            force += np.stack([friction.at(own) for friction, own in zip(frictions, velocity)])
        coriolis = (_stacked([self._physics[row].bias for row in rows])[:, dofs]
                    - _stacked([self._physics[row].gravcomp for row in rows])[:, dofs])
        if not servos._all_compensated:
            coriolis *= servos._compensated
        force += coriolis[:, None]
        force /= self._stiffness[rows][:, None]
        force += position
        if servos._geared:
            force *= servos._gear
        return np.asarray(force)


def _stacked(fields: list[FloatArray]) -> FloatArray:
    return np.concatenate(fields).reshape(len(fields), -1)
