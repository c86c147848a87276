# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A node that does a task step by step: it waits for conditions, and prints what it does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
import sys
import time
from typing import Any

import mujoco
import rclpy
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from std_msgs.msg import String

from manip_sim.rclpy_internals import describe_unheard
from manip_sim.ros.arguments import start_ros

_PATIENCE_S = 10.0
#: Time that a node may take to compile its control laws, on a busy machine [s].
_START_S = 600.0
_MODEL = 'manip_sim/mjcf'


class TaskFailed(Exception):
    """The task could not be done; the message says why."""


class TaskInterrupted(Exception):
    """Somebody has asked the task to end."""


class Demonstration(Node):
    """
    A node that does one task and ends.

    :param name: of the node
    :param start: a command that starts the simulation that the task needs, for error messages
    :ivar is_asked_to_end: is asked while the task waits
    :ivar latest: the newest message of each topic that is followed
    """

    def __init__(self, name: str, start: str) -> None:
        super().__init__(name)
        self._start = start
        self.is_asked_to_end: Callable[[], bool] = lambda: False
        self._mjcf: str | None = None
        self.latest: dict[str, Any] = {}
        latched = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(String, _MODEL, self._take_mjcf, latched)

    def _take_mjcf(self, message: String) -> None:
        self._mjcf = message.data

    def perform(self) -> None:
        """
        Do the task.

        :raises TaskFailed: if it could not be done
        """
        raise NotImplementedError

    def follow(self, message_type: Any, topic: str) -> None:
        """Keep the newest message of a topic, on which states with a stamp arrive."""
        self.create_subscription(message_type, topic, partial(self.latest.__setitem__, topic), 1)

    @property
    def now_s(self) -> float:
        """
        Simulation time up to which messages of all topics have come [s].

        On a busy machine the states of an instant may come on one topic long after those on
        another.
        """
        stamps = [message.header.stamp for message in self.latest.values()]
        return min((stamp.sec + stamp.nanosec * 1e-9 for stamp in stamps), default=0.0)

    def connect(self, ready: Callable[[], bool]) -> mujoco.MjModel:
        """
        Wait for the simulation.

        :param ready: returns whether all states that the task needs have come
        :returns: the simulation's model
        :raises TaskFailed: if they do not come; the message says how to start the simulation
        """
        start = f"start one with '{self._start}'"
        self._wait_for_model(f'no node answers: {start}')
        self.wait_until(ready, 'the node that answers has no arm with a gripper by the names that '
                        f'this example uses: {start}')
        return mujoco.MjModel.from_xml_string(self._mjcf)

    def _wait_for_model(self, problem: str) -> None:
        try:
            self.wait_until(lambda: self._mjcf is not None, problem)
        except TaskFailed:
            if not self.count_publishers(_MODEL) or describe_unheard(self):
                raise
            print('the node is starting: the first time it compiles control laws', flush=True)
            self.wait_until(
                lambda: self._mjcf is not None or not self.count_publishers(_MODEL),
                'the node is still starting: its log says what it waits for', _START_S)
            self.wait_until(lambda: self._mjcf is not None, problem)

    def wait_until(self, condition: Callable[[], bool], problem: str,
                   patience_s: float | None = None) -> None:
        """
        Wait for a condition.

        :param patience_s: wall time [s]; None: ten seconds
        :raises TaskFailed: with ``problem``, if it is not met by then
        :raises TaskInterrupted: if the task is asked to end
        """
        end = time.monotonic() + (_PATIENCE_S if patience_s is None else patience_s)
        while not condition():
            if self.is_asked_to_end():
                raise TaskInterrupted
            rclpy.spin_once(self, timeout_sec=0.1)
            if time.monotonic() > end:
                raise TaskFailed('; '.join(filter(None, (problem, describe_unheard(self)))))

    def next_state(self) -> None:
        """
        Wait until :attr:`now_s` is later.

        :raises TaskFailed: if it stands still for ten seconds of wall time
        """
        last = self.now_s
        self.wait_until(lambda: self.now_s > last,
                        'the simulation stands still: is it paused, or in lock-step?')

    def wait(self, duration_s: float) -> None:
        """Wait for a duration of simulation time [s]."""
        end = self.now_s + duration_s
        while self.now_s < end:
            self.next_state()

    def say(self, text: str) -> None:
        """Print a line with the simulation time."""
        print(f'{self.now_s:8.2f} s  {text}', flush=True)


def run(create: Callable[[], Demonstration], arguments: Sequence[str] | None,
        is_asked_to_end: Callable[[], bool]) -> int:
    """
    Run a task as a process.

    :param arguments: the command line, with ROS arguments; None: that of the process
    :param is_asked_to_end: is asked while the task waits
    :returns: the exit code: 1 if the task failed, 0 if it is done or was interrupted
    :raises ManipSimError: if a ROS argument is wrong
    """
    start_ros(arguments)
    task = create()
    task.is_asked_to_end = is_asked_to_end
    try:
        task.perform()
        return 0
    except TaskFailed as error:
        print(f'{task.get_name()}: {error}', file=sys.stderr)
        return 1
    except (KeyboardInterrupt, TaskInterrupted):
        return 0
    finally:
        task.destroy_node()
        rclpy.try_shutdown()
