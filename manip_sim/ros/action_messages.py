# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Convert requests of actions to goals, and goals to feedback and results."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from typing import Any, ClassVar

from trajectory_msgs.msg import JointTrajectoryPoint

from manip_sim.arrays import FloatArray
from manip_sim.errors import CommandError
from manip_sim.ros.messages import nanoseconds_of, seconds_of, stamp_of
from manip_sim.ros.serialization import trajectory_fields
from manip_sim.runtime.action_goals import (
    ActionGoal, gripper_goal, GoalCode, GoalError, GripperRequest)
from manip_sim.runtime.trajectory_goal import JointTolerance, TrajectoryGoal, TrajectoryRequest
from manip_sim.simulation import SimulatedRobot


class ActionMessages(ABC):
    """
    Conversions between the messages of an action and goals for a part of a robot.

    :param action_type: with ``Feedback`` and ``Result``, such as the types of ``control_msgs``
    :param robot: that is commanded
    :param part: of the robot
    :param now_ns: returns the simulation time [ns]
    :cvar name: of the action, after ``<part>/``
    """

    name: ClassVar[str]

    def __init__(self, action_type: Any, robot: SimulatedRobot, part: str,
                 now_ns: Callable[[], int]) -> None:
        self.action_type = action_type
        self.robot = robot
        self.part = part
        self._now_ns = now_ns

    @abstractmethod
    def goal_of(self, request: Any) -> ActionGoal:
        """
        Return the goal of a request.

        :raises GoalError: if it cannot be met
        """

    @abstractmethod
    def feedback_of(self, goal: Any) -> Any:
        """Return the feedback of a goal that has not ended."""

    @abstractmethod
    def result_of(self, goal: Any) -> Any:
        """Return the result of a goal that has ended."""


class TrajectoryMessages(ActionMessages):
    """Conversions of the messages of control_msgs/FollowJointTrajectory."""

    name = 'follow_joint_trajectory'

    def goal_of(self, request: Any) -> TrajectoryGoal:
        multi_dof = request.multi_dof_trajectory
        if len(multi_dof.joint_names) or len(multi_dof.points):
            raise GoalError(GoalCode.INVALID_GOAL, f'{self.part} has no joints with several '
                            'degrees of freedom, leave multi_dof_trajectory empty')
        for field in ('component_path_tolerance', 'component_goal_tolerance'):
            if len(getattr(request, field, ())):
                raise GoalError(GoalCode.INVALID_GOAL, f'leave {field} empty, it is for '
                                'multi_dof_trajectory')
        message = request.trajectory
        try:
            times_s, positions, velocities, accelerations = trajectory_fields(self.part, message)
        except CommandError as error:
            raise GoalError(GoalCode.INVALID_GOAL, str(error)) from error
        return TrajectoryGoal(self.robot, self.part, TrajectoryRequest(
            list(message.joint_names), times_s, positions, velocities, accelerations,
            nanoseconds_of(message.header.stamp), list(_tolerances(request.path_tolerance)),
            list(_tolerances(request.goal_tolerance)), seconds_of(request.goal_time_tolerance)),
            self._now_ns())

    def feedback_of(self, goal: TrajectoryGoal) -> Any:
        message, view = self.action_type.Feedback(), goal.view
        message.joint_names = list(goal.names)
        if view is not None:
            position, velocity, acceleration = view.desired
            message.header.stamp = stamp_of(view.time_ns)
            message.desired = _point(position, velocity, acceleration)
            message.actual = _point(view.position, view.velocity)
            message.error = _point(position - view.position, velocity - view.velocity)
            if hasattr(message, 'index'):  # Since version 6.3 of control_msgs.
                message.index = view.index
        return message

    def result_of(self, goal: TrajectoryGoal) -> Any:
        message, outcome = self.action_type.Result(), goal.outcome
        if outcome is not None:
            message.error_code, message.error_string = int(outcome.code), outcome.reason
        return message


def _tolerances(messages: Any) -> Iterator[JointTolerance]:
    for message in messages:
        yield JointTolerance(message.name, message.position, message.velocity,
                             message.acceleration)


def _point(position: FloatArray, velocity: FloatArray, acceleration: FloatArray | None = None
           ) -> JointTrajectoryPoint:
    return JointTrajectoryPoint(
        positions=position.tolist(), velocities=velocity.tolist(),
        accelerations=[] if acceleration is None else acceleration.tolist())


class GripperMessages(ActionMessages):
    """Conversions of the messages of control_msgs/GripperCommand."""

    name = 'gripper_cmd'

    def goal_of(self, request: Any) -> ActionGoal:
        command = request.command
        return gripper_goal(self.robot, self.part,
                            GripperRequest(command.position, command.max_effort))

    def feedback_of(self, goal: ActionGoal) -> Any:
        return self._filled(self.action_type.Feedback(), goal)

    def result_of(self, goal: ActionGoal) -> Any:
        return self._filled(self.action_type.Result(), goal)

    @staticmethod
    def _filled(message: Any, goal: ActionGoal) -> Any:
        view = goal.view
        if view is not None:
            message.position, message.effort = view.position, view.effort
            message.reached_goal, message.stalled = view.reached, view.stalled
        return message


class ParallelGripperMessages(GripperMessages):
    """Conversions of the messages of control_msgs/ParallelGripperCommand."""

    name = 'parallel_gripper_cmd'

    def goal_of(self, request: Any) -> ActionGoal:
        command, numbers = request.command, {}
        for field, fewest in (('name', 0), ('position', 1), ('velocity', 0), ('effort', 0)):
            values = list(getattr(command, field))
            if not fewest <= len(values) <= 1:
                raise GoalError(GoalCode.INVALID_GOAL, f'{self.part}: command.{field} must have '
                                f'{"one element" if fewest else "one element or none"}, got '
                                f'{len(values)}')
            numbers[field] = values
        return gripper_goal(self.robot, self.part, GripperRequest(
            numbers['position'][0], *numbers['effort'] or (0.0,), *numbers['velocity'] or (0.0,),
            *numbers['name']))

    def result_of(self, goal: ActionGoal) -> Any:
        message = self._filled(self.action_type.Result(), goal)
        if goal.view is not None:
            message.reached_goal, message.stalled = goal.view.reached, goal.view.stalled
        return message

    @staticmethod
    def _filled(message: Any, goal: ActionGoal) -> Any:
        view = goal.view
        if view is not None:
            message.state.header.stamp = stamp_of(view.time_ns)
            message.state.name, message.state.position = [view.joint], [view.position]
            message.state.velocity, message.state.effort = [view.velocity], [view.effort]
        return message
