# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Goals of ROS actions: commands that are watched until they have ended.

Fingers go to a position; suction cups to a vacuum, as a fraction of the full one; joints follow a
trajectory within tolerances.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import Enum, IntEnum
import math
import threading
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.control.command_parser import check_names
from manip_sim.control.commands import (
    Command, GripperGrasp, GripperSuction, JointTrajectory, Ledger, Status)
from manip_sim.errors import CommandError, SimulationEnded
from manip_sim.quoting import quoted
from manip_sim.runtime.simulation_thread import SimulationThread
from manip_sim.simulation.robot import SimulatedRobot
from manip_sim.simulation.simulation import Simulation
from manip_sim.validation import clamp

#: Reason for the loss of joints or a gripper, if no other is known.
_NEWER = 'a newer command has taken over'


class Ending(Enum):
    """Outcome of a goal, in the terms of ROS 2 actions."""

    SUCCEEDED = 'succeeded'
    ABORTED = 'aborted'
    CANCELED = 'canceled'


class GoalCode(IntEnum):
    """The ``error_code`` of control_msgs/FollowJointTrajectory."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


class GoalError(CommandError):
    """
    The rejection of a goal.

    :ivar code: the reason
    """

    def __init__(self, code: GoalCode, message: str) -> None:
        super().__init__(message)
        self.code = code


@dataclass(frozen=True)
class Outcome:
    """
    Result of a goal.

    :ivar ending: whether it has succeeded, was aborted or canceled
    :ivar code: the ``error_code`` for FollowJointTrajectory
    :ivar reason: in words
    """

    ending: Ending
    code: GoalCode
    reason: str


class ActionGoal(ABC):
    """
    A command that the simulation's thread watches; any thread may read its outcome and view.

    :param robot: the robot that is commanded
    :param command: the command, not yet applied
    :param ledger: that it will be in
    :ivar robot: the robot that is commanded
    :ivar command: the command
    :ivar outcome: how it has ended, or None; set once
    :ivar view: progress for feedback, or None; replaced, never changed in place
    """

    def __init__(self, robot: SimulatedRobot, command: Command, ledger: Ledger) -> None:
        self.robot = robot
        self._ledger = ledger
        self.command = command
        self.outcome: Outcome | None = None
        self.view: Any = None

    @property
    def busy_parts(self) -> frozenset[str]:
        """The atomic parts that the goal commands while it has not ended."""
        return self.command.parts if self.outcome is None else frozenset()

    def check(self, simulation: Simulation) -> None:
        """
        Check whether the goal has ended; to be called at the end of each control period.

        :param simulation: at that instant
        """
        handle = self.command.handle
        if self.outcome is not None:
            return
        self._look(simulation)
        if handle.status in (Status.ABORTED, Status.REPLACED):
            self.abort(handle.reason or _NEWER)
        elif simulation.diverged is not None:
            self.abort(simulation.diverged)
        elif handle.status is not Status.WAITING:
            rival = self._ledger.current_owner(self.command)
            if rival is None:
                self._judge(simulation)
            else:
                self.abort(rival.reason or _NEWER)

    def look(self, simulation: Simulation) -> None:
        """Replace :attr:`view` by the present instant, unless the goal has ended."""
        if self.outcome is None:
            self._look(simulation)

    def abort(self, reason: str, code: GoalCode = GoalCode.INVALID_GOAL) -> None:
        """End the goal without success; joints or fingers that are still its own come to rest."""
        self._give_up(Outcome(Ending.ABORTED, code, reason))

    def cancel(self) -> bool:
        """
        End the goal for its client; joints or fingers that are still its own come to rest.

        :returns: whether it had not ended before
        """
        active = self.outcome is None
        self._give_up(Outcome(Ending.CANCELED, GoalCode.SUCCESSFUL, 'canceled by the client'))
        return active

    def _give_up(self, outcome: Outcome) -> None:
        if self.outcome is None:
            self.robot.withdraw(self.command, outcome.reason)
            self.outcome = outcome

    def _succeed(self, reason: str) -> None:
        self.outcome = Outcome(Ending.SUCCEEDED, GoalCode.SUCCESSFUL, reason)

    @abstractmethod
    def _look(self, simulation: Simulation) -> None:
        """Observe the present instant, and replace :attr:`view`."""

    @abstractmethod
    def _judge(self, simulation: Simulation) -> None:
        """Compare the present state with the goal, and end the goal if it is decided."""


class GoalTracker:
    """
    Goals that have not ended.

    In lock-step each counts as the command of its parts until it has ended, so that a client that
    waits for the result does not have to command them too.

    :param thread: runs the simulation; any number of trackers may observe it
    :param simulation: is used in its thread only
    :param ended: is called in the simulation's thread, with each goal that has ended
    :ivar goals: those that have not ended, oldest first
    """

    def __init__(self, thread: SimulationThread, simulation: Simulation,
                 ended: Callable[[ActionGoal], None]) -> None:
        self._thread, self._simulation = thread, simulation
        self._ended = ended
        self._lock = threading.Lock()
        self.goals: tuple[ActionGoal, ...] = ()
        thread.observe(self.observe, look=lambda: bool(self.goals))
        thread.changes.commands.keep_busy(self.busy_parts)

    def busy_parts(self, robot: str) -> frozenset[str]:
        """Return the atomic parts of a robot that goals command."""
        return frozenset().union(*(goal.busy_parts for goal in self.goals
                                   if goal.robot.name == robot))

    def start(self, goal: ActionGoal) -> None:
        """Submit the command of a goal and watch it from now on."""
        with self._lock:
            self.goals = (*self.goals, goal)
        self._thread.observers.refresh()
        self._thread.submit([goal.command], robot=goal.robot.name)

    def cancel(self, goal: ActionGoal) -> bool:
        """
        End a goal at the request of its client.

        :returns: whether this ended it; False if it or the simulation had ended before
        """
        def cancel() -> bool:
            goal.look(self._simulation)
            cancelled = goal.cancel()
            self._sweep()
            return cancelled
        try:
            return self._thread.call(cancel)
        except SimulationEnded:
            return False

    def abort_all(self, reason: str, robot: str | None = None) -> None:
        """
        Abort all goals.

        :param robot: name of the robot whose goals are aborted; None for all robots
        """
        def abort() -> None:
            for goal in self.goals:
                if robot in (None, goal.robot.name):
                    goal.look(self._simulation)
                    goal.abort(reason)
            self._sweep()
        self._thread.call(abort)

    def observe(self, simulation: Simulation) -> None:
        """Check which goals have ended; called in the simulation's thread."""
        if self.goals:
            for goal in self.goals:
                goal.check(simulation)
            self._sweep()

    def _sweep(self) -> None:
        with self._lock:
            ended = [goal for goal in self.goals if goal.outcome is not None]
            if ended:
                self.goals = tuple(goal for goal in self.goals if goal.outcome is None)
        for goal in ended:
            if goal.outcome is not None and goal.outcome.ending is not Ending.SUCCEEDED:
                self._thread.changes.journal.withdrawn(
                    goal.robot.name, goal.command, goal.outcome.reason)
            self._ended(goal)


