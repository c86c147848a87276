# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
A simulation that stands still unless a test lets simulated time pass, and what it published.

Its topics are recorded as arrays; a failed test leaves them, the model and a picture.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
import math
from pathlib import Path
import subprocess
import sys
import time
from typing import Any

from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
import mujoco
import numpy as np
from PIL import Image
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
import rclpy
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.topic_endpoint_info import TopicEndpointInfo
from sensor_msgs.msg import JointState
from std_msgs.msg import UInt8MultiArray
from std_srvs.srv import SetBool, Trigger

from manip_sim.arrays import FloatArray
from manip_sim.errors import ManipSimError, UnknownNameError
from manip_sim.models.archive import load_archive
from manip_sim.rclpy_internals import describe_unheard, is_unheard, start_rclpy
from manip_sim.ros.messages import LATCHED, nanoseconds_of
from manip_sim.ros_environment import check_ros_environment
from manip_sim.testing.controllers import Controllers, NodeInProcess, NodeProcess, ServedNode

#: Number of control periods that pass at once: fewer than the messages that a publisher keeps.
_AT_ONCE = 5
#: Longest wait for a message at once; the awaited condition may also come about otherwise [s].
_LOOK_S = 0.05
#: Time until a request without an answer is repeated; DDS may lose it [s].
_AGAIN_S = 2.0
#: Time after which a name without any owner counts as unknown; discovery takes less [s].
_UNKNOWN_S = 3.0
#: Time for which DDS counts a killed node as present [s].
_LEASE_S = 30.0
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


class SimulationStalled(ManipSimError):
    """Simulated time does not pass although the test lets it."""


class NotInTime(ManipSimError, AssertionError):
    """The condition that a test waits for was not met within its limit of simulated time."""


