# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Turn Cartesian commands that run into joint velocities or efforts, arm by arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
from typing import Any

import mujoco
import numpy as np

from manip_sim.errors import UnknownNameError
from manip_sim.models.quaternion import wxyz_to_xyzw
from manip_sim.simulation.cartesian.commands import CartesianCommand
from manip_sim.simulation.cartesian.goals import target_of
from manip_sim.simulation.cartesian.inverse_kinematics import (
    approach, follow_twist, JointState, Solution, stop)
from manip_sim.simulation.cartesian.operational_space import effort, wanted_twist
from manip_sim.simulation.cartesian.reports import CartesianReport
from manip_sim.simulation.cartesian.settings import CartesianSettings
from manip_sim.simulation.cartesian.targets import Hand, pose_error, Target
from manip_sim.simulation.commands import Status
from manip_sim.simulation.poses import Pose
from manip_sim.simulation.servos import Servos
from manip_sim.simulation.setpoints import SetpointGenerator
from manip_sim.typing import FloatArray, IntArray

#: Where control periods are longer, inverse kinematics is solved so often [s].
_LONGEST_INTERVAL_S = 0.012
#: A pose is reached within this, by setpoints and by the measured hand [m, rad].
_REACHED = np.array([1e-4] * 3 + [1e-3] * 3)
_REACHED_BY_EFFORT = np.array([1e-3] * 3 + [1e-2] * 3)
#: A hand that is slower rests: as a share of joint velocity limits, and measured [m/s, rad/s].
_SLOW_PACE, _SLOW_TWIST = 0.005, 2e-3
#: Slower setpoints have come to rest [rad/s].
_AT_REST = 1e-4
#: What carries an arm has moved if it is farther from where it was [m, rad].
_MOVED = 1e-5


