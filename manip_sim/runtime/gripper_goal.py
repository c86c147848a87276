# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Goals of GripperCommand and ParallelGripperCommand: reached, or stopped by what is held.

Fingers go to a position; suction cups to a vacuum, as a fraction of the full one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np

from manip_sim.clamping import clamp
from manip_sim.control.commands import GripperGrasp, GripperSuction, Status
from manip_sim.control.joint_command_parser import check_names
from manip_sim.errors import CommandError
from manip_sim.runtime.action_goals import ActionGoal, GoalCode, GoalError
from manip_sim.simulation.robot import SimulatedRobot
from manip_sim.simulation.simulation import Simulation

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
        if not self._gripper.joints.are_still(simulation.data):
            self._still_since_ns = None
        elif self._still_since_ns is None:
            self._still_since_ns = time_ns
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
        if not leaks:
            self._leaks_since_ns = None
        elif self._leaks_since_ns is None:
            self._leaks_since_ns = time_ns
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
