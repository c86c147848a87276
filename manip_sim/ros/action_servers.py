# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The actions of the package control_msgs, where it is installed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
import contextlib
from functools import partial
import queue
import threading
from typing import Any, TYPE_CHECKING

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.clock import Clock, ClockType
from rclpy.task import Future

from manip_sim.errors import SimulationEnded
from manip_sim.ros.action_messages import (
    ActionMessages, GripperMessages, ParallelGripperMessages, TrajectoryMessages)
from manip_sim.ros.background import Rounds
from manip_sim.ros.command_subscribers import CommandSubscribers
from manip_sim.ros.optional_packages import import_optional
from manip_sim.ros.rejection_log import kind_of
from manip_sim.runtime.action_goals import Ending, ActionGoal, GoalError
from manip_sim.runtime.goal_tracker import GoalTracker
from manip_sim.simulation import SimulatedRobot

if TYPE_CHECKING:
    from manip_sim.ros.sim_node import SimNode

ACTION_TYPES = import_optional('control_msgs.action')
#: How long a client may take to ask for a result, wall time [s]; the default of rcl_action.
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
    """

    def __init__(self, node: SimNode, messages: ActionMessages, commands: CommandSubscribers,
                 tracker: GoalTracker, begun: Callable[[], None]) -> None:
        self._messages = messages
        self._commands = commands
        self.robot = commands.robot
        self._tracker = tracker
        self._log = node.rejections
        self._begun = begun
        self._name = commands.scope.topic(f'{messages.part}/{messages.name}')
        #: The last request that was accepted, with its goal, which is begun right afterwards.
        self._accepted: tuple[Any, ActionGoal] | None = None
        self._running: dict[bytes, tuple[ActionGoal, Any, Future]] = {}
        self._sent_ns: dict[bytes, int] = {}
        self._closed = False
        self._server = ActionServer(
            node, messages.action_type, self._name, self._execute, goal_callback=self._accept,
            handle_accepted_callback=self._begin, cancel_callback=self._cancel,
            result_timeout=_RESULT_TIMEOUT_S)

    def close(self) -> None:
        self._closed = True

    def _accept(self, request: Any) -> GoalResponse:
        if self._closed:
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
#: How long the node waits at its end until clients have their results, wall time [s].
_END_S = 1.0
#: Ends of goals, results and their answers each take a round of the executor.
_ROUNDS = 6


class ActionServers:
    """
    The action servers of all robots.

    :param offer: returns the conversions of the messages of each action of a robot
    :ivar tracker: watches the goals
    """

    def __init__(self, node: SimNode,
                 offer: Callable[[SimulatedRobot], Iterable[ActionMessages]]) -> None:
        self._node, self._offer = node, offer
        self._ended: queue.SimpleQueue[ActionGoal] = queue.SimpleQueue()
        self._guard = node.create_guard_condition(self._report_ends)
        self.tracker = GoalTracker(node.thread, node.simulation, self._has_ended)
        # The timer runs while there are goals.
        self._timer = node.create_timer(_FEEDBACK_S, self._send_feedback,
                                        clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._servers: list[GoalServer] = []
        for commands in node.commands:
            self.add(commands)

    def add(self, commands: CommandSubscribers) -> None:
        """Add the servers of a robot, whose commands count its goals."""
        self._servers += [
            GoalServer(self._node, messages, commands, self.tracker, self._timer.reset)
            for messages in self._offer(commands.robot)]

    def close(self, robot: SimulatedRobot, reason: str) -> None:
        """Abort the goals of a robot, for a reason that its clients learn, and accept no more."""
        for server in self._servers:
            if server.robot is robot:
                server.close()
        self.tracker.abort_all(reason, robot.name)

    def remove(self, robot: SimulatedRobot) -> None:
        """Destroy the servers of a robot, after :meth:`close`."""
        for server in self._servers:
            if server.robot is robot:
                server.destroy()
        self._servers = [server for server in self._servers if server.robot is not robot]

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

    def destroy(self) -> None:
        for server in self._servers:
            server.destroy()
        self._servers = []

    def end(self) -> None:
        """Abort all goals and wait until their clients know, while the executor still spins."""
        with contextlib.suppress(SimulationEnded):
            if not self.tracker.goals:
                return
            self.tracker.abort_all('the node is ending')
        answered = threading.Event()

        async def wait() -> None:
            await self.answered()
            answered.set()
        self._node.executor.create_task(wait)
        answered.wait(_END_S)

    def answered(self) -> Rounds:
        """Return an awaitable for the clients of goals that end now to know that."""
        return Rounds(self._node, _ROUNDS)


def messages_of(types: Any, robot: SimulatedRobot, now_ns: Callable[[], int]
                ) -> Iterator[ActionMessages]:
    """
    Yield the conversions of the messages of each action of a robot.

    :param types: such as ``control_msgs.action``, with or without ``ParallelGripperCommand``
    :param now_ns: returns the simulation time [ns]
    """
    for name, part in robot.parts.items():
        if part.gripper is None:
            if part.actuators:
                yield TrajectoryMessages(types.FollowJointTrajectory, robot, name, now_ns)
        elif robot.grippers[name].joints.names:
            yield GripperMessages(types.GripperCommand, robot, name, now_ns)
            if hasattr(types, 'ParallelGripperCommand'):
                yield ParallelGripperMessages(types.ParallelGripperCommand, robot, name, now_ns)


def offer_actions(node: SimNode) -> ActionServers | None:
    """Offer the actions if the package control_msgs is installed, else note that it is missing."""
    if ACTION_TYPES is None:
        node.missing['control_msgs'] = 'actions'
        return None
    return ActionServers(node, partial(
        messages_of, ACTION_TYPES, now_ns=lambda: node.thread.progress.time_ns))