class CartesianController:
    """
    Controls the hands of a robot through the servos and setpoints of its arm joints.

    In position and velocity mode inverse kinematics runs on the setpoints, not on the measured
    joints: a force at the hand does not change where the setpoints go, and one that deflects the
    hand is answered by the servos. In effort mode operational space control runs in every interval
    of the physics, on the measured joints.

    :param model: the compiled ``mujoco.MjModel``
    :param data: the ``mujoco.MjData`` at the start, whose arm positions are the posture
    :param hands: by arm
    :param names: of the joints
    :param servos: of all driven joints
    :param setpoints: of all driven joints
    :ivar settings: by arm
    :ivar reports: by arm
    :ivar period_s: length of the control period [s]
    """

    def __init__(self, model: Any, data: Any, hands: Mapping[str, Hand], names: Sequence[str],
                 servos: Servos, setpoints: SetpointGenerator) -> None:
        self._hands = hands
        self._names = names
        self._servos = servos
        self._setpoints = setpoints
        self._posture = data.qpos[servos.qpos].copy()
        self._low, self._high = servos.position_clamp().T
        self._torque = servos.ranges['effort']
        self.settings = {arm: CartesianSettings() for arm in hands}
        self.reports = {arm: CartesianReport(arm) for arm in hands}
        self.period_s = float(model.opt.timestep)
        self._targets: dict[str, Target] = {}
        self.rebind(model)

    def rebind(self, model: Any) -> None:
        """Go on with a model in which the robot is what and where it was."""
        self._model = model
        self._scratch: Any = mujoco.MjData(model) if self._hands else None
        self._jacobian = np.zeros((6, model.nv))
        self._unit, self._column = np.zeros(model.nv), np.zeros(model.nv)

    def set(self, arm: str, name: str, value: float) -> None:
        """
        Change a setting of an arm.

        :raises CommandError: if the value is not positive and finite
        :raises UnknownNameError: if there is no such arm or setting
        """
        if arm not in self.settings:
            raise UnknownNameError('arm with a gripper', arm, self.settings)
        self.settings[arm] = self.settings[arm].changed(name, value)

    def goal(self, arm: str, data: Any) -> Pose | None:
        """
        Return where the hand of an arm shall be in ``world``, or None before the first command.

        :raises UnknownNameError: if there is no such arm
        """
        if arm not in self.settings:
            raise UnknownNameError('arm with a gripper', arm, self.settings)
        if arm not in self._targets:
            return None
        position, rotation = self._targets[arm].goal(data)
        quat_wxyz = np.empty(4)
        mujoco.mju_mat2Quat(quat_wxyz, rotation.reshape(9))
        return Pose(position, wxyz_to_xyzw(quat_wxyz))

    def reset(self) -> None:
        """Forget all targets; settings stay."""
        self._targets.clear()

    # ------------------------------------------------------------------ when a command begins

    def begin(self, command: CartesianCommand, data: Any, now_s: float) -> None:
        """
        Take a command over, at the beginning of a control period.

        :param data: after ``mj_forward``
        :param now_s: simulation time [s]
        """
        before = self._targets.get(command.arm)
        if before is not None and (before.twist is None or now_s > before.until_s + 1e-9):
            before = None
        self._targets[command.arm] = target_of(
            command, self._hands[command.arm], self._model, data, before,
            now_s + self.settings[command.arm].twist_timeout)

    # ------------------------------------------------------------------ in the control loop

    def moves(self, command: CartesianCommand) -> bool:
        """Tell whether a command that runs has something to do in the next interval."""
        return (self._targets[command.arm].settled_in is None
                or bool(self._servos.gives_effort(command.indices).any()))

    def begin_period(self, command: CartesianCommand, data: Any) -> None:
        """Solve anew in this control period, and see whether what carries the arm has moved."""
        target = self._targets[command.arm]
        target.solve_s = -math.inf
        if target.settled_in is not None:
            place = self._place(command, target, data)
            if place.shape != target.settled_in.shape or (
                    np.abs(place - target.settled_in).max() > _MOVED):
                target.settled_in = None

    def _place(self, command: CartesianCommand, target: Target, data: Any) -> FloatArray:
        hand = self._hands[command.arm]
        bodies = [hand.origin.body, target.anchor.body]
        taken = np.setdiff1d(hand.qpos, self._servos.qpos[command.indices])
        return np.concatenate([data.xpos[bodies].ravel(), data.xmat[bodies].ravel(),
                               data.qpos[taken]])

    def follow(self, command: CartesianCommand, data: Any, now_s: float, duration_s: float,
               efforts: FloatArray) -> None:
        """
        Set velocities of setpoints, or efforts, for the next interval.

        :param now_s: simulation time [s]
        :param duration_s: length of the interval [s]
        :param efforts: of all joints, changed in place [N m], shape (n,)
        """
        target = self._targets[command.arm]
        if target.twist is not None and now_s >= target.until_s - 1e-9:
            target.twist = None
            target.until_s = -math.inf
            command.handle.end(Status.ABORTED, 'no fresh twist came in time')
        if self._servos.gives_effort(command.indices).any():
            efforts[command.indices] = self._effort(command, target, data, now_s, duration_s)
        elif target.settled_in is None and now_s >= target.solve_s - 1e-9:
            parts = max(1, math.ceil(self.period_s / _LONGEST_INTERVAL_S - 1e-9))
            interval_s = max(self.period_s / parts, duration_s)
            target.solve_s = now_s + interval_s
            self._solve(command, target, data, now_s, interval_s)

    # ------------------------------------------------------------------ by inverse kinematics

    def _solve(self, command: CartesianCommand, target: Target, data: Any, now_s: float,
               interval_s: float) -> None:
        indices, settings = command.indices, self.settings[command.arm]
        joints = self._joints(indices)
        scratch = self._scratch
        scratch.qpos[:] = data.qpos
        ahead = interval_s / 2.0 if target.twist is not None else 0.0
        scratch.qpos[self._servos.qpos[indices]] = joints.position + ahead * joints.velocity
        mujoco.mj_kinematics(self._model, scratch)
        mujoco.mj_comPos(self._model, scratch)
        if target.until_s == -math.inf:
            velocity = stop(joints, interval_s)
        elif target.twist is not None:
            solution = follow_twist(self._jacobian_of(command, scratch),
                                    target.twist_in_world(scratch), joints, interval_s)
            self._see(command, solution, 'the twist')
            target.stay_at(self._hands[command.arm].tip.pose(scratch), scratch)
            velocity = solution.velocity
        else:
            error = pose_error(target.goal(scratch), self._hands[command.arm].tip.pose(scratch))
            solution = approach(self._jacobian_of(command, scratch), error, joints, interval_s,
                                settings.linear_velocity, settings.angular_velocity)
            self._see(command, solution, 'the way to the target')
            near = (np.abs(error) <= _REACHED).all() and solution.pace < _SLOW_PACE
            self._look(command, target, data, now_s, error, bool(near), solution.progress)
            velocity = solution.velocity
        self._setpoints.ramp_to(indices, velocity, interval_s)
        if max(np.abs(velocity).max(), np.abs(joints.velocity).max()) < _AT_REST and (
                target.twist is None):
            self._setpoints.ramp_to(indices, np.zeros(len(indices)), interval_s)
            target.settled_in = self._place(command, target, data)

    def _see(self, command: CartesianCommand, solution: Solution, what: str) -> None:
        self.reports[command.arm].see_motion(
            solution, what, [self._names[i] for i in command.indices[solution.held]])

    def _joints(self, indices: IntArray) -> JointState:
        setpoints, servos = self._setpoints, self._servos
        return JointState(
            setpoints.position[indices], setpoints.velocity[indices], self._low[indices],
            self._high[indices], servos.cruising_velocity[indices],
            servos.acceleration_limit[indices], self._posture[indices])

    def _jacobian_of(self, command: CartesianCommand, data: Any) -> FloatArray:
        mujoco.mj_jacSite(self._model, data, self._jacobian[:3], self._jacobian[3:],
                          self._hands[command.arm].tip.site)
        return self._jacobian[:, self._servos.dofs[command.indices]]

    def _look(self, command: CartesianCommand, target: Target, data: Any, now_s: float,
              error: FloatArray, reached: bool, progress: float) -> None:
        """See whether the pose is reached, or the hand comes no nearer."""
        if reached and command.handle.is_active:
            here = self._hands[command.arm].tip.pose(data)
            command.handle.end(Status.DONE, error=pose_error(target.goal(data), here))
        self.reports[command.arm].see_target(error, progress, now_s)

    # ------------------------------------------------------------------ by operational space

    def _effort(self, command: CartesianCommand, target: Target, data: Any, now_s: float,
                duration_s: float) -> FloatArray:
        indices, tip = command.indices, self._hands[command.arm].tip
        dofs = self._servos.dofs[indices]
        twist = target.twist_in_world(data)
        if target.twist is not None:
            target.move(data, tip, twist, duration_s)
        error = pose_error(target.goal(data), tip.pose(data))
        jacobian, velocity = self._jacobian_of(command, data), data.qvel[dofs]
        settings = self.settings[command.arm]
        wanted = wanted_twist(jacobian, error, twist, settings,
                              self._servos.velocity_limit[indices])
        given = effort(jacobian, self._inertia(data, dofs), velocity, wanted,
                       self._posture[indices] - data.qpos[self._servos.qpos[indices]],
                       settings.damping)
        # Gravity that is compensated counts as none.
        given += data.qfrc_bias[dofs] - data.qfrc_gravcomp[dofs]
        given += self._servos.passive_damping[indices] * velocity
        if target.twist is None:
            moved, goes = jacobian @ velocity, settings.stiffness / settings.damping * error
            near = (np.abs(error) <= _REACHED_BY_EFFORT).all() and (
                np.abs(moved) < _SLOW_TWIST).all()
            self._look(command, target, data, now_s, error, bool(near),
                       float(moved @ goes) / max(float(goes @ goes), 1e-12))
        return np.clip(given, *self._torque[indices].T)

    def _inertia(self, data: Any, dofs: IntArray) -> FloatArray:
        inertia = np.empty((len(dofs), len(dofs)))
        for index, dof in enumerate(dofs):
            self._unit[dof] = 1.0
            mujoco.mj_mulM(self._model, data, self._column, self._unit)
            self._unit[dof] = 0.0
            inertia[index] = self._column[dofs]
        return inertia
