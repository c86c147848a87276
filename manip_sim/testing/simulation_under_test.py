# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A simulation that stands still unless a test lets simulated time pass, and what it published."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
import math
from pathlib import Path
import subprocess
import time
from typing import Any

from rcl_interfaces.srv import GetParameters, SetParametersAtomically
import rclpy
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.topic_endpoint_info import TopicEndpointInfo
from std_msgs.msg import UInt8MultiArray
from std_srvs.srv import SetBool, Trigger

from manip_sim.errors import ManipSimError, UnknownNameError
from manip_sim.rclpy_internals import describe_unheard, is_unheard, start_rclpy
from manip_sim.ros.messages import LATCHED
from manip_sim.ros_environment import check_ros_environment
from manip_sim.testing.controllers import Controllers, NodeInProcess, NodeProcess, ServedNode
from manip_sim.testing.evidence import (
    joint_history, JointHistory, RecordedTopics, save_evidence, wrench_history, WrenchHistory)

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
