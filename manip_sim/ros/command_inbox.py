# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Let the simulation's thread take commands itself in lock-step.

An executor of rclpy asks all that a node has, in Python, before and after each wait, and what it
takes has to wait for another thread then. Here one thread waits for the commands alone, takes them
and uses them. In real time a flood of commands would take time from the physics, so the executor
takes them there. There is no public way to wait for some subscriptions; where rclpy is another
than those that this is known to work with, the executor takes commands as it does everything else.
"""

from __future__ import annotations

import contextlib
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from rclpy._rclpy_pybind11 import InvalidHandle, RCLError
from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import EventHandler
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node

from manip_sim.ros.log import RejectionLog
from manip_sim.runtime.inbox import Inbox

#: The releases of rclpy, those of ROS 2 Jazzy, whose wait sets are known.
_KNOWN = '7.1.'
#: While the context is being shut down there is nothing to wait for; then it is looked again [s].
_CLOSING_S = 0.01


class _NotByExecutors(CallbackGroup):
    """What executors leave to somebody else, but its events."""

    def can_execute(self, entity: Any) -> bool:
        return isinstance(entity, EventHandler)

    def beginning_execution(self, entity: Any) -> bool:
        return True

    def ending_execution(self, entity: Any) -> None:
        pass


class CommandInbox(Inbox):
    """
    Takes the messages of subscriptions in the thread that waits.

    :param node: the node
    :param log: counts and tells what callbacks raise, and what cannot be read
    :ivar group: of the subscriptions
    """

    def __init__(self, node: Node, log: RejectionLog) -> None:
        super().__init__()
        self._node = node
        self._log = log
        self.group = _NotByExecutors()
        self._guard = node.create_guard_condition(lambda: None, self.group)
        self._subscriptions: list[Any] = []
        self._wait_set: Any = None

    def add(self, subscription: Any) -> None:
        """Take the messages of a subscription of the group; any thread may call this."""
        self._subscriptions = [*self._subscriptions, subscription]
        self.wake()

    def wake(self) -> None:
        """Let the present wait end, or the next one if there is none; any thread may call this."""
        with contextlib.suppress(InvalidHandle):  # The node is being destroyed.
            self._guard.trigger()

    def wait(self, timeout_s: float) -> None:
        """
        Wait until a message comes or somebody wakes this, and take what has come.

        :param timeout_s: for so long at most [s]
        """
        try:
            self._receive(timeout_s)
        except (InvalidHandle, RCLError):  # Something is being closed in another thread.
            super().wait(min(timeout_s, _CLOSING_S))

    def take(self, most: int = 1) -> None:
        """
        Take what has come, without waiting.

        :param most: of each topic; a flood must not hold up the physics
        """
        with contextlib.suppress(InvalidHandle, RCLError):
            for _ in range(most):
                # To wait for no time takes longer than to be woken. Whoever else wakes this now
                # has said why before, and is seen to before the next wait.
                self._guard.trigger()
                if not self._receive(0.0):
                    break

    def _receive(self, timeout_s: float) -> bool:
        """Wait for messages and take one of each topic that has some; tell whether one has."""
        subscriptions = self._subscriptions
        with contextlib.ExitStack() as in_use:
            for handle in (self._node.context.handle, self._guard.handle,
                           *(subscription.handle for subscription in subscriptions)):
                in_use.enter_context(handle)
            wait_set = rclpy_implementation.WaitSet(
                len(subscriptions), 1, 0, 0, 0, 0, self._node.context.handle)
            wait_set.clear_entities()
            wait_set.add_guard_condition(self._guard.handle)
            for subscription in subscriptions:
                wait_set.add_subscription(subscription.handle)
            wait_set.wait(max(0, int(timeout_s * 1e9)))
            ready = [subscription for index, subscription in enumerate(subscriptions)
                     if wait_set.is_ready('subscription', index)]
            for subscription in ready:
                self._take(subscription)
        return bool(ready)

    def _take(self, subscription: Any) -> None:
        try:
            taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
            if taken is None:
                self._log.unreadable(subscription.topic_name)
            else:
                subscription.callback(*taken)
        except Exception as error:
            self._log.failure('callbacks', subscription.topic_name, error)


def create_command_inbox(node: Node, log: RejectionLog) -> CommandInbox | None:
    """
    Create what takes commands, or return None if the executor has to.

    :param log: counts and tells what callbacks raise, and what cannot be read
    """
    try:
        known = version('rclpy').startswith(_KNOWN)
    except PackageNotFoundError:
        known = False
    return CommandInbox(node, log) if known else None
