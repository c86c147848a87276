# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Turn running Cartesian commands into joint velocities or efforts, arm by arm."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import math

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.algebra import length, product, transposed_product, wxyz_to_xyzw
from manip_sim.arrays import FloatArray
from manip_sim.control.cartesian.cartesian_commands import (
    CartesianCommand, CartesianPose, CartesianTwist, CartesianWrench, ForceMode, GuardedTwist)
from manip_sim.control.cartesian.cartesian_settings import (
    BASE, CartesianSettings, posture_of, TOOL)
from manip_sim.control.cartesian.kinematic_chains import Arms, KinematicChain
from manip_sim.control.cartesian.pose_stream import PoseStream
from manip_sim.control.cartesian.reports import CartesianReport, Contact
from manip_sim.control.cartesian.targets import Guard, Target, target_of
from manip_sim.control.commands import Status
from manip_sim.control.law.records import (
    Arm, BRAKES, EXERTS, IDLE, LEADS, no_targets, RESTS, STREAMS, Targets, targets_of, TWISTS)
from manip_sim.control.seats import Seats
from manip_sim.control.servos import Servos, SPEED_UP_S
from manip_sim.control.setpoints import SetpointGenerator
from manip_sim.control.streamed_trajectories import STREAM_INTERVAL_S
from manip_sim.control.velocity_stream import VelocityStream
from manip_sim.derived import Derived
from manip_sim.errors import CommandError, UnknownNameError
from manip_sim.physics.parts import EndEffectorReader
from manip_sim.physics.physics import Physics
from manip_sim.physics.poses_and_twists import Pose
from manip_sim.physics.robot_frames import Frame, WORLD

#: Longest interval between two solutions of the inverse kinematics [s].
_LONGEST_INTERVAL_S = 0.012
#: The mount of an arm has moved if it is farther than this from where it was [m, rad].
_MOVED = 1e-5
_IN_WORLD = Frame(WORLD, 0)
#: Counters of reports that compiled code compares with what it notes, in its order.
_KNOWN = ('joint_limit', 'singular', 'aside', 'slowed')


