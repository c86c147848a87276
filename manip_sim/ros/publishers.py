# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Publish states: every message of one call has the same stamp."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from manip_sim.ros import messages
from manip_sim.simulation import Simulation, State


class StatePublishers:
    """
    Publishers for the joint states of all parts, wrenches, poses and the clock.

    :param node: the node
    :param simulation: tells the parts and their joints
    :param publish_clock: whether ``/clock`` is published
    """

    def __init__(self, node: Node, simulation: Simulation, publish_clock: bool) -> None:
        self._node = node
        joints = list(simulation.joint_names)
        everything = slice(0, len(joints))
        self._joint_states = [
            (self._publisher(JointState, topic), joints[part], part)
            for topic, part in [('joint_states', everything), *(
                (f'{name}/joint_states', part) for name, part in simulation.slice_of.items()
                if part.stop > part.start)]]
        self._arms = []
        for arm, reader in simulation.end_effectors.items():
            self._arms.append((
                arm, reader.ft_frame,
                self._publisher(WrenchStamped, f'{arm}/wrench'),
                self._publisher(WrenchStamped, f'{arm}/external_wrench'),
                self._publisher(PoseStamped, f'{arm}/eef_pose'),
                self._publisher(TwistStamped, f'{arm}/eef_twist')))
        self._clock = self._publisher(Clock, '/clock', depth=1) if publish_clock else None

    def _publisher(self, message_type: Any, topic: str, depth: int = 10) -> Publisher:
        return self._node.create_publisher(
            message_type, topic, QoSProfile(depth=depth),
            qos_overriding_options=QoSOverridingOptions.with_default_policies())

    def publish(self, state: State) -> None:
        """Publish a state on all topics that somebody listens to."""
        stamp = messages.stamp_of(state.time_ns)
        for publisher, joints, part in self._joint_states:
            if publisher.get_subscription_count():
                publisher.publish(messages.joint_state(stamp, joints, state, part))
        for arm, frame, wrench, external_wrench, pose, twist in self._arms:
            end_effector = state.end_effectors[arm]
            for publisher, measured in ((wrench, end_effector.wrench),
                                        (external_wrench, end_effector.external_wrench)):
                if publisher.get_subscription_count():
                    publisher.publish(messages.wrench_stamped(stamp, frame, measured))
            for publisher, message in ((pose, messages.pose_stamped),
                                       (twist, messages.twist_stamped)):
                if publisher.get_subscription_count():
                    publisher.publish(message(stamp, end_effector))
        if self._clock is not None and self._clock.get_subscription_count():
            self._clock.publish(Clock(clock=stamp))


def publish_mjcf(node: Node, xml: str) -> Publisher:
    """Publish the composed model once, for everyone who comes later too."""
    publisher = node.create_publisher(String, '~/mjcf', QoSProfile(
        depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL))
    publisher.publish(String(data=xml))
    return publisher