#: A goal is reached if the joint is nearer than this fraction of its range; 0.8 mm of a Panda's.
_REACHED = 0.02
#: The same for a joint without a range [rad or m].
_REACHED_ENDLESS = 0.01
#: A gripper has stalled when its fingers have stood still for this long, simulation time [ns].
_STALL_NS = 250_000_000
#: A vacuum is reached if it is nearer than this fraction of the full one.
_VACUUM_REACHED = 0.05
#: A cup that has leaked for so long holds nothing, simulation time [ns].
_LEAKS_NS = 1_000_000_000


@dataclass(frozen=True)
class GripperRequest:
    """
    A client's request.

    :ivar position: of the joint [rad or m]; of suction cups 0 to let go, up to 1 for all vacuum
    :ivar max_effort: of the actuators, at their joints [N or N m]; 0 for their own limits
    :ivar max_velocity: of the joint [rad/s or m/s]; 0 for its own limit
    :ivar joint: that the position is for; empty for the first one that takes positions
    """

    position: float
    max_effort: float = 0.0
    max_velocity: float = 0.0
    joint: str = ''


@dataclass(frozen=True)
class GripperView:
    """
    The state of a gripper.

    :ivar time_ns: simulation time [ns]
    :ivar joint: that the numbers are for, or the actuator of a suction cup
    :ivar position: [rad or m]
    :ivar velocity: [rad/s or m/s]
    :ivar effort: of the actuators at the joint [N or N m]
    :ivar reached: whether the joint is at its goal
    :ivar stalled: whether the fingers were stopped before they reached the goal
    """

    time_ns: int
    joint: str
    position: float
    velocity: float
    effort: float
    reached: bool = False
    stalled: bool = False


