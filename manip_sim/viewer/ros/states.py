# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Receive the states of a node: the newest of each kind, as plain numbers."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from functools import partial
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, WrenchStamped
import numpy as np
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data, QoSProfile, QoSReliabilityPolicy
from sensor_msgs.msg import Image, JointState
from visualization_msgs.msg import MarkerArray

from manip_sim.viewer.page.latest import Latest, ShownStatus
from manip_sim.viewer.ros import readers
from manip_sim.viewer.ros.discovery import Layout, name_of
from manip_sim.viewer.ros.readers import Readers

#: The newest message is enough, and a lost one is followed by another.
_NEWEST = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)
#: Size of an image at most [bytes]: 4096 times 4096 pixels.
_MAX_IMAGE_BYTES = 2**26


class States:
    """
    Subscriptions to all states of a node.

    :param node: the viewer's own
    :param simulation: full name of the node that is seen, without the first slash
    :param base: its namespace, with a slash at its end
    :ivar latest: the latest messages
    :ivar frames: the frame of the poses of end effectors, by namespace and arm
    """

    def __init__(self, node: Node, readers: Readers, simulation: str, base: str) -> None:
        self._node, self._readers = node, readers
        self._name, self._base = simulation, base
        self._subscriptions: dict[str, Any] = {}
        self.latest = Latest()
        self.frames: dict[tuple[str, str], str] = {}
        self.on_statuses: Callable[[list[ShownStatus]], None] = lambda statuses: None
        readers.subscribe(DiagnosticArray, '/diagnostics', self._take_diagnostics, 10)

    def forget(self) -> None:
        """Stop listening to states, and forget them."""
        for subscription in self._subscriptions.values():
            self._node.destroy_subscription(subscription)
        self._subscriptions = {}
        self.latest = Latest()

    def listen(self, layout: Layout) -> None:
        """Listen to the robots and objects of a layout, and no longer to others."""
        subscriptions: dict[str, tuple[Any, Any]] = {}
        for robot in layout.robots:
            subscriptions[name_of(robot.space, 'joint_states')] = JointState, partial(
                self._take_joints, robot.space)
            for arm in robot.end_effectors:
                key = robot.space, arm
                subscriptions[name_of(robot.space, '<arm>/eef_pose', arm)] = PoseStamped, partial(
                    self._take_end_effector, key)
                subscriptions[name_of(robot.space, '<arm>/external_wrench', arm)] = (
                    WrenchStamped, partial(self._take_wrench, key))
        for name in layout.objects:
            subscriptions[name_of(self._base, 'objects/<name>/pose', name)] = PoseStamped, partial(
                self._take_object, name)
        self._keep(subscriptions)
        arms = {(robot.space, arm) for robot in layout.robots for arm in robot.end_effectors}
        kept: tuple[tuple[dict[Any, Any], Collection[Any]], ...] = (
            (self.latest.objects, layout.objects),
            (self.latest.joints, {robot.space for robot in layout.robots}),
            (self.latest.end_effectors, arms), (self.latest.wrenches, arms), (self.frames, arms))
        for states, present in kept:
            for key in states.keys() - set(present):
                del states[key]

    def _keep(self, wanted: dict[str, tuple[Any, Any]]) -> None:
        lasting = {f'/{self._name}/markers', *(
            topic for topic in self._subscriptions if topic.endswith('/image_raw'))}
        for topic in self._subscriptions.keys() - wanted.keys() - lasting:
            self._unsubscribe(topic)
        for topic, (kind, take) in wanted.items():
            self._subscribe(topic, kind, take)

    def _subscribe(self, topic: str, kind: Any, take: Any, qos: Any = _NEWEST, **most: int
                   ) -> None:
        if topic not in self._subscriptions:
            self._subscriptions[topic] = self._readers.subscribe(kind, topic, take, qos, **most)

    def _unsubscribe(self, topic: str) -> None:
        if topic in self._subscriptions:
            self._node.destroy_subscription(self._subscriptions.pop(topic))

    def want_markers(self, wanted: bool) -> None:
        """Start or stop listening to contacts and wrenches as markers."""
        topic = f'/{self._name}/markers'
        if wanted:
            self._subscribe(topic, MarkerArray, self._take_markers)
        else:
            self._unsubscribe(topic)
            self.latest.contacts, self.latest.arrows = np.zeros((0, 3)), {}

    def want_images(self, cameras: Iterable[str]) -> None:
        """Listen to the images of these cameras, and of no others."""
        topics = {name_of(self._base, '<camera>/color/image_raw', name): name for name in cameras}
        for topic in [t for t in self._subscriptions if t.endswith('/color/image_raw')]:
            if topic not in topics:
                self._unsubscribe(topic)
        for topic, name in topics.items():
            self._subscribe(topic, Image, partial(self._take_image, name),
                            qos_profile_sensor_data, most=_MAX_IMAGE_BYTES)

    def _take_joints(self, space: str, message: JointState) -> None:
        self.latest.joints[space] = readers.joint_states(message)
        self.latest.joints_s = time.monotonic()

    def _take_end_effector(self, key: tuple[str, str], message: PoseStamped) -> None:
        self.latest.end_effectors[key] = readers.pose(message)
        self.frames[key] = message.header.frame_id

    def _take_object(self, name: str, message: PoseStamped) -> None:
        self.latest.objects[name] = readers.pose(message)

    def _take_wrench(self, key: tuple[str, str], message: WrenchStamped) -> None:
        self.latest.wrenches[key] = readers.wrench(message)

    def _take_image(self, name: str, message: Image) -> None:
        self.latest.images[name] = readers.image(message)

    def _take_markers(self, message: MarkerArray) -> None:
        self.latest.contacts, self.latest.arrows = readers.markers(message)

    def _take_diagnostics(self, message: DiagnosticArray) -> None:
        statuses = readers.statuses(message, self._name)
        if statuses:
            self.latest.diagnostics = statuses
            self.on_statuses(statuses)
