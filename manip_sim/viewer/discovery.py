# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Find a node, learn its layout from its topics, notice when it changes or goes, read its states.

Functions that read messages raise a MessageError for those that cannot be used; these are counted.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial
import itertools
import re
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, WrenchStamped
import mujoco
import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data, QoSProfile, QoSReliabilityPolicy
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import String, UInt8MultiArray
from visualization_msgs.msg import Marker, MarkerArray

from manip_sim.arrays import FloatArray
from manip_sim.errors import ManipSimError, MessageError, ModelError
from manip_sim.interface.topics import BY_NAME
from manip_sim.models.archive import load_archive, MAX_ARCHIVE_BYTES
from manip_sim.quoting import pluralize, quoted
from manip_sim.ros.executor import begin, GuardedExecutor, kind_of, RejectionLog
from manip_sim.ros.messages import LATCHED, read_message, seconds_of
from manip_sim.viewer.page.latest import (
    commanded_joints, declared_limits, JointStates, Latest, limit_of, PoseInWorld, Robot,
    ShownPart, ShownStatus)

#: Size of a number at most; larger ones overflow where they are multiplied or drawn.
_LARGEST = 1e9
#: Number of joints, markers and statuses of a message, and width and height of an image.
_MAX_JOINTS, _MAX_MARKERS, _MAX_STATUSES, _MAX_PIXELS = 1000, 5000, 100, 4096
#: Least norm of a quaternion that is an orientation.
_LEAST_NORM = 1e-3
_CONTACTS = 'contact_points'


def numbers(values: Any, noun: str) -> FloatArray:
    """Return numbers as an array; finite ones that can be drawn, by the noun for the message."""
    array = np.asarray(values, dtype=float)
    bad = array[~(np.abs(array) <= _LARGEST)]
    if bad.size:
        raise MessageError(f'{noun}: {bad.flat[0]:g} cannot be drawn')
    return array


def joint_states(message: JointState) -> JointStates:
    """Return the joints of a message; velocities and efforts that it leaves empty are zero."""
    count = len(message.name)
    if not 0 < count <= _MAX_JOINTS or len(set(message.name)) < count:
        raise MessageError(f'{pluralize(count, "name")}, of which {len(set(message.name))} '
                           f'differ; there must be 1 to {_MAX_JOINTS}, each once')
    columns: list[FloatArray] = []
    for field in ('position', 'velocity', 'effort'):
        values = getattr(message, field)
        if len(values) != count and (field == 'position' or len(values)):
            raise MessageError(f'{field}: {pluralize(len(values), "number")} for '
                               f'{pluralize(count, "joint")}')
        columns.append(numbers(values, field) if len(values) else np.zeros(count))
    position, velocity, effort = columns
    return JointStates(tuple(message.name), position, velocity, effort,
                       seconds_of(message.header.stamp))


def pose(message: PoseStamped) -> PoseInWorld:
    """Return the pose of a message, whose quaternion must be an orientation."""
    at, turn = message.pose.position, message.pose.orientation
    position = numbers([at.x, at.y, at.z], 'position')
    quat = numbers([turn.w, turn.x, turn.y, turn.z], 'orientation')
    norm = float(np.linalg.norm(quat))
    if norm < _LEAST_NORM:
        raise MessageError(f'orientation: the quaternion has the norm {norm:g}')
    return PoseInWorld(position, quat / norm)


def wrench(message: WrenchStamped) -> FloatArray:
    """Return force and torque [N, N m], shape (6,)."""
    force, torque = message.wrench.force, message.wrench.torque
    return numbers([force.x, force.y, force.z, torque.x, torque.y, torque.z], 'wrench')


def image(message: Image) -> NDArray[Any]:
    """Return the pixels of an image in the encoding rgb8, shape (h, w, 3)."""
    height, width, step = message.height, message.width, message.step
    if message.encoding != 'rgb8':
        raise MessageError(f'the encoding is {quoted(message.encoding)}, and only rgb8 is shown')
    if not (0 < height <= _MAX_PIXELS and 0 < width <= _MAX_PIXELS and 3 * width <= step
            and len(message.data) == height * step):
        raise MessageError(f'{len(message.data)} bytes are not an image of {width} times {height} '
                           f'pixels in rows of {step} bytes')
    pixels = np.frombuffer(message.data, np.uint8).reshape(height, step)
    return pixels[:, :3 * width].reshape(height, width, 3)


