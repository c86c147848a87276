# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Record topics of a running node as they are sent, with its model and its parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
import importlib
import os
from pathlib import Path
import time
from typing import Any

import mujoco
import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import LoggingSeverity, set_logger_level
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import UInt8MultiArray
import yaml

from manip_sim.errors import describe_choices, RecordError
from manip_sim.quoting import pluralize, quoted
from manip_sim.rclpy_internals import describe_missing, RCLError, start_rclpy, without_source
from manip_sim.records.record_file import installed, joined, RecordFile
from manip_sim.records.recorder import MODEL, NODE
from manip_sim.resources import package_version
from manip_sim.startup import EndSignals

#: Period of looking up the topics of the node, time to wait for the node, for topics that
#: were asked for, and for parameters [s].
_LOOK_S, _NODE_S, _TOPICS_S, _PARAMETERS_S = 0.5, 10.0, 3.0, 5.0
#: Messages that may wait, of images and of others.
_IMAGE_DEPTH, _DEPTH = 20, 500
_ARCHIVE = 'mjcf_archive'


def record_node(path: Path, name: str, topics: Sequence[str], duration_s: float | None,
                show: Callable[[int, str], object]) -> tuple[str, bool]:
    """
    Record a node until SIGINT, SIGTERM or SIGHUP, or for some time.

    :param path: of the file, which must not be there
    :param name: full name of the node, such as ``/manip_sim``
    :param topics: that are recorded, ``~`` and relative names as in the node; none for all topics
        that it publishes or subscribes to, but for topics of actions
    :param duration_s: None for no limit [s]
    :param show: is called with the number of messages and more text from time to time
    :returns: a summary, and whether anything was recorded
    :raises RecordError: if the file is there or cannot be written, or the node or a topic is
        missing
    """
    if path.exists():
        raise RecordError(f'{path} already exists and is not overwritten')
    ended = EndSignals()
    set_logger_level('rcl', LoggingSeverity.FATAL)
    try:
        start_rclpy(args=[], signal_handler_options=SignalHandlerOptions.NO)
        node: Node = rclpy.create_node(f'manip_sim_record_{os.getpid()}', enable_rosout=False,
                                       start_parameter_services=False)
    except RCLError as error:
        raise RecordError(f'ROS cannot be started: {without_source(error)}') from error
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        recorder = _NodeRecorder(node, executor, name, topics)
        if not recorder.wait(ended):
            return f'nothing was recorded, {path} was not written', False
        recorder.open(path)
        end_s = None if duration_s is None else time.monotonic() + duration_s
        recorder.run(ended, end_s, show)
        return recorder.close(), recorder.messages > 0
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown()


