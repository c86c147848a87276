# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Subscriptions of the viewer, and the numbers in messages; unusable ones are counted."""

from __future__ import annotations

from collections.abc import Callable
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, WrenchStamped
import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import Image, JointState
from visualization_msgs.msg import Marker, MarkerArray

from manip_sim.arrays import FloatArray
from manip_sim.errors import ManipSimError, MessageError
from manip_sim.quoting import pluralize, quoted
from manip_sim.ros.executor import GuardedExecutor, kind_of, RejectionLog
from manip_sim.ros.messages import read_message, seconds_of
from manip_sim.viewer.page.latest import JointStates, PoseInWorld, ShownStatus

#: Size of a number at most; larger ones overflow where they are multiplied or drawn.
_LARGEST = 1e9
#: Number of joints, markers and statuses of a message, and width and height of an image.
_MAX_JOINTS, _MAX_MARKERS, _MAX_STATUSES, _MAX_PIXELS = 1000, 5000, 100, 4096
#: Least norm of a quaternion that is an orientation.
_LEAST_NORM = 1e-3
_CONTACTS = 'contact_points'


def numbers(values: Any, noun: str) -> FloatArray:
    """
    Return numbers as an array.

    :param noun: they are, for the message
    :raises MessageError: if one is not finite, or too large to be drawn
    """
    array = np.asarray(values, dtype=float)
    bad = array[~(np.abs(array) <= _LARGEST)]
    if bad.size:
        raise MessageError(f'{noun}: {bad.flat[0]:g} cannot be drawn')
    return array


def joint_states(message: JointState) -> JointStates:
    """
    Return the joints of a message; velocities and efforts that it leaves empty are zero.

    :raises MessageError: if lengths do not fit, a name comes twice or a number is not finite
    """
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
    """
    Return the pose of a message.

    :raises MessageError: if a number is not finite or the quaternion is not an orientation
    """
    at, turn = message.pose.position, message.pose.orientation
    position = numbers([at.x, at.y, at.z], 'position')
    quat = numbers([turn.w, turn.x, turn.y, turn.z], 'orientation')
    norm = float(np.linalg.norm(quat))
    if norm < _LEAST_NORM:
        raise MessageError(f'orientation: the quaternion has the norm {norm:g}')
    return PoseInWorld(position, quat / norm)


def wrench(message: WrenchStamped) -> FloatArray:
    """
    Return force and torque [N, N m], shape (6,).

    :raises MessageError: if a number is not finite
    """
    force, torque = message.wrench.force, message.wrench.torque
    return numbers([force.x, force.y, force.z, torque.x, torque.y, torque.z], 'wrench')


def image(message: Image) -> NDArray[Any]:
    """
    Return the pixels of an image, shape (h, w, 3).

    :raises MessageError: if its encoding is not rgb8, or its data has another size
    """
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
    """
    Return contacts, shape (n, 3), and arrows by what they show, shape (n, 2, 3), in ``world`` [m].

    :raises MessageError: if there are too many or a number is not finite
    """
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
    """
    Return the statuses of a node; none if the message is of others.

    :param node: its full name, without the first slash
    :raises MessageError: if there are too many
    """
    begin = f'{node}: '
    matching = [status for status in message.status if status.name.startswith(begin)]
    if len(matching) > _MAX_STATUSES:
        raise MessageError(f'{len(matching)} statuses, and at most {_MAX_STATUSES} are shown')
    return [ShownStatus(_level(status.level), status.name.removeprefix(begin), status.message,
                        {pair.key: pair.value for pair in status.values}) for status in matching]


def _level(level: bytes | int) -> int:
    # rclpy gives a field of type byte as a bytes object.
    return level[0] if isinstance(level, bytes) else int(level)


#: More than any message but images and models needs [bytes].
_MAX_BYTES = 2**20
#: Time for callbacks before the page gets its turn [s].
_ROUND_S = 0.05


class Readers:
    """
    The subscriptions of the viewer.

    :param node: the viewer's own
    :ivar log: of rejected messages, bounded
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