class SimulationUnderTest:
    """
    A node in a domain of its own; its time passes only in :meth:`run_for` and :meth:`wait_for`.

    The fixture ``sim_node`` makes it. The node starts paused. With ``stepping='lockstep'`` it
    waits for the commands of the controller under test, so that results repeat to the last bit;
    with ``'free'``, the default here, nothing waits, which fits tests that send goals.

    :param domain: the ROS domain
    :param parameters: of the node, by name
    :param as_process: start the node as a process of its own
    :param patience_s: wall time after which waiting for time, messages or answers fails [s]
    :raises ManipSimError: if the node cannot start
    :ivar domain: the ROS domain
    :ivar node: an ``rclpy`` node for what a test publishes, calls or subscribes to; its callbacks
        run while the test waits
    :ivar period_s: length of a control period [s]
    """

    def __init__(self, domain: int, parameters: Mapping[str, Any], as_process: bool,
                 patience_s: float = 10.0) -> None:
        if not patience_s > 0.0:
            raise ManipSimError(f'patience must be above 0 s, got {patience_s}')
        check_ros_environment()
        self._patience_s = patience_s
        settings = self._given = {'stepping': 'free', **parameters, 'start_paused': True}
        self._lockstep = settings['stepping'] == 'lockstep'
        self.domain = domain
        self._context = rclpy.Context()
        start_rclpy(context=self._context, domain_id=domain, args=[])
        try:
            # A context of its own would be another participant of DDS in this process: while one
            # works, Fast DDS does not reliably survive the end of the other.
            self.server: ServedNode = (
                NodeProcess(settings) if as_process else NodeInProcess(self._context, settings))
        except BaseException:
            rclpy.try_shutdown(context=self._context)
            raise
        self.node = rclpy.create_node('test_of_a_controller', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._publishers: dict[str, Any] = {}
        self._clients: dict[tuple[Any, str], Any] = {}
        self._recorded = RecordedTopics(self.node)
        self._controllers = Controllers(domain)
        self._now_ns = 0
        try:
            self._begin()
        except BaseException:
            self.close()
            raise

    def _begin(self) -> None:
        values = self._parameters('publish_rate', 'robots')
        self.period_s = 1.0 / float(values[0].double_value)
        spaces = [f'{name}/' for name in values[1].string_array_value if name] or ['']
        topics = [f'/{space}joint_states' for space in spaces]
        self._spin_until(lambda: all(map(self.node.count_publishers, topics)))
        self._recorded.begin()
        self._states = topics
        self._wait_for_the_start()

    def _wait_for_the_start(self) -> None:
        # Topics of a robot without an arm, or of objects that come later, have no message yet.
        self._spin_until(lambda: self._recorded.repeats > 2 and all(
            self._recorded.messages(topic) for topic in self._states))
        self._topics = self._recorded.with_messages()
        self._now_ns = self._recorded.stamp_ns(self._states[0], 0)

    def _parameters(self, *names: str) -> Any:
        self._spin_until(lambda: self.node.count_services('manip_sim/get_parameters') > 0)
        # After a crash, DDS knows the services of the node that was killed for some time yet.
        return self._call(GetParameters, 'manip_sim/get_parameters',
                          GetParameters.Request(names=list(names)), True, math.inf).values

    # ------------------------------------------------------------------ time

    @property
    def time_s(self) -> float:
        """Simulation time now, that of the newest state [s]."""
        return self._now_ns * 1e-9

    def run_for(self, duration_s: float) -> None:
        """
        Let simulated time pass, in whole control periods.

        :param duration_s: simulated time [s]
        :raises ManipSimError: if the duration is negative or not finite, or the node has ended
        :raises SimulationStalled: if no control period begins, such as for want of commands
        """
        if not (math.isfinite(duration_s) and duration_s >= 0.0):
            raise ManipSimError(f'a duration must be finite and 0 or more, got {duration_s}')
        left = round(duration_s / self.period_s)
        while left:
            periods = min(left, _AT_ONCE)
            self._advance(periods)
            left -= periods

    def wait_for(self, predicate: Callable[[], bool], limit_s: float = 10.0) -> None:
        """
        Let simulated time pass until something is true, and no longer.

        :param predicate: is called once at each instant, such as with ``states()``
        :param limit_s: simulated time [s]
        :raises NotInTime: if it has not become true
        :raises SimulationStalled: if no control period begins
        """
        periods = max(0, math.ceil(limit_s / self.period_s - 1e-9))
        for _ in range(periods):
            if predicate():
                return
            self._advance(1)
        if not predicate():
            raise NotInTime(f'not true within {limit_s:g} s of simulated time, at '
                            f'{self.time_s:.3f} s')

    def _advance(self, periods: int) -> None:
        end_ns = self._now_ns + periods * round(self.period_s * 1e9)
        for topic in self._publishers:
            self._wait_until_acknowledged(topic)
        self.set_parameter('pause_at', end_ns * 1e-9)
        self._recorded.last_new_s = time.monotonic()
        # Only passing time counts: DDS may lose the answer.
        self._ask(SetBool, 'manip_sim/pause', SetBool.Request(data=False))
        self._wait_for_states(end_ns, self._check_not_stalled)

    def _wait_until_acknowledged(self, topic: str) -> None:
        limit_s = min(max(self._patience_s, _LEASE_S), 1e9)
        if not self._publishers[topic].wait_for_all_acked(Duration(seconds=limit_s)):
            raise SimulationStalled(f'a subscriber of {topic} has not acknowledged what was '
                                    f'published within {limit_s:g} s')

    def _wait_for_states(self, end_ns: int, check: Callable[[], None]) -> None:
        self._spin_until(lambda: all(
            self._recorded.stamp_ns(topic) >= end_ns for topic in self._topics), check)
        self._now_ns = end_ns

    def _limit(self, problem: str, limit_s: float) -> Callable[[], None]:
        """Return a check that raises ManipSimError after some wall time [s]."""
        end_s = time.monotonic() + limit_s

        def check() -> None:
            if time.monotonic() > end_s:
                raise ManipSimError(f'{problem} within {limit_s:g} s')
        return check

    def _check_not_stalled(self) -> None:
        if time.monotonic() - self._recorded.last_new_s <= self._patience_s:
            return
        parts = ', '.join(self._given.get('lockstep_parts', ['arm']))
        reason = (f'lock-step waits for a command of the parts {parts}; {self._senders()}'
                  if self._lockstep else 'is it paused by somebody else, or has it diverged?')
        doing = self._controllers.describe()
        raise SimulationStalled(
            f'the simulation stands still at {self.time_s:.3f} s: {reason}; waited for '
            f'{self._patience_s:g} s of wall time' + (f'; {doing}' if doing else ''))

    def _senders(self) -> str:
        """Return which nodes publish to topics of the node under test."""
        senders = [
            f"'{info.node_name}' publishes {topic[1:]}" for topic, types in
            self._subscribed() if '/ParameterEvent' not in types[0]
            for info in self._others(self.node.get_publishers_info_by_topic(topic))
            if info.node_name != 'manip_sim' and not is_unheard(info)]
        return ', '.join(senders) or describe_unheard(self.node) or (
            'no node publishes what it takes')

    def set_parameter(self, name: str, value: Any) -> None:
        """
        Change a live parameter of the node.

        :param name: such as ``control_mode.arm``
        :param value: the new value
        :raises ManipSimError: if the node rejects it, with its reason
        """
        result = self.call(SetParametersAtomically, 'manip_sim/set_parameters_atomically',
                           SetParametersAtomically.Request(parameters=[
                               Parameter(name, value=value).to_parameter_msg()]),
                           again=True).result
        if not result.successful:
            raise ManipSimError(result.reason)

    def reset(self) -> None:
        """
        Put the simulation back to its start; time and recording go on.

        :raises ManipSimError: if the node refuses
        """
        answer = self._ask(Trigger, 'manip_sim/reset', Trigger.Request())

        def check() -> None:
            if answer.done() and not answer.result().success:
                raise ManipSimError(answer.result().message)
        self._wait_for_states(self._now_ns + round(self.period_s * 1e9), check)

    def crash(self) -> None:
        """
        Kill the node (SIGKILL), and start it again: its time and the recording begin again.

        The controllers under test go on, and find another node of the same name.

        :raises ManipSimError: if the node was not started with ``as_process=True``
        """
        self.server.kill()
        self._recorded.begin_anew()
        self.server = NodeProcess(self._given)
        self._wait_for_the_start()
        self._parameters('publish_rate')

    # ------------------------------------------------------------------ published messages

    def messages(self, topic: str) -> list[Any]:
        """
        Return the messages of a recorded topic up to now, one for each control period, a copy.

        :param topic: such as ``right/eef_pose``; joint states, wrenches, poses and twists
        :raises UnknownNameError: if the topic is unknown
        """
        return self._recorded.messages(topic)

    def recorded(self, message_type: Any) -> list[str]:
        """Return the names of the recorded topics of a type of messages that have a message."""
        return [name[1:] for name in self._recorded.with_messages(message_type)]

    def nodes(self) -> list[str]:
        """Return the full names of the nodes in the domain; one that is there twice is twice."""
        return sorted(f'{space.rstrip("/")}/{name}'
                      for name, space in self.node.get_node_names_and_namespaces())

    def receive(self, message_type: Any, topic: str, qos: Any = 10) -> Any:
        """
        Return the next message of any topic; of a latched one the last that was published.

        :param message_type: such as ``std_msgs.msg.String``
        :param topic: such as ``manip_sim/mjcf``
        :param qos: profile, or depth of the history
        :raises UnknownNameError: if nobody publishes it with this type
        :raises ManipSimError: if no message comes, or the node has ended
        """
        messages: list[Any] = []
        subscriptions: list[Any] = []
        self._wait_for_name('published topic', topic, message_type, self._published)
        begin_s = time.monotonic()

        def received() -> bool:
            # DDS may lose a latched message on its way to a new subscription.
            if not messages and time.monotonic() - begin_s >= _AGAIN_S * len(subscriptions):
                subscriptions.append(self.node.create_subscription(
                    message_type, topic, messages.append, qos))
            return bool(messages)
        try:
            self._spin_until(received, self._limit(f'no message on {topic}', self._patience_s))
        finally:
            for subscription in subscriptions:
                self.node.destroy_subscription(subscription)
        return messages[0]

    def states(self, topic: str = 'joint_states') -> JointHistory:
        """
        Return the states of joints up to now.

        :param topic: such as ``arm/joint_states``
        :raises UnknownNameError: if the topic is unknown
        """
        return joint_history(self.messages(topic))

    def wrenches(self, topic: str = 'right/external_wrench') -> WrenchHistory:
        """
        Return the wrenches at a tool up to now.

        :param topic: such as ``left/wrench``
        :raises UnknownNameError: if the topic is unknown
        """
        return wrench_history(self.messages(topic))

    # ------------------------------------------------------------------ what a test does

    def publish(self, topic: str, message: Any) -> None:
        """
        Publish a command; the next control period uses it.

        :param topic: such as ``arm/joint_command``
        :param message: of the type of the topic
        :raises UnknownNameError: if nobody subscribes to it with this type
        :raises ManipSimError: if the node has ended
        """
        if topic not in self._publishers:
            self._wait_for_name('subscribed topic', topic, type(message), self._subscribed)
            # Fast DDS asks for acknowledgements at once if the history is full, else every 3 s.
            publisher = self.node.create_publisher(type(message), topic, 1)
            infos = self.node.get_subscriptions_info_by_topic(publisher.topic_name)
            ours = len(infos) - len(self._others(infos))
            self._wait_until_connected(topic, lambda: publisher.get_subscription_count() > ours)
            self._publishers[topic] = publisher
        self._wait_until_acknowledged(topic)
        self._publishers[topic].publish(message)

    def call(self, service_type: Any, name: str, request: Any = None, again: bool = False) -> Any:
        """
        Call a service and return its response.

        :param service_type: such as ``std_srvs.srv.Trigger``
        :param name: such as ``manip_sim/tare_wrench``
        :param request: None for an empty one
        :param again: ask again if no answer comes for some seconds, as DDS may lose it; the
            service may then be executed twice
        :raises UnknownNameError: if nobody offers it with this type
        :raises ManipSimError: if no answer comes, or the node has ended
        """
        return self._call(service_type, name, request, again, self._patience_s)

    def _call(self, service_type: Any, name: str, request: Any, again: bool,
              limit_s: float) -> Any:
        request = request or service_type.Request()
        futures: list[Any] = []
        begin_s = time.monotonic()

        def answered() -> bool:
            if not futures or again and time.monotonic() - begin_s >= _AGAIN_S * len(futures):
                futures.append(self._ask(service_type, name, request))
            return any(future.done() for future in futures)
        self._spin_until(answered, self._limit(f'no answer of the service {name}', limit_s))
        return next(future.result() for future in futures if future.done())

    def _ask(self, service_type: Any, name: str, request: Any) -> Any:
        # The answer to a client that is new is more easily lost.
        key = service_type, name
        if key not in self._clients:
            self._wait_for_name('service', name, service_type,
                                self.node.get_service_names_and_types)
            self._clients[key] = self.node.create_client(service_type, name)
        client = self._clients[key]
        self._wait_until_connected(name, client.service_is_ready)
        return client.call_async(request)

    def _published(self) -> list[tuple[str, Sequence[str]]]:
        return [topic for topic in self.node.get_topic_names_and_types()
                if self._others(self.node.get_publishers_info_by_topic(topic[0]))]

    def _subscribed(self) -> list[tuple[str, Sequence[str]]]:
        return [topic for topic in self.node.get_topic_names_and_types()
                if self._others(self.node.get_subscriptions_info_by_topic(topic[0]))]

    def _others(self, infos: list[TopicEndpointInfo]) -> list[TopicEndpointInfo]:
        """Return the publishers or subscriptions of nodes other than :attr:`node`."""
        return [info for info in infos if info.node_name != self.node.get_name()]

    def _wait_for_name(self, kind: str, name: str, interface: Any,
                       listed: Callable[[], Iterable[tuple[str, Sequence[str]]]]) -> None:
        """
        Wait until somebody has a topic or service.

        :param kind: noun for it, such as ``service``
        :param interface: its type; None for any
        :param listed: returns the names and types that are there
        :raises UnknownNameError: if nobody has it, with the nearest names, of this type if any has
        :raises ManipSimError: if it has another type
        """
        full_name, begin_s = self.node.resolve_topic_name(name), time.monotonic()
        package, module = interface.__module__.split('.')[:2] if interface else ('', '')
        type_name = f'{package}/{module}/{interface.__name__}' if interface else ''

        def check() -> None:
            # A controller may just have been started.
            if time.monotonic() <= max(begin_s + _UNKNOWN_S,
                                       self._controllers.started_s + self._patience_s):
                return
            present = dict(listed())
            if types := present.get(full_name):
                raise ManipSimError(f'the {kind} {name} has the type {", ".join(types)}, not '
                                    f'{type_name}')
            alike = [other[1:] for other, types in present.items() if type_name in types]
            raise UnknownNameError(kind + (f' of the type {type_name}' if type_name else ''), name,
                                   alike or [other[1:] for other in present])
        self._spin_until(lambda: any(
            other == full_name and (not type_name or type_name in types)
            for other, types in listed()), check)

    def _wait_until_connected(self, name: str, connected: Callable[[], bool]) -> None:
        self._spin_until(connected, self._limit(
            f'{name} is there, but DDS has not connected it', self._patience_s))

    def spin(self, node: Node) -> None:
        """
        Run the callbacks of a controller's node in a thread of its own, until the test ends.

        :param node: of the context that ``rclpy.init()`` initialised after the simulation began,
            or of any other in its domain
        :raises ManipSimError: if it is in another domain
        """
        self._controllers.spin(node)

    def start(self, command: Sequence[str], **arguments: Any) -> subprocess.Popen[Any]:
        """
        Start a controller as a process in the domain of the node; it is ended with the test.

        So are its child processes, which ``ros2 run`` and ``ros2 launch`` have.

        :param command: such as ``['ros2', 'run', 'my_package', 'my_controller']``
        :param arguments: further arguments of ``subprocess.Popen``
        """
        return self._controllers.start(command, **arguments)

    def wait_for_publisher(self, topic: str) -> None:
        """
        Wait until the controller under test publishes a topic; simulated time does not pass.

        :param topic: such as ``arm/joint_command``
        :raises UnknownNameError: if nobody publishes it
        :raises ManipSimError: if the node or the processes of :meth:`start` have ended meanwhile
        """
        self._wait_for_name('published topic', topic, None, self._running_and_published)

    def _running_and_published(self) -> list[tuple[str, Sequence[str]]]:
        self._controllers.check_running()
        return self._published()

    def _spin_until(self, condition: Callable[[], bool],
                    check: Callable[[], None] = lambda: None) -> None:
        while not condition():
            self.server.check()
            self._controllers.check()
            check()
            self._executor.spin_once(timeout_sec=_LOOK_S)

    # ------------------------------------------------------------------ the end

    def save_evidence(self, folder: Path) -> list[str]:
        """
        Save the recorded messages, and a picture of the present instant.

        :param folder: is created
        :returns: a line about the nodes in the domain, and one for each file
        """
        nodes = f'nodes in ROS domain {self.domain}: {", ".join(self.nodes())}'
        return [nodes, *save_evidence(self._recorded, lambda: bytes(self.receive(
            UInt8MultiArray, 'manip_sim/mjcf_archive', LATCHED).data), folder)]

    def close(self) -> None:
        """
        End controllers and node.

        :raises Exception: that of a controller, if the test has not waited since it failed
        :raises ManipSimError: if the node has failed, or a controller does not end
        """
        with ExitStack() as last_first:
            last_first.callback(rclpy.try_shutdown, context=self._context)
            last_first.callback(self.server.close)
            last_first.callback(self.node.destroy_node)
            last_first.callback(self._executor.shutdown)
            last_first.callback(self._controllers.close)
