# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Topics recorded as arrays, and what a failed test leaves: a record and a picture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
import subprocess
import sys
import time
from typing import Any

from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
import mujoco
import numpy as np
from PIL import Image
from rclpy.node import Node
from sensor_msgs.msg import JointState

from manip_sim.arrays import FloatArray
from manip_sim.errors import ManipSimError, UnknownNameError
from manip_sim.models.archive import load_archive
from manip_sim.ros.messages import nanoseconds_of

#: Size of the picture of a failed test [pixels].
_SIZE = (960, 720)
#: The longest time for a picture, also of a machine with many other processes [s].
_RENDERING_S = 300.0
_ARCHIVE, _STATES, _PICTURE = 'model.mjz', 'states.npz', 'picture.png'


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


#: Recorded fields, by the name of the type of the topic.
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
        """Record the topics that are published now."""
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
        :raises UnknownNameError: if the topic is unknown
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


def save_evidence(recorded: RecordedTopics, archive: Callable[[], bytes], folder: Path
                  ) -> list[str]:
    """
    Save the joint states and the model, and render a picture in a process of its own.

    :param archive: returns the model
    :param folder: is created
    :returns: a line for each file
    """
    folder.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, Any] = {}
    for topic in recorded.with_messages(JointState):
        history = joint_history(recorded.messages(topic))
        for field in ('names', 'time_s', 'position', 'velocity', 'effort'):
            arrays[f'{topic[1:]}/{field}'] = np.array(getattr(history, field))
    for topic in recorded.with_messages(PoseStamped):
        pose = recorded.messages(topic)[-1].pose
        arrays[f'{topic[1:]}/last'] = np.array([
            pose.position.x, pose.position.y, pose.position.z, pose.orientation.w,
            pose.orientation.x, pose.orientation.y, pose.orientation.z])
    np.savez(folder / _STATES, **arrays)
    lines = [f'states at each control period: {folder / _STATES}']
    try:
        (folder / _ARCHIVE).write_bytes(archive())
        _picture(folder)
        lines.append(f'the last instant: {folder / _PICTURE}')
    except ManipSimError as error:
        lines.append(f'no picture: {error}')
    return lines


def _picture(folder: Path) -> None:
    try:
        done = subprocess.run(
            [sys.executable, '-c', f'from {__name__} import render; render({str(folder)!r})'],
            capture_output=True, text=True, check=False, timeout=_RENDERING_S)
    except subprocess.TimeoutExpired as error:
        raise ManipSimError(f'rendering took more than {_RENDERING_S:g} s') from error
    if done.returncode:
        raise ManipSimError((done.stderr.strip().splitlines() or ['it ended without output'])[-1])


def render(folder: str) -> None:
    """
    Render the last instant of what :func:`save_evidence` has saved.

    :param folder: where it is
    """
    model = load_archive(Path(folder, _ARCHIVE).read_bytes())
    data = mujoco.MjData(model)
    with np.load(Path(folder, _STATES)) as arrays:
        for name in arrays.files:
            topic, _, field = name.rpartition('/')
            if field == 'names':
                for joint, position in zip(arrays[name], arrays[f'{topic}/position'][-1]):
                    data.joint(str(joint)).qpos[0] = position
            elif field == 'last' and topic.startswith('objects/'):
                body = model.body(topic.split('/')[1])
                data.qpos[model.jnt_qposadr[body.jntadr[0]]:][:7] = arrays[name]
    mujoco.mj_forward(model, data)
    from manip_sim.cli.render import picture_of_state
    picture: Image.Image = picture_of_state(model, data, _SIZE)
    picture.save(Path(folder, _PICTURE))
