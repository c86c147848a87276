# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Goals of ROS actions: commands that are watched until they have ended.

Fingers go to a position; suction cups to a vacuum, as a fraction of the full one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum, IntEnum
import math
import threading
from typing import Any

import numpy as np

from manip_sim.control.command_parser import check_names
from manip_sim.control.commands import (
    Command, GripperGrasp, GripperSuction, Ledger, Status)
from manip_sim.errors import CommandError, SimulationEnded
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
