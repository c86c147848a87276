# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Fixtures: a node in this process, or one in its own; each with a domain nobody else uses."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import os
import signal
import subprocess
import sys
import threading
import time
from typing import Any

import pytest

rclpy = pytest.importorskip('rclpy', reason='tests of the node need ROS 2')

from rcl_interfaces.msg import Log  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import QoSDurabilityPolicy, QoSProfile  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402

os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
DOMAIN = 1 + os.getpid() % 100
os.environ['ROS_DOMAIN_ID'] = str(DOMAIN)


class Client:
    """A node that subscribes, publishes and calls, and waits for conditions, never for time."""

    def __init__(self) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=DOMAIN)
        self.node = rclpy.create_node('client', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self._publishers: dict[str, Any] = {}

    def spin_until(self, condition: Callable[[], bool], timeout_s: float = 20.0) -> None:
        end = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < end, 'timed out'
            self.executor.spin_once(timeout_sec=0.05)

    def listen(self, message_type: Any, topic: str, qos: Any = 1000) -> list[Any]:
        """Return a list that is filled with the messages of a topic, the first one included."""
        messages: list[Any] = []
        self.node.create_subscription(message_type, topic, messages.append, qos)
        self.spin_until(lambda: self.node.count_publishers(topic) > 0)
        return messages

    def log(self) -> list[str]:
        """Return a list that is filled with the texts that the node logs."""
        texts: list[str] = []
        qos = QoSProfile(depth=1000, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(Log, '/rosout', lambda m: texts.append(m.msg), qos)
        return texts

    def publisher(self, message_type: Any, topic: str, depth: int = 1000) -> Any:
        if topic not in self._publishers:
            publisher = self.node.create_publisher(message_type, topic, depth)
            self._publishers[topic] = publisher
            self.spin_until(lambda: publisher.get_subscription_count() > 0)
        return self._publishers[topic]

    def publish(self, topic: str, message: Any) -> None:
        self.publisher(type(message), topic).publish(message)

    def call(self, service_type: Any, name: str, request: Any = None) -> Any:
        client = self.node.create_client(service_type, name)
        self.spin_until(client.service_is_ready)
        future = client.call_async(request or service_type.Request())
        self.spin_until(future.done)
        self.node.destroy_client(client)
        return future.result()

    def state(self, topic: str = 'joint_states') -> JointState:
        """Return the next joint states of a topic."""
        messages: list[Any] = []
        subscription = self.node.create_subscription(JointState, topic, messages.append, 1)
        self.spin_until(lambda: len(messages) > 1)
        self.node.destroy_subscription(subscription)
        return messages[-1]

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture
def client() -> Iterator[Client]:
    client = Client()
    yield client
    client.close()


class Served:
    """A node that runs in this process, with an executor thread of its own."""

    def __init__(self, parameters: dict[str, Any]) -> None:
        from manip_sim.ros.sim_node import SimNode
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=DOMAIN)
        self.node = SimNode(context=self.context, parameter_overrides=[
            Parameter(name, value=value) for name, value in parameters.items()])
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.thread = threading.Thread(target=self.executor.spin)
        self.thread.start()
        self.node.start()

    def close(self) -> None:
        self.node.stop()
        self.executor.shutdown()
        self.thread.join(timeout=10.0)
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)
        assert self.node.runner.error is None


@pytest.fixture
def serve() -> Iterator[Callable[..., Any]]:
    """Return a function that starts a node with parameters (dots as double underscores)."""
    running: list[Served] = []

    def start(**parameters: Any) -> Any:
        served = Served({name.replace('__', '.'): value for name, value in parameters.items()})
        running.append(served)
        return served.node

    yield start
    for served in running:
        served.close()


@pytest.fixture
def process() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Return a function that starts ``python3 -m MODULE ARGUMENTS`` and ends it after the test."""
    running: list[subprocess.Popen[str]] = []

    def start(*arguments: str, module: str = 'manip_sim') -> subprocess.Popen[str]:
        started = subprocess.Popen([sys.executable, '-m', module, *arguments], text=True,
                                   stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        running.append(started)
        return started

    yield start
    for started in running:
        if started.poll() is None:
            started.send_signal(signal.SIGKILL)
        started.communicate(timeout=10.0)


@pytest.fixture
def sim_process(process: Any) -> Callable[..., subprocess.Popen[str]]:
    """Return a function that starts the node as a process, with parameters NAME:=VALUE."""
    def start(*parameters: str) -> subprocess.Popen[str]:
        arguments = [word for parameter in parameters for word in ('-p', parameter)]
        return process('--ros-args', *arguments)
    return start
