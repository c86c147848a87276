# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""One action server: it accepts goals, has them tracked, and sends feedback and results."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.node import Node
from rclpy.task import Future

from manip_sim.ros.action_messages import ActionMessages
from manip_sim.ros.commands import CommandSubscribers
from manip_sim.ros.log import kind_of, RejectionLog
from manip_sim.runtime.goal_tracker import GoalTracker
from manip_sim.simulation.goals import Ending, Goal, GoalError

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

    def __init__(self, node: Node, messages: ActionMessages, commands: CommandSubscribers,
                 tracker: GoalTracker, log: RejectionLog, begun: Callable[[], None]) -> None:
        self._messages = messages
        self._commands = commands
        self.robot = commands.robot
        self._tracker = tracker
        self._log = log
        self._begun = begun
        self._name = commands.scope.topic(f'{messages.part}/{messages.name}')
        #: The last request that was accepted, with its goal, which is begun right afterwards.
        self._accepted: tuple[Any, Goal] | None = None
        self._running: dict[bytes, tuple[Goal, Any, Future]] = {}
        self._sent_ns: dict[bytes, int] = {}
        self._closed = False
        self._server = ActionServer(
            node, messages.action_type, self._name, self._execute, goal_callback=self._accept,
            handle_accepted_callback=self._begin, cancel_callback=self._cancel,
            result_timeout=_RESULT_TIMEOUT_S)

    def close(self) -> None:
        """Accept no more goals."""
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
        """Destroy the server."""
        self._server.destroy()

    def report_end(self, goal: Goal) -> bool:
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