class GripperGoal(ActionGoal):
    """
    A position of a gripper; to be stopped before it by an object is a success too.

    :param robot: the robot with the gripper
    :param part: the gripper
    :param request: of the client
    :raises GoalError: if it cannot be met
    """

    view: GripperView | None

    def __init__(self, robot: SimulatedRobot, part: str, request: GripperRequest) -> None:
        gripper = robot.grippers[part]
        joint = _checked(request, gripper.joints.names, part)
        low, high = gripper.joints.reach(joint)
        values, clamped = clamp(np.array([request.position]), np.array([[low, high]]))
        super().__init__(robot, GripperGrasp(
            robot=robot.robot_model, parts=frozenset([part]), indices=gripper.indices,
            joints=(joint,), values=values, clamped=clamped, max_effort=request.max_effort,
            max_velocity=request.max_velocity), gripper.commands)
        self._gripper = gripper
        self._joint, self._position = joint, float(values[0])
        span = high - low
        self._near = _REACHED * span if math.isfinite(span) else _REACHED_ENDLESS
        self._still_since_ns: int | None = None

    def _look(self, simulation: Simulation) -> None:
        joint, time_ns = simulation.data.joint(self._joint), simulation.time_ns
        position = float(joint.qpos[0])
        self._still_since_ns = _since(
            self._still_since_ns, self._gripper.joints.are_still(simulation.data), time_ns)
        status = self.command.handle.status
        reached = status is not Status.WAITING and abs(position - self._position) < self._near
        stalled = (not reached and status is Status.DONE
                   and self._still_since_ns is not None
                   and time_ns - self._still_since_ns >= _STALL_NS)
        effort = float(simulation.efforts.values[simulation.model.joint(self._joint).dofadr[0]])
        self.view = GripperView(time_ns, self._joint, position, float(joint.qvel[0]),
                                effort, reached, stalled)

    def _judge(self, simulation: Simulation) -> None:
        assert self.view is not None
        if self.view.reached:
            self._succeed('the goal is reached')
        elif self.view.stalled:
            self._succeed('the fingers were stopped before they reached the goal')


class SuctionGoal(ActionGoal):
    """
    A vacuum of the suction cups of a gripper; cups that do not seal end it without success.

    :param robot: the robot with the gripper
    :param part: the gripper
    :param request: of the client
    :raises GoalError: if it cannot be met
    """

    view: GripperView | None

    def __init__(self, robot: SimulatedRobot, part: str, request: GripperRequest) -> None:
        gripper = robot.grippers[part]
        self._cups, self._name = gripper.cups, _checked(request, gripper.cups.names, part)
        values, clamped = clamp(np.array([request.position]), np.array([[0.0, 1.0]]))
        controls = self._cups.controls(float(values[0]), request.max_effort)
        super().__init__(robot, GripperSuction(
            robot=robot.robot_model, parts=frozenset([part]), indices=gripper.indices,
            controls=controls, clamped=clamped), gripper.commands)
        self._goal = np.maximum(controls, 0.0)
        self._leaks_since_ns: int | None = None

    def _look(self, simulation: Simulation) -> None:
        cups, data, time_ns = self._cups, simulation.data, simulation.time_ns
        begun = self.command.handle.status is not Status.WAITING
        vacuum = cups.vacuum(data)
        leaks = begun and bool(self._goal.any()) and min(cups.held(data)) < 0
        self._leaks_since_ns = _since(self._leaks_since_ns, leaks, time_ns)
        near = np.abs(vacuum - self._goal) <= _VACUUM_REACHED * cups.full
        self.view = GripperView(
            time_ns, self._name, float((vacuum / cups.full).min()), 0.0,
            float(cups.forces(data).sum()), begun and bool(near.all()))

    def _judge(self, simulation: Simulation) -> None:
        assert self.view is not None
        if self.view.reached:
            self._succeed('the vacuum is reached')
        elif self._leaks_since_ns is not None and (
                simulation.time_ns - self._leaks_since_ns >= _LEAKS_NS):
            self.abort('the cup does not seal: part of its lip touches nothing')


