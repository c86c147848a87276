# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Estimate what an arm holds: a short motion of the wrist, and least squares on the wrench."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.control.commands import Command, Status
from manip_sim.control.modes import MODES
from manip_sim.errors import CommandError
from manip_sim.physics.payload import Payload
from manip_sim.physics.physics import Physics
from manip_sim.simulation.robot import SimulatedRobot

#: Rotation of the last joints to each side, and the distance that they keep from their ends [rad].
_TURN, _MARGIN = 0.4, 0.02
#: So many of the last joints turn, to so many places.
_JOINTS, _PLACES = 3, 6
#: Share of the velocity limits of the joints; shortest motion, and rest at each place [s].
_SPEED, _SHORTEST_S, _REST_S = 0.5, 0.6, 0.4
#: Joints that are slower than this rest [rad/s], for so long before measurements count [s].
_RESTING, _SETTLING_S = 1e-3, 0.15
#: Least change of gravity in the axes of the sensor that tells a payload from an offset [m/s^2].
_LEAST_CHANGE = 0.3
#: A smaller mass is none [kg].
_NOTHING = 1e-3


@dataclass(frozen=True)
class PayloadEstimate:
    """
    An estimated payload, with standard errors.

    Its inertia is that of the payload that was declared before, as nothing tells it at rest.

    :ivar payload: mass and centre of mass are estimated
    :ivar mass_error: [kg]
    :ivar center_of_mass_error: [m], three numbers; zeros without a payload
    """

    payload: Payload
    mass_error: float
    center_of_mass_error: tuple[float, ...]


