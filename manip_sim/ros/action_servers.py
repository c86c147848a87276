# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The actions of control_msgs, where it is installed, and the service of motions until contact."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
import contextlib
from functools import partial
import json
import queue
import threading
from typing import Any, ClassVar, NamedTuple

from diagnostic_msgs.srv import AddDiagnostics
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.task import Future
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectoryPoint

from manip_sim.arrays import FloatArray
from manip_sim.control.cartesian.cartesian_commands import GuardedTwist
from manip_sim.control.cartesian.reports import Contact
from manip_sim.control.commands import CommandHandle, Status
from manip_sim.errors import CommandError, ManipSimError, SimulationEnded, UnknownNameError
from manip_sim.interface.profiles import JointNames
from manip_sim.interface.topics import BY_NAME, Scope
from manip_sim.models.user_files import parse_yaml
from manip_sim.quoting import format_value
from manip_sim.ros.command_subscribers import CommandSubscribers, RobotCommands
from manip_sim.ros.executor import kind_of, let_clients_know
from manip_sim.ros.feature import create_publisher, Feature, NodeContext
from manip_sim.ros.messages import (
    import_optional, nanoseconds_of, seconds_of, stamp_of, trajectory_fields)
from manip_sim.runtime.action_goals import (
    ActionGoal, Ending, GoalCode, GoalError, GoalTracker, gripper_goal, GripperRequest)
from manip_sim.runtime.trajectory_goal import JointTolerance, TrajectoryGoal, TrajectoryRequest
from manip_sim.simulation import SimulatedRobot, Simulation


class ActionMessages(ABC):
    """
    Conversions between the messages of an action and goals for a part of a robot.

    :param action_type: with ``Feedback`` and ``Result``, such as the types of ``control_msgs``
    :param robot: that is commanded
    :param part: of the robot
    :param now_ns: returns the simulation time [ns]
    :param names: what joints are called in messages
    :cvar name: of the action, after ``<part>/``
    """

    name: ClassVar[str]

    def __init__(self, action_type: Any, robot: SimulatedRobot, part: str,
                 now_ns: Callable[[], int], names: JointNames | None = None) -> None:
        self.action_type = action_type
        self.robot = robot
        self.part = part
        self._now_ns = now_ns
        self._names = names or JointNames()

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
            list(self._names.own(message.joint_names)), times_s, positions, velocities,
            accelerations, nanoseconds_of(message.header.stamp),
            self._tolerances(request.path_tolerance),
            self._tolerances(request.goal_tolerance), seconds_of(request.goal_time_tolerance)),
            self._now_ns())

    def feedback_of(self, goal: TrajectoryGoal) -> Any:
        message, view = self.action_type.Feedback(), goal.view
        message.joint_names = self._names.public(goal.names)
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

    def _tolerances(self, messages: Any) -> list[JointTolerance]:
        names = self._names.own([message.name for message in messages])
        return [JointTolerance(name, message.position, message.velocity, message.acceleration)
                for name, message in zip(names, messages)]


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

    def _filled(self, message: Any, goal: ActionGoal) -> Any:
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
            *self._names.own(numbers['name'])))

    def result_of(self, goal: ActionGoal) -> Any:
        message = self._filled(self.action_type.Result(), goal)
        if goal.view is not None:
            message.reached_goal, message.stalled = goal.view.reached, goal.view.stalled
        return message

    def _filled(self, message: Any, goal: ActionGoal) -> Any:
        view = goal.view
        if view is not None:
            message.state.header.stamp = stamp_of(view.time_ns)
            message.state.name = self._names.public([view.joint])
            message.state.position = [view.position]
            message.state.velocity, message.state.effort = [view.velocity], [view.effort]
        return message


ACTION_TYPES = import_optional('control_msgs.action')
#: Time for a client to ask for a result, wall time [s]; the default of rcl_action.
_RESULT_TIMEOUT_S = 10


