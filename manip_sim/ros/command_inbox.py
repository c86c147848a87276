# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Take commands without rclpy's executor.

An executor goes through all entities of a node, in Python, before and after each wait. Here one
thread waits for nothing but commands: in lock-step the simulation's thread, which uses them next,
else a separate thread, so that a flood takes no time from the physics. A thread of the middleware
counts the messages of each subscription in an eventfd, for which the system waits, so that a wait
costs the same however many topics there are. rclpy has no public way to do so; with a release of
rclpy or a middleware that lacks the internals used here, the executor takes the commands too, and
a warning says so.
"""

from __future__ import annotations

import contextlib
import os
import select
import threading
import time
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.publisher import Publisher

from manip_sim.quoting import one_line
from manip_sim.rclpy_internals import (
    count_messages, InUse, MatchCounter, missing_for_waits, RCLError, WaitSet, without_source)
from manip_sim.ros.executor import RejectionLog
from manip_sim.runtime.simulation_thread import Inbox

#: Period at which events are looked at [s].
_EVENTS_S = 0.2
#: Pause when there is nothing to wait for, as while the context is shut down [s].
_CLOSING_S = 0.01
#: Number of messages of a topic that are taken at once, which a subscription keeps.
_TAKEN_AT_ONCE = 10


class _NotByExecutors(CallbackGroup):
    """
    A group of entities that executors do not serve.

    :ivar exempt: entities that they serve all the same
    """

    def __init__(self) -> None:
        super().__init__()
        self.exempt: list[Any] = []

    def can_execute(self, entity: Any) -> bool:
        return entity in self.exempt

    def beginning_execution(self, entity: Any) -> bool:
        return True

    def ending_execution(self, entity: Any) -> None:
        pass


class CommandInbox(Inbox):
    """
    An inbox that takes the messages of subscriptions in the thread that waits.

    It handles their events too, a few times a second: in Fast DDS a subscription and its events
    share a wake-up, so a thread may miss its own while another thread waits for the other.

    It also notes whether subscriptions of the node's publishers come or go.

    :ivar group: of the subscriptions
    :ivar matches: another number whenever a subscription of a watched publisher has come or gone;
        None if the middleware does not tell
    """

    def __init__(self, node: Node, log: RejectionLog) -> None:
        super().__init__()
        self._node = node
        self._log = log
        self.group = _NotByExecutors()
        self._poll = select.epoll()
        self._wakes = self._counter()
        self._subscriptions: dict[int, Any] = {}  # By their counters.
        self.matches: int | None = 0
        self._of_matches = self._counter()
        self._watched: dict[Publisher, MatchCounter] = {}
        #: Held while counters come and go; a signal handler may wake this too.
        self._lock = threading.RLock()
        self._closed = False
        self._look_at_s = 0.0

    def _counter(self) -> int:
        """Return an eventfd that ends waits while it is not zero."""
        counter = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._poll.register(counter, select.EPOLLIN)
        return counter

    def add(self, subscription: Any) -> None:
        """
        Take the messages of a subscription of the group; any thread may call this.

        If the middleware cannot count them, or the process has too many files open, executors
        take them, and a warning says so.
        """
        with self._lock:
            try:
                counter = self._counter()
                self._subscriptions[counter] = subscription
                count_messages(subscription, counter)
                # One that came while this began may not be among those that are counted.
                os.eventfd_write(counter, 1)
            except (OSError, RCLError) as error:
                self.remove(subscription)
                if not self.group.exempt:
                    _warn(self._node, without_source(error))
                self.group.exempt.append(subscription)

    def remove(self, subscription: Any) -> None:
        """Take the messages of a subscription no more; to be called before it is destroyed."""
        with self._lock:
            if subscription in self.group.exempt:
                self.group.exempt.remove(subscription)
            for counter in [counter for counter, other in self._subscriptions.items()
                            if other is subscription]:
                del self._subscriptions[counter]
                with contextlib.suppress(InvalidHandle, RCLError):  # Nothing is counted.
                    count_messages(subscription, None)
                os.close(counter)  # Nothing waits for it then.

    def watch(self, publisher: Publisher) -> None:
        """Note from now on whether subscriptions of a publisher come or go, in ``matches``."""
        with self._lock:
            if self.matches is None:
                return
            try:
                self._watched[publisher] = MatchCounter(publisher, self._of_matches)
                self.matches += 1
            except RCLError:
                self.matches = None

    def forget(self, publisher: Publisher) -> None:
        """Let go of a publisher; to be called before it is destroyed."""
        with self._lock:
            counter = self._watched.pop(publisher, None)
            if counter is not None:
                with contextlib.suppress(InvalidHandle):  # Nothing is counted.
                    counter.close()

    def wake(self) -> None:
        with self._lock:
            if not self._closed:
                os.eventfd_write(self._wakes, 1)

    def wait(self, timeout_s: float) -> None:
        """Wait until a message comes or somebody wakes this, and take one of each topic."""
        if self._closed:
            super().wait(min(timeout_s, _CLOSING_S))
        else:
            self._receive(timeout_s)

    def take(self, most: int = 1) -> None:
        """
        Take the messages that have come, without waiting.

        :param most: of each topic; a flood must not hold up the physics
        """
        for _ in range(most):
            # If this swallows a wake-up by another thread, its cause is checked before the next
            # wait.
            if self._closed or not self._receive(0.0):
                break

    def close(self) -> None:
        """Take no messages any more; to be called when no thread does, before the node's end."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
            for subscription in list(self._subscriptions.values()):
                self.remove(subscription)
            for publisher in list(self._watched):
                self.forget(publisher)
            self.matches = None
            self._poll.close()
            os.close(self._wakes)
            os.close(self._of_matches)

    def _receive(self, timeout_s: float) -> bool:
        """Wait for messages and take one of each topic that has some; return whether one has."""
        now_s = time.monotonic()
        if now_s >= self._look_at_s:
            self._look_at_s = now_s + _EVENTS_S
            with contextlib.suppress(InvalidHandle, RCLError):  # Something is being closed.
                self._see_events([event for subscription in list(self._subscriptions.values())
                                  for event in subscription.event_handlers])
        ready = [counter for counter, _ in self._poll.poll(max(0.0, min(timeout_s, _EVENTS_S)))]
        for counter in ready:
            self._take(counter)
        return any(counter in self._subscriptions for counter in ready)

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

    def _take(self, counter: int) -> None:
        """Take a message, if a counter counts those of a subscription."""
        with self._lock:
            subscription = self._subscriptions.get(counter)
            if subscription is None and counter not in (self._wakes, self._of_matches):
                return  # It has been removed meanwhile.
            try:
                count = os.eventfd_read(counter)
            except BlockingIOError:  # That of another one that came instead.
                return
            if counter == self._of_matches and self.matches is not None:
                self.matches += count
        if subscription is None:
            return
        try:
            handle = subscription.handle
            with handle:  # Or another thread may destroy it meanwhile.
                taken = handle.take_message(subscription.msg_type, subscription.raw)
            # If there is none, those that were counted have been replaced by later ones.
            if taken is not None:
                if count > 1:
                    self._count_again(counter, count - 1)
                subscription.callback(*taken)
        except InvalidHandle:  # It is being closed in another thread.
            pass
        except Exception as error:
            self._log.failure('callbacks', subscription.topic_name, error)

    def _count_again(self, counter: int, count: int) -> None:
        with self._lock:
            if counter in self._subscriptions:
                os.eventfd_write(counter, count)


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
    _warn(node, ', '.join(missing))
    return None


def _warn(node: Node, why: str) -> None:
    node.get_logger().warning(
        f'this rclpy cannot wait for commands alone ({why}): its executor takes them, which is '
        'slower, and slows down all else in a flood')
