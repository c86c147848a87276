# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A robot of a running node as LeRobot's ``Robot`` needs it; nothing of LeRobot is imported."""

from __future__ import annotations

from manip_sim.ros_environment import check_shared_memory

check_shared_memory()  # Where it is full, the imports of ROS below end the process.
# ruff: noqa: E402
# flake8: noqa: E402

from collections.abc import Callable, Mapping, Sequence
import contextlib
import math
import threading
import time
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from rcl_interfaces.srv import SetParameters
import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import String

from manip_sim.errors import CommandError, ManipSimError, UnknownNameError
from manip_sim.lerobot_units import plain_scales, POSITION, Scale
from manip_sim.quoting import quoted_names
from manip_sim.rclpy_internals import RCLError, start_rclpy

_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
#: Longest wait for the node at the start, and greatest age of what is observed, wall time [s].
_PATIENCE_S, _OLDEST_S = 20.0, 2.0


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
        end = time.monotonic() + _PATIENCE_S
        with self._changed:
            while not done():
                if time.monotonic() > end:
                    raise ManipSimError(f'{problem()} for {_PATIENCE_S:g} s')
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