class PayloadEstimation:
    """
    An estimate of the payload of an arm from how gravity pulls at it in several orientations.

    The last three joints turn by 0.4 rad to each side, and the arm goes back to where it was. An
    offset of the sensor is estimated with it, so no tare is needed.

    :param physics: of the world
    :param robot: in it
    :param arm: such as ``right``
    :ivar command: moves the arm; it has yet to be applied
    :raises CommandError: if the arm follows another command, is not in position mode, or cannot
        turn its gripper enough
    :raises UnknownNameError: if the arm is unknown or has no gripper
    """

    def __init__(self, physics: Physics, robot: SimulatedRobot, arm: str) -> None:
        self._declared = robot.payload(arm)
        joints = robot.joints
        self._robot, self._arm, self._physics = robot, arm, physics
        self._reader = robot.end_effectors[arm]
        indices = joints.indices_of(arm)
        self._names = [joints.names[index] for index in indices]
        model_joints = [physics.model.joint(name) for name in self._names]
        self._qpos = np.array([joint.qposadr[0] for joint in model_joints])
        self._dofs = np.array([joint.dofadr[0] for joint in model_joints])
        others = [mode for mode in joints.modes_of(indices)
                  if not MODES[mode].follows_trajectories]
        if others:
            raise CommandError(f'the payload of {arm} can be estimated in position mode, but it '
                               f'is in {others[0]} mode, which follows no trajectories')
        if any([np.isin(command.indices, indices).any() for command in (
                *joints.commands.running, *joints.commands.waiting)]):
            raise CommandError(f'the payload of {arm} cannot be estimated while the arm follows '
                               'another command')
        self._rested_s = 0.0
        self._last_ns: int | None = None
        self._rows: list[FloatArray] = []
        self._wrenches: list[FloatArray] = []
        self.command = self._plan(
            joints.clamps(indices), joints.ranges_of('velocity', indices)[:, 1])

    # ------------------------------------------------------------------ the motion

    def _plan(self, ranges: FloatArray, fastest: FloatArray) -> Command:
        """
        Return the motion to the places that tell most, and back.

        :param ranges: of the positions [rad or m], shape (n, 2)
        :param fastest: velocities [rad/s or m/s], shape (n,)
        """
        start = self._physics.data.qpos[self._qpos].copy()
        last = range(max(0, len(start) - _JOINTS), len(start))
        places = []
        for turns in product((0.0, -_TURN, _TURN), repeat=len(last)):
            place = start.copy()
            place[last] += turns
            if ((place >= ranges[:, 0] + _MARGIN) & (place <= ranges[:, 1] - _MARGIN))[last].all():
                places.append(place)
        chosen = self._most_telling(places)
        points, times, now_s, before = [], [], 0.0, start
        for place in (*chosen, start):
            now_s += max(_SHORTEST_S, float(np.max(
                1.5 * np.abs(place - before) / (_SPEED * fastest))))
            for time_s in (now_s, now_s + _REST_S):
                times.append(time_s)
                points.append(place)
            now_s, before = times[-1], place
        return self._robot.parse.trajectory(
            self._arm, self._names, times, points, np.zeros((len(points), len(start))))

    def _most_telling(self, places: list[FloatArray]) -> list[FloatArray]:
        """Choose the places that determine the payload best, one after another."""
        rows = [_rows(self._gravity_at(place)) for place in places]
        information, chosen = 1e-6 * np.eye(10), []
        for _ in range(_PLACES if rows else 0):
            gains = [np.linalg.slogdet(information + row.T @ row)[1] for row in rows]
            best = int(np.argmax(gains))
            information = information + rows[best].T @ rows[best]
            chosen.append(places[best])
        if not chosen or _change(np.concatenate(
                [_rows(self._gravity_at(place)) for place in chosen])) < _LEAST_CHANGE:
            raise CommandError(
                f'the payload of {self._arm} cannot be estimated from here: within their ranges, '
                'its last joints turn the gripper too little with respect to gravity')
        return chosen

    def _gravity_at(self, place: FloatArray) -> FloatArray:
        """Return gravity in the axes of the sensor with the arm elsewhere [m/s^2], shape (3,)."""
        scratch, data = self._physics.scratch.data, self._physics.data
        mujoco.mj_copyState(self._physics.model, data, scratch,
                            int(mujoco.mjtState.mjSTATE_PHYSICS)
                            | int(mujoco.mjtState.mjSTATE_USER))
        scratch.qpos[self._qpos] = place
        mujoco.mj_kinematics(self._physics.model, scratch)
        return self._gravity(scratch)

    def _gravity(self, data: Any) -> FloatArray:
        axes = data.site_xmat[self._reader.external.site].reshape(3, 3)
        return np.asarray(axes.T @ self._physics.model.opt.gravity)

    # ------------------------------------------------------------------ the estimate

    def record(self) -> None:
        """Take the measurements of the end of a control period, if the arm rests."""
        state, data = self._robot.state(), self._physics.data
        before, self._last_ns = self._last_ns, state.time_ns
        if before is None or np.abs(data.qvel[self._dofs]).max() > _RESTING:
            self._rested_s = 0.0
            return
        self._rested_s += (state.time_ns - before) * 1e-9
        if self._rested_s >= _SETTLING_S:
            wrench = state.end_effectors[self._arm].external_wrench
            self._rows.append(_rows(self._gravity(data)))
            self._wrenches.append(np.concatenate([wrench.force, wrench.torque]))

    def result(self) -> PayloadEstimate:
        """
        Return the estimate, after the motion.

        :raises CommandError: if the arm could not make the motion, or has hardly rested
        """
        handle, arm = self.command.handle, self._arm
        if handle.status is not Status.DONE:
            raise CommandError(f'the payload of {arm} could not be estimated: '
                               f'{handle.reason or "the motion has not ended"}')
        rows = np.concatenate(self._rows) if self._rows else np.zeros((0, 10))
        if _change(rows) < _LEAST_CHANGE:
            raise CommandError(f'the payload of {arm} could not be estimated: the arm has not '
                               'come to rest where it was to be measured')
        values = np.concatenate(self._wrenches)
        parameters = np.asarray(np.linalg.lstsq(rows, values, rcond=None)[0], dtype=float)
        variance = np.sum((rows @ parameters - values)**2) / (len(values) - len(parameters))
        return self._estimate(
            parameters[:4], variance * np.asarray(np.linalg.inv(rows.T @ rows))[:4, :4])

    def _estimate(self, parameters: FloatArray, covariance: FloatArray) -> PayloadEstimate:
        """
        Return the estimate of mass and first moments beside those that were declared.

        :param parameters: mass [kg] and first moments [kg m], shape (4,)
        """
        before = self._declared
        mass = before.mass + parameters[0]
        mass_error = float(np.sqrt(covariance[0, 0]))
        if mass < max(_NOTHING, 3.0 * mass_error):
            return PayloadEstimate(Payload(), mass_error, (0.0,) * 3)
        center = (before.mass * np.array(before.center_of_mass) + parameters[1:]) / mass
        variances = (np.diag(covariance)[1:] + center**2 * covariance[0, 0]
                     - 2.0 * center * covariance[0, 1:]) / mass**2
        return PayloadEstimate(
            Payload(float(mass), tuple(center.tolist()), before.inertia), mass_error,
            tuple(np.sqrt(np.maximum(variances, 0.0)).tolist()))


def _rows(gravity: FloatArray) -> FloatArray:
    """
    Return how the wrench depends on mass, first moments, and offsets of the sensor, (6, 10).

    :param gravity: in the axes of the sensor [m/s^2], shape (3,)
    """
    x, y, z = gravity
    rows = np.zeros((6, 10))
    rows[:3, 0] = gravity
    rows[3:, 1:4] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    rows[:, 4:] = np.eye(6)
    return rows


def _change(rows: FloatArray) -> float:
    """Return the least root mean square change of what a payload exerts, per mass or moment."""
    if not len(rows):
        return 0.0
    measured = rows.reshape(-1, 6, 10)[:, :, :4]
    free = measured - measured.mean(axis=0)
    information = np.einsum('nij,nik->jk', free, free) / len(measured)
    return float(np.sqrt(max(np.linalg.eigvalsh(information)[0], 0.0)))
