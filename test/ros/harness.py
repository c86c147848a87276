# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A client that waits for conditions, and a node that runs in this process."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import os
import signal
import threading
import time
from typing import Any

from manip_sim.ros_environment import set_discovery_profile
from manip_sim.testing.domains import reserve_domain
from rcl_interfaces.msg import Log
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState


#: Nobody else's domain; for this process and those that it starts.
DOMAIN, _reserved = reserve_domain()
os.environ['ROS_DOMAIN_ID'] = str(DOMAIN)
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
set_discovery_profile()  # Else nodes that start find clients up to 3 s later.


#: How long to wait for what has to come, on a machine with twenty other processes too [s].
START_S = 300.0


#: What ends a process; pytest that nohup started ignores SIGHUP, and all that it starts.
END_SIGNALS = [number for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
               if signal.getsignal(number) != signal.SIG_IGN]


class Client:
    """A node that subscribes, publishes and calls, and waits for conditions, never for time."""

    def __init__(self) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=DOMAIN)
        self.node = rclpy.create_node('client', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self._publishers: dict[str, Any] = {}

    def spin_until(self, condition: Callable[[], bool], timeout_s: float = START_S) -> None:
        end = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < end, 'timed out'
            self.executor.spin_once(timeout_sec=0.05)

    def settled(self, value: Callable[[], Any], rounds: int = 30) -> Any:
        """Return a value that has not changed while the node published many states."""
        states = self.listen(JointState, 'joint_states')
        while True:
            before, count = value(), len(states)
            self.spin_until(lambda n=count: len(states) > n + rounds)  # type: ignore[misc]
            if value() == before:
                return before

    def listen(self, message_type: Any, topic: str, qos: Any = 1000) -> list[Any]:
        """Return a list that is filled with the messages of a topic, the first one included."""
        messages: list[Any] = []
        self.node.create_subscription(message_type, topic, messages.append, qos)
        self.spin_until(lambda: self.node.count_publishers(topic) > 0)
        return messages

    def log(self, level: int = 0) -> list[str]:
        """Return a list that is filled with the texts that the node logs, from a level on."""
        texts: list[str] = []
        qos = QoSProfile(depth=1000, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(
            Log, '/rosout', lambda m: texts.append(m.msg) if m.level >= level else None, qos)
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


class Served:
    """A node that runs in this process, with an executor thread of its own."""

    def __init__(self, parameters: dict[str, Any], arguments: Sequence[str] = ()) -> None:
        from manip_sim.ros.executor import GuardedExecutor
        from manip_sim.ros.sim_node import SimNode
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=DOMAIN, args=list(arguments))
        self.node = SimNode(context=self.context, parameter_overrides=[
            Parameter(name, value=value) for name, value in parameters.items()])
        self.executor = GuardedExecutor(self.node.rejections, context=self.context)
        self.executor.add_node(self.node)
        self.thread = threading.Thread(target=self.executor.spin)
        self.thread.start()
        self.node.start()

    def close(self) -> None:
        self.executor.end()
        self.thread.join(timeout=300.0)
        # A node that is still spun cannot be destroyed, and would be seen by the next test.
        assert not self.thread.is_alive()
        self.executor.shutdown()
        self.node.stop()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)
        assert self.node.thread.error is None
