# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Control the joints of one robot in several worlds at once, where they follow setpoints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.simulation import SimulatedRobot, Simulation
from manip_sim.simulation.commands import JointSetpoint
from manip_sim.simulation.joint_controller import JointController
from manip_sim.worlds.setpoint_rows import SetpointRows
from manip_sim.worlds.shared_goals import take_goals


class Views(NamedTuple):
    """What control reads of a ``MjData``, and where it writes; never replaced while it lives."""

    data: mujoco.MjData
    qpos: FloatArray
    qvel: FloatArray
    bias: FloatArray
    gravcomp: FloatArray
    act: FloatArray
    ctrl: FloatArray


def views_of(simulation: Simulation) -> Views:
    """Return the views of a simulation's present data."""
    data = simulation.data
    return Views(
        data, data.qpos, data.qvel, data.qfrc_bias, data.qfrc_gravcomp, data.act, data.ctrl)


def takes(joints: JointController) -> bool:
    """Tell whether :class:`JointRows` can control joints until the next command."""
    return (joints._setpoints.moving and not joints._efforts_due
            and not joints.commands.waiting and not np.count_nonzero(joints._servos._gives_effort)
            and all(type(command) is JointSetpoint for command in joints.commands.running))


class JointRows:
    """
    The joints of one robot in several worlds, each a row, in one control period.

    :param robots: the robot in each of these worlds, whose joints are those that :func:`takes`
        tells
    :param simulations: of these worlds
    :param views: of their data
    """

    def __init__(self, robots: Sequence[SimulatedRobot], simulations: Sequence[Simulation],
                 views: Sequence[Views]) -> None:
        self._clocks = [robot._clock for robot in robots]
        self._joints = [robot.joints for robot in robots]
        self._physics = [(simulation.model, simulation.data) for simulation in simulations]
        self._robots = robots
        self._fields = {name: [getattr(of, name) for of in views] for name in Views._fields}
        self._own = [True] * len(robots)
        generators = []
        for joints, clock in zip(self._joints, self._clocks):
            generators.append(joints._setpoints)
            joints._setpoints.now_s = clock.control_s
            joints._written = True
        shared = take_goals(generators)
        self._setpoints = SetpointRows(generators)
        for goals in shared:
            self._setpoints.take(goals)
        servos = [joints._servos for joints in self._joints]
        self._servos = servos[0]
        self._drag, self._stiffness, self._lead = (
            np.stack(of) for of in zip(*((s._drag, s._stiffness, s.lead) for s in servos)))
        self._limit = self._servos.velocity_limit
        self._accelerations, self._forces = np.zeros((2, len(robots), len(views[0].qvel)))
        self._products = list(zip(self._physics, self._forces, self._accelerations))

    def release(self) -> None:
        """Give the joints back to their controllers."""
        self._setpoints.release([row for row, own in enumerate(self._own) if own])
        self._own = [False] * len(self._own)

    def tick(self, duration_s: float) -> list[SimulatedRobot]:
        """
        Write the controls of the next interval.

        :param duration_s: length of the interval [s]
        :returns: robots whose setpoints have come to rest, so their joints were given back
        """
        setpoints, servos = self._setpoints, self._servos
        setpoints.set_time(np.array([clock.control_s for clock in self._clocks]))
        setpoints.advance(duration_s)
        measured = self._read('qpos')[:, servos.qpos]
        velocity = self._read('qvel')[:, servos.dofs]
        fast = np.asarray((np.abs(velocity) > self._limit).any(axis=1))
        if np.count_nonzero(fast):
            measured = np.where(fast[:, None], measured + duration_s * (
                velocity - np.clip(velocity, -self._limit, self._limit)), measured)
        setpoints.hold_back(measured, self._lead)
        here = self._read('act')[:, servos._activation]
        rates = (self._activations() - here) / duration_s
        arrived = []
        for row, (ctrl, own, moves) in enumerate(zip(
                self._fields['ctrl'], self._own, setpoints.moves.tolist())):
            if own:
                ctrl[servos._ids] = rates[row]
                if not moves:
                    setpoints.release([row])
                    self._own[row] = False
                    arrived.append(self._robots[row])
        return arrived

    def _activations(self) -> FloatArray:
        """Return the activations of servos with the force that the motion needs."""
        setpoints, servos = self._setpoints, self._servos
        self._accelerations[:, servos.dofs] = setpoints.acceleration
        for (model, data), force, acceleration in self._products:
            mujoco.mj_mulM(model, data, force, acceleration)
        force = self._drag * setpoints.velocity + self._forces[:, servos.dofs]
        force += servos._friction.at(setpoints.velocity)
        force += servos._compensated * (self._read('bias')[:, servos.dofs]
                                        - self._read('gravcomp')[:, servos.dofs])
        return np.asarray((setpoints.position + force / self._stiffness) * servos._gear)

    def _read(self, field: str) -> FloatArray:
        """Return a field of the data of all rows, shape (rows, ...)."""
        fields = self._fields[field]
        return np.concatenate(fields).reshape(len(fields), -1)