class _NodeRecorder:
    """Subscribes to the topics of a node, and writes what comes."""

    def __init__(self, node: Node, executor: SingleThreadedExecutor, name: str,
                 topics: Sequence[str]) -> None:
        self._node, self._executor = node, executor
        self._space, _, self._name = name.rpartition('/')
        self._full = name
        self._asked = {self._resolved(topic) for topic in topics}
        self._subscriptions: dict[str, Any] = {}
        self._notes: list[str] = []
        self._file: RecordFile | None = None
        self.messages = 0
        self._bytes = 0
        self._begin_s = 0.0

    def _resolved(self, topic: str) -> str:
        if topic.startswith('~/'):
            return f'{self._full}{topic[1:]}'
        return topic if topic.startswith('/') else f'{self._space}/{topic}'

    def _topics(self) -> dict[str, str]:
        """Return the topics of the node with their types; none if it is not there."""
        topic_types: dict[str, str] = {}
        for find in (self._node.get_publisher_names_and_types_by_node,
                     self._node.get_subscriber_names_and_types_by_node):
            try:
                topic_types.update((topic, types[0]) for topic, types in find(
                    self._name, self._space or '/') if types and '/_action/' not in topic)
            except RuntimeError:  # The node is missing, or not discovered yet.
                return {}
        return topic_types

    def wait(self, ended: EndSignals) -> bool:
        """Wait for the node and the topics that were asked for; tell whether they are there."""
        before: dict[str, str] = {}
        end_s = time.monotonic() + _NODE_S
        while time.monotonic() < end_s:
            if ended.wait(0.2):
                return False
            topics = self._topics()
            # Names arrive one by one: a list that stays equal between two looks is complete.
            if topics and (topics == before and not self._asked or self._asked and
                           self._asked <= topics.keys()):
                return True
            if topics and not before:
                end_s = time.monotonic() + _TOPICS_S
            before = topics
        if not before:
            nodes = [f'{space.rstrip("/")}/{name}'
                     for name, space in self._node.get_node_names_and_namespaces()
                     if name != self._node.get_name()]
            raise RecordError(
                f'there is no node {quoted(self._full)}: '
                + (describe_missing(self._node) or describe_choices(self._full, nodes)))
        missing = sorted(self._asked - before.keys())[0]
        raise RecordError(f'the node {self._full} has no topic {quoted(missing)}: '
                          + describe_choices(missing, before))

    def open(self, path: Path) -> None:
        """Create the file and subscribe."""
        self._file = RecordFile(path)
        self._file.describe(NODE, {
            'node': self._full, 'manip_sim': package_version(),
            'mujoco': mujoco.mj_versionString(), 'begin_ns': str(time.time_ns()),
            'parameters': yaml.safe_dump(self._parameters(), sort_keys=True)})
        self._begin_s = time.monotonic()
        archive = f'{self._full}/{_ARCHIVE}'
        self._node.create_subscription(
            UInt8MultiArray, archive, self._attach, QoSProfile(
                depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL), raw=True)
        self._look()

    def _parameters(self) -> dict[str, Any]:
        client = AsyncParameterClient(self._node, self._full)
        if not client.wait_for_services(_PARAMETERS_S):
            return {}
        listed = client.list_parameters()
        self._executor.spin_until_future_complete(listed, _PARAMETERS_S)
        names = list(listed.result().result.names) if listed.done() else []
        values = client.get_parameters(names)
        self._executor.spin_until_future_complete(values, _PARAMETERS_S)
        if not values.done():
            return {}
        parameters = {name: parameter_value_to_python(value) for name, value in zip(
            names, values.result().values) if not name.startswith('qos_overrides.')}
        return {name: value if isinstance(value, (str, bytes, bool, int, float, type(None))) else
                list(value) for name, value in parameters.items()}

    def _look(self) -> None:
        """Subscribe to topics that are new."""
        for topic, kind in self._topics().items():
            if topic not in self._subscriptions and (not self._asked or topic in self._asked):
                self._subscriptions[topic] = self._subscribe(topic, kind)

    def _subscribe(self, topic: str, kind: str) -> Any:
        assert self._file is not None
        try:
            package, folder, type_name = kind.split('/')
            cls = getattr(importlib.import_module(f'{package}.{folder}'), type_name)
            text = joined(kind, installed) + '\n'
        except (ImportError, AttributeError, RecordError) as error:
            self._notes.append(f'{topic} was left out: {kind} is not installed ({error})')
            return None
        offered = [info.qos_profile for info in self._node.get_publishers_info_by_topic(topic)]
        # The offer of the least of all publishers, so that each matches.
        qos = QoSProfile(
            depth=_IMAGE_DEPTH if 'image' in kind.lower() else _DEPTH,
            reliability=_common(offered, 'reliability', QoSReliabilityPolicy.RELIABLE,
                                QoSReliabilityPolicy.BEST_EFFORT),
            durability=_common(offered, 'durability', QoSDurabilityPolicy.TRANSIENT_LOCAL,
                               QoSDurabilityPolicy.VOLATILE))
        channel = self._file.channel(topic, kind, text, {
            'offered_qos_profiles': yaml.safe_dump([_described(profile) for profile in offered])})
        return self._node.create_subscription(
            cls, topic, partial(self._write, channel), qos, raw=True)

    def _write(self, channel: int, content: bytes, info: dict[str, int]) -> None:
        assert self._file is not None
        self._file.write(channel, info['received_timestamp'], content, info['source_timestamp'])
        self.messages += 1
        self._bytes += len(content)

    def _attach(self, content: bytes, _: dict[str, int]) -> None:
        assert self._file is not None
        archive = bytes(deserialize_message(content, UInt8MultiArray).data)
        self._file.attach(MODEL, 'application/zip', archive, time.time_ns())

    def run(self, ended: EndSignals, end_s: float | None, show: Callable[[int, str], object]
            ) -> None:
        """Record what comes until a signal or an instant of the monotonic clock [s]."""
        assert self._file is not None
        look_s = 0.0
        while not ended.wait(0.0):
            now_s = time.monotonic()
            if end_s is not None and now_s >= end_s:
                break
            if now_s >= look_s:
                look_s = now_s + _LOOK_S
                self._look()
                self._file.flush_when_due()
                show(self.messages, f', {now_s - self._begin_s:.0f} s, {self._size()}'
                     + ('' if self._topics() else ', the node is gone'))
            try:
                self._executor.spin_once(timeout_sec=0.1)
            except ExternalShutdownException:
                break
        # The messages that wait now; no later ones, as topics may be faster than this.
        now_ns = time.time_ns()
        for subscription in self._node.subscriptions:
            received_ns = 0
            with subscription.handle:
                while received_ns <= now_ns and (taken := subscription.handle.take_message(
                        subscription.msg_type, subscription.raw)) is not None:
                    subscription.callback(*taken)
                    received_ns = taken[1]['received_timestamp']

    def _size(self) -> str:
        return f'{self._bytes / 1e6:.1f} MB'

    def close(self) -> str:
        """Complete the file and return what it holds."""
        assert self._file is not None
        self._file.close()
        topics = sum(subscription is not None for subscription in self._subscriptions.values())
        summary = f'{pluralize(self.messages, "message")} of {pluralize(topics, "topic")}'
        return '\n'.join([*self._notes, f'{self._file.path} ({summary}, '
                          f'{time.monotonic() - self._begin_s:.1f} s, {self._size()})'])


def _common(profiles: Sequence[QoSProfile], policy: str, more: Any, less: Any) -> Any:
    return more if profiles and all(getattr(qos, policy) == more for qos in profiles) else less


def _described(profile: QoSProfile) -> dict[str, Any]:
    """Return a profile as rosbag2 stores it."""
    def duration(time: Any) -> dict[str, int]:
        seconds, nanoseconds = divmod(time.nanoseconds, 1_000_000_000)
        return {'sec': seconds, 'nsec': nanoseconds}
    return {
        'history': int(profile.history), 'depth': profile.depth,
        'reliability': int(profile.reliability), 'durability': int(profile.durability),
        'deadline': duration(profile.deadline), 'lifespan': duration(profile.lifespan),
        'liveliness': int(profile.liveliness),
        'liveliness_lease_duration': duration(profile.liveliness_lease_duration),
        'avoid_ros_namespace_conventions': profile.avoid_ros_namespace_conventions}
