# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Find a node, learn its layout from its topics, and notice when it changes or goes."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial
import itertools
import re
import time
from typing import Any

import mujoco
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import String, UInt8MultiArray

from manip_sim.errors import MessageError, ModelError
from manip_sim.interface.topics import BY_NAME
from manip_sim.models.archive import load_archive, MAX_ARCHIVE_BYTES
from manip_sim.ros.executor import begin
from manip_sim.ros.messages import LATCHED
from manip_sim.viewer.page.latest import (
    commanded_joints, declared_limits, limit_of, Robot, ShownPart)
from manip_sim.viewer.ros import readers
from manip_sim.viewer.ros.readers import Readers

_GRIPPER = '/gripper'
_DESCRIPTION = BY_NAME['robot_description'].name
#: An absolute name, and how many topics of a node are looked at.
_NAME = re.compile(r'(/[A-Za-z_][A-Za-z0-9_]*)+')
_MAX_TOPICS = 5000


@dataclass(frozen=True)
class RobotTopics:
    """
    The topics of one robot.

    :ivar space: what their names begin with, such as ``/left/``
    :ivar parts: those that take joint commands and do not overlap
    :ivar end_effectors: the arms that take Cartesian targets
    :ivar drives: whether its base takes a twist
    """

    space: str
    parts: tuple[str, ...]
    end_effectors: tuple[str, ...]
    drives: bool


@dataclass(frozen=True)
class Layout:
    """
    Robots, topics and services of a node.

    :ivar robots: none as long as none is known
    :ivar objects: names of free bodies
    :ivar cameras: names
    """

    robots: tuple[RobotTopics, ...] = ()
    objects: tuple[str, ...] = ()
    cameras: tuple[str, ...] = ()


def name_of(space: str, row: str, owner: str = '') -> str:
    """
    Return the name of a topic.

    :param space: that it begins with, such as ``/left/``
    :param row: its name in the table, such as ``<part>/joint_command``
    :param owner: the part, arm, object or camera
    """
    return space + BY_NAME[row].filled_in(owner).name


def layout_of(base: str, published: Collection[str], subscribed: Collection[str]) -> Layout:
    """
    Return what a node offers.

    :param base: namespace of the node, with a slash at its end
    :param published: absolute names of the topics that it publishes
    :param subscribed: absolute names of the topics that it takes; invalid names are ignored, and
        so are names beyond the limits
    """
    published, subscribed = (sorted(filter(_NAME.fullmatch, names))[:_MAX_TOPICS]
                             for names in (published, subscribed))
    spaces = sorted(name.removesuffix(_DESCRIPTION) for name in published
                    if name.startswith(base) and name.endswith(f'/{_DESCRIPTION}'))
    objects = [name for name in _named(base, published, 'objects/<name>/pose') if '/' not in name]
    cameras = _named(base, published, '<camera>/color/image_raw')
    # The namespace of a spawned robot is below that of the only one from the start.
    owned = {space: [topic for topic in subscribed if topic.startswith(space) and not any(
        len(other) > len(space) and topic.startswith(other) for other in spaces)]
        for space in spaces}
    return Layout(tuple(_robot(space, owned[space]) for space in spaces), tuple(sorted(objects)),
                  tuple(sorted(cameras)))


def _robot(space: str, subscribed: Collection[str]) -> RobotTopics:
    parts = _named(space, subscribed, '<part>/joint_command')
    end_effectors = _named(space, subscribed, '<arm>/target_pose')
    # A single arm is also the part right, and of two arms, arm is both.
    double = 'arm' if {'right', 'left'} <= set(parts) else 'right'
    kept = [part for part in parts if part.count('/') <= part.endswith(_GRIPPER)
            and not (part == double and 'arm' in parts)]
    return RobotTopics(space, tuple(sorted(kept, key=_order)),
                       tuple(sorted(end_effectors, reverse=True)),
                       name_of(space, 'base/cmd_vel') in subscribed)


def _named(space: str, topics: Collection[str], row: str) -> list[str]:
    """Return the parts, arms, objects or cameras that have a topic of the table."""
    names = [BY_NAME[row].of_name(topic.removeprefix(space)) for topic in topics
             if topic.startswith(space)]
    return list(filter(None, names))


def _order(part: str) -> tuple[int, str]:
    names = ('arm', 'right', 'right/gripper', 'left', 'left/gripper', 'torso', 'base', 'head',
             'legs')
    return names.index(part) if part in names else len(names), part


