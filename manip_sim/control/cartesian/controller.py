# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Turn running Cartesian commands into joint velocities or efforts, arm by arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
from typing import Any

import mujoco
import numpy as np

from manip_sim.algebra import product, transposed_product
from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.control.cartesian.cartesian_commands import (
    CartesianCommand, CartesianPose, CartesianTwist)
from manip_sim.control.cartesian.cartesian_settings import CartesianSettings
from manip_sim.control.cartesian.kinematic_chains import KinematicChain
from manip_sim.control.cartesian.operational_space_controller import (
    EffortSolution, OperationalSpaceController)
from manip_sim.control.cartesian.pose_stream import PoseStream
from manip_sim.control.cartesian.reports import CartesianReport, MISSED
from manip_sim.control.cartesian.targets import pose_error, Target, target_of
from manip_sim.control.commands import Status
from manip_sim.control.joint_accelerations import SPEED_UP_S
from manip_sim.control.law.arm_records import ArmMotion, Velocities
from manip_sim.control.streamed_trajectories import STREAM_INTERVAL_S
from manip_sim.control.servos import Servos
from manip_sim.control.setpoints import SetpointGenerator
from manip_sim.control.velocity_stream import VelocityStream
from manip_sim.errors import UnknownNameError
from manip_sim.physics.physics import Physics
from manip_sim.physics.poses_and_twists import Pose
from manip_sim.physics.robot_frames import Frame
from manip_sim.quaternion import wxyz_to_xyzw

#: Longest interval between two solutions of the inverse kinematics [s].
_LONGEST_INTERVAL_S = 0.012
#: A pose is reached if the setpoints are within this of it [m, rad].
_REACHED = np.array([1e-4] * 3 + [1e-3] * 3)
#: And if they are slower than this share of the joint velocity limits.
_SLOW_PACE = 0.005
#: Slower setpoints have come to rest [rad/s].
_AT_REST = 1e-4
#: The mount of an arm has moved if it is farther than this from where it was [m, rad].
_MOVED = 1e-5
#: The velocity of a pose that rests.
_STILL = np.zeros(6)


