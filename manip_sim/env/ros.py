# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Tasks and robots of a running node, over topics.

A task is an environment with the same episodes as in this process; a robot is what LeRobot's
``Robot`` needs, of which nothing is imported.
"""

from __future__ import annotations

from manip_sim.ros_environment import check_shared_memory

check_shared_memory()  # Where it is full, the imports of ROS below end the process.
# ruff: noqa: E402
# flake8: noqa: E402

from collections import deque
from collections.abc import Callable, Mapping, Sequence
import contextlib
import functools
import json
import math
import threading
import time
from typing import Any
from xml.etree import ElementTree

from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
import gymnasium
import numpy as np
from numpy.typing import ArrayLike, NDArray
from rcl_interfaces.srv import SetParameters
import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import SetBool, Trigger

from manip_sim.arrays import FloatArray
from manip_sim.env.task_env import action_space, check_options, observation_space, SEEDS, TaskEnv
from manip_sim.errors import CommandError, ManipSimError, UnknownNameError
from manip_sim.lerobot_units import plain_scales, POSITION, Scale
from manip_sim.quoting import quoted_names
from manip_sim.rclpy_internals import RCLError, start_rclpy
from manip_sim.tasks.latency import NO_LATENCY, number_of_parts
from manip_sim.tasks.observation import IMAGE, Observation
from manip_sim.validation import finite_command_numbers

_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
#: Longest wait for an answer of the node, wall time [s].
_PATIENCE_S = 60.0
#: Longest wait for the node at the start, and greatest age of what is observed, wall time [s].
_ROBOT_PATIENCE_S, _OLDEST_S = 20.0, 2.0


class NodeEnv(gymnasium.Env[Observation, NDArray[Any]]):
    """
    Episodes of a task in a running node, with observations, actions and digests as of TaskEnv.

    The node must have been started with ``task``, ``stepping:=lockstep``, the ``publish_rate``
    ``control_hz``, and as ``lockstep_parts`` the arm and its gripper. Actions of joints set the
    ``control_mode`` of the arms, and switch their ``command_timeout`` off. ``noise`` sets those
    parameters of the node. ``cameras`` are among the node's, with its size and a rate of
    ``control_hz``. The latency of commands sets ``latency.command`` of the node and its jitter;
    that of states is whole control periods, without jitter.

    :param task: its name, as the node has it
    :param control_hz: actions per second of simulated time [Hz]
    :param node: name of the node, with its namespace
    :param domain_id: of ROS; None for that of the environment
    :param arguments: further ones of :class:`TaskEnv`, such as ``robot``
    :raises ManipSimError: if something cannot be used, or the node is missing
    """

    metadata: dict[str, Any] = {'render_modes': [], 'render_fps': 20}

    def __init__(self, task: str, control_hz: float = 20.0, node: str = '/manip_sim',
                 domain_id: int | None = None, **arguments: Any) -> None:
        if 'render_mode' in arguments:
            raise ManipSimError('render_mode cannot be used with a node')
        # Gives observations and the length of episodes; it is not advanced.
        like = TaskEnv(task, control_hz=control_hz, **arguments)
        self._like = like.episode
        self.action_space = action_space(self._like)
        seen = self._like.observation
        self.observation_space = observation_space(seen)
        like.close()
        late, period_s = self._like.latency, self._like.period_s
        if late.state_jitter_s:
            raise ManipSimError('latency of states with jitter cannot be used with a node')
        state_periods = number_of_parts(late.state_s, period_s, 'latency of a state with a node',
                                        'control periods')
        self._images = {key: value.shape for key, value in seen.items() if key.startswith(IMAGE)}
        #: Late observations of all but the robots, whose states the node delays.
        self._scenes: deque[Observation] = deque(maxlen=state_periods + 1)
        self._context = rclpy.Context()
        start_rclpy(context=self._context, domain_id=domain_id)
        self._node = rclpy.create_node('task_env', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._name = node
        #: The newest message of each topic: its stamp [ns] and its numbers.
        self._seen: dict[str, tuple[int, NDArray[Any]]] = {}
        self._task: dict[str, Any] = {}
        self._stamp_ns = self._periods = -1
        try:
            self._connect(node.rpartition('/')[0])
        except BaseException:
            self.close()
            raise

    def _connect(self, namespace: str) -> None:
        robots = self._like.simulation.robots
        self._keys: dict[str, list[str]] = {key: [] for key in (
            'joint_states', 'eef_pose', 'eef_twist', 'external_wrench', 'object_pose')}
        #: Publishers, and what makes their message of an action.
        self._commands: list[tuple[Any, Callable[[FloatArray], Any]]] = []
        #: Parameters of the node that the actions need.
        self._settings: dict[str, Any] = {}
        for name, robot in robots.items():
            scope = f'{namespace}/{name}' if len(robots) > 1 else namespace
            self._subscribe('joint_states', f'{scope}/joint_states', JointState, _joints)
            for arm in robot.end_effectors:
                for key, kind in (('eef_pose', PoseStamped), ('eef_twist', TwistStamped),
                                  ('external_wrench', WrenchStamped)):
                    self._subscribe(key, f'{scope}/{arm}/{key}', kind, _numbers)
        self._offer_actions(namespace, len(robots) > 1)
        for name in self._like.simulation.entities.free_names:
            self._subscribe('object_pose', f'{namespace}/objects/{name}/pose', PoseStamped,
                            _numbers)
        for key, shape in self._images.items():
            self._keys[key] = []
            self._subscribe(key, f'{namespace}/{key[len(IMAGE):]}/color/image_raw', Image,
                            functools.partial(_pixels, shape))
        self._node.create_subscription(String, f'{self._name}/task', self._see_task, _LATCHED)
        self._reset = self._node.create_client(Trigger, f'{self._name}/reset')
        self._save = self._node.create_client(Trigger, f'{self._name}/save_state')
        self._pause = self._node.create_client(SetBool, f'{self._name}/pause')
        self._set = self._node.create_client(SetParameters, f'{self._name}/set_parameters')
        self._spin_until(lambda: bool(self._task) and all(
            client.service_is_ready() for client in (
                self._reset, self._save, self._set, self._pause))
            and all(publisher.get_subscription_count() for publisher, *_ in self._commands),
            f'there is no node {self._name} with a task')
        asked = (self._like.task.name, self._like.task.robot.type_name)
        served = (self._task['task'], self._task['robot'])
        if asked != served:
            self.close()
            raise ManipSimError(f'{self._name} does {served[0]} with {served[1]}, not {asked[0]} '
                                f'with {asked[1]}')

    def _offer_actions(self, namespace: str, several: bool) -> None:
        actions: Any = self._like.actions
        self._settings |= {f'{robot}.{name}' if several else name: value
                           for robot in self._like.simulation.robots
                           for name, value in {
                               **{f'latency.{key}': 0.0 for key in NO_LATENCY.as_mapping()},
                               **self._like.settings}.items()}
        for item in actions.arms:
            prefix = f'{item.robot.name}/' if several else ''
            topic = f'{namespace}/{prefix}{item.arm}'
            if self._like.kind == 'osc_pose':
                self._command(f'{topic}/pose_command', Float64MultiArray,
                              functools.partial(_array, item.goals, 1))
            else:
                self._command(f'{topic}/joint_command', JointState, functools.partial(
                    _joint_command, item.names, actions.mode, item.goals))
                scope = prefix.replace('/', '.')
                # Actions come in each period; in this process arms have no timeout.
                self._settings |= {f'{scope}control_mode.{item.arm}': actions.mode,
                                   f'{scope}command_timeout.{item.arm}': 0.0}
            dof = item.robot.grippers[f'{item.arm}/gripper'].dof
            if dof:
                self._command(f'{topic}/gripper/command', Float64MultiArray,
                              functools.partial(_array, item.gripper, dof))

    def _command(self, topic: str, kind: Any, make: Callable[[FloatArray], Any]) -> None:
        self._commands.append((self._node.create_publisher(kind, topic, 10), make))

    def _subscribe(self, key: str, topic: str, kind: Any, numbers: Callable[[Any], Any]) -> None:
        self._keys[key].append(topic)
        self._node.create_subscription(
            kind, topic, functools.partial(self._see, topic, numbers), 10)

    def _see(self, topic: str, numbers: Callable[[Any], Any], message: Any) -> None:
        stamp = message.header.stamp
        self._seen[topic] = stamp.sec * 10**9 + stamp.nanosec, np.array(numbers(message))

    def _see_task(self, message: String) -> None:
        self._task = json.loads(message.data)

    def _spin_until(self, done: Callable[[], bool], problem: str) -> None:
        end = time.monotonic() + _PATIENCE_S
        while not done():
            if time.monotonic() > end:
                self.close()
                raise ManipSimError(f'{problem}: nothing for {_PATIENCE_S:g} s')
            self._executor.spin_once(timeout_sec=0.1)

    def _call(self, client: Any, request: Any) -> Any:
        future = client.call_async(request)
        self._spin_until(future.done, f'no answer from {client.srv_name}')
        return future.result()

    def _observe(self, after_ns: int) -> Observation:
        """Wait for an instant after another one, of which all topics have come."""
        topics = [topic for topics in self._keys.values() for topic in topics]

        def is_whole() -> bool:
            stamps = {self._seen[topic][0] if topic in self._seen else -1 for topic in topics}
            return stamps == {self._task['stamp_ns']} and self._task['stamp_ns'] > after_ns
        self._spin_until(is_whole, f'{self._name} does not publish all that is observed; see its '
                         'lockstep_parts, cameras and their rates')
        self._stamp_ns = self._task['stamp_ns']
        values = {key: [self._seen[topic][1] for topic in topics]
                  for key, topics in self._keys.items() if topics}
        images = {key: values.pop(key)[0].copy() for key in [*values] if key.startswith(IMAGE)}
        joints = np.concatenate(values.pop('joint_states'), axis=1)
        states = dict(zip(('joint_position', 'joint_velocity', 'joint_effort'), joints.copy()))
        states |= {key: np.stack(rows) for key, rows in values.items()}
        scene = {'object_pose': states.pop('object_pose')} if 'object_pose' in states else {}
        if self._task['goal']:
            scene['goal'] = np.array(self._task['goal'])
        self._scenes.append(scene | images)
        return states | {key: value.copy() for key, value in self._scenes[0].items()}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None
              ) -> tuple[Observation, dict[str, Any]]:
        """
        Begin an episode, as :meth:`TaskEnv.reset`.

        :param seed: whose start it has; None draws one
        :param options: none are known
        :raises UnknownNameError: if there are options
        :raises ManipSimError: if the node rejects the seed, or does not answer
        """
        check_options(options)
        super().reset(seed=seed)
        start_seed = int(self.np_random.integers(SEEDS)) if seed is None else int(seed)
        for name, value in {'seed': start_seed, **self._settings}.items():
            answer = self._call(self._set, SetParameters.Request(
                parameters=[Parameter(name, value=value).to_parameter_msg()]))
            if not answer.results[0].successful:
                raise ManipSimError(f'{name} {value}: {answer.results[0].reason}')
        self._call(self._pause, SetBool.Request(data=False))
        self._scenes.clear()
        before = self._task['stamp_ns']
        self._call(self._reset, Trigger.Request())
        self._periods = 0
        observation = self._observe(before)
        success = self._task['success']
        return observation, {'seed': start_seed, 'success': success, 'is_success': success,
                             'digest': self.digest()}

    def step(self, action: ArrayLike
             ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """
        Take an action and advance by one control period, as :meth:`TaskEnv.step`.

        :param action: of :attr:`action_space`
        :raises gymnasium.error.ResetNeeded: if no episode has begun
        :raises CommandError: if the action cannot be used; then nothing is sent
        """
        if self._periods < 0:
            raise gymnasium.error.ResetNeeded('call reset() before step()')
        numbers = finite_command_numbers(action, self._like.actions.size, 'an action')
        for publisher, make in self._commands:
            publisher.publish(make(numbers))
        observation = self._observe(self._stamp_ns)
        self._periods += 1
        self._like.periods = self._periods
        terminated, truncated = self._task['success'], self._like.time_is_up
        info = {'success': terminated, 'is_success': terminated}
        if terminated or truncated:
            info['digest'] = self.digest()
        return observation, self._task['reward'], terminated, truncated, info

    def digest(self) -> str:
        """Return the digest of the node's present state; it is saved there in passing."""
        answer = self._call(self._save, Trigger.Request())
        if not answer.success:
            raise CommandError(answer.message)
        return str(answer.message)

    def close(self) -> None:
        """End the connection; nothing happens the second time."""
        if self._context.ok():
            self._executor.shutdown()
            self._node.destroy_node()
            self._context.shutdown()


