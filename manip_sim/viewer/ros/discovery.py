# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Find a node, learn what it is from its topics, and notice when it changes or goes."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Future
from functools import partial
from typing import Any

import mujoco
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import String, UInt8MultiArray

from manip_sim.errors import MessageError, ModelError
from manip_sim.models.archive import load_archive, MAX_ARCHIVE_BYTES
from manip_sim.ros.background import begin
from manip_sim.ros.messages import LATCHED
from manip_sim.viewer.page.robots import (
    commanded_joints, declared_limits, limit_of, Robot, ShownPart)
from manip_sim.viewer.ros import contents
from manip_sim.viewer.ros.layout import Layout, layout_of, name_of, RobotTopics
from manip_sim.viewer.ros.readers import Readers

#: Velocity limits of the base where none are declared [m/s, m/s, rad/s].
_TWIST = (0.5, 0.5, 1.0)
_BASE = 'base'
#: Size of a URDF at most [bytes].
_MAX_URDF_BYTES = 2**23


class Discovery:
    """
    What is known about the node.

    :param node: the viewer's own
    :param simulation: full name of the node that is seen, without the first slash
    :ivar base: namespace of the node, with a slash at its end
    :ivar model: its ``mujoco.MjModel``, or None
    :ivar layout: what it offers, when the names of all its joints are known; else None
    :ivar models: how many models have come
    :ivar checking: the model that is checked and compiled in the background, or None
    """

    def __init__(self, node: Node, readers: Readers, simulation: str) -> None:
        self._node, self._readers, self._name = node, readers, simulation
        self.base = f'/{simulation}'.rpartition('/')[0] + '/'
        self.model: Any = None
        self.models = 0
        self.layout: Layout | None = None
        self._seen = Layout()
        self._subscriptions: dict[str, Any] = {}
        self._joints: dict[str, list[str]] = {}
        #: The parts whose names of joints came after the model and are in it.
        self._current: set[str] = set()
        self._limits: dict[str, Mapping[str, Mapping[str, float]]] = {}
        self._archive = f'/{simulation}/mjcf_archive'
        self._newest, self._tried = b'', b''
        self.checking: Future[Any] | None = None
        readers.subscribe(UInt8MultiArray, self._archive, self._take_archive, LATCHED,
                          most=MAX_ARCHIVE_BYTES)

    @property
    def is_there(self) -> bool:
        return bool(self._node.count_publishers(self._archive))

    def _take_archive(self, message: UInt8MultiArray) -> None:
        self._newest = bytes(message.data)

    def load_model(self) -> None:
        """Take a model that has been compiled; begin with the newest one of all that came."""
        if self.checking is not None and self.checking.done():
            checked, self.checking = self.checking, None
            try:
                self.model = checked.result()
            except ModelError as error:
                self._readers.reject(self._archive, error)
            else:
                self.models += 1
                # Another robot may have parts of the same names, and the node before it counts
                # as present until DDS misses it.
                self._current.clear()
        if self.checking is None and self._newest != self._tried:
            self._tried = self._newest
            self.checking = begin(partial(load_archive, self._newest))

    def look(self) -> None:
        """Check which model and topics the node has; to be called from time to time."""
        self.load_model()
        if not self.is_there:
            self.forget()
            return
        namespace, _, name = f'/{self._name}'.rpartition('/')
        try:
            published, subscribed = (
                [topic for topic, _ in found(name, namespace or '/')]
                for found in (self._node.get_publisher_names_and_types_by_node,
                              self._node.get_subscriber_names_and_types_by_node))
        except RuntimeError:  # Its topics are discovered before the node.
            return
        seen = layout_of(self.base, published, subscribed)
        # Names arrive one by one: what has not changed between two looks is complete.
        settled, self._seen = seen == self._seen, seen
        if settled and seen.robots:
            self._learn(seen)

    def _learn(self, layout: Layout) -> None:
        """Take over a layout when the joints of all parts and all limits are known."""
        spaces = [robot.space for robot in layout.robots]
        parts = [robot.space + name for robot in layout.robots for name in robot.parts]
        # Another description may come at any time, the names of joints come many times a second.
        wanted: dict[str, tuple[Any, ...]] = {name_of(space, 'robot_description'): (
            String, partial(self._take_urdf, space), LATCHED, _MAX_URDF_BYTES)
            for space in spaces}
        wanted.update({name_of('', '<part>/joint_states', part): (
            JointState, partial(self._take_names, part), 1) for part in parts
                       if part not in self._joints or part not in self._current})
        for topic in self._subscriptions.keys() - wanted.keys():
            self._node.destroy_subscription(self._subscriptions.pop(topic))
        for topic, (kind, *rest) in wanted.items():
            if topic not in self._subscriptions:
                self._subscriptions[topic] = self._readers.subscribe(kind, topic, *rest)
        if self._limits.keys() >= set(spaces) and self._joints.keys() >= set(parts):
            self.layout = layout
            # A robot that is gone may come again as another one.
            self._limits = {space: self._limits[space] for space in spaces}
            self._joints = {part: self._joints[part] for part in parts}

    def _take_urdf(self, space: str, message: String) -> None:
        try:
            self._limits[space] = declared_limits(message.data)
        except ValueError as error:
            raise MessageError(f'the URDF cannot be read: {error}') from error

    def _take_names(self, part: str, message: JointState) -> None:
        names = self._joints[part] = list(contents.joint_states(message).names)
        if self.model is not None and all(
                mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_JOINT, name) >= 0
                for name in names):
            self._current.add(part)

    def forget(self) -> None:
        """Forget all but the model: the node is gone, and another may come."""
        for subscription in self._subscriptions.values():
            self._node.destroy_subscription(subscription)
        self._subscriptions, self._joints, self._limits = {}, {}, {}
        self._current.clear()
        self.layout, self._seen = None, Layout()

    def robots(self) -> list[Robot]:
        """Return what the page has to know of the robots; model and layout must be known."""
        assert self.layout is not None
        return [self._robot(robot) for robot in self.layout.robots]

    def _robot(self, topics: RobotTopics) -> Robot:
        limits = self._limits[topics.space]
        names = {part: self._joints[topics.space + part] for part in topics.parts}
        parts = tuple(
            ShownPart(part, commanded_joints(self.model, names[part], limits,
                                             part.endswith('/gripper')))
            for part in topics.parts)
        twist = None
        if topics.drives:
            x, y, yaw = (limit_of(limits.get(name, {}), 'velocity', usual) for name, usual in zip(
                [*names.get(_BASE, []), '', '', ''], _TWIST))
            twist = x, y, yaw
        return Robot(topics.space, topics.space.removeprefix(self.base).strip('/'), parts,
                     topics.end_effectors, twist)
