# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A subscription to commands that matches reliable and best-effort publishers."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

from manip_sim.ros.command_inbox import CommandInbox

#: How many commands of a topic may wait to be taken.
COMMAND_DEPTH = 10


class CommandSubscription:
    """
    A reliable subscription, to which a best-effort one is added once such a publisher comes.

    A reliable subscription loses nothing, which lock-step needs, but does not match a best-effort
    publisher. Messages of reliable publishers, which then come twice, are taken once.

    :param node: the node
    :param message_type: of the topic
    :param topic: its name
    :param take: is called with each message in its serialized form
    :param inbox: takes the messages; None: the executor does
    """

    def __init__(self, node: Node, message_type: Any, topic: str, take: Callable[[bytes], None],
                 inbox: CommandInbox | None = None) -> None:
        self._take = take
        self._taken: deque[tuple[int, int]] = deque(maxlen=4 * COMMAND_DEPTH)
        self._best_effort: Any = None

        def subscribe(qos: QoSProfile, **arguments: Any) -> Any:
            subscription = node.create_subscription(
                message_type, topic, self._take_once, qos, raw=True,
                callback_group=None if inbox is None else inbox.group, **arguments)
            if inbox is not None:
                inbox.add(subscription)
            return subscription

        def match_best_effort(_: Any) -> None:
            if self._best_effort is None:
                self._best_effort = subscribe(QoSProfile(
                    depth=COMMAND_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT),
                    event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False))

        self._reliable = subscribe(
            QoSProfile(depth=COMMAND_DEPTH),
            event_callbacks=SubscriptionEventCallbacks(
                incompatible_qos=match_best_effort, use_default_callbacks=False),
            qos_overriding_options=QoSOverridingOptions.with_default_policies())

    def _take_once(self, data: bytes, info: dict[str, Any]) -> None:
        which = info['source_timestamp'], info['publication_sequence_number']
        if which not in self._taken:
            self._taken.append(which)
            self._take(data)
