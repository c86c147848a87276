# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A ROS node as policy: it answers observations on topics with actions, in lock-step."""

from __future__ import annotations

from collections.abc import Callable
import json
import time
from typing import Any

from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
import numpy as np
import rclpy
from rclpy.exceptions import InvalidNamespaceException
from rclpy.executors import SingleThreadedExecutor
from rclpy.validate_namespace import validate_namespace
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import String

from manip_sim.arrays import FloatArray
from manip_sim.channels import contents
from manip_sim.channels.contents import Fields, image, Make, stamp_fields
from manip_sim.errors import CommandError, ManipSimError, ModelError, UnknownNameError
from manip_sim.quoting import quoted
from manip_sim.rclpy_internals import start_rclpy
from manip_sim.ros.messages import fill, LATCHED, nanoseconds_of, WORLD
from manip_sim.tasks import Episode
from manip_sim.tasks.observation import IMAGE, Observation

#: An observation is repeated after this wall time, for a node that came late [s].
_AGAIN_S = 0.1


class RosPolicy:
    """
    A node that answers each observation on ``joint_states`` and its neighbours on ``action``.

    :param namespace: of the topics, such as ``/policy``
    :param episode: in which it acts
    :param limit_s: how long an answer may take, wall time [s]
    :raises ModelError: if it is not a namespace
    """

    def __init__(self, namespace: str, episode: Episode, limit_s: float) -> None:
        try:
            validate_namespace(namespace)
        except InvalidNamespaceException as error:
            raise ModelError(f'policy {quoted("ros:" + namespace)}: the namespace must be such as '
                             f'ros:/policy: {str(error).splitlines()[0]}') from None
        self._namespace = namespace
        self._episode = episode
        self._limit_s = limit_s
        #: Stamp of the present observation [ns]; it rises over all episodes.
        self._stamp_ns = 0
        self._answer: JointState | None = None
        self._stale = ''
        self._executor: SingleThreadedExecutor | None = None

    def _connect(self) -> None:
        """Make topics; only what acts has them, as the process that starts others does not."""
        context = rclpy.Context()
        start_rclpy(context=context)
        self._node = node = rclpy.create_node(
            'manip_sim_run', namespace=self._namespace, context=context)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(node)
        self._about = node.create_publisher(String, 'episode', LATCHED)
        #: By topic, the publisher, and what makes the fields of its message for a header.
        self._topics: list[tuple[Any, Callable[[Fields, Observation], Fields]]] = []
        robots, names = self._episode.simulation.robots, self._episode.observer.names
        joints = contents.joint_state(names['joint_position'])
        self._add('joint_states', JointState, lambda head, seen: joints(head, np.concatenate([
            seen[f'joint_{field}'] for field in ('position', 'velocity', 'effort')])))
        for row, arm in enumerate(names['eef_pose']):
            scope = arm if len(robots) > 1 else arm.rpartition('/')[2]
            for key, kind, make in (
                    ('eef_pose', PoseStamped, contents.pose),
                    ('eef_twist', TwistStamped, contents.twist),
                    ('external_wrench', WrenchStamped, contents.wrench)):
                self._add_row(f'{scope}/{key}', kind, make, key, row)
        for row, name in enumerate(names.get('object_pose', [])):
            self._add_row(f'objects/{name}/pose', PoseStamped, contents.pose, 'object_pose', row)
        for key in self._episode.observation:
            if key.startswith(IMAGE):
                self._add(f'{key.removeprefix(IMAGE)}/image', Image,
                          lambda head, seen, key=key: image(head, seen[key]))
        node.create_subscription(JointState, 'action', self._receive, 10)

    def _add(self, topic: str, kind: Any, make: Callable[..., Fields]) -> None:
        self._topics.append((self._node.create_publisher(kind, topic, 10), make))

    def _add_row(self, topic: str, kind: Any, make: Make, key: str, row: int) -> None:
        self._add(topic, kind, lambda head, seen: make(head, seen[key][row]))

    def _receive(self, message: JointState) -> None:
        stamp_ns = nanoseconds_of(message.header.stamp)
        if stamp_ns == self._stamp_ns:
            self._answer = message
        else:
            self._stale = (f'; the last action has the stamp {stamp_ns} ns, and that of the '
                           f'observation is {self._stamp_ns} ns')

    def reset(self, seed: int) -> None:
        """
        Begin an episode: publish what it is, latched.

        :param seed: of the episode
        """
        if self._executor is None:
            self._connect()
        task, actions = self._episode.task, self._episode.actions
        self._stale = ''
        self._about.publish(String(data=json.dumps({
            'seed': seed, 'task': task.name, 'instruction': task.instruction,
            'begins_ns': self._stamp_ns + self._period_ns, 'period_s': self._episode.period_s,
            'action': self._episode.kind, 'names': actions.names,
            'bounds': actions.bounds.tolist(),
            'goal': task.goal(self._episode.simulation).tolist()})))

    @property
    def _period_ns(self) -> int:
        return round(self._episode.period_s * 1e9)

    def act(self, observation: Observation) -> FloatArray:
        """
        Publish an observation and return the action that answers it.

        :param observation: of the present instant
        :raises ManipSimError: if no answer comes in time
        :raises CommandError: if the answer cannot be used
        """
        assert self._executor is not None
        self._stamp_ns += self._period_ns
        self._answer = None
        head = {'stamp': stamp_fields(self._stamp_ns), 'frame_id': WORLD}
        messages = [(publisher, fill(publisher.msg_type(), make(head, observation)))
                    for publisher, make in self._topics]
        end, again = time.monotonic() + self._limit_s, 0.0
        while self._answer is None:
            now = time.monotonic()
            if now > end:
                raise ManipSimError(self._missing())
            if now >= again:
                again = now + _AGAIN_S
                for publisher, message in messages:
                    publisher.publish(message)
            self._executor.spin_once(timeout_sec=min(_AGAIN_S, end - now))
        return self._numbers(self._answer)

    def _missing(self) -> str:
        topic = self._node.resolve_topic_name('action')
        if not self._node.count_publishers(topic):
            return f'no node publishes {topic}: nothing for {self._limit_s:g} s'
        return f'no answer on {topic} for {self._limit_s:g} s{self._stale}'

    def _numbers(self, answer: JointState) -> FloatArray:
        """Return the action of a message, by its names if it has any."""
        numbers, names = np.array(answer.position, dtype=float), self._episode.actions.names
        if not answer.name:
            return numbers
        for name in answer.name:
            if name not in names:
                raise UnknownNameError('name in an action', name, names)
        if sorted(answer.name) != sorted(names) or len(numbers) != len(names):
            raise CommandError(f'an action needs {len(names)} names and positions, or positions '
                               f'alone, got {len(answer.name)} and {len(numbers)}')
        return numbers[[list(answer.name).index(name) for name in names]]