def markers(message: MarkerArray) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Return contacts, (n, 3), and arrows by what they show, (n, 2, 3), in ``world`` [m]."""
    if len(message.markers) > _MAX_MARKERS:
        raise MessageError(f'{len(message.markers)} markers, and at most {_MAX_MARKERS} are drawn')
    points = np.zeros((0, 3))
    arrows: dict[str, list[FloatArray]] = {}
    for marker in message.markers:
        if marker.ns == _CONTACTS:
            points = _points(marker)
        elif marker.type == Marker.ARROW and len(marker.points) == 2:
            # Namespaces of wrenches are <arm>/external_force and <arm>/external_torque.
            arrows.setdefault(marker.ns.rpartition('external_')[2], []).append(_points(marker))
    return points, {name: np.array(ends) for name, ends in arrows.items()}


def _points(marker: Marker) -> FloatArray:
    if len(marker.points) > _MAX_MARKERS:
        raise MessageError(f'{len(marker.points)} points, and at most {_MAX_MARKERS} are drawn')
    return numbers([[point.x, point.y, point.z] for point in marker.points],
                   'points').reshape(-1, 3)


def statuses(message: DiagnosticArray, node: str) -> list[ShownStatus]:
    """Return the statuses of a node by its full name without the first slash, if any."""
    begin = f'{node}: '
    matching = [status for status in message.status if status.name.startswith(begin)]
    if len(matching) > _MAX_STATUSES:
        raise MessageError(f'{len(matching)} statuses, and at most {_MAX_STATUSES} are shown')
    # rclpy gives the level, a field of type byte, as a bytes object.
    return [ShownStatus(status.level[0], status.name.removeprefix(begin), status.message,
                        {pair.key: pair.value for pair in status.values}) for status in matching]


#: More than any message but images and models needs [bytes].
_MAX_BYTES = 2**20
#: Time for callbacks before the page gets its turn [s].
_ROUND_S = 0.05


class Readers:
    """The subscriptions of the viewer, and the bounded log of rejected messages."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self.log = RejectionLog(node.get_logger())
        self.rejected = 0

    def subscribe(self, kind: Any, topic: str, take: Callable[[Any], None], qos: Any,
                  most: int = _MAX_BYTES) -> Any:
        """
        Subscribe to a topic.

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


_GRIPPER = '/gripper'
_DESCRIPTION = BY_NAME['robot_description'].name
#: An absolute name, and how many topics of a node are looked at.
_NAME = re.compile(r'(/[A-Za-z_][A-Za-z0-9_]*)+')
_MAX_TOPICS = 5000
#: Order of the parts on the page.
_ORDER = ('arm', 'right', 'right/gripper', 'left', 'left/gripper', 'torso', 'base', 'head', 'legs')


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
    """Robots of a node, as far as they are known, and the names of its free bodies and cameras."""

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
    return RobotTopics(space, tuple(sorted(kept, key=lambda part: (
        _ORDER.index(part) if part in _ORDER else len(_ORDER), part))),
                       tuple(sorted(end_effectors, reverse=True)),
                       name_of(space, 'base/cmd_vel') in subscribed)


def _named(space: str, topics: Collection[str], row: str) -> list[str]:
    """Return the parts, arms, objects or cameras that have a topic of the table."""
    names = [BY_NAME[row].of_name(topic.removeprefix(space)) for topic in topics
             if topic.startswith(space)]
    return list(filter(None, names))


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
        names = list(joint_states(message).names)
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


#: The newest message is enough, and a lost one is followed by another.
_NEWEST = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)
#: Size of an image at most [bytes]: 4096 times 4096 pixels.
_MAX_IMAGE_BYTES = 2**26


class States:
    """
    Subscriptions to all states of a node, as for :class:`Discovery`.

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
                    WrenchStamped, partial(self._take, 'wrenches', wrench, key))
        for name in layout.objects:
            subscriptions[name_of(self._base, 'objects/<name>/pose', name)] = PoseStamped, partial(
                self._take, 'objects', pose, name)
        lasting = {f'/{self._name}/markers', *(
            topic for topic in self._subscriptions if topic.endswith('/image_raw'))}
        for topic in self._subscriptions.keys() - subscriptions.keys() - lasting:
            self._unsubscribe(topic)
        for topic, (kind, take) in subscriptions.items():
            self._subscribe(topic, kind, take)
        arms = {(robot.space, arm) for robot in layout.robots for arm in robot.end_effectors}
        kept: tuple[tuple[dict[Any, Any], Collection[Any]], ...] = (
            (self.latest.objects, layout.objects),
            (self.latest.joints, {robot.space for robot in layout.robots}),
            (self.latest.end_effectors, arms), (self.latest.wrenches, arms), (self.frames, arms))
        for states, present in kept:
            for key in states.keys() - set(present):
                del states[key]

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
            self._subscribe(topic, Image, partial(self._take, 'images', image, name),
                            qos_profile_sensor_data, most=_MAX_IMAGE_BYTES)

    def _take_joints(self, space: str, message: JointState) -> None:
        self._take('joints', joint_states, space, message)
        self.latest.joints_s = time.monotonic()

    def _take(self, kind: str, read: Callable[[Any], Any], key: Any, message: Any) -> None:
        getattr(self.latest, kind)[key] = read(message)

    def _take_end_effector(self, key: tuple[str, str], message: PoseStamped) -> None:
        self._take('end_effectors', pose, key, message)
        self.frames[key] = message.header.frame_id

    def _take_markers(self, message: MarkerArray) -> None:
        self.latest.contacts, self.latest.arrows = markers(message)

    def _take_diagnostics(self, message: DiagnosticArray) -> None:
        of_node = statuses(message, self._name)
        if of_node:
            self.latest.diagnostics = of_node
            self.on_statuses(of_node)