class CartesianController:
    """
    A controller of a robot's end effectors, through the servos and setpoints of its arm joints.

    In position and velocity mode inverse kinematics runs on the setpoints, not on the measured
    joints: the servos resist a force at the end effector, which does not change where the
    setpoints go unless it exceeds the effort limits. In effort mode operational space control runs
    in every interval, on the measured joints.

    Times ``now_s`` are simulation time [s].

    :param physics: of the world at the start, whose joint positions are the posture
    :param chains: by arm
    :param names: of the joints
    :param servos: of all driven joints
    :param setpoints: of all driven joints
    :param end_effectors: readers of the grippers, by arm
    :param seats: laws of users, which get the setpoints
    :param arms: joints of the arms as the law reads them
    :ivar readers: of the grippers, by arm
    :ivar settings: by arm
    :ivar reports: by arm
    :ivar period_s: length of the control period [s]
    :ivar interval_s: length of the intervals in which setpoints move in this part of it [s]
    :ivar posture: in which the episode begins [rad], shape (n,)
    """

    remembered = ('posture', 'settings', 'period_s', 'interval_s', '_targets', '_streams')
    #: Set anew in each control period.
    undigested = ('interval_s',)

    def __init__(self, physics: Physics, chains: Mapping[str, KinematicChain],
                 names: Sequence[str], servos: Servos, setpoints: SetpointGenerator,
                 end_effectors: Mapping[str, EndEffectorReader], seats: Seats, arms: Arms
                 ) -> None:
        self._physics, self._chains, self._names = physics, chains, names
        self._servos, self._setpoints, self._seats = servos, setpoints, seats
        self._arms, self.readers = arms, end_effectors
        self.posture: FloatArray = physics.data.qpos[servos.qpos].copy()
        self._low, self._high = servos.position_clamp().T
        #: Joints of each arm, of all driven ones, in the arm's order.
        self._joints = {arm: np.array([number for address in chain.qpos.tolist() for number in
                                       np.flatnonzero(servos.qpos == address)], dtype=np.int64)
                        for arm, chain in chains.items()}
        self.settings = {arm: CartesianSettings() for arm in chains}
        self.reports = {arm: CartesianReport(arm) for arm in chains}
        self.period_s = self.interval_s = self._timestep_s = float(physics.model.opt.timestep)
        self._targets: dict[str, Target] = {}
        #: By arm: longest interval of a stream of poses, how long it goes on when it stops [s].
        self._streams = {arm: (STREAM_INTERVAL_S, 0.0) for arm in chains}
        self._derived = Derived()
        physics.on_change(self._rebind)

    def _rebind(self) -> None:
        for chain in self._chains.values():
            chain.tip.rebind(self._physics.model)
            chain.origin.rebind(self._physics.model)

    def set(self, arm: str, name: str, value: ArrayLike | str) -> None:
        """
        Change a setting of an arm, one of :class:`CartesianSettings`.

        :raises CommandError: if a number is not finite, not positive where it has to be, or a
            position is out of the range of its joint
        :raises UnknownNameError: if the arm, setting or frame is unknown
        """
        if arm not in self.settings:
            raise UnknownNameError('arm with a gripper', arm, self.settings)
        self._physics.interrupt()
        before, changed = self.settings[arm], self.settings[arm].changed(name, value)
        if changed == before:  # Equal ones would have another digest.
            return
        if changed.null_space_posture != before.null_space_posture:
            self._check_posture(arm, changed.null_space_posture)
            if arm in self._targets:
                self._targets[arm].settled_in = None
        self.settings[arm] = changed

    def _check_posture(self, arm: str, text: str) -> None:
        """Reject a posture of an arm that it cannot have."""
        joints = self._joints[arm]
        positions = posture_of(text, len(joints))
        for joint, position in zip(joints, [] if positions is None else positions.tolist()):
            if not self._low[joint] <= position <= self._high[joint]:
                raise CommandError(
                    f"null_space_posture: joint '{self._names[joint]}' must be from "
                    f'{self._low[joint]:g} to {self._high[joint]:g}, got {position:g}')

    @property
    def postures(self) -> FloatArray:
        """Positions that redundant arms tend to [rad], shape (n,), a view."""
        given = {arm: positions for arm, settings in self.settings.items() if (positions := (
            posture_of(settings.null_space_posture, len(self._joints[arm])))) is not None}
        if not given:
            return self.posture
        # The same array each time, as compiled code keeps its address.
        postures: FloatArray = self._derived.of.setdefault('postures', self.posture.copy())
        postures[:] = self.posture
        for arm, positions in given.items():
            postures[self._joints[arm]] = positions
        return postures

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

        :raises UnknownNameError: if the arm is unknown
        """
        if arm not in self.settings:
            raise UnknownNameError('arm with a gripper', arm, self.settings)
        self._physics.interrupt()
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

    def begin(self, command: CartesianCommand, data: mujoco.MjData, now_s: float, goes_on: bool
              ) -> None:
        """
        Start a command, at the beginning of a control period.

        :param data: after ``mj_forward``
        :param goes_on: whether the end effector had a target until now
        """
        streamed = before = self._targets.get(command.arm)
        if before is not None and (before.twists is None or now_s > before.until_s + 1e-9):
            before = None
        lasts_s = (math.inf if isinstance(command, GuardedTwist)
                   else self.settings[command.arm].twist_timeout)
        target = self._targets[command.arm] = target_of(
            command, self._chains[command.arm], self._physics.model, data,
            self._physics.arrays.kinematics, before, now_s + lasts_s)
        if isinstance(command, GuardedTwist):
            pose = self._chains[command.arm].tip.pose(data)
            target.guard = Guard(pose[0], now_s, pose)
        if goes_on and streamed is not None:
            target.go_on(streamed, data)
        if isinstance(command, CartesianPose):
            self._continue_stream(command, target, streamed, data, now_s)
        elif isinstance(command, CartesianTwist):
            self._continue_twists(command, target, before, data, now_s)

    def stay(self, command: CartesianCommand, data: mujoco.MjData) -> CartesianPose:
        """Return the command for the end effector of a command to stay where it is."""
        position, rotation = self._chains[command.arm].tip.pose(data)
        return CartesianPose(
            robot=command.robot, parts=command.parts, indices=command.indices, arm=command.arm,
            frame=_IN_WORLD, position=position, rotation=rotation)

    def push(self, command: CartesianWrench, until_s: float) -> None:
        """
        Let an impedance, which has a target, exert a wrench beside its springs.

        :param until_s: simulation time when that ends [s]
        """
        target = self._targets[command.arm]
        if not isinstance(command, ForceMode):
            self._end_push(command.arm, target, self._physics.data)
        target.push, target.push_until_s = command, until_s

    def _end_push(self, arm: str, target: Target, data: mujoco.MjData) -> None:
        """End what an impedance exerts; after force mode the end effector stays where it is."""
        if isinstance(target.push, ForceMode):
            target.stay_at(self._chains[arm].tip.view(data), data)
            target.reference = target.stream = target.twists = None
        target.push, target.push_until_s = None, math.inf

    def _continue_stream(self, command: CartesianPose, target: Target, before: Target | None,
                         data: mujoco.MjData, now_s: float) -> None:
        """Let a pose continue the stream of the target before, if it is one in that frame."""
        if before is None or before.stream is None or before.anchor != target.anchor:
            target.stream = PoseStream()
        else:
            target.stream = before.stream
        target.stream.set(*self._streams[command.arm])
        target.stream.take(
            target.position, target.rotation, now_s, self.period_s,
            lambda: self._present_twist(command, target.anchor, data),
            self.settings[command.arm].limits, command.messages, command.sent_s)

    def _continue_twists(self, command: CartesianTwist, target: Target, before: Target | None,
                         data: mujoco.MjData, now_s: float) -> None:
        """Let a twist continue the stream of the target before, if it is one in those axes."""
        continued = before.twists if before is not None and before.axes == target.axes else None
        target.twists = continued or VelocityStream(
            np.repeat(self.settings[command.arm].limits, 3) / SPEED_UP_S)
        target.twists.set(*self._streams[command.arm])
        target.twists.take(
            command.twist, lambda: self._present_twist(command, target.axes, data), now_s,
            self.period_s, command.messages, command.sent_s)

    def _present_twist(self, command: CartesianCommand, frame: Frame, data: mujoco.MjData
                       ) -> FloatArray:
        """Return the end effector's velocity in the axes of a frame [m/s, rad/s], shape (6,)."""
        dofs = self._servos.dofs[command.indices]
        gives = self._servos.gives_effort(command.indices)
        if self._seats.act_on(command.indices):
            gives[:] = False
        velocity = np.where(gives, data.qvel[dofs], self._setpoints.velocity[command.indices])
        moved = product(self._chains[command.arm].tip.jacobian(self._physics.model, data, dofs),
                        velocity)
        _, axes = frame.pose(data)
        return np.concatenate([transposed_product(axes, moved[:3]),
                               transposed_product(axes, moved[3:])])

    # ------------------------------------------------------------------ in the control loop

    def moves(self, command: CartesianCommand) -> bool:
        """Return whether a command that runs has something to do in the next interval."""
        return self._targets[command.arm].settled_in is None or self._exerts(command)

    def _exerts(self, command: CartesianCommand) -> bool:
        """Return whether the joints of a command exert efforts, and follow no setpoints."""
        return self._servos.any_gives_effort_of(command.indices) and not (
            self._seats.act_on(command.indices))

    def begin_period(self, command: CartesianCommand, data: mujoco.MjData, now_s: float) -> None:
        """
        Let this control period solve anew, and check whether the arm's mount has moved.

        A motion until contact ends here.
        """
        target = self._targets[command.arm]
        if isinstance(command, GuardedTwist) and target.guard is not None:
            self._guard(command, target, target.guard, data, now_s)
        target.solve_s = -math.inf
        if target.settled_in is not None:
            place = self._place(command, target, data)
            if place.shape != target.settled_in.shape or (
                    np.abs(place - target.settled_in).max() > _MOVED):
                target.settled_in = None

    def _guard(self, command: GuardedTwist, target: Target, guard: Guard, data: mujoco.MjData,
               now_s: float) -> None:
        """
        Let the end effector stay where it is if something ends its motion, and report it.

        After a contact it goes back to where the force was below its limit, as a stiff arm that
        has moved on for a control period presses much harder.
        """
        pose = position, _ = self._chains[command.arm].tip.pose(data)
        wrench = self.readers[command.arm].external_wrench(data)
        distance, duration_s = length(position - guard.start), now_s - guard.begin_s
        causes = {'contact': length(wrench[:3]) >= command.force,
                  'distance': distance >= command.distance,
                  'time': duration_s >= command.duration_s - 1e-9}
        cause = next((cause for cause, ends in causes.items() if ends), None)
        if cause is None:
            target.guard = guard._replace(free=pose)
            return
        target.guard = target.twists = target.reference = None
        target.stay_at(guard.free if cause == 'contact' else pose, data)
        self.reports[command.arm].contact = Contact(
            cause, now_s, position, wrench.copy(), distance, duration_s)
        command.handle.end(Status.DONE)

    def _place(self, command: CartesianCommand, target: Target, data: mujoco.MjData) -> FloatArray:
        chain = self._chains[command.arm]
        bodies = [chain.origin.body, target.anchor.body]
        taken = np.setdiff1d(chain.qpos, self._servos.qpos[command.indices])
        return np.concatenate([data.xpos[bodies].ravel(), data.xmat[bodies].ravel(),
                               data.qpos[taken]])

    def _is_mounted(self, command: CartesianCommand, target: Target) -> bool:
        """Return whether nothing can move the arm's mount, and the frame of a target."""
        chain, fixed_to = self._chains[command.arm], self._physics.model.body_weldid
        return (fixed_to[chain.origin.body] == fixed_to[target.anchor.body] == 0
                and bool(np.isin(chain.qpos, self._servos.qpos[command.indices]).all()))

    def begin_run(self, commands: Sequence[CartesianCommand], now_s: float,
                  durations_s: FloatArray, begins_s: Callable[[], FloatArray]
                  ) -> tuple[Targets, int]:
        """
        Return the targets of commands for the compiled law.

        :param commands: of the arms, two at most
        :param durations_s: lengths of intervals [s], shape (k,)
        :param begins_s: returns when they begin, simulation time [s], shape (k,)
        :returns: the targets, and for how many intervals they are known
        """
        if not commands:
            return no_targets(), len(durations_s)
        targets, count = self._targets_for_law(commands), len(durations_s)
        targets.tasks['acts'] = IDLE
        for number, command in enumerate(commands):
            target = self._targets[command.arm]
            if target.twists is not None and now_s >= target.until_s - 1e-9:
                target.twists, target.until_s = None, -math.inf
                command.handle.end(Status.ABORTED, 'no fresh twist came in time')
            if now_s >= target.push_until_s - 1e-9:
                self._end_push(command.arm, target, self._physics.data)
            exerts = self._exerts(command)
            interval_s = self._solution_s(float(durations_s[0]))
            follows = self._follows(target, exerts, now_s)
            self._fill(targets, number, command, exerts, follows, interval_s)
            self._fill_impedance(targets, number, command)
            known_s = target.known_s
            if known_s < math.inf:  # It may end within the period.
                known = int(np.count_nonzero(begins_s() < known_s - 1e-9))
                count = min(count, max(known, 1))
        return targets, count

    def _solution_s(self, duration_s: float) -> float:
        """Return for how long a solution of the kinematics is used [s]: for whole intervals."""
        parts = max(1, math.ceil(self.period_s / _LONGEST_INTERVAL_S - 1e-9))
        intervals = math.ceil(self.period_s / parts / self.interval_s - 1e-9)
        return max(min(intervals * self.interval_s, self.period_s), duration_s)

    @staticmethod
    def _follows(target: Target, exerts: bool, now_s: float) -> int:
        """Return how a target moves from now on."""
        if target.twists is not None:
            return TWISTS
        if target.until_s == -math.inf and not exerts:
            return BRAKES
        if exerts or target.settled_in is None and now_s >= target.solve_s - 1e-9:
            return RESTS if target.ends_stream(now_s) else STREAMS
        return STREAMS if target.stream is not None and target.stream.moving else RESTS

    def _targets_for_law(self, commands: Sequence[CartesianCommand]) -> Targets:
        """Return room for the targets of arms, which is used again."""
        arms = [self._arms.arm(self._chains[command.arm].tip, command.indices)
                for command in commands]
        room: Targets | None = self._derived.of.get('targets')
        if room is None:
            room = self._derived.of['targets'] = targets_of(len(self._names))
        return self._derived.made_of(_with_arms, room, arms[0], arms[-1])

    def _fill(self, targets: Targets, number: int, command: CartesianCommand, exerts: bool,
              follows: int, interval_s: float) -> None:
        """Write the target of a command for the compiled law."""
        target, settings = self._targets[command.arm], self.settings[command.arm]
        report = self.reports[command.arm]
        tip, anchor, axes = self._chains[command.arm].tip, target.anchor, target.axes
        frame, push = self._frame(command.arm), target.push
        push_frame = frame if push is None or isinstance(push, ForceMode) else push.frame
        targets.tasks[number] = (
            EXERTS if exerts else LEADS, follows, *tip.number, *anchor.number, *axes.number,
            *frame.number, *push_frame.number,
            target.rests, target.settled_in is not None, target.start is not None,
            target.solve_s == -math.inf, 0, exerts and settings.impedes,
            target.reference is not None, command.handle.is_active,
            *[kind in report.active for kind in _KNOWN], False,
            settings.stiffness, settings.damping, settings.linear_velocity,
            settings.angular_velocity, settings.cartesian_damping_ratio,
            settings.null_space_stiffness,
            target.stream.smooth if follows == STREAMS and target.stream else 0.0,
            target.solve_s, interval_s, report.seen_s)
        targets.positions[number], targets.rotations[number] = target.position, target.rotation
        stream = target.stream if target.twists is None else target.twists
        if stream is not None:
            targets.streams[number] = stream.motion
        if target.start is not None:
            targets.starts[number] = target.start

    def _fill_impedance(self, targets: Targets, number: int, command: CartesianCommand) -> None:
        """Write the springs of a command for the compiled law."""
        if not targets.tasks[number]['impedes']:
            return
        target = self._targets[command.arm]
        settings = self.settings[command.arm]
        targets.springs[number] = settings.cartesian_stiffness
        push = target.push
        targets.pushes[number] = 0.0 if push is None else push.wrench
        targets.brakes[number] = settings.cartesian_damping, [math.inf] * 6
        if isinstance(push, ForceMode):
            targets.springs[number, push.selection] = 0.0
            chosen = push.selection
            targets.brakes[number, 0, chosen] = np.abs(push.wrench / push.limits)[chosen]
            targets.brakes[number, 1, chosen] = push.limits[chosen]
        if target.reference is not None:
            targets.places[number], targets.attitudes[number] = target.reference

    def _frame(self, arm: str) -> Frame:
        """Return the frame whose axes the springs of an impedance have."""
        chain = self._chains[arm]
        return {BASE: chain.origin, TOOL: chain.tip}.get(
            self.settings[arm].cartesian_frame, _IN_WORLD)

    def end_run(self, commands: Sequence[CartesianCommand], targets: Targets,
                places_at_begin: Callable[[], mujoco.MjData]) -> None:
        """
        Take over the targets that the compiled law moved, and report their outcomes.

        :param commands: that it moved
        :param targets: of these
        :param places_at_begin: returns data with the kinematics at the beginning of the period
        """
        for number, command in enumerate(commands):
            task, target = targets.tasks[number], self._targets[command.arm]
            _keep(target, targets, number)
            if task['usual'] and self.reports[command.arm].active.issubset(_KNOWN):
                self.reports[command.arm].keep_seen(float(task['seen_s']))
            else:
                for k in range(int(task['solutions'])):
                    self._look(command, targets, number, k)
            if task['settled'] and target.settled_in is None:
                target.settled_in = self._place(command, target, places_at_begin())

    def stand(self, commands: Sequence[CartesianCommand], targets: Targets) -> float:
        """
        Let compiled code go on with the targets of commands, if it may.

        It may unless a motion ends at contact, or an arm at its goal has a mount that can move.

        :param targets: as :meth:`begin_run` has returned them
        :returns: simulation time until which it may [s], -inf if it may not
        """
        until_s = math.inf
        for number, command in enumerate(commands):
            task, report = targets.tasks[number], self.reports[command.arm]
            target = self._targets[command.arm]
            if target.guard is not None or not report.active.issubset(_KNOWN) or (
                    task['settled'] and not self._is_mounted(command, target)):
                return -math.inf
            task['awaited'], task['seen_s'] = command.handle.is_active, report.seen_s
            task['was_held'], task['was_singular'], task['was_aside'], task['was_slowed'] = (
                kind in report.active for kind in _KNOWN)
            until_s = min(until_s, target.known_s - self.period_s + 1e-9)
        return until_s

    def catch_up(self, commands: Sequence[CartesianCommand], targets: Targets) -> None:
        """
        Take over what compiled code has done by itself.

        :param commands: with which it has gone on
        :param targets: of these
        """
        for number, command in enumerate(commands):
            _keep(self._targets[command.arm], targets, number)
            self.reports[command.arm].keep_seen(float(targets.tasks[number]['seen_s']))

    # ------------------------------------------------------------------ reports

    def _look(self, command: CartesianCommand, targets: Targets, number: int, k: int) -> None:
        """Check whether a target is reached, and report what keeps an arm from it."""
        report, follows = self.reports[command.arm], int(targets.tasks[number]['follows'])
        now_s, progress, aside, reached, close, singular, held, slowed = (
            targets.facts[number, k].item())
        if follows == BRAKES:
            return
        motion = ('the twist' if follows == TWISTS else 'the stream of poses' if slowed
                  else 'the motion to the target')
        at_ends = command.indices[targets.held[number, k, command.indices]] if held else []
        report.see_motion(motion, [self._names[joint] for joint in at_ends], bool(singular),
                          bool(slowed))
        if follows == TWISTS:
            return
        if reached and command.handle.is_active:
            command.handle.end(Status.DONE, error=targets.missed[number, k].copy())
        report.see_target(targets.errors[number, k], bool(close), progress, now_s)
        if follows == RESTS and not targets.tasks[number]['impedes']:  # Which yields aside.
            report.see_way(aside)


def _keep(target: Target, targets: Targets, number: int) -> None:
    """Take over where a target is, and how far the end effector has come to it."""
    task = targets.tasks[number]
    target.position = targets.positions[number].copy()
    target.rotation = targets.rotations[number].copy()
    target.rests, target.solve_s = bool(task['rests']), float(task['solve_s'])
    target.start = targets.starts[number].copy() if task['begun'] else None
    target.reference = None
    if task['impedes']:
        target.reference = targets.places[number].copy(), targets.attitudes[number].copy()


def _with_arms(targets: Targets, first: Arm, second: Arm) -> Targets:
    return targets._replace(arms=(first, second))
