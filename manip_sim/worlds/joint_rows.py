# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Control the joints of one robot in several worlds at once, where they follow setpoints."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.simulation import SimulatedRobot
from manip_sim.simulation.commands import JointSetpoint
from manip_sim.simulation.joint_controller import JointController
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
        self._accelerations, self._forces = np.zeros((2, len(robots), len(self._physics[0].qvel)))
        self._products = [
            (physics.model, physics.data, force, acceleration) for physics, force, acceleration
            in zip(self._physics, self._forces, self._accelerations)]

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
        rates = self._goals()
        rates -= _stacked([physics.act for physics in self._physics])[:, activation]
        rates /= duration_s
        for physics, own, rate in zip(self._physics, self._own, rates):
            if own:
                physics.ctrl[ids] = rate
        if setpoints.moves.all() and not setpoints.plans:
            return []
        done = [row for row, (own, moves) in enumerate(zip(self._own, setpoints.moves))
                if own and (row in setpoints.plans or not moves)]
        setpoints.release(done)
        for row in done:
            self._own[row] = False
            self._robots[row].joints.write_plan()
        return [self._robots[row] for row in done]

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

    def _goals(self) -> FloatArray:
        """Return the activations of servos with the force that the motion needs."""
        setpoints, servos, (_, dofs, _, _) = self._setpoints, self._servos, self._places
        self._accelerations[:, dofs] = setpoints.acceleration
        for product in self._products:
            mujoco.mj_mulM(*product)
        force = self._drag * setpoints.velocity
        force += self._forces[:, dofs]
        if servos._friction.acts:
            force += servos._friction.at(setpoints.velocity)
        coriolis = (_stacked([physics.bias for physics in self._physics])[:, dofs]
                    - _stacked([physics.gravcomp for physics in self._physics])[:, dofs])
        if not servos._all_compensated:
            coriolis *= servos._compensated
        force += coriolis
        force /= self._stiffness
        force += setpoints.position
        if servos._geared:
            force *= servos._gear
        return np.asarray(force)


def _stacked(fields: list[FloatArray]) -> FloatArray:
    return np.concatenate(fields).reshape(len(fields), -1)
