# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The servos of one robot in several worlds: where joints are, and what lets them move."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.control.motion_profiles import Plan
from manip_sim.control.planned_controls import CALM
from manip_sim.control.servo_laws import activations, place_after
from manip_sim.simulation import SimulatedRobot


class ServoRows:
    """
    The servos of the joints of one robot in several worlds, each a row.

    :param robots: the robot in each of these worlds, in models of the same size; none of its
        actuators is a source of effort
    :ivar lead: how far a setpoint may be ahead of its joint [rad or m], shape (rows, n)
    """

    def __init__(self, robots: Sequence[SimulatedRobot]) -> None:
        self._physics = [robot._physics for robot in robots]
        servos = [robot.joints._servos for robot in robots]
        self._servos, self._places = servos[0], servos[0]._places
        self._frictions = [of._friction for of in servos]
        self._drag, self._stiffness, self.lead = (
            np.stack(of) for of in zip(*((s._drag, s._stiffness, s.lead) for s in servos)))

    def write(self, row: int, rate: FloatArray) -> None:
        """
        Let the setpoints of a row move at a rate.

        :param rate: shape (n,)
        """
        self._physics[row].ctrl[self._places[3]] = rate

    def measured(self, duration_s: float) -> FloatArray:
        """Return where the joints are, farther on where they are too fast."""
        positions, velocities, _, _ = self._places
        position = _stacked([physics.qpos for physics in self._physics])[:, positions]
        velocity = _stacked([physics.qvel for physics in self._physics])[:, velocities]
        return place_after(position, velocity, self._servos.velocity_limit, duration_s)

    def keep_up(self, plan: Plan) -> bool:
        """
        Return whether no joint needs to be watched while all rows follow a plan.

        :param plan: of shape (k, rows, n)
        """
        durations_s = plan.durations_s.ravel()
        ahead = np.abs(plan.positions[0] - self.measured(float(durations_s[0])))
        way = np.abs(plan.velocities) * float(np.add.reduce(durations_s))
        return not (np.count_nonzero(ahead > self.lead)
                    or np.count_nonzero(way > CALM * self.lead))

    def rates(self, rows: Sequence[int], durations_s: FloatArray, position: FloatArray,
              velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        """
        Return the rates at which setpoints move in some intervals, as :meth:`Servos.rates` does.

        :param rows: that move
        :param durations_s: of the intervals [s], of a shape that fits (rows, intervals, n)
        :param position: at their ends [rad or m], shape (rows, intervals, n)
        :param velocity: there [rad/s or m/s], of that shape
        :param acceleration: [rad/s^2 or m/s^2], of that shape
        :returns: of that shape
        """
        rates = self._goals(rows, position, velocity, acceleration)
        rates[:, 1:] -= rates[:, :-1].copy()
        rates[:, 0] -= _stacked([self._physics[row].act for row in rows])[:, self._places[2]]
        rates /= durations_s
        return rates

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
        needed = [forces[..., dofs]]
        frictions = [self._frictions[row] for row in rows]
        if any([friction.acts for friction in frictions]):
            needed.append(np.stack(
                [friction.at(own) for friction, own in zip(frictions, velocity)]))
        coriolis = (_stacked([self._physics[row].bias for row in rows])[:, dofs]
                    - _stacked([self._physics[row].gravcomp for row in rows])[:, dofs])
        if not servos._all_compensated:
            coriolis *= servos._compensated
        needed.append(coriolis[:, None])
        goals = activations(position, velocity, needed, self._drag[rows][:, None],
                            self._stiffness[rows][:, None])
        if servos._geared:
            goals *= servos._gear
        return goals


def _stacked(fields: list[FloatArray]) -> FloatArray:
    return np.concatenate(fields).reshape(len(fields), -1)