#: Velocity limits of the base where none are declared [m/s, m/s, rad/s].
_TWIST = (0.5, 0.5, 1.0)
_BASE = 'base'
#: Size of a URDF at most [bytes].
_MAX_URDF_BYTES = 2**23
#: Wall time after which a part without states belongs to a killed node, which DDS counts as
#: present for 20 s, if other parts have states [s]; nodes repeat their states ten times a second.
_SILENT_S = 2.0
#: Last parts of the names of topics by which robots, objects and cameras are known, and parts.
_PUBLISHED = (_DESCRIPTION, 'pose', 'image_raw')
_TAKEN = ('joint_command', 'target_pose', 'cmd_vel')


class Discovery:
    """
    The properties of the node that have been discovered.

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
        #: The parts whose names of joints came after the model and are in it; since when the
        #: others are waited for [s of wall time]; and those for which nobody waits any more.
        self._current: set[str] = set()
        self._awaited_s: dict[str, float] = {}
        self._silent: set[str] = set()
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
        """Take a model that has been compiled; begin to compile the newest one that came."""
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
                self._expect_names()
                if not all(map(self._is_in_model, self._joints.values())):
                    self.layout = None
        if self.checking is None and self._newest != self._tried:
            self._tried = self._newest
            self.checking = begin(partial(load_archive, self._newest))

    def _expect_names(self) -> None:
        self._current.clear()
        self._awaited_s.clear()
        self._silent.clear()

    def _is_in_model(self, names: Collection[str]) -> bool:
        return self.model is not None and all(
            mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_JOINT, name) >= 0
            for name in names)

    def look(self) -> None:
        """Check which model and topics the node has; to be called from time to time."""
        self.load_model()
        if not self.is_there:
            self.forget()
            return
        published = self._topics(_PUBLISHED, self._node.get_publishers_info_by_topic)
        subscribed = self._topics(_TAKEN, self._node.get_subscriptions_info_by_topic)
        silent = {f'{part}/{topic}' for part in self._silent for topic in _TAKEN}
        seen = layout_of(self.base, published, subscribed - silent)
        # Names arrive one by one: a layout that stays equal between two looks is complete.
        settled, self._seen = seen == self._seen, seen
        if settled and seen.robots:
            self._learn(seen)

    def _topics(self, last: Collection[str], list_ends: Callable[[str], Any]) -> set[str]:
        """
        Return topics of the node, and of a killed one of its name that counts as present.

        :param last: their names after the last slash
        :param list_ends: the publishers or the subscriptions of a topic
        """
        namespace, _, name = f'/{self._name}'.rpartition('/')
        topics = (topic for topic, _ in self._node.get_topic_names_and_types()
                  if topic.startswith(self.base) and topic.rpartition('/')[2] in last)
        return {topic for topic in itertools.islice(topics, _MAX_TOPICS) if any(
            (end.node_namespace, end.node_name) == (namespace or '/', name)
            for end in list_ends(topic))}

    def _learn(self, layout: Layout) -> None:
        """Take over a layout when the joints of all parts and all limits are known."""
        layout = replace(layout, robots=tuple(
            robot for robot in layout.robots if robot.parts
            or not any(part.startswith(robot.space) for part in self._silent)))
        spaces = [robot.space for robot in layout.robots]
        parts = [robot.space + name for robot in layout.robots for name in robot.parts]
        awaited = set(parts) - self._current
        now_s = time.monotonic()
        late = {part for part in awaited
                if now_s - self._awaited_s.setdefault(part, now_s) > _SILENT_S}
        if len(awaited) < len(parts):
            self._silent |= late
        # Another description may come at any time, the names of joints come many times a second.
        subscriptions: dict[str, tuple[Any, ...]] = {name_of(space, 'robot_description'): (
            String, partial(self._take_urdf, space), LATCHED, _MAX_URDF_BYTES)
            for space in spaces}
        subscriptions.update({name_of('', '<part>/joint_states', part): (
            JointState, partial(self._take_names, part), 1) for part in awaited | self._silent})
        for topic in self._subscriptions.keys() - subscriptions.keys():
            self._node.destroy_subscription(self._subscriptions.pop(topic))
        for topic, (kind, *rest) in subscriptions.items():
            if topic not in self._subscriptions:
                self._subscriptions[topic] = self._readers.subscribe(kind, topic, *rest)
        if self._limits.keys() >= set(spaces) and not awaited:
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
        names = list(readers.joint_states(message).names)
        if self._is_in_model(names):
            self._joints[part] = names
            self._current.add(part)
            self._silent.discard(part)

    def forget(self) -> None:
        """Forget all but the model: the node is gone, and another may come."""
        for subscription in self._subscriptions.values():
            self._node.destroy_subscription(subscription)
        self._subscriptions, self._joints, self._limits = {}, {}, {}
        self._expect_names()
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
