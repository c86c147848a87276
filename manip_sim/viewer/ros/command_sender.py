# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Send the commands that people give on the page to the node."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
import re
from typing import Any

from geometry_msgs.msg import Point, PoseStamped, Twist
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, SetParameters
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import Marker

from manip_sim.arrays import FloatArray
from manip_sim.interface.topics import BY_NAME
from manip_sim.viewer.page.latest import ShownStatus
from manip_sim.viewer.ros.discovery import name_of

_ACTION_SIZE, _MAX_ACTION_SIZE = 'action_size', 100
_SERVICES = {'pause': SetBool, 'step': Trigger, 'reset': Trigger, 'tare_wrench': Trigger,
             'describe_parameters': DescribeParameters, 'set_parameters': SetParameters}
#: The constraint in the description of a parameter that has choices.
_CHOICES = re.compile(r'One of: (?P<names>[\w:, -]+)\.')


class CommandSender:
    """
    The publishers and service clients for commands.

    :param node: the viewer's own
    :param simulation: full name of the node that is seen, without the first slash
    :param frames: those in which the node gives the poses of end effectors, by namespace and arm
    :param notify: called with what could not be done, for people
    :param record: begins or ends a record of the node
    :ivar paused: called when the simulation has been paused or goes on
    """

    def __init__(self, node: Node, simulation: str, frames: Mapping[tuple[str, str], str],
                 notify: Callable[[str], None],
                 record: Callable[[bool], None] = lambda wanted: None) -> None:
        self._node, self._name, self._frames, self._notify = node, simulation, frames, notify
        self._publishers: dict[str, Any] = {}
        self._clients: dict[str, Any] = {}
        self._waiting: dict[str, Any] = {}
        self._action_sizes: dict[str, int] = {}
        #: The control modes of parts, by the name of their parameter; None if not asked for.
        self._modes: dict[str, list[str]] | None = None
        self._parts: set[str] = set()
        self.paused: Callable[[bool], None] = lambda paused: None
        self.record = record

    def notice(self, base: str, statuses: list[ShownStatus]) -> None:
        """Take from the diagnostics how many numbers the actions of grippers have."""
        sizes = {f'{base}{status.name}': status.number(_ACTION_SIZE) for status in statuses}
        self._action_sizes = {name: int(size) for name, size in sizes.items()
                              if size is not None and 1.0 <= size <= _MAX_ACTION_SIZE}

    def prepare(self, topics: Mapping[str, Any]) -> None:
        """Create publishers and clients early: a message sent before discovery is lost."""
        for topic in self._publishers.keys() - topics.keys():
            self._node.destroy_publisher(self._publishers.pop(topic))
        for topic, kind in topics.items():
            if topic not in self._publishers:
                self._publishers[topic] = self._node.create_publisher(kind, topic, 10)
        self._modes = None
        self._parts = set(filter(None, map(BY_NAME['<part>/joint_command'].of_name, topics)))
        for name, kind in _SERVICES.items():
            if name not in self._clients:
                self._clients[name] = self._node.create_client(kind, f'/{self._name}/{name}')

    def _publish(self, topic: str, message: Any) -> None:
        if topic not in self._publishers:
            self._notify(f'{topic}: the node no longer subscribes to this topic')
        elif self._publishers[topic].get_subscription_count():
            self._waiting.pop(topic, None)
            self._publishers[topic].publish(message)
        else:
            self._waiting[topic] = message

    def send_waiting(self) -> None:
        """Send what waits for the node to be discovered: the last message of each topic."""
        self._ask_modes()
        for topic in list(self._waiting):
            self._publish(topic, self._waiting.pop(topic))

    def forget_waiting(self) -> None:
        """Drop the messages that wait for a node that is gone."""
        self._waiting.clear()

    def _ask_modes(self) -> None:
        client = self._clients.get('describe_parameters')
        if self._modes is not None or client is None or not client.service_is_ready():
            return
        self._modes = modes = {}

        def answered(future: Any, name: str) -> None:
            for descriptor in future.result().descriptors:
                if match := _CHOICES.fullmatch(descriptor.additional_constraints):
                    modes[name] = match['names'].split(', ')
        # Each by itself: a name that the node does not know leaves its answer empty.
        for name in sorted(self._mode_parameter('', part) for part in self._parts):
            client.call_async(DescribeParameters.Request(names=[name])).add_done_callback(
                partial(answered, name=name))

    def _mode_parameter(self, space: str, part: str) -> str:
        base = f'/{self._name}'.rpartition('/')[0]
        *scope, name = f'{space}{part}'.removeprefix(f'{base}/').strip('/').split('/')
        return '.'.join((*scope, 'control_mode', name))

    def modes(self, space: str, part: str) -> Sequence[str]:
        return (self._modes or {}).get(self._mode_parameter(space, part), ())

    def switch_mode(self, space: str, part: str, mode: str) -> None:
        self._call('set_parameters', SetParameters.Request(parameters=[Parameter(
            name=self._mode_parameter(space, part), value=ParameterValue(
                type=ParameterType.PARAMETER_STRING, string_value=mode))]))

    def move_joints(self, space: str, part: str, field: str, goals: Mapping[str, float]) -> None:
        """Publish goals of joints; see :class:`PageCommands`, as for all further methods."""
        message = JointState(name=list(goals), **{field: list(goals.values())})
        self._publish(name_of(space, '<part>/joint_command', part), message)

    def act(self, space: str, part: str, action: float) -> None:
        size = self._action_sizes.get(f'{space}{part}')
        if size is None:
            self._notify(f'{part}: the length of an action is not known yet')
            return
        self._publish(name_of(space, '<part>/command', part),
                      Float64MultiArray(data=[action] * size))

    def drive(self, space: str, twist: tuple[float, float, float]) -> None:
        message = Twist()
        message.linear.x, message.linear.y, message.angular.z = twist
        self._publish(name_of(space, 'base/cmd_vel'), message)

    def reach(self, space: str, arm: str, position: FloatArray, quat_wxyz: FloatArray) -> None:
        message = PoseStamped()
        message.header.frame_id = self._frames.get((space, arm), 'world')
        at, turn = message.pose.position, message.pose.orientation
        at.x, at.y, at.z = (float(value) for value in position)
        turn.w, turn.x, turn.y, turn.z = (float(value) for value in quat_wxyz)
        self._publish(name_of(space, '<arm>/target_pose', arm), message)

    def pull(self, body: str, number: int, point: FloatArray, target: FloatArray) -> None:
        self._pull(Marker(ns=body, id=number, points=[
            Point(x=x, y=y, z=z) for x, y, z in (point.tolist(), target.tolist())]))

    def let_go(self, body: str) -> None:
        self._pull(Marker(ns=body, action=Marker.DELETE))

    def _pull(self, message: Marker) -> None:
        publisher = self._publishers.get(f'/{self._name}/pull')
        # One that would wait for the node would pull when nobody drags any more.
        if publisher is not None and publisher.get_subscription_count():
            publisher.publish(message)
        elif message.action == Marker.DELETE:
            self._notify('pull: the node does not take pulls')

    def pause(self, paused: bool) -> None:
        self._call('pause', SetBool.Request(data=paused), lambda: self.paused(paused))

    def step(self) -> None:
        self._call('step', Trigger.Request())

    def reset(self) -> None:
        self._call('reset', Trigger.Request())

    def tare(self) -> None:
        self._call('tare_wrench', Trigger.Request())

    def _call(self, name: str, request: Any, done: Callable[[], None] = lambda: None) -> None:
        client = self._clients.get(name)
        if client is None or not client.service_is_ready():
            self._notify(f'{name}: the node does not answer')
            return

        def answered(future: Any) -> None:
            answer = future.result()
            if isinstance(answer, SetParameters.Response):
                success, message = answer.results[0].successful, answer.results[0].reason
            else:
                success, message = answer.success, answer.message
            if success:
                done()
            else:
                self._notify(f'{name}: {message}')
        client.call_async(request).add_done_callback(answered)
