# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Take commands without rclpy's executor.

An executor goes through all entities of a node, in Python, before and after each wait. Here one
thread waits for nothing but commands: in lock-step the simulation's thread, which uses them next,
else a separate thread, so that a flood takes no time from the physics. rclpy has no public
way to wait for some subscriptions only; with a release of rclpy that lacks the internals used
here, the executor takes the commands too, and a warning says so.
"""

from __future__ import annotations

import contextlib
import threading
import time
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node

from manip_sim.quoting import one_line
from manip_sim.rclpy_internals import InUse, missing_for_waits, RCLError, WaitSet
from manip_sim.ros.rejection_log import RejectionLog
from manip_sim.runtime.inbox import Inbox

#: Period at which events are looked at [s].
_EVENTS_S = 0.2
#: Pause when there is nothing to wait for, as while the context is shut down [s].
_CLOSING_S = 0.01
#: Number of messages of a topic that are taken at once, which a subscription keeps.
_TAKEN_AT_ONCE = 10


class _NotByExecutors(CallbackGroup):
    """A group of entities that executors do not serve."""

    def can_execute(self, entity: Any) -> bool:
        return False

    def beginning_execution(self, entity: Any) -> bool:
        return True

    def ending_execution(self, entity: Any) -> None:
        pass


class CommandInbox(Inbox):
    """
    An inbox that takes the messages of subscriptions in the thread that waits.

    It handles their events too, a few times a second: in Fast DDS a subscription and its events
    share a wake-up, so a thread may miss its own while another thread waits for the other.

    :ivar group: of the subscriptions
    """

    def __init__(self, node: Node, log: RejectionLog) -> None:
        super().__init__()
        self._node = node
        self._log = log
        self.group = _NotByExecutors()
        self._guard = node.create_guard_condition(lambda: None, self.group)
        self._subscriptions: dict[Any, Any] = {}  # By their handles.
        self._look_at_s = 0.0

    def add(self, subscription: Any) -> None:
        """Take the messages of a subscription of the group; any thread may call this."""
        self._subscriptions = {**self._subscriptions, subscription.handle: subscription}
        self.wake()

    def remove(self, subscription: Any) -> None:
        """Take the messages of a subscription no more; to be called before it is destroyed."""
        self._subscriptions = {handle: other for handle, other in self._subscriptions.items()
                               if other is not subscription}
        self.wake()

    def wake(self) -> None:
        with contextlib.suppress(InvalidHandle):  # The node is being destroyed.
            self._guard.trigger()

    def wait(self, timeout_s: float) -> None:
        """Wait until a message comes or somebody wakes this, and take the waiting messages."""
        try:
            self._receive(timeout_s)
        except (InvalidHandle, RCLError):  # Something is being closed in another thread.
            super().wait(min(timeout_s, _CLOSING_S))

    def take(self, most: int = 1) -> None:
        """
        Take the messages that have come, without waiting.

        :param most: of each topic; a flood must not hold up the physics
        """
        with contextlib.suppress(InvalidHandle, RCLError):
            for _ in range(most):
                # A wait with a timeout of zero takes longer than one that is woken. If this
                # swallows a wake-up by another thread, its cause is checked before the next wait.
                self._guard.trigger()
                if not self._receive(0.0):
                    break

    def close(self) -> None:
        """Destroy what wakes this; not needed before the node is destroyed."""
        self._node.destroy_guard_condition(self._guard)

    def _receive(self, timeout_s: float) -> bool:
        """Wait for messages and take one of each topic that has some; return whether one has."""
        subscriptions = self._subscriptions
        now_s = time.monotonic()
        if now_s >= self._look_at_s:
            self._look_at_s = now_s + _EVENTS_S
            self._see_events([event for subscription in subscriptions.values()
                              for event in subscription.event_handlers])
        context, guard = self._node.context.handle, self._guard.handle
        with InUse((context, guard, *subscriptions)):
            wait_set = WaitSet(len(subscriptions), 1, 0, 0, 0, 0, context)
            wait_set.clear_entities()
            wait_set.add_guard_condition(guard)
            for handle in subscriptions:
                wait_set.add_subscription(handle)
            wait_set.wait(max(0, int(min(timeout_s, _EVENTS_S) * 1e9)))
            ready = wait_set.get_ready_entities('subscription')
            if ready:
                for handle, subscription in subscriptions.items():
                    if handle.pointer in ready:
                        self._take(subscription)
        return bool(ready)

    def _see_events(self, events: list[Any]) -> None:
        """Call the callbacks of events that have come, such as a publisher that does not match."""
        with InUse((self._node.context.handle, *events)):
            wait_set = WaitSet(0, 0, 0, 0, 0, len(events), self._node.context.handle)
            wait_set.clear_entities()
            for event in events:
                event.add_to_wait_set(wait_set)
            wait_set.wait(0)
            for event in events:
                if event.is_ready(wait_set):
                    self._report(event)

    def _report(self, event: Any) -> None:
        try:
            data = event.take_data()
            if data:
                event.callback(data)
        except Exception as error:
            self._log.failure('callbacks', f'an event of kind {event.event_type}', error)

    def _take(self, subscription: Any) -> None:
        try:
            taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
            if taken is None:
                self._log.unreadable(subscription.topic_name)
            else:
                subscription.callback(*taken)
        except Exception as error:
            self._log.failure('callbacks', subscription.topic_name, error)


class CommandThread:
    """
    A thread that takes the messages of an inbox.

    It sleeps for as long as it has worked, so that a flood of messages leaves time to the physics.
    """

    def __init__(self, inbox: CommandInbox) -> None:
        self._inbox = inbox
        self._ending = False
        self._lock = threading.Lock()
        #: Are set as soon as what had come before is taken.
        self._taken: list[threading.Event] = []
        self._thread = threading.Thread(target=self._run, name='commands')

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """End after the present message."""
        self._ending = True
        self._inbox.wake()
        if self._thread.is_alive():
            self._thread.join()

    @property
    def is_alive(self) -> bool:
        return self._thread.is_alive()

    def take(self) -> None:
        """
        Wait until the messages that have come are taken, of a flood only the first ones.

        In a callback of a message this does nothing: it would wait for itself.
        """
        if threading.current_thread() is self._thread:
            return
        taken = threading.Event()
        with self._lock:
            self._taken.append(taken)
        self._inbox.wake()
        while self.is_alive and not taken.wait(_EVENTS_S):
            pass

    def _run(self) -> None:
        while not self._ending:
            begin_s = time.thread_time()
            with self._lock:
                waiting, self._taken = self._taken, []
            if waiting:
                self._inbox.take(_TAKEN_AT_ONCE)
                for taken in waiting:
                    taken.set()
            else:
                self._inbox.wait(_EVENTS_S)
            time.sleep(time.thread_time() - begin_s)


def create_command_inbox(node: Node, log: RejectionLog) -> CommandInbox | None:
    """Create an inbox that takes commands; None, with a warning, if the executor has to."""
    missing = [f'no {name}' for name in missing_for_waits()]
    if not missing:
        inbox = CommandInbox(node, log)
        try:
            inbox.take()
        except (AttributeError, TypeError) as error:  # The internals have other signatures.
            inbox.close()
            missing = [one_line(str(error))]
        else:
            return inbox
    node.get_logger().warning(
        f'this rclpy cannot wait for commands alone ({", ".join(missing)}): its executor takes '
        'them, which is slower, and slows down all else in a flood')
    return None