def _since(since_ns: int | None, holds: bool, now_ns: int) -> int | None:
    """Return since when a condition has held without a break, or None."""
    return None if not holds else now_ns if since_ns is None else since_ns


def gripper_goal(robot: SimulatedRobot, part: str, request: GripperRequest) -> ActionGoal:
    """
    Return the goal of a request to the fingers of a gripper, or to its suction cups.

    :param part: the gripper
    :raises GoalError: if it cannot be met
    """
    fingers = robot.grippers[part].joints.names
    return (GripperGoal if fingers else SuctionGoal)(robot, part, request)


def _checked(request: GripperRequest, names: Sequence[str], part: str) -> str:
    """Return the joint or cup that a request is for, or raise :class:`GoalError`."""
    joint = request.joint or names[0]
    try:
        check_names([joint], names, part)
    except CommandError as error:
        raise GoalError(GoalCode.INVALID_JOINTS, str(error)) from error
    for name in ('position', 'max_effort', 'max_velocity'):
        value = getattr(request, name)
        if not math.isfinite(value) or (value < 0.0 and name != 'position'):
            raise GoalError(GoalCode.INVALID_GOAL, f'{part}: {name} must be finite'
                            f'{"" if name == "position" else " and not negative"}, got '
                            f'{value:g}')
    return joint


#: The value that erases a tolerance: the error is not limited.
ERASE = -1.0


@dataclass(frozen=True)
class JointTolerance:
    """
    The largest errors of a joint; 0 for the default, -1 for no limit.

    :ivar name: of the joint
    :ivar position: [rad or m]
    :ivar velocity: [rad/s or m/s]
    :ivar acceleration: validated, but not used: accelerations are not measured
    """

    name: str
    position: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0


class Tolerances:
    """
    Tolerances of joints in a given order, infinite where there is none.

    :param joints: the joints, in order
    :param part: the joints that may be named
    :param tolerances: by the client
    :param velocity: the default [rad/s or m/s]
    :raises GoalError: if a joint is not in the part, or a number is not a tolerance
    """

    def __init__(self, joints: Sequence[str], part: Sequence[str],
                 tolerances: Sequence[JointTolerance], velocity: float = math.inf) -> None:
        self._joints = joints
        self.position = np.full(len(joints), np.inf)
        self.velocity = np.full(len(joints), velocity)
        for tolerance in tolerances:
            if tolerance.name not in part:
                raise GoalError(GoalCode.INVALID_JOINTS, 'a tolerance is for the joint '
                                f'{quoted(tolerance.name)}, which is not in the part')
            _resolved(tolerance.name, tolerance.acceleration, math.inf)
            for index in [i for i, name in enumerate(joints) if name == tolerance.name]:
                self.position[index] = _resolved(tolerance.name, tolerance.position, math.inf)
                self.velocity[index] = _resolved(tolerance.name, tolerance.velocity, velocity)

    def violated(self, position_error: FloatArray, velocity_error: FloatArray) -> str:
        """Return which joint exceeds its tolerance by the largest factor; empty if none does."""
        errors = np.abs([position_error, velocity_error])
        limits = np.array([self.position, self.velocity])
        with np.errstate(invalid='ignore', over='ignore'):
            ratios = errors / limits
        kind, joint = divmod(int(np.argmax(ratios)), len(self._joints))
        if not ratios[kind, joint] > 1.0:
            return ''
        name = ('position', 'velocity')[kind]
        return (f"the {name} of joint '{self._joints[joint]}' is {errors[kind, joint]:.4g} off, "
                f'its tolerance is {limits[kind, joint]:.4g}')


def _resolved(joint: str, value: float, default: float) -> float:
    if value == 0.0:
        return default
    if value == ERASE:
        return math.inf
    if not (value > 0.0 and math.isfinite(value)):
        raise GoalError(GoalCode.INVALID_GOAL, f"joint '{joint}': a tolerance must be positive, 0 "
                        f'for the default or -1 for none, got {value:g}')
    return value


