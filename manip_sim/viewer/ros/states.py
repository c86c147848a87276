# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Receive the states of a node: the newest of each kind, as plain numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, WrenchStamped
import numpy as np
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data, QoSProfile, QoSReliabilityPolicy
from sensor_msgs.msg import Image, JointState
from visualization_msgs.msg import Marker, MarkerArray

from manip_sim.arrays import FloatArray
from manip_sim.viewer.page.diagnosis import Status
from manip_sim.viewer.page.latest import JointStates, Latest, Pose
from manip_sim.viewer.ros.layout import Layout

#: The newest message is enough, and a lost one is followed by another.
_NEWEST = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)
_CONTACTS = 'contact_points'


class States:
    """
    Subscriptions to all states of a node.

    :param node: the viewer's own
    :param simulation: full name of the node that is seen, without the first slash
    :param base: its namespace, with a slash at its end
    :ivar latest: what has come
    :ivar frames: the frame of the poses of hands, by namespace and arm
    """

    def __init__(self, node: Node, simulation: str, base: str) -> None:
        self._node, self._name, self._base = node, simulation, base
        self._subscriptions: dict[str, Any] = {}
        self.latest = Latest()
        self.frames: dict[tuple[str, str], str] = {}
        self.told: Callable[[list[Status]], None] = lambda statuses: None
        node.create_subscription(DiagnosticArray, '/diagnostics', self._take_diagnostics, 10)

    def forget(self) -> None:
        """Stop listening to states, and forget them."""
        for subscription in self._subscriptions.values():
            self._node.destroy_subscription(subscription)
        self._subscriptions = {}
        self.latest = Latest()

    def listen(self, layout: Layout) -> None:
        """Listen to the robots and objects of a layout, and no longer to others."""
        wanted: dict[str, tuple[Any, Any]] = {}
        for robot in layout.robots:
            wanted[f'{robot.space}joint_states'] = JointState, partial(
                self._take_joints, robot.space)
            for arm in robot.hands:
                key = robot.space, arm
                wanted[f'{robot.space}{arm}/eef_pose'] = PoseStamped, partial(
                    self._take_hand, key)
                wanted[f'{robot.space}{arm}/external_wrench'] = WrenchStamped, partial(
                    self._take_wrench, key)
        for name in layout.objects:
            wanted[f'{self._base}objects/{name}/pose'] = PoseStamped, partial(
                self._take_object, name)
        self._keep(wanted)
        for name in self.latest.objects.keys() - set(layout.objects):
            del self.latest.objects[name]

    def _keep(self, wanted: dict[str, tuple[Any, Any]]) -> None:
        lasting = {f'/{self._name}/markers', *(
            topic for topic in self._subscriptions if topic.endswith('/image_raw'))}
        for topic in self._subscriptions.keys() - wanted.keys() - lasting:
            self._unsubscribe(topic)
        for topic, (kind, take) in wanted.items():
            self._subscribe(topic, kind, take)

    def _subscribe(self, topic: str, kind: Any, take: Any, qos: Any = _NEWEST) -> None:
        if topic not in self._subscriptions:
            self._subscriptions[topic] = self._node.create_subscription(kind, topic, take, qos)

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
        topics = {f'{self._base}{name}/color/image_raw': name for name in cameras}
        for topic in [t for t in self._subscriptions if t.endswith('/color/image_raw')]:
            if topic not in topics:
                self._unsubscribe(topic)
        for topic, name in topics.items():
            self._subscribe(topic, Image, partial(self._take_image, name),
                            qos_profile_sensor_data)

    def _take_joints(self, space: str, message: JointState) -> None:
        self.latest.joints[space] = JointStates(
            message.name, message.position, message.velocity, message.effort,
            _seconds(message.header.stamp))
        self.latest.joints_s = time.monotonic()

    def _take_hand(self, key: tuple[str, str], message: PoseStamped) -> None:
        self.frames[key] = message.header.frame_id
        self.latest.hands[key] = _pose(message)

    def _take_object(self, name: str, message: PoseStamped) -> None:
        self.latest.objects[name] = _pose(message)

    def _take_wrench(self, key: tuple[str, str], message: WrenchStamped) -> None:
        force, torque = message.wrench.force, message.wrench.torque
        self.latest.wrenches[key] = np.array(
            [force.x, force.y, force.z, torque.x, torque.y, torque.z])

    def _take_image(self, name: str, message: Image) -> None:
        if message.encoding == 'rgb8':
            self.latest.images[name] = np.frombuffer(message.data, np.uint8).reshape(
                message.height, message.step)[:, :3 * message.width].reshape(
                message.height, message.width, 3)

    def _take_markers(self, message: MarkerArray) -> None:
        points = np.zeros((0, 3))
        arrows: dict[str, list[FloatArray]] = {}
        for marker in message.markers:
            if marker.ns == _CONTACTS:
                points = _points(marker)
            elif marker.type == Marker.ARROW and len(marker.points) == 2:
                # Namespaces of wrenches are <arm>/external_force and <arm>/external_torque.
                arrows.setdefault(marker.ns.rpartition('external_')[2], []).append(
                    _points(marker))
        self.latest.contacts = points
        self.latest.arrows = {what: np.array(found) for what, found in arrows.items()}

    def _take_diagnostics(self, message: DiagnosticArray) -> None:
        begin = f'{self._name}: '
        statuses = [
            Status(_level(status.level), status.name.removeprefix(begin), status.message,
                   {pair.key: pair.value for pair in status.values})
            for status in message.status if status.name.startswith(begin)]
        if statuses:
            self.latest.diagnostics = statuses
            self.told(statuses)


def _seconds(stamp: Any) -> float:
    return float(stamp.sec + stamp.nanosec * 1e-9)


def _pose(message: PoseStamped) -> Pose:
    at, turn = message.pose.position, message.pose.orientation
    return Pose(np.array([at.x, at.y, at.z]), np.array([turn.w, turn.x, turn.y, turn.z]))


def _points(marker: Marker) -> FloatArray:
    return np.array([[point.x, point.y, point.z] for point in marker.points])


def _level(level: bytes | int) -> int:
    # rclpy gives a field of type byte as a bytes object.
    return level[0] if isinstance(level, bytes) else int(level)