class GoalServer:
    """
    The server of an action; all of it runs in the thread of the executor.

    A goal that cannot be met is rejected, with the code and the reason in the log: ROS 2 has no
    result for a goal that was rejected.

    :param messages: conversions of the messages of the action
    :param commands: counts goals as commands of the part
    :param tracker: watches the goals
    :param begun: is called when a goal has begun
    :ivar robot: that the goals are for
    :ivar is_closed: true if no more goals are accepted
    """

    def __init__(self, context: NodeContext, messages: ActionMessages,
                 commands: CommandSubscribers, tracker: GoalTracker, begun: Callable[[], None]
                 ) -> None:
        self._messages = messages
        self._commands = commands
        self.robot = commands.robot
        self._tracker = tracker
        self._log = context.log
        self._begun = begun
        self._name = commands.scope.topic(f'{messages.part}/{messages.name}')
        #: The last request that was accepted, with its goal, which is begun right afterwards.
        self._accepted: tuple[Any, ActionGoal] | None = None
        self._running: dict[bytes, tuple[ActionGoal, Any, Future]] = {}
        self._sent_ns: dict[bytes, int] = {}
        self.is_closed = False
        self._server = ActionServer(
            context.node, messages.action_type, context.node.renamed(self._name), self._execute,
            goal_callback=self._accept, handle_accepted_callback=self._begin,
            cancel_callback=self._cancel, result_timeout=_RESULT_TIMEOUT_S)

    def _accept(self, request: Any) -> GoalResponse:
        if self.is_closed:
            return GoalResponse.REJECT
        try:
            goal = self._messages.goal_of(request)
        except GoalError as error:
            self._commands.count_rejected(self._messages.part)
            self._log.warn(self._name, kind_of(error), f'rejected a goal of {self._name}: '
                           f'{error.code.name} ({error.code.value}): {error}')
            return GoalResponse.REJECT
        self._accepted = request, goal
        return GoalResponse.ACCEPT

    def _begin(self, goal_handle: Any) -> None:
        assert self._accepted is not None
        request, goal = self._accepted
        self._accepted = None
        assert request is goal_handle.request
        self._running[_key(goal_handle)] = goal, goal_handle, Future()
        goal_handle.execute()
        self._tracker.start(goal)
        self._commands.count(self._name, self._messages.part, [goal.command])
        self._begun()

    def _cancel(self, goal_handle: Any) -> CancelResponse:
        running = self._running.get(_key(goal_handle))
        if running is None or not self._tracker.cancel(running[0]):
            return CancelResponse.REJECT
        return CancelResponse.ACCEPT

    async def _execute(self, goal_handle: Any) -> Any:
        key = _key(goal_handle)
        goal, _, ended = self._running[key]
        await ended
        del self._running[key]
        self._sent_ns.pop(key, None)
        outcome = goal.outcome
        assert outcome is not None
        if outcome.ending is Ending.SUCCEEDED:
            goal_handle.succeed()
        elif outcome.ending is Ending.CANCELED:
            goal_handle.canceled()
        else:
            goal_handle.abort()
            self._log.warn(self._name, outcome.code.name, f'aborted a goal of {self._name}: '
                           f'{outcome.code.name} ({outcome.code.value}): {outcome.reason}')
        return self._messages.result_of(goal)

    def destroy(self) -> None:
        self._server.destroy()

    def report_end(self, goal: ActionGoal) -> bool:
        """
        Inform the client of a goal that has ended.

        :returns: whether the goal is one of this action
        """
        for running, _, ended in self._running.values():
            if running is goal:
                ended.set_result(None)
                return True
        return False

    def send_feedback(self) -> None:
        """Publish feedback of each goal if simulation time has passed since the last one."""
        for key, (goal, goal_handle, _) in self._running.items():
            view = goal.view
            if view is None or goal.outcome is not None or self._sent_ns.get(key) == view.time_ns:
                continue
            self._sent_ns[key] = view.time_ns
            goal_handle.publish_feedback(self._messages.feedback_of(goal))


def _key(goal_handle: Any) -> bytes:
    return bytes(goal_handle.goal_id.uuid)


#: Period of feedback to clients, wall time [s].
_FEEDBACK_S = 0.05


