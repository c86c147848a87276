# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Publishers that never stop the simulation, and cost little while nobody subscribes."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.duration import Duration
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.serialization import serialize_message

from manip_sim.interface.topics import Topic
from manip_sim.rclpy_internals import parameter_overrides, publish_bytes, RCLError
from manip_sim.ros.messages import message_class
from manip_sim.ros.node_context import NodeContext
from manip_sim.ros.publishing_thread import PublishingThread
from manip_sim.ros.rejection_log import RejectionLog


class Output:
    """
    A publisher that never stops the simulation.

    With history ``keep_all`` a reader that does not acknowledge fills the history. Publishing then
    waits (100 ms with Fast DDS) and fails. Until all messages are acknowledged or the reader is
    gone, further messages are dropped and counted without waiting.

    :param thread: publishes the messages; None: :meth:`publish` does so itself
    """

    def __init__(self, publisher: Publisher, log: RejectionLog,
                 thread: PublishingThread | None = None) -> None:
        self._publisher = publisher
        self._thread = thread
        self._log = log
        self._stalled = False
        self._closed = False

    @property
    def subscribers(self) -> int:
        try:
            return 0 if self._closed else int(self._publisher.get_subscription_count())
        except InvalidHandle:  # It is being closed in another thread.
            return 0

    @property
    def has_subscribers(self) -> bool:
        return self.subscribers > 0

    @property
    def wanted(self) -> bool:
        """Whether there are subscribers and the next message can be published."""
        return self.has_subscribers and not self._drops()

    def _drops(self) -> bool:
        """Return whether the next message is dropped, and count it if so."""
        if self._stalled:
            self._stalled = not self._publisher.wait_for_all_acked(Duration())
            if self._stalled:
                topic = self._publisher.topic_name
                self._log.failed['publications'] += 1
                self._log.warn(topic, 'stalled', f'{topic}: a reader does not acknowledge, '
                               'messages are dropped until it does or is gone')
        return self._stalled

    def close(self, node: Node) -> None:
        """Destroy the publisher; no messages are wanted from now on."""
        self._closed = True
        node.destroy_publisher(self._publisher)

    def publish(self, message: Any) -> None:
        """Publish a message or its serialized bytes, or count it as dropped."""
        if self._thread is None:
            self._publish(self._publisher.publish, message)
            return
        content = message if isinstance(message, bytes) else serialize_message(message)
        self._thread.add(partial(
            self._publish, partial(publish_bytes, self._publisher), content))

    def _publish(self, publish: Callable[[Any], None], message: Any) -> None:
        try:
            if not (self._stalled and self._drops()):
                publish(message)
        except InvalidHandle:  # It is being closed in another thread.
            pass
        except RCLError as error:
            self._stalled = True
            self._log.failure('publications', self._publisher.topic_name, error)


def qos_options(context: NodeContext, topic: str) -> dict[str, Any]:
    """
    Return the arguments with which parameters override the QoS of a topic that is created now.

    Topics that come while the node runs have no such parameters, unless they were given: a dump
    has to start a node in which the topics are not there yet.
    """
    begin = f'qos_overrides.{context.node.resolve_topic_name(topic)}.'
    if context.is_built and not any(
            name.startswith(begin) for name in parameter_overrides(context.node)):
        return {}
    return {'qos_overriding_options': QoSOverridingOptions.with_default_policies()}


def create_publisher(context: NodeContext, row: Topic, message_type: Any = None) -> Publisher:
    """Create the publisher of a row of the table, or of another message type."""
    message_type = message_type or message_class(row.type)
    if row.latched:
        return context.node.create_publisher(message_type, row.name, QoSProfile(
            depth=row.depth, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL))
    return context.node.create_publisher(
        message_type, row.name, QoSProfile(depth=row.depth), **qos_options(context, row.name))


def create_output(context: NodeContext, row: Topic, message_type: Any = None) -> Output:
    """
    Create the output of a row of the table; at the start, parameters override its QoS.

    :param message_type: instead of that of the row
    """
    return Output(create_publisher(context, row, message_type), context.log, context.publishing)