#: The default of ``stopped_velocity_tolerance`` of joint_trajectory_controller [rad/s or m/s].
STOPPED_VELOCITY = 0.01
#: Greatest distance of the last point beyond the range of a joint without tolerance [rad or m].
_BEYOND = 0.01


@dataclass(frozen=True)
class TrajectoryRequest:
    """
    A client's request.

    :ivar names: of joints, n of them
    :ivar times_s: of the points, from the start [s]
    :ivar positions: [rad or m], shape (n_points, n)
    :ivar velocities: [rad/s or m/s], of that shape, or None
    :ivar accelerations: [rad/s^2 or m/s^2], of that shape, or None
    :ivar start_ns: simulation time of the start [ns]; 0 for now
    :ivar path_tolerance: on the way
    :ivar goal_tolerance: at the end
    :ivar goal_time_s: how long after the end the joints may take to come within the goal
        tolerance [s]; 0 and -1 for ever
    """

    names: Sequence[str]
    times_s: Sequence[float]
    positions: ArrayLike
    velocities: ArrayLike | None = None
    accelerations: ArrayLike | None = None
    start_ns: int = 0
    path_tolerance: Sequence[JointTolerance] = field(default_factory=tuple)
    goal_tolerance: Sequence[JointTolerance] = field(default_factory=tuple)
    goal_time_s: float = 0.0


@dataclass(frozen=True)
class TrajectoryView:
    """
    Desired and measured state of the joints of a trajectory.

    :ivar time_ns: simulation time [ns]
    :ivar desired: position, velocity and acceleration of the trajectory, each of shape (n,)
    :ivar position: measured [rad or m], shape (n,)
    :ivar velocity: measured [rad/s or m/s], shape (n,)
    :ivar index: of the point that the trajectory goes to, among the points of the request
    """

    time_ns: int
    desired: tuple[FloatArray, FloatArray, FloatArray]
    position: FloatArray
    velocity: FloatArray
    index: int