class ActionServers(Feature):
    """
    The action servers of all robots.

    :param commands: count the goals
    :param offer: returns the conversions of the messages of each action of a robot
    :ivar tracker: watches the goals
    """

    def __init__(self, context: NodeContext, commands: RobotCommands,
                 offer: Callable[[SimulatedRobot], Iterable[ActionMessages]]) -> None:
        self._context, self._commands, self._offer = context, commands, offer
        self._ended: queue.SimpleQueue[ActionGoal] = queue.SimpleQueue()
        self._guard = context.node.create_guard_condition(self._report_ends)
        self.tracker = GoalTracker(context.thread, context.simulation, self._has_ended)
        # The timer runs while there are goals.
        self._timer = context.node.create_timer(_FEEDBACK_S, self._send_feedback,
                                                clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._servers: list[GoalServer] = []
        for scope, robot in context.robots.items():
            self.robot_added(scope, robot)

    def robot_added(self, scope: Scope, robot: SimulatedRobot) -> None:
        self._servers += [
            GoalServer(self._context, messages, self._commands.of_robot(scope), self.tracker,
                       self._timer.reset) for messages in self._offer(robot)]

    def robot_removed(self, scope: Scope) -> None:
        """Abort the goals of a robot, for a reason that its clients learn, and accept no more."""
        robot = self._context.robots[scope]
        for server in self._servers:
            server.is_closed |= server.robot is robot
        self.tracker.abort_all(f"robot '{robot.name}' was deleted", robot.name)

    def world_changed(self) -> None:
        """Destroy the servers of robots that have gone, whose clients have their results."""
        for server in self._servers:
            if server.is_closed:
                server.destroy()
        self._servers = [server for server in self._servers if not server.is_closed]

    def _has_ended(self, goal: ActionGoal) -> None:
        """Hand a goal over from the simulation's thread to the executor's."""
        self._ended.put(goal)
        self._guard.trigger()

    def _report_ends(self) -> None:
        while not self._ended.empty():
            goal = self._ended.get()
            any(server.report_end(goal) for server in self._servers)

    def _send_feedback(self) -> None:
        if not self.tracker.goals:
            self._timer.cancel()
        for server in self._servers:
            server.send_feedback()

    def close(self) -> None:
        """Destroy the servers, which rclpy does not with their node."""
        for server in self._servers:
            server.destroy()
        self._servers = []

    def end(self) -> None:
        """Abort all goals and wait until their clients know, while the executor still spins."""
        with contextlib.suppress(SimulationEnded):
            if not self.tracker.goals:
                return
            self.tracker.abort_all('the node is ending')
        let_clients_know(self._context.node)


def messages_of(types: Any, robot: SimulatedRobot, now_ns: Callable[[], int],
                names: JointNames | None = None) -> Iterator[ActionMessages]:
    """
    Yield the conversions of the messages of each action of a robot.

    :param types: such as ``control_msgs.action``, with or without ``ParallelGripperCommand``
    :param now_ns: returns the simulation time [ns]
    :param names: what joints are called in messages
    """
    for name, part in robot.parts.items():
        if part.gripper is None:
            if part.actuators:
                yield TrajectoryMessages(types.FollowJointTrajectory, robot, name, now_ns, names)
        elif robot.grippers[name].joints.names or robot.grippers[name].cups.names:
            yield GripperMessages(types.GripperCommand, robot, name, now_ns, names)
            if hasattr(types, 'ParallelGripperCommand'):
                yield ParallelGripperMessages(
                    types.ParallelGripperCommand, robot, name, now_ns, names)


def offer_actions(context: NodeContext, commands: RobotCommands) -> ActionServers | None:
    """Offer the actions if the package control_msgs is installed, else note that it is missing."""
    if ACTION_TYPES is None:
        context.missing['control_msgs'] = 'actions'
        return None
    return ActionServers(context, commands, partial(
        messages_of, ACTION_TYPES, now_ns=lambda: context.thread.progress.time_ns,
        names=context.joint_names))


_SERVICE = '~/move_until_contact'
_STANDS = (0.0, 0.0, 0.0)
_ENDING = 'the node is ending'
#: Keys of a request with their defaults, None for those that have none.
_KEYS: Mapping[str, Any] = {'robot': '', 'arm': 'right', 'linear': _STANDS, 'angular': _STANDS,
                            'frame': '', 'force': None, 'distance': None, 'duration': None}


class _Motion(NamedTuple):
    """
    A motion whose client waits for its end.

    :ivar robot: its name
    :ivar handle: of the command
    :ivar answer: set to whether a limit has ended it, and to the message
    """

    robot: str
    arm: str
    handle: CommandHandle
    answer: Future


class MotionsUntilContact(Feature):
    """
    The service ``~/move_until_contact``, and a latched publisher of the ends, ``~/contact``.

    :param context: with a thread that has not been started
    :param commands: count the motions
    """

    def __init__(self, context: NodeContext, commands: RobotCommands) -> None:
        self._context, self._commands = context, commands
        self._publisher = create_publisher(context, BY_NAME['~/contact'])
        self._simulation: Simulation = context.simulation
        self._published = self._present()
        # The executor adds to them, the thread of the simulation takes away.
        self._motions: tuple[_Motion, ...] = ()
        self._lock, self._ends = threading.Lock(), False
        self._ended: queue.SimpleQueue[tuple[_Motion, bool, str]] = queue.SimpleQueue()
        # A group of their own: nothing else waits for the end of a motion, nor for one another.
        group = ReentrantCallbackGroup()
        self._guard = context.node.create_guard_condition(self._answer, group)
        context.node.create_service(AddDiagnostics, _SERVICE, self._serve, callback_group=group)
        context.thread.observe(self._observe, look=self._has_ended)

    def _present(self) -> dict[tuple[str, str], Contact | None]:
        return {(name, arm): report.contact for name, robot in self._simulation.robots.items()
                for arm, report in robot.joints.cartesian.reports.items()}

    def _new(self) -> dict[tuple[str, str], Contact]:
        return {place: contact for place, contact in self._present().items()
                if contact is not None and contact is not self._published.get(place)}

    def _has_ended(self) -> bool:
        return bool(self._new()) or not all([
            motion.handle.is_active for motion in self._motions])

    def _observe(self, _: Simulation) -> None:
        """Publish the ends of motions, and hand over the answers of those that were requested."""
        present = self._present()
        for (robot, arm), contact in self._new().items():
            self._publisher.publish(String(data=_described(robot, arm, contact)))
        self._published = present
        ended = [motion for motion in self._motions if not motion.handle.is_active]
        for motion in ended:
            done = motion.handle.status is Status.DONE
            end = present.get((motion.robot, motion.arm))
            self._ended.put((motion, done, _described(motion.robot, motion.arm, end)
                             if done and end else _why(motion.handle)))
        if ended:
            with self._lock:
                self._motions = tuple([m for m in self._motions if m not in ended])
            self._guard.trigger()

    def _answer(self) -> None:
        while not self._ended.empty():
            motion, success, message = self._ended.get()
            if not motion.answer.done():
                motion.answer.set_result((success, message))

    async def _serve(self, request: Any, response: Any) -> Any:
        """Begin the motion that a text in ``load_namespace`` describes, and wait for its end."""
        try:
            robot, command = self._command(request.load_namespace)
            handle, = self._context.thread.submit([command], robot=robot.name)
        except ManipSimError as error:
            response.success, response.message = False, str(error)
            return response
        motion = _Motion(robot.name, command.arm, handle, Future())
        with self._lock:
            self._motions = (*self._motions, motion)
            if self._ends:
                motion.answer.set_result((False, _ENDING))
        next(commands for commands in self._commands.robots if commands.robot is robot).count(
            _SERVICE, command.arm, [command])
        self._context.thread.observers.refresh()
        response.success, response.message = await motion.answer
        return response

    def _command(self, text: str) -> tuple[SimulatedRobot, GuardedTwist]:
        """
        Return the robot and the command of a request.

        :raises ManipSimError: if it cannot be used
        """
        values = parse_yaml(text, 'the motion')
        for key in values:
            if key not in _KEYS:
                raise UnknownNameError('key of a motion until contact', key, _KEYS)
        values = {**_KEYS, **values}
        for key in ('robot', 'arm', 'frame'):
            if not isinstance(values[key], str):
                raise CommandError(f"the motion: '{key}' must be a name, "
                                   f'got {format_value(values[key])}')
        robots = self._simulation.robots
        name = values['robot'] or self._simulation.robot.name
        if name not in robots:
            raise UnknownNameError('robot', name, robots)
        command = robots[name].parse_cartesian.until_contact(
            values['arm'], values['linear'], values['angular'], force=values['force'],
            distance=values['distance'], duration_s=values['duration'], frame=values['frame'])
        refusal = robots[name].reflexes.refusal(command)
        if refusal is not None:
            raise CommandError(refusal)
        return robots[name], command

    def end(self) -> None:
        """Answer clients that wait still, and wait until they know."""
        with self._lock:
            self._ends, motions = True, self._motions
        for motion in motions:
            self._ended.put((motion, False, _ENDING))
        if motions:
            self._guard.trigger()
            let_clients_know(self._context.node)


def _described(robot: str, arm: str, contact: Contact) -> str:
    """Return JSON of the end of a motion."""
    return json.dumps({
        'robot': robot, 'arm': arm, 'cause': contact.cause,
        'position': contact.position.tolist(), 'wrench': contact.wrench.tolist(),
        'distance': contact.distance, 'duration': contact.duration_s})


def _why(handle: CommandHandle) -> str:
    """Return why none of its limits has ended a motion."""
    replaced = handle.status is Status.REPLACED
    return f'the motion was {"replaced by a newer command" if replaced else "aborted"}' + (
        f': {handle.reason}' if handle.reason else '')
