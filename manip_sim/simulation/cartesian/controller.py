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
from manip_sim.simulation.cartesian.commands import (
    CartesianCommand, CartesianPose, CartesianTwist, PoseAction)
from manip_sim.simulation.cartesian.frames import Frame, rotation_of_vector, WORLD
from manip_sim.simulation.cartesian.inverse_kinematics import (
    approach, follow_twist, JointState, Solution, stop)
from manip_sim.simulation.cartesian.operational_space import effort, wanted_twist
from manip_sim.simulation.cartesian.settings import CartesianSettings
from manip_sim.simulation.cartesian.targets import CartesianReport, Hand, pose_error, Target
from manip_sim.simulation.commands import Status
from manip_sim.simulation.poses import Pose
from manip_sim.simulation.servos import Servos
from manip_sim.simulation.setpoints import SetpointGenerator
from manip_sim.typing import FloatArray, IntArray

#: What an action of 1 moves the goal by [m], [rad]; robosuite's defaults for OSC_POSE.
_ACTION_STEP, _ACTION_TURN = 0.05, 0.5
#: Where control periods are longer, inverse kinematics is solved so often [s].
_LONGEST_INTERVAL_S = 0.012
#: A pose is reached within this, by setpoints and by the measured hand [m, rad].
_REACHED = np.array([1e-4] * 3 + [1e-3] * 3)
_REACHED_BY_EFFORT = np.array([1e-3] * 3 + [1e-2] * 3)
#: What is farther away and does not come nearer for a while is out of reach.
_MISSED = np.array([2e-3] * 3 + [2e-2] * 3)
_STALLED_S, _STALLED_PROGRESS = 0.3, 0.1
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
        self.reports = {arm: CartesianReport() for arm in hands}
        self.period_s = float(model.opt.timestep)
        self._targets: dict[str, Target] = {}
        #: When each hand was looked at last, and since when it has rested far from its target.
        self._judged_s = dict.fromkeys(hands, -math.inf)
        self._stalled_s = dict.fromkeys(hands, 0.0)
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

    # ------------------------------------------------------------------ when a command begins

    def begin(self, command: CartesianCommand, data: Any, now_s: float) -> None:
        """
        Take a command over, at the beginning of a control period.

        :param data: after ``mj_forward``
        :param now_s: simulation time [s]
        """
        hand = self._hands[command.arm]
        if isinstance(command, CartesianPose):
            origin, turned = command.frame.pose(data)
            anchor = command.frame if self._carries(command) else Frame(WORLD, 0)
            target = Target.at(anchor, origin + turned @ command.position,
                               turned @ command.rotation, data)
        elif isinstance(command, PoseAction):
            target = self._acted(hand, command.action, data)
        else:
            assert isinstance(command, CartesianTwist)
            target = self._twisted(hand, command, data, now_s)
        self._targets[command.arm] = target

    def _carries(self, command: CartesianPose) -> bool:
        """Tell whether a frame is one that the arm does not move."""
        arm = {int(body) for body in self._model.dof_bodyid[self._servos.dofs[command.indices]]}
        body = command.frame.body
        while body and body not in arm:
            body = int(self._model.body_parentid[body])
        return body == 0

    @staticmethod
    def _acted(hand: Hand, action: FloatArray, data: Any) -> Target:
        position, rotation = hand.tip.pose(data)
        _, axes = hand.origin.pose(data)
        turn = rotation_of_vector(axes @ (_ACTION_TURN * action[3:]))
        return Target.at(hand.origin, position + axes @ (_ACTION_STEP * action[:3]),
                         turn @ rotation, data)

    def _twisted(self, hand: Hand, command: CartesianTwist, data: Any, now_s: float) -> Target:
        before = self._targets.get(command.arm)
        if before is not None and before.twist is not None and now_s <= before.until_s + 1e-9:
            goal = before.goal(data)
        else:
            goal = hand.tip.pose(data)
        target = Target.at(hand.origin, *goal, data)
        target.axes, target.twist = command.frame, command.twist
        target.until_s = now_s + self.settings[command.arm].twist_timeout
        return target

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
            self._report(command, solution, 'the twist')
            velocity = solution.velocity
        else:
            error = pose_error(target.goal(scratch), self._hands[command.arm].tip.pose(scratch))
            solution = approach(self._jacobian_of(command, scratch), error, joints, interval_s,
                                settings.linear_velocity, settings.angular_velocity)
            self._report(command, solution, 'the way to the target')
            self._judge(command, target, data, now_s, error, _REACHED,
                        solution.pace < _SLOW_PACE, solution.progress)
            velocity = solution.velocity
        self._setpoints.ramp_to(indices, velocity, interval_s)
        if max(np.abs(velocity).max(), np.abs(joints.velocity).max()) < _AT_REST and (
                target.twist is None):
            self._setpoints.ramp_to(indices, np.zeros(len(indices)), interval_s)
            target.settled_in = self._place(command, target, data)

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

    def _report(self, command: CartesianCommand, solution: Solution, what: str) -> None:
        report, arm = self.reports[command.arm], command.arm
        held = [self._names[i] for i in command.indices[solution.held]]
        report.note('joint_limit', bool(held),
                    f'{arm}: {what} is limited by the range of {", ".join(held)}')
        report.note('singular', solution.singular,
                    f'{arm}: {what} leads to a singularity, where the hand hardly moves')
        report.note('slowed', solution.slowed,
                    f'{arm}: {what} is slowed down to keep to the velocity limits of the joints')

    def _judge(self, command: CartesianCommand, target: Target, data: Any, now_s: float,
               error: FloatArray, reached: FloatArray, rests: bool, progress: float) -> None:
        """See whether the pose is reached, or the hand comes no nearer."""
        arm, report = command.arm, self.reports[command.arm]
        if (np.abs(error) <= reached).all() and rests:
            here = self._hands[arm].tip.pose(data)
            command.handle.end(Status.DONE, error=pose_error(target.goal(data), here))
        fresh = now_s - self._judged_s[arm] > _STALLED_S
        if fresh or progress > _STALLED_PROGRESS or (np.abs(error) <= _MISSED).all():
            self._stalled_s[arm] = now_s
        self._judged_s[arm] = now_s
        missed = now_s - self._stalled_s[arm] >= _STALLED_S
        causes = [text for kind, text in (('joint_limit', 'a joint is at the end of its range'),
                                          ('singular', 'the arm is at a singularity'))
                  if report.is_active(kind)]
        report.note('unreachable', missed, (
            f'{arm}: the target is not reached, {np.linalg.norm(error[:3]):.3f} m and '
            f'{np.linalg.norm(error[3:]):.3f} rad are left'
            + ''.join(f', {cause}' for cause in causes)))

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
            self._judge(command, target, data, now_s, error, _REACHED_BY_EFFORT,
                        bool(np.abs(moved).max() < _SLOW_TWIST),
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