class TrajectoryGoal(ActionGoal):
    """
    A trajectory for joints, which have to stand still at its end.

    The path tolerance applies until the command is done; then the joints have to come within the
    goal tolerance. A trajectory that had to be slowed down still has to end in time if the client
    gave a goal time.

    :param robot: the robot that follows it
    :param part: the part that the joints belong to
    :param request: of the client
    :param now_ns: simulation time [ns]
    :ivar names: of the joints
    :raises GoalError: if it cannot be followed
    """

    view: TrajectoryView | None
    command: JointTrajectory

    def __init__(self, robot: SimulatedRobot, part: str, request: TrajectoryRequest, now_ns: int
                 ) -> None:
        joints = [robot.joints.names[i] for i in robot.joints.indices_of(part)]
        _check(part, joints, request, now_ns)
        self.names = tuple(request.names)
        self._path = Tolerances(self.names, joints, request.path_tolerance)
        self._end = Tolerances(self.names, joints, request.goal_tolerance, STOPPED_VELOCITY)
        try:
            command = robot.parse.trajectory(
                part, request.names, request.times_s, request.positions, request.velocities,
                request.accelerations, request.start_ns, now_ns)
        except CommandError as error:
            raise GoalError(GoalCode.INVALID_GOAL, str(error)) from error
        assert isinstance(command, JointTrajectory)
        super().__init__(robot, command, robot.joints.commands)
        self._last = command.trajectory.positions[-1].copy()
        _check_end(part, self.names, request, self._last, self._end)
        self._points = len(request.times_s)
        self._goal_time_s = request.goal_time_s
        self._length_ns = round(request.times_s[-1] * 1e9)
        self._stamped_ns = request.start_ns
        self._start_ns = now_ns
        #: Delay of trajectories by ``speed_scaling`` when it started [s].
        self._late_s = robot.trajectories_late_s
        self._on_the_way = False

    def _look(self, simulation: Simulation) -> None:
        joints, time_ns = self.robot.joints, simulation.time_ns
        if self.command.handle.status is Status.WAITING:
            self._start_ns = time_ns
        position, velocity = joints.measured(self.command.indices, simulation.data)
        reference = self.robot.trajectory_reference(self.command.handle)
        self._on_the_way = reference is not None
        if not self._has_started:
            self._late_s = self.robot.trajectories_late_s
        if reference is not None:
            # Points that were past at the start were left out.
            index = min(self._points - reference.points_ahead, self._points - 1)
            self.view = TrajectoryView(time_ns, reference[:3], position, velocity, index)
            return
        still = np.zeros(len(self._last))
        # Before it starts there is nothing to compare with.
        goal, index = (self._last, self._points - 1) if self._has_started else (position, 0)
        self.view = TrajectoryView(time_ns, (goal, still, still), position, velocity, index)

    @property
    def _has_started(self) -> bool:
        return (self.command.handle.status is not Status.WAITING
                and not self._ledger.awaits(self.command.handle))

    def _judge(self, simulation: Simulation) -> None:
        assert self.view is not None
        if not self._has_started:
            return
        view = self.view
        if self._on_the_way:
            violation = self._path.violated(view.desired[0] - view.position,
                                            view.desired[1] - view.velocity)
            if violation:
                self.abort(f'on the way, {violation}', GoalCode.PATH_TOLERANCE_VIOLATED)
                return
        self._judge_end(simulation.time_ns, view.position, view.velocity)

    def _judge_end(self, time_ns: int, position: FloatArray, velocity: FloatArray) -> None:
        violation = self._end.violated(self._last - position, velocity)
        if self.command.handle.status is Status.DONE and not violation:
            self._succeed('the goal is reached')
            return
        since_s = (time_ns - (self._stamped_ns or self._start_ns) - self._length_ns) * 1e-9
        since_s -= self.robot.trajectories_late_s - self._late_s
        if 0.0 < self._goal_time_s < since_s - 1e-9:
            slowed = self.command.slowed
            hint = (f'; it was slowed down by the factor {slowed:.3g} to keep to the velocity '
                    'limits' if slowed > 1.0 else '')
            self.abort(f'{since_s:.3f} s after the end, '
                       f'{violation or "the trajectory is still on its way"}{hint}',
                       GoalCode.GOAL_TOLERANCE_VIOLATED)


def _check(part: str, joints: Sequence[str], request: TrajectoryRequest, now_ns: int) -> None:
    try:
        check_names(request.names, joints, part)
    except CommandError as error:
        raise GoalError(GoalCode.INVALID_JOINTS, str(error)) from error
    if not len(request.times_s):
        raise GoalError(GoalCode.INVALID_GOAL, f'{part}: a goal needs at least one point; cancel '
                        'a goal to stop it')
    end_ns = request.start_ns + round(request.times_s[-1] * 1e9)
    if request.start_ns and end_ns < now_ns:
        raise GoalError(GoalCode.OLD_HEADER_TIMESTAMP, f'{part}: the trajectory ended '
                        f'{(now_ns - end_ns) * 1e-9:.3f} s ago, by its stamp')
    time_s = request.goal_time_s
    if not (time_s >= 0.0 or time_s == ERASE):
        raise GoalError(GoalCode.INVALID_GOAL, f'{part}: goal_time_tolerance must not be '
                        f'negative, but for -1, got {time_s:g} s')


def _check_end(part: str, names: Sequence[str], request: TrajectoryRequest, last: FloatArray,
               tolerances: Tolerances) -> None:
    asked = np.asarray(request.positions, dtype=float)[-1]
    allowed = np.where(np.isfinite(tolerances.position), tolerances.position, _BEYOND)
    for name, requested, possible, most in zip(names, asked, last, allowed):
        if abs(requested - possible) > most:
            raise GoalError(GoalCode.INVALID_GOAL, f"{part}: the last point of joint '{name}' is "
                            f'{requested:g}, its range ends at {possible:g}')
    if request.velocities is not None:
        speeds = np.asarray(request.velocities, dtype=float)[-1]
        for name, speed in zip(names, speeds):
            if speed:
                raise GoalError(GoalCode.INVALID_GOAL, f"{part}: joint '{name}' must stand still "
                                f'at the last point, its velocity there is {speed:g}')
