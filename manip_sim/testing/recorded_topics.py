# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What the node under test has published: the messages of its topics, also as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import time
from typing import Any

from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState

from manip_sim.arrays import FloatArray
from manip_sim.errors import UnknownNameError
from manip_sim.ros.messages import nanoseconds_of


@dataclass(frozen=True, eq=False)
class JointHistory:
    """
    States of joints, one row for each control period.

    :ivar names: of the joints
    :ivar time_s: stamps [s], shape (t,)
    :ivar position: [rad or m], shape (t, n)
    :ivar velocity: [rad/s or m/s], shape (t, n)
    :ivar effort: [N m or N], shape (t, n)
    """

    names: tuple[str, ...]
    time_s: FloatArray
    position: FloatArray
    velocity: FloatArray
    effort: FloatArray


@dataclass(frozen=True, eq=False)
class WrenchHistory:
    """
    Wrenches, one row for each control period.

    :ivar frame: of the numbers
    :ivar time_s: stamps [s], shape (t,)
    :ivar force: [N], shape (t, 3)
    :ivar torque: [N m], shape (t, 3)
    """

    frame: str
    time_s: FloatArray
    force: FloatArray
    torque: FloatArray


def joint_history(messages: Sequence[Any]) -> JointHistory:
    """Return ``sensor_msgs.msg.JointState`` messages, at least one, of the same joints."""
    position, velocity, effort = (
        np.array([getattr(message, field) for message in messages])
        for field in ('position', 'velocity', 'effort'))
    return JointHistory(tuple(messages[0].name), _times(messages), position, velocity, effort)


def wrench_history(messages: Sequence[Any]) -> WrenchHistory:
    """Return ``geometry_msgs.msg.WrenchStamped`` messages, at least one, of the same frame."""
    force, torque = (
        np.array([[vector.x, vector.y, vector.z] for message in messages
                  for vector in [getattr(message.wrench, field)]])
        for field in ('force', 'torque'))
    return WrenchHistory(messages[0].header.frame_id, _times(messages), force, torque)


def _times(messages: Sequence[Any]) -> FloatArray:
    return np.array([nanoseconds_of(message.header.stamp) * 1e-9 for message in messages])


#: What is recorded, by the name of the type of the topic.
_RECORDED = {f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}': kind
             for kind in (JointState, WrenchStamped, PoseStamped, TwistStamped)}


class RecordedTopics:
    """
    The messages of the topics with joint states, wrenches, poses and twists.

    :param node: that subscribes to them
    :ivar repeats: how often all joint states were repeated since the last new message
    :ivar last_new_s: when the last new message came [s], of ``time.monotonic``
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._messages: dict[str, list[Any]] = {}
        self._subscriptions: dict[str, Any] = {}
        self.repeats = 0
        self.last_new_s = time.monotonic()

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
                self.last_new_s = time.monotonic()
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
