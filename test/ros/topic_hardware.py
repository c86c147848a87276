# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
A hardware component of ros2_control whose robot is at the other end of two topics.

It sends and reads what ``joint_state_topic_hardware_interface/JointStateTopicSystem`` of
ros-controls/topic_based_hardware_interfaces 1.1.0 does, message by message; controllers are
played by the test, which sets the command interfaces.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
import math
from typing import Any

from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState

#: The interfaces that a JointState can carry.
FIELDS = ('position', 'velocity', 'effort')


@dataclass(frozen=True)
class Mimic:
    """What a joint's state is computed from: ``offset + multiplier * position of joint``."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class TagJoint:
    """
    A joint of a ``<ros2_control>`` tag.

    :ivar commands: its command interfaces; none for a joint that is only observed
    :ivar states: its state interfaces
    :ivar mimic: whose state it takes; such a joint must have no command interface
    """

    name: str
    commands: tuple[str, ...] = ('position',)
    states: tuple[str, ...] = FIELDS
    mimic: Mimic | None = None


def tag(names: Iterable[str], *commands: str) -> list[TagJoint]:
    """Return joints with the same command interfaces and all state interfaces."""
    return [TagJoint(name, commands) for name in names]


class TopicHardware:
    """
    The hardware component: states in, commands out, one cycle at a time.

    :param node: publishes and subscribes; its executor delivers the states
    :param joints: the tag, in its order
    :param command_topic: where commands go to
    :param state_topic: where states come from
    :param threshold: summed distance of commands from states up to which nothing is sent
    :ivar states: by joint and interface; NaN until something came
    :ivar commands: by joint and interface; NaN until a controller set it
    :ivar sent: every message that was published
    """

    def __init__(self, node: Any, joints: Sequence[TagJoint], command_topic: str = 'joint_command',
                 state_topic: str = 'joint_states', threshold: float = 1e-5) -> None:
        for joint in joints:
            if joint.mimic is not None and joint.commands:
                raise ValueError(f"mimic joint '{joint.name}' cannot have command interfaces")
        self._node = node
        self._joints = list(joints)
        self._threshold = threshold
        self._latest = JointState()
        self.states = {(j.name, kind): math.nan for j in joints for kind in j.states}
        self.commands = {(j.name, kind): math.nan for j in joints for kind in j.commands}
        self.sent: list[JointState] = []
        self._publisher = node.create_publisher(JointState, command_topic, 1)
        node.create_subscription(JointState, state_topic, self._receive, qos_profile_sensor_data)

    def _receive(self, message: JointState) -> None:
        self._latest = message

    @property
    def connected(self) -> bool:
        """Whether a state has come, and somebody takes the commands."""
        return bool(self._latest.name) and self._publisher.get_subscription_count() > 0

    def acknowledged(self) -> None:
        """Wait until the node has received what was published."""
        self._publisher.wait_for_all_acked()

    def claim(self, kind: str, values: Mapping[str, float]) -> None:
        """
        Set command interfaces, as a controller does in its update.

        :param kind: ``position``, ``velocity`` or ``effort``
        :param values: by joint
        """
        for name, value in values.items():
            self._require(self.commands, name, kind, 'command')
            self.commands[name, kind] = value

    def cycle(self) -> None:
        """Read and write once, as the controller manager does."""
        self.read()
        self.write()

    def read(self) -> None:
        """
        Take over the last states that came.

        :raises LookupError: if a field comes for a joint without that state interface
        :raises IndexError: if a field is neither empty nor as long as the names
        """
        followers = {j.name: j.mimic for j in self._joints if j.mimic is not None}
        own = {j.name for j in self._joints} - set(followers)
        for i, name in enumerate(self._latest.name):
            if name not in own:
                continue
            for kind in FIELDS:
                values = getattr(self._latest, kind)
                if len(values) and math.isfinite(values[i]):
                    self._require(self.states, name, kind, 'state')
                    self.states[name, kind] = values[i]
        for name, mimic in followers.items():
            for kind, offset in (('position', mimic.offset), ('velocity', 0.0)):
                if (name, kind) in self.states:
                    self.states[name, kind] = (
                        offset + mimic.multiplier * self.states[mimic.joint, kind])

    def write(self) -> JointState | None:
        """
        Publish all commands, unless they are where the states are already.

        Every joint is named. A field has a number for each joint that has the command interface,
        one after the other, and none for the rest. One NaN anywhere lets the distance be NaN, so
        that the message is sent in every cycle.

        :returns: the message, or None
        :raises LookupError: if a joint has a command interface without its state interface
        """
        distance = 0.0
        for (name, kind), value in self.commands.items():
            self._require(self.states, name, kind, 'state')
            distance += abs(self.states[name, kind] - value)
        if distance <= self._threshold:
            return None
        message = JointState(name=[joint.name for joint in self._joints])
        message.header.stamp = self._node.get_clock().now().to_msg()
        for kind in FIELDS:
            setattr(message, kind, [self.commands[joint.name, kind] for joint in self._joints
                                    if kind in joint.commands])
        self._publisher.publish(message)
        self.sent.append(message)
        return message

    @staticmethod
    def _require(interfaces: Mapping[tuple[str, str], float], name: str, kind: str,
                 what: str) -> None:
        if (name, kind) not in interfaces:
            raise LookupError(f"joint '{name}' has no {what} interface '{kind}'")