def _array(part: slice, times: int, numbers: FloatArray) -> Float64MultiArray:
    return Float64MultiArray(data=np.repeat(numbers[part], times).tolist())


def _joint_command(names: list[str], mode: str, goals: slice, numbers: FloatArray) -> JointState:
    return JointState(name=names, **{mode: numbers[goals].tolist()})


def _pixels(shape: tuple[int, ...], message: Image) -> NDArray[np.uint8]:
    size = message.height, message.width, 3
    if size != shape:
        raise ManipSimError(f'{message.header.frame_id}: the node has images of {size[1]} x '
                            f'{size[0]} pixels, not {shape[1]} x {shape[0]}; see image_size')
    return np.frombuffer(message.data, np.uint8).reshape(shape)


def _joints(message: JointState) -> list[Any]:
    return [message.position, message.velocity, message.effort]


def _numbers(message: Any) -> list[float]:
    """Return the numbers of a pose, twist or wrench behind a header."""
    *_, name = message.get_fields_and_field_types()
    content = getattr(message, name)
    parts = [getattr(content, part) for part in content.get_fields_and_field_types()]
    return [getattr(part, axis) for part in parts for axis in part.get_fields_and_field_types()]


class NodeRobot:
    """
    A robot of a running node that runs in real time.

    A thread takes the node's messages from :meth:`connect` to :meth:`close`.

    :param node: name of the node, with its namespace
    :param robot: its name in a node with several robots; empty for the only one
    :param parts: that are observed and commanded: ``arm``, ``right/gripper`` ...
    :param cameras: whose images are observed, with their height and width [pixels]
    :param scales: makes the keys of the joints, without :data:`POSITION`, of their ranges
    :param domain_id: of ROS; None for that of the environment
    """

    def __init__(self, node: str = '/manip_sim', robot: str = '',
                 parts: Sequence[str] = ('arm', 'right/gripper'),
                 cameras: Mapping[str, tuple[int, int]] | None = None,
                 scales: Callable[[Mapping[str, tuple[float, float]]], dict[str, Scale]]
                 = plain_scales, domain_id: int | None = None) -> None:
        self._name, self._robot, self._parts = node, robot, tuple(parts)
        self._cameras, self._make_scales = dict(cameras or {}), scales
        self._domain_id = domain_id
        self._context: rclpy.Context | None = None
        #: The newest message of each topic, and when it came [s].
        self._seen: dict[str, tuple[float, Any]] = {}
        self._changed = threading.Condition()

    @property
    def is_connected(self) -> bool:
        """True from a successful :meth:`connect` to :meth:`close`."""
        return self._context is not None and self._context.ok()

    def connect(self) -> None:
        """
        Find the node, its joints and cameras.

        :raises ManipSimError: if something of it is missing, or it is connected
        """
        if self.is_connected:
            raise ManipSimError(f'{self._name} is connected already')
        self._seen.clear()
        namespace = self._name.rpartition('/')[0]
        scope = f'{namespace}/{self._robot}' if self._robot else namespace
        self._context = rclpy.Context()
        start_rclpy(context=self._context, domain_id=self._domain_id)
        self._node = rclpy.create_node('lerobot_robot', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._ending = False
        self._thread = threading.Thread(target=self._spin, name='lerobot_robot', daemon=True)
        self._thread.start()
        try:
            self._find(namespace, scope)
        except BaseException:
            self.close()
            raise

    def _find(self, namespace: str, scope: str) -> None:
        create = self._node.create_subscription
        topics: dict[str, tuple[Any, str, Any]] = {
            'urdf': (String, f'{scope}/robot_description', _LATCHED),
            'joints': (JointState, f'{scope}/joint_states', 10),
            **{part: (JointState, f'{scope}/{part}/joint_states', 10) for part in self._parts},
            **{f'image of {camera}': (Image, f'{namespace}/{camera}/color/image_raw', 2)
               for camera in self._cameras}}
        subscriptions = {key: create(kind, topic, lambda message, key=key: self._see(key, message),
                                     quality) for key, (kind, topic, quality) in topics.items()}
        self._command = self._node.create_publisher(JointState, f'{scope}/joint_command', 10)
        self._set = self._node.create_client(SetParameters, f'{self._name}/set_parameters')
        self._wait(lambda: all(key in self._seen for key in topics) and (
            self._command.get_subscription_count() > 0 and self._set.service_is_ready()),
            lambda: ('nothing on ' + quoted_names([
                topic for key, (_, topic, _) in topics.items() if key not in self._seen])
                if len(self._seen) < len(topics) else
                f'{self._name} does not take commands on {scope}/joint_command'))
        for camera, (height, width) in self._cameras.items():
            image = self._seen[f'image of {camera}'][1]
            if (image.height, image.width) != (height, width):
                raise ManipSimError(f'{camera}: the node has images of {image.width} x '
                                    f'{image.height} pixels, not {width} x {height}')
        ranges = _driven_ranges(self._seen['urdf'][1].data)
        self.scales = self._make_scales({
            joint: ranges[joint] for part in self._parts
            for joint in self._seen[part][1].name if joint in ranges})
        # In the thread that waits for them: rclpy fails if they go meanwhile.
        ended = self._executor.create_task(lambda: [
            self._node.destroy_subscription(subscriptions[key]) for key in ('urdf', *self._parts)])
        self._wait(ended.done, lambda: 'subscriptions were not ended')

    def set_position_mode(self) -> None:
        """
        Put the parts that are no grippers into position mode.

        :raises ManipSimError: if the node rejects that, or does not answer
        """
        scope = f'{self._robot}.' if self._robot else ''
        future = self._set.call_async(SetParameters.Request(parameters=[
            Parameter(f'{scope}control_mode.{part}', value='position').to_parameter_msg()
            for part in self._parts if '/' not in part]))
        self._wait(future.done, lambda: f'no answer from {self._set.srv_name}')
        for result in future.result().results:
            if not result.successful:
                raise ManipSimError(f'{self._name}: {result.reason}')

    def _spin(self) -> None:
        # The context may end meanwhile.
        with contextlib.suppress(ExternalShutdownException, RCLError):
            while self._executor.context.ok() and not self._ending:
                self._executor.spin_once(timeout_sec=0.1)

    def _see(self, key: str, message: Any) -> None:
        with self._changed:
            self._seen[key] = time.monotonic(), message
            self._changed.notify_all()

    def _wait(self, done: Callable[[], bool], problem: Callable[[], str]) -> None:
        end = time.monotonic() + _ROBOT_PATIENCE_S
        with self._changed:
            while not done():
                if time.monotonic() > end:
                    raise ManipSimError(f'{problem()} for {_ROBOT_PATIENCE_S:g} s')
                self._changed.wait(0.05)

    def _newest(self, key: str) -> Any:
        if not self.is_connected:
            raise ManipSimError(f'{self._name} is not connected: call connect()')
        came_s, message = self._seen[key]
        age_s = time.monotonic() - came_s
        if age_s > _OLDEST_S:
            raise ManipSimError(f'{self._name} has published no {key} for {age_s:.1f} s')
        return message

    def positions(self) -> dict[str, float]:
        """
        Return the present positions in LeRobot's numbers, by key.

        :raises ManipSimError: if the node is gone, or not connected
        """
        message = self._newest('joints')
        positions = dict(zip(message.name, message.position))
        return {key + POSITION: scale.number(positions[scale.joint])
                for key, scale in self.scales.items()}

    def images(self) -> dict[str, NDArray[np.uint8]]:
        """
        Return the newest images by camera, each of shape (height, width, 3), RGB, copies.

        :raises ManipSimError: if the node is gone, or not connected
        """
        return {camera: np.array(self._newest(f'image of {camera}').data, np.uint8).reshape(
            height, width, 3) for camera, (height, width) in self._cameras.items()}

    def command(self, numbers: Mapping[str, float]) -> None:
        """
        Lead joints to positions; the node clamps them to their ranges and limits.

        :param numbers: LeRobot's, by key, of any of the joints
        :raises ManipSimError: if the node is not connected
        :raises UnknownNameError: if a key is unknown
        :raises CommandError: if a number is not finite
        """
        if not self.is_connected:
            raise ManipSimError(f'{self._name} is not connected: call connect()')
        message = JointState()
        for key, number in numbers.items():
            name = key.removesuffix(POSITION)
            if name not in self.scales or not key.endswith(POSITION):
                raise UnknownNameError('key', key, [name + POSITION for name in self.scales])
            if not math.isfinite(number):
                raise CommandError(f'{key} is not finite: {number}')
            message.name.append(self.scales[name].joint)
            message.position.append(self.scales[name].position(float(number)))
        self._command.publish(message)

    def close(self) -> None:
        """End the connection; nothing happens the second time."""
        if self._context is not None and self._context.ok():
            # First the thread: what a callback triggers at its end goes with the executor.
            self._ending = True
            self._thread.join()
            self._executor.shutdown()
            self._context.shutdown()
            self._node.destroy_node()


def _driven_ranges(urdf: str) -> dict[str, tuple[float, float]]:
    """Return the ranges of the joints that follow no other one, infinite without limits."""
    ranges = {}
    for joint in ElementTree.fromstring(urdf).iter('joint'):
        if joint.get('type') != 'fixed' and joint.find('mimic') is None:
            limit = joint.find('limit')
            attributes = {} if limit is None or joint.get('type') == 'continuous' else limit.attrib
            ranges[str(joint.get('name'))] = (float(attributes.get('lower', -math.inf)),
                                              float(attributes.get('upper', math.inf)))
    return ranges
