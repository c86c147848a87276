# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Subscriptions of the viewer: messages that cannot be used are counted and logged."""

from __future__ import annotations

from collections.abc import Callable
import time
from typing import Any

from rclpy.node import Node

from manip_sim.errors import ManipSimError
from manip_sim.ros.executor import GuardedExecutor
from manip_sim.ros.reading import read_message
from manip_sim.ros.rejection_log import kind_of, RejectionLog

#: More than any message but images and models needs [bytes].
_MAX_BYTES = 2**20
#: How long callbacks may run before the page gets its turn [s].
_ROUND_S = 0.05


class Readers:
    """
    The subscriptions of the viewer.

    :param node: the viewer's own
    :ivar log: bounds what is logged
    :ivar rejected: how many messages could not be used
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self.log = RejectionLog(node.get_logger())
        self.rejected = 0

    def subscribe(self, kind: Any, topic: str, take: Callable[[Any], None], qos: Any,
                  most: int = _MAX_BYTES) -> Any:
        """
        Subscribe to a topic.

        :param kind: type of its messages
        :param take: takes a message, or raises a :class:`ManipSimError`, which rejects it
        :param most: size of a message at most [bytes]
        :returns: the subscription
        """
        def receive(data: bytes) -> None:
            try:
                take(read_message(kind, data, most, 'what is shown'))
            except ManipSimError as error:
                self.reject(topic, error)
        return self._node.create_subscription(kind, topic, receive, qos, raw=True)

    def reject(self, topic: str, error: ManipSimError) -> None:
        """Count a message that cannot be used, and log it, each kind once a second."""
        self.rejected += 1
        self.log.warn(topic, kind_of(error), f'{topic}: {error}')


class PolledExecutor(GuardedExecutor):
    """An executor that runs callbacks when it is polled, not when messages come."""

    def run_ready(self) -> None:
        """Run callbacks until none is ready or time is up, without waiting for more."""
        end_s = time.monotonic() + _ROUND_S
        while time.monotonic() < end_s and self.run_one(0.0):
            pass
