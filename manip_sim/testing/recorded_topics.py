# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The topics of a node that a test records: one message for each control period."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState

from manip_sim.errors import UnknownNameError
from manip_sim.ros.messages import nanoseconds_of

#: What is recorded, by the name of the type of the topic.
_RECORDED = {f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}': kind
             for kind in (JointState, WrenchStamped, PoseStamped, TwistStamped)}


class RecordedTopics:
    """
    The messages of the topics with joint states, wrenches, poses and twists.

    :param node: that subscribes to them
    :ivar repeats: how often all joint states were repeated since the last new message
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._messages: dict[str, list[Any]] = {}
        self._subscriptions: dict[str, Any] = {}
        self.repeats = 0

    def begin(self) -> None:
        """Record what is published now."""
        for topic, types in self._node.get_topic_names_and_types():
            if types[0] in _RECORDED and self._node.count_publishers(topic):
                self._record(topic, _RECORDED[types[0]])

    def begin_anew(self) -> None:
        """Forget all messages; subscriptions may still hold some of a node that was killed."""
        for topic, subscription in list(self._subscriptions.items()):
            message_type = subscription.msg_type
            self._node.destroy_subscription(subscription)
            self._record(topic, message_type)
        self.repeats = 0

    def _record(self, topic: str, message_type: Any) -> None:
        messages = self._messages[topic] = []

        def take(message: Any) -> None:
            stamp_ns = nanoseconds_of(message.header.stamp)
            if not messages or stamp_ns > nanoseconds_of(messages[-1].header.stamp):
                messages.append(message)
                self.repeats = 0
            else:
                self.repeats += topic.endswith('/joint_states') and topic.count('/') == 1
        self._subscriptions[topic] = self._node.create_subscription(
            message_type, topic, take, 1000)

    def messages(self, topic: str) -> list[Any]:
        """
        Return the messages of a topic up to now, a copy.

        :param topic: such as ``right/eef_pose``, with or without a slash before it
        :raises UnknownNameError: if there is no such topic
        """
        name = f'/{topic.lstrip("/")}'
        if name not in self._messages:
            raise UnknownNameError('recorded topic', topic, [t[1:] for t in self._messages])
        return list(self._messages[name])

    def stamp_ns(self, topic: str, index: int = -1) -> int:
        """Return the stamp of a message [ns], by its index; of a topic with a leading slash."""
        return nanoseconds_of(self._messages[topic][index].header.stamp)

    def with_messages(self, message_type: type = object) -> list[str]:
        """Return the names of the topics of a type that have a message, with a leading slash."""
        return [name for name, messages in self._messages.items()
                if messages and isinstance(messages[0], message_type)]
