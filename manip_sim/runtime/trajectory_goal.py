# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Goals of FollowJointTrajectory: tolerances on the way and at the end, as in ros2_controllers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
import math

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.control.commands import JointTrajectory, Status
from manip_sim.control.command_parser import check_names
from manip_sim.errors import CommandError
from manip_sim.quoting import quoted
from manip_sim.runtime.action_goals import ActionGoal, GoalCode, GoalError
from manip_sim.simulation.robot import SimulatedRobot
from manip_sim.simulation.simulation import Simulation

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
#: Smaller velocities at the last point are none, as for joint_trajectory_controller; planners
#: leave some 1e-17 [rad/s or m/s].
_ROUNDING = float(np.finfo(np.float32).eps)


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
            if abs(speed) > _ROUNDING:
                raise GoalError(GoalCode.INVALID_GOAL, f"{part}: joint '{name}' must stand still "
                                f'at the last point, its velocity there is {speed:g}')