class CartesianController:
    """
    A controller of a robot's end effectors, through the servos and setpoints of its arm joints.

    In position and velocity mode inverse kinematics runs on the setpoints, not on the measured
    joints: the servos resist a force at the end effector, which does not change where the
    setpoints go unless it exceeds the effort limits. In effort mode operational space control runs
    in every tick, on the measured joints.

    :param physics: of the world at the start, whose joint positions are the posture
    :param chains: by arm
    :param names: of the joints
    :param servos: of all driven joints
    :param setpoints: of all driven joints
    :ivar settings: by arm
    :ivar reports: by arm
    :ivar period_s: length of the control period [s]
    """

    def __init__(self, physics: Physics, chains: Mapping[str, KinematicChain],
                 names: Sequence[str], servos: Servos, setpoints: SetpointGenerator) -> None:
        self._physics = physics
        self._chains = chains
        self._names = names
        self._servos = servos
        self._setpoints = setpoints
        self._posture = physics.data.qpos[servos.qpos].copy()
        self._low, self._high = servos.position_clamp().T
        self.settings = {arm: CartesianSettings() for arm in chains}
        self.reports = {arm: CartesianReport(arm) for arm in chains}
        self.period_s = self._timestep_s = float(physics.model.opt.timestep)
        self._targets: dict[str, Target] = {}
        #: By arm: longest interval of a stream of poses, how long it goes on when it stops [s].
        self._streams = {arm: (STREAM_INTERVAL_S, 0.0) for arm in chains}
        self._operational = OperationalSpaceController(physics, servos, self._posture)
        physics.on_change(self._look_at_model)

    def look_at_joints(self) -> None:
        """Take over the damping of the joints, which was changed in the model."""
        self._operational.look_at_joints()

    def _look_at_model(self) -> None:
        for chain in self._chains.values():
            chain.tip.look_at_model(self._physics.model)
            chain.origin.look_at_model(self._physics.model)
        self._scratch: Any = mujoco.MjData(self._physics.model) if self._chains else None

    def set(self, arm: str, name: str, value: float) -> None:
        """
        Change a setting of an arm.

        :raises CommandError: if the value is not positive and finite
        :raises UnknownNameError: if there is no such arm or setting
        """
        if arm not in self.settings:
            raise UnknownNameError('arm with a gripper', arm, self.settings)
        changed = self.settings[arm].changed(name, value)
        if changed != self.settings[arm]:  # Equal ones would have another digest.
            self.settings[arm] = changed

    def set_stream(self, arm: str, longest_s: float | None = None, hold_s: float | None = None
                   ) -> None:
        """
        Change what counts as a stream of poses of an arm, and what happens when one stops.

        :param longest_s: longest interval between messages of a stream [s]; None: no change
        :param hold_s: how long the end effector goes on at the velocity of a stream after a
            message was due [s]; 0: two message intervals; None: no change
        """
        before = self._streams[arm]
        self._streams[arm] = (before[0] if longest_s is None else longest_s,
                              before[1] if hold_s is None else hold_s)

    def goal(self, arm: str, data: mujoco.MjData) -> Pose | None:
        """
        Return the goal of an arm's end effector in ``world``, or None before the first command.

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

    def reset(self, data: mujoco.MjData) -> None:
        """
        Forget all targets; settings and counts stay.

        :param data: at the start, whose posture redundant arms keep to
        """
        self._targets.clear()
        self._posture[:] = data.qpos[self._servos.qpos]
        self.period_s = self._timestep_s
        for report in self.reports.values():
            report.reset()

    # ------------------------------------------------------------------ when a command begins

    def begin(self, command: CartesianCommand, data: mujoco.MjData, now_s: float) -> None:
        """
        Start a command, at the beginning of a control period.

        :param data: after ``mj_forward``
        :param now_s: simulation time [s]
        """
        before, streamed = (self._targets.get(command.arm),) * 2
        if before is not None and (before.twists is None or now_s > before.until_s + 1e-9):
            before = None
        target = self._targets[command.arm] = target_of(
            command, self._chains[command.arm], self._physics.model, data, before,
            now_s + self.settings[command.arm].twist_timeout)
        if isinstance(command, CartesianPose):
            self._continue_stream(command, target, streamed, data)
        elif isinstance(command, CartesianTwist):
            self._continue_twists(command, target, before, data, now_s)

    def _continue_stream(self, command: CartesianPose, target: Target, before: Target | None,
                         data: mujoco.MjData) -> None:
        """Let a pose continue the stream of the target before, if it is one in that frame."""
        if before is None or before.stream is None or before.anchor != target.anchor:
            target.stream = PoseStream()
        else:
            target.stream = before.stream
        target.stream.set(*self._streams[command.arm])
        twist = np.zeros(6)
        if not target.stream.moving:
            twist = self._present_twist(command, target.anchor, data)
        target.stream.take(
            target.position, target.rotation, self.period_s, twist,
            self.settings[command.arm].limits, command.messages,
            command.sent_s)

    def _continue_twists(self, command: CartesianTwist, target: Target, before: Target | None,
                         data: mujoco.MjData, now_s: float) -> None:
        """Let a twist continue the stream of the target before, if it is one in those axes."""
        continued = before.twists if before is not None and before.axes == target.axes else None
        target.twists = continued or VelocityStream(
            np.repeat(self.settings[command.arm].limits, 3) / SPEED_UP_S)
        target.twists.set(*self._streams[command.arm])
        target.twists.take(
            command.twist, self._present_twist(command, target.axes, data), now_s, self.period_s,
            command.messages, command.sent_s)

    def _present_twist(self, command: CartesianCommand, frame: Frame, data: mujoco.MjData
                       ) -> FloatArray:
        """Return the end effector's velocity in the axes of a frame [m/s, rad/s], shape (6,)."""
        dofs = self._servos.dofs[command.indices]
        gives = self._servos.gives_effort(command.indices)
        velocity = np.where(gives, data.qvel[dofs], self._setpoints.velocity[command.indices])
        moved = product(self._chains[command.arm].tip.jacobian(self._physics.model, data, dofs),
                        velocity)
        _, axes = frame.pose(data)
        return np.concatenate([transposed_product(axes, moved[:3]),
                               transposed_product(axes, moved[3:])])

    # ------------------------------------------------------------------ in the control loop

    def moves(self, command: CartesianCommand) -> bool:
        """Return whether a command that runs has something to do in the next interval."""
        return (self._targets[command.arm].settled_in is None
                or self._servos.any_gives_effort_of(command.indices))

    def begin_period(self, command: CartesianCommand, data: mujoco.MjData) -> None:
        """Let this control period solve anew, and check whether the arm's mount has moved."""
        target = self._targets[command.arm]
        target.solve_s = -math.inf
        if target.settled_in is not None:
            place = self._place(command, target, data)
            if place.shape != target.settled_in.shape or (
                    np.abs(place - target.settled_in).max() > _MOVED):
                target.settled_in = None

    def _place(self, command: CartesianCommand, target: Target, data: mujoco.MjData) -> FloatArray:
        chain = self._chains[command.arm]
        bodies = [chain.origin.body, target.anchor.body]
        taken = np.setdiff1d(chain.qpos, self._servos.qpos[command.indices])
        return np.concatenate([data.xpos[bodies].ravel(), data.xmat[bodies].ravel(),
                               data.qpos[taken]])

    def follow(self, command: CartesianCommand, data: mujoco.MjData, now_s: float,
               duration_s: float, efforts: FloatArray) -> None:
        """
        Set velocities of setpoints, or efforts, for the next interval.

        :param now_s: simulation time [s]
        :param duration_s: length of the interval [s]
        :param efforts: of all joints, changed in place [N m], shape (n,)
        """
        target = self._targets[command.arm]
        self._end_twist(command, target, now_s)
        if self._servos.any_gives_effort_of(command.indices):
            solution = self._operational.solve(
                self._chains[command.arm].tip, target, command.indices,
                self.settings[command.arm], now_s, duration_s)
            efforts[command.indices] = solution.efforts
            if target.solve_s == -math.inf:
                # What limits the end effector, and whether it rests, is reported once in a period.
                target.solve_s = now_s
                self._report(command, target, solution, data, now_s)
        elif target.settled_in is None and now_s >= target.solve_s - 1e-9:
            parts = max(1, math.ceil(self.period_s / _LONGEST_INTERVAL_S - 1e-9))
            interval_s = max(self.period_s / parts, duration_s)
            target.solve_s = now_s + interval_s
            self._solve(command, target, data, now_s, interval_s)

    def decides_at(self, command: CartesianCommand) -> float:
        """Return when a command solves the kinematics again, or exerts other efforts [s]."""
        target = self._targets[command.arm]
        if self._servos.any_gives_effort_of(command.indices):
            return -math.inf
        ends_s = target.until_s if target.twists is not None else math.inf
        return min(ends_s, target.solve_s if target.settled_in is None else math.inf)

    def rests_in_effort_mode(self, command: CartesianCommand) -> bool:
        """Return whether the target of a command rests, to which efforts lead the arm."""
        target = self._targets[command.arm]
        return (target.twists is None and (target.stream is None or target.stream.at_rest)
                and self._servos.any_gives_effort_of(command.indices))

    def step(self, command: CartesianCommand, intervals: IntArray, notes: Any,
             efforts: FloatArray) -> None:
        """
        Run the physics of intervals in which efforts lead an arm to a target that rests.

        :param intervals: physics steps of each, shape (k,)
        :param notes: of the steps, see ``law.stepping.Notes``
        :param efforts: of all joints, changed in place [N m], shape (n,)
        """
        efforts[command.indices] = self._operational.step(
            self._chains[command.arm].tip, self._targets[command.arm], command.indices,
            self.settings[command.arm], intervals, notes)

    @staticmethod
    def _end_twist(command: CartesianCommand, target: Target, now_s: float) -> None:
        if target.twists is not None and now_s >= target.until_s - 1e-9:
            target.twists = None
            target.until_s = -math.inf
            command.handle.end(Status.ABORTED, 'no fresh twist came in time')

    # ------------------------------------------------------------------ by inverse kinematics

    def _solve(self, command: CartesianCommand, target: Target, data: mujoco.MjData, now_s: float,
               interval_s: float) -> None:
        from manip_sim.control.law import approach as law  # It imports numba.
        indices, settings = command.indices, self.settings[command.arm]
        arm, result = self._arm(indices, interval_s), Velocities.of(len(indices))
        scratch = self._scratch
        scratch.qpos[:] = data.qpos
        # Velocities are sought for the end of the interval, so the arm is put where it is then.
        scratch.qpos[self._servos.qpos[indices]] = arm.position
        mujoco.mj_kinematics(self._physics.model, scratch)
        mujoco.mj_comPos(self._physics.model, scratch)
        tip = self._chains[command.arm].tip
        jacobian = tip.jacobian(self._physics.model, scratch, self._servos.dofs[indices])
        still, velocity, limit = True, result.velocity, None
        if target.until_s == -math.inf:
            change = interval_s * arm.acceleration_limit
            velocity = np.clip(0.0, arm.velocity - change, arm.velocity + change)
        elif target.twists is not None:
            twist = target.in_world(target.twists.at(now_s + interval_s), scratch)
            _, _, singular, slowed, _ = law.follow_twist(
                jacobian, twist, arm, interval_s, False, result)
            self._see(command, 'the twist', result.held, singular, slowed)
            target.stay_at(tip.pose(scratch), scratch)
        else:
            still, limit = target.ends_stream(now_s), result.acceleration_limit
            if still:
                before = twist = _STILL
                error = pose_error(target.goal(scratch), tip.view(scratch))
            else:
                _, before, _ = target.reference(scratch, now_s)
                goal, twist, _ = target.reference(scratch, now_s + interval_s)
                error = pose_error(goal, tip.view(scratch)) - (twist - before) * interval_s / 2.0
            pace, progress, singular, slowed, target.rests = law.approach(
                jacobian, error, arm, interval_s, settings.linear_velocity,
                settings.angular_velocity, before, twist, not still, target.smooth, target.rests,
                result)
            behind = not still and slowed and bool((np.abs(error) > MISSED).any())
            self._see(command, 'the stream of poses' if behind else 'the motion to the target',
                      result.held, singular, behind)
            near = still and pace < _SLOW_PACE and bool((np.abs(error) <= _REACHED).all())
            self._look(command, target, data, now_s, error, near, progress)
        self._setpoints.ramp_to(indices, velocity, interval_s, limit)
        if (still and target.twists is None
                and max(np.abs(velocity).max(), np.abs(arm.velocity).max()) < _AT_REST):
            self._setpoints.ramp_to(indices, np.zeros(len(indices)), interval_s)
            target.settled_in = self._place(command, target, data)

    def _see(self, command: CartesianCommand, what: str, held: BoolArray, singular: bool,
             slowed: bool = False) -> None:
        names = [self._names[i] for i in command.indices[held]] if np.count_nonzero(held) else []
        self.reports[command.arm].see_motion(what, names, singular, slowed)

    def _arm(self, indices: IntArray, interval_s: float) -> ArmMotion:
        servos, velocity = self._servos, self._setpoints.velocity[indices]
        return ArmMotion(
            self._setpoints.position[indices] + interval_s * velocity, velocity,
            self._low[indices], self._high[indices], servos.cruising_velocity[indices],
            servos.acceleration_limit[indices], self._posture[indices], servos.turn[indices])

    def _look(self, command: CartesianCommand, target: Target, data: mujoco.MjData, now_s: float,
              error: FloatArray, reached: bool, progress: float) -> None:
        """Check whether the pose is reached, and report an end effector that comes no nearer."""
        if reached and command.handle.is_active:
            here = self._chains[command.arm].tip.pose(data)
            command.handle.end(Status.DONE, error=pose_error(target.goal(data), here))
        self.reports[command.arm].see_target(error, progress, now_s)
        if target.stream is None or not target.stream.moving:
            place = target.goal(data)[0] - error[:3]
            self.reports[command.arm].see_way(target.off_the_way(place, data))

    # ------------------------------------------------------------------ by operational space

    def _report(self, command: CartesianCommand, target: Target, solution: EffortSolution,
                data: mujoco.MjData, now_s: float) -> None:
        rests, twisted = solution.rests, target.twists is not None
        self._see(command, 'the twist' if twisted else 'the motion to the target',
                  solution.held & (not rests), not rests and solution.singular,
                  twisted and solution.slowed)
        if not twisted:
            self._look(command, target, data, now_s, solution.error, rests,
                       solution.progress(self.settings[command.arm]))
