# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Turn running Cartesian commands into joint velocities or efforts, arm by arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
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
from manip_sim.control.cartesian.reports import CartesianReport
from manip_sim.control.cartesian.targets import pose_error, Target, target_of
from manip_sim.control.commands import Status
from manip_sim.control.joint_accelerations import SPEED_UP_S
from manip_sim.control.law.arm_records import (
    ArmMotion, EXERTS, IDLE, LEADS, MISSED, MISSED_TURN, no_targets, Targets, targets_of,
    Velocities)
from manip_sim.control.streamed_trajectories import STREAM_INTERVAL_S
from manip_sim.control.servos import Servos
from manip_sim.control.setpoints import SetpointGenerator
from manip_sim.control.velocity_stream import VelocityStream
from manip_sim.derived import Derived
from manip_sim.errors import UnknownNameError
from manip_sim.physics.physics import Physics
from manip_sim.physics.poses_and_twists import Pose
from manip_sim.physics.robot_frames import Frame
from manip_sim.quaternion import wxyz_to_xyzw

#: Longest interval between two solutions of the inverse kinematics [s].
_LONGEST_INTERVAL_S = 0.012
#: Slower setpoints have come to rest [rad/s].
_AT_REST = 1e-4
#: The mount of an arm has moved if it is farther than this from where it was [m, rad].
_MOVED = 1e-5
#: None of the joints.
_NOBODY = np.zeros(0, dtype=bool)
#: The compiled law leads the end effectors of so many arms.
_MOST_ARMS = 2


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
    :ivar posture: that redundant arms tend to [rad], shape (n,)
    """

    def __init__(self, physics: Physics, chains: Mapping[str, KinematicChain],
                 names: Sequence[str], servos: Servos, setpoints: SetpointGenerator) -> None:
        self._physics = physics
        self._chains = chains
        self._names = names
        self._servos = servos
        self._setpoints = setpoints
        self.posture = physics.data.qpos[servos.qpos].copy()
        self._low, self._high = servos.position_clamp().T
        self.settings = {arm: CartesianSettings() for arm in chains}
        self.reports = {arm: CartesianReport(arm) for arm in chains}
        self.period_s = self._timestep_s = float(physics.model.opt.timestep)
        self._targets: dict[str, Target] = {}
        #: By arm: longest interval of a stream of poses, how long it goes on when it stops [s].
        self._streams = {arm: (STREAM_INTERVAL_S, 0.0) for arm in chains}
        self._derived = Derived()
        self._operational = OperationalSpaceController(physics, servos, self.posture)
        physics.on_change(self._look_at_model)

    def look_at_joints(self) -> None:
        """Take over the damping of the joints, which was changed in the model."""
        self._operational.look_at_joints()

    def _look_at_model(self) -> None:
        for chain in self._chains.values():
            chain.tip.look_at_model(self._physics.model)
            chain.origin.look_at_model(self._physics.model)

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
        self.posture[:] = data.qpos[self._servos.qpos]
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

    def begin_run(self, commands: Sequence[CartesianCommand], now_s: float, duration_s: float
                  ) -> Targets | None:
        """
        Return the targets of commands for the compiled law, None if one of them moves.

        :param now_s: simulation time [s]
        :param duration_s: length of the next interval [s]
        """
        if not commands:
            return no_targets()
        if len(commands) > _MOST_ARMS or not all(
                [self._rests(command, now_s) for command in commands]):
            return None
        targets = self._targets_for_law(commands)
        targets.tasks['acts'] = IDLE
        interval_s = self._solution_s(duration_s)
        for number, command in enumerate(commands):
            self._fill(targets, number, command, interval_s)
        return targets

    def _solution_s(self, duration_s: float) -> float:
        """Return for how long a solution of the kinematics is used [s]."""
        parts = max(1, math.ceil(self.period_s / _LONGEST_INTERVAL_S - 1e-9))
        return max(self.period_s / parts, duration_s)

    def _rests(self, command: CartesianCommand, now_s: float) -> bool:
        """Return whether the target of a command rests from now on, until the next command."""
        target = self._targets[command.arm]
        if target.twists is not None:
            return False
        if self._servos.any_gives_effort_of(command.indices):
            return target.ends_stream(now_s)
        if target.settled_in is not None:
            return True
        if target.until_s == -math.inf:
            return False
        if now_s >= target.solve_s - 1e-9:
            return target.ends_stream(now_s)
        return target.stream is None or target.stream.at_rest

    def _targets_for_law(self, commands: Sequence[CartesianCommand]) -> Targets:
        """Return room for the targets of arms, which is used again."""
        arms = [self._operational.arm(self._chains[command.arm].tip, command.indices)
                for command in commands]
        room: Targets | None = self._derived.of.get('targets')
        if room is None:
            room = self._derived.of['targets'] = targets_of(len(self._names))
        return room._replace(arms=(arms[0], arms[-1]))

    def _fill(self, targets: Targets, number: int, command: CartesianCommand, interval_s: float
              ) -> None:
        """Write the target of a command for the compiled law."""
        target, settings = self._targets[command.arm], self.settings[command.arm]
        tip, anchor = self._chains[command.arm].tip, target.anchor
        exerts = self._servos.any_gives_effort_of(command.indices)
        targets.tasks[number] = (
            EXERTS if exerts else LEADS,
            tip.body if tip.site is None else tip.site, tip.site is not None,
            anchor.body if anchor.site is None else anchor.site, anchor.site is not None,
            target.rests, target.settled_in is not None, target.start is not None,
            target.solve_s == -math.inf, 0,
            settings.stiffness, settings.damping, settings.linear_velocity,
            settings.angular_velocity, target.solve_s, interval_s)
        targets.positions[number], targets.rotations[number] = target.position, target.rotation
        if target.start is not None:
            targets.starts[number] = target.start

    def end_run(self, commands: Sequence[CartesianCommand], targets: Targets) -> None:
        """Take over what the compiled law has changed, and report what has become of targets."""
        for number, command in enumerate(commands):
            task, target = targets.tasks[number], self._targets[command.arm]
            target.rests, target.solve_s = bool(task['rests']), float(task['solve_s'])
            if task['begun'] and target.start is None:
                target.start = targets.starts[number].copy()
            for k in range(int(task['solutions'])):
                self._look(command, targets, number, k)
            if task['settled'] and target.settled_in is None:
                scratch = self._physics.scratch.data
                target.settled_in = self._place(command, target, scratch)

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
        exerts = self._servos.any_gives_effort_of(command.indices)
        if not exerts and (target.settled_in is not None or now_s < target.solve_s - 1e-9):
            return
        targets = self.begin_run([command], now_s, duration_s)
        if targets is not None:
            self._follow_resting(command, targets, now_s, efforts)
        elif exerts:
            solution = self._operational.solve(
                self._chains[command.arm].tip, target, command.indices,
                self.settings[command.arm], now_s, duration_s)
            efforts[command.indices] = solution.efforts
            if target.solve_s == -math.inf:
                # What limits the end effector is reported once in a period.
                target.solve_s = now_s
                self._report(command, target, solution, now_s)
        else:
            interval_s = self._solution_s(duration_s)
            target.solve_s = now_s + interval_s
            self._solve(command, target, data, now_s, interval_s)

    def _follow_resting(self, command: CartesianCommand, targets: Targets, now_s: float,
                        efforts: FloatArray) -> None:
        from manip_sim.control.law.leading import lead, press_on, put_ahead  # It imports numba.
        world, model = self._physics.arrays, self._physics.model
        if targets.tasks[0]['acts'] == EXERTS:
            press_on(world, efforts, self.posture, targets, 0, now_s)
        else:
            scratch, joints = self._physics.scratch, self._setpoints.joints
            put_ahead(world, scratch.kinematics, joints, targets, 0)
            mujoco.mj_kinematics(model, scratch.data)
            mujoco.mj_comPos(model, scratch.data)
            lead(world, scratch.kinematics, joints, self.posture, targets, 0, now_s)
            self._setpoints.moving = True
        self.end_run([command], targets)

    @staticmethod
    def _end_twist(command: CartesianCommand, target: Target, now_s: float) -> None:
        if target.twists is not None and now_s >= target.until_s - 1e-9:
            target.twists = None
            target.until_s = -math.inf
            command.handle.end(Status.ABORTED, 'no fresh twist came in time')

    # ------------------------------------------------------------------ by inverse kinematics

    def _solve(self, command: CartesianCommand, target: Target, data: mujoco.MjData, now_s: float,
               interval_s: float) -> None:
        """Set velocities of setpoints for a target that moves, or let them come to rest."""
        from manip_sim.control.law import approach as law  # It imports numba.
        indices, settings = command.indices, self.settings[command.arm]
        arm, result = self._arm(indices, interval_s), Velocities.of(len(indices))
        scratch = self._physics.scratch.data
        scratch.qpos[:] = data.qpos
        # Velocities are sought for the end of the interval, so the arm is put where it is then.
        scratch.qpos[self._servos.qpos[indices]] = arm.position
        mujoco.mj_kinematics(self._physics.model, scratch)
        mujoco.mj_comPos(self._physics.model, scratch)
        tip = self._chains[command.arm].tip
        jacobian = tip.jacobian(self._physics.model, scratch, self._servos.dofs[indices])
        velocity, limit = result.velocity, None
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
            limit = result.acceleration_limit
            _, before, _ = target.reference(scratch, now_s)
            goal, twist, _ = target.reference(scratch, now_s + interval_s)
            error = pose_error(goal, tip.view(scratch)) - (twist - before) * interval_s / 2.0
            _, progress, singular, slowed, target.rests = law.approach(
                jacobian, error, arm, interval_s, settings.linear_velocity,
                settings.angular_velocity, before, twist, True, target.smooth, target.rests,
                result)
            behind = slowed and not _is_close(error)
            self._see(command, 'the stream of poses' if behind else 'the motion to the target',
                      result.held, singular, behind)
            self.reports[command.arm].see_target(error, _is_close(error), progress, now_s)
        self._setpoints.ramp_to(indices, velocity, interval_s, limit)
        if (target.until_s == -math.inf
                and max(np.abs(velocity).max(), np.abs(arm.velocity).max()) < _AT_REST):
            self._setpoints.ramp_to(indices, np.zeros(len(indices)), interval_s)
            target.settled_in = self._place(command, target, data)

    def _arm(self, indices: IntArray, interval_s: float) -> ArmMotion:
        servos, velocity = self._servos, self._setpoints.velocity[indices]
        return ArmMotion(
            self._setpoints.position[indices] + interval_s * velocity, velocity,
            self._low[indices], self._high[indices], servos.cruising_velocity[indices],
            servos.acceleration_limit[indices], self.posture[indices], servos.turn[indices])

    # ------------------------------------------------------------------ reports

    def _see(self, command: CartesianCommand, what: str, held: BoolArray, singular: bool,
             slowed: bool = False) -> None:
        names = [self._names[i] for i in command.indices[held]] if held.any() else []
        self.reports[command.arm].see_motion(what, names, singular, slowed)

    def _look(self, command: CartesianCommand, targets: Targets, number: int, k: int) -> None:
        """Check whether a target that rests is reached, and report what keeps an arm from it."""
        report = self.reports[command.arm]
        now_s, progress, aside, reached, close, singular, held = targets.facts[number, k].item()
        self._see(command, 'the motion to the target',
                  targets.held[number, k, command.indices] if held else _NOBODY, bool(singular))
        if reached and command.handle.is_active:
            command.handle.end(Status.DONE, error=targets.missed[number, k].copy())
        report.see_target(targets.errors[number, k], bool(close), progress, now_s)
        report.see_way(aside)

    def _report(self, command: CartesianCommand, target: Target, solution: EffortSolution,
                now_s: float) -> None:
        """Report what limits an end effector that efforts move with its target."""
        twisted = target.twists is not None
        self._see(command, 'the twist' if twisted else 'the motion to the target',
                  solution.held, solution.singular, twisted and solution.slowed)
        if not twisted:
            self.reports[command.arm].see_target(
                solution.error, _is_close(solution.error),
                solution.progress(self.settings[command.arm]), now_s)


def _is_close(error: FloatArray) -> bool:
    """Return whether an end effector comes near enough to a target."""
    return bool((np.abs(error[:3]) <= MISSED).all() and (np.abs(error[3:]) <= MISSED_TURN).all())
