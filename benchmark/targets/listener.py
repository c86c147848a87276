# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
A client of the node in a process of its own, as anyone would write it with rclpy.

usage: python3 listener.py (TOPIC ... | all | nobody)

It reads commands from standard input, and answers each with one line of JSON:

- ``ready``: wait until states come
- ``begin``: forget what has come
- ``report``: simulation time [ns] and wall time [s] between first and last state since then
- ``first``: when the first state came since then, wall time [s]
- ``walls``: when they all did

With ``nobody`` it subscribes only while it answers one of these.
"""

from __future__ import annotations

from collections.abc import Callable
import importlib
import json
import select
import sys
import time
from typing import Any

from geometry_msgs.msg import WrenchStamped
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.utilities import remove_ros_args
from sensor_msgs.msg import JointState

STATES = 'joint_states'
_ALWAYS_THERE = ('/rosout', '/parameter_events')


class Listener:
    """
    Subscribes to topics and notes when states come.

    :param topics: their names, or ``all`` or ``nobody``
    """

    def __init__(self, topics: list[str]) -> None:
        self.node = rclpy.create_node('listener')
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.asleep = topics == ['nobody']
        self.walls: list[float] = []
        self.stamps: list[int] = []
        if self.asleep:
            return
        for name, kind in self._all() if topics == ['all'] else self._named(topics):
            take = self._note if name.endswith(STATES) and name.count('/') < 2 else self._ignore
            self.node.create_subscription(kind, name, take, 10)

    @staticmethod
    def _named(topics: list[str]) -> list[tuple[str, Any]]:
        return [(name, WrenchStamped if name.endswith('wrench') else JointState)
                for name in topics]

    def _all(self) -> list[tuple[str, Any]]:
        while True:
            found = []
            for name, kinds in self.node.get_topic_names_and_types():
                # The topics of actions are hidden, by a leading underscore.
                if name not in _ALWAYS_THERE and '/_' not in name and any(
                        info.node_name == 'manip_sim'
                        for info in self.node.get_publishers_info_by_topic(name)):
                    found.append((name, _message_type(kinds[0])))
            if any(name == f'/{STATES}' for name, _ in found):
                return found
            self.executor.spin_once(timeout_sec=0.1)

    def _note(self, message: JointState) -> None:
        self.walls.append(time.monotonic())
        self.stamps.append(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)

    def _ignore(self, message: Any) -> None:
        pass

    def _until(self, count: int) -> None:
        subscription = None
        if self.asleep:
            subscription = self.node.create_subscription(JointState, STATES, self._note, 10)
        while len(self.walls) < count:
            self.executor.spin_once(timeout_sec=0.1)
        if subscription is not None:
            self.node.destroy_subscription(subscription)

    def ready(self) -> bool:
        """Wait until states come."""
        self._until(20)
        return True

    def begin(self) -> bool:
        """Forget what has come."""
        del self.walls[:], self.stamps[:]
        if self.asleep:
            self._until(1)
            del self.walls[1:], self.stamps[1:]
        return True

    def report(self) -> list[float]:
        """Return the simulation time [ns] and wall time [s] since :meth:`begin`."""
        if self.asleep:
            self._until(len(self.walls) + 1)
        self._until(2)
        if (count := self.node.count_publishers(STATES)) > 1:
            raise RuntimeError(f'{count} publishers of {STATES} in this domain')
        return [self.stamps[-1] - self.stamps[0], self.walls[-1] - self.walls[0]]

    def first(self) -> float:
        """Return when the first state came since :meth:`begin`, wall time [s]."""
        self._until(1)
        return self.walls[0]

    def serve(self) -> None:
        """Obey standard input until its end."""
        commands: dict[str, Callable[[], Any]] = {
            'ready': self.ready, 'begin': self.begin, 'report': self.report,
            'first': self.first, 'walls': lambda: self.walls}
        while True:
            if not self.asleep:
                self.executor.spin_once(timeout_sec=0.01)
            if select.select([sys.stdin], [], [], None if self.asleep else 0.0)[0]:
                line = sys.stdin.readline()
                if not line:
                    return
                print(json.dumps(commands[line.strip()]()), flush=True)


def _message_type(name: str) -> Any:
    package, _, kind = name.split('/')
    return getattr(importlib.import_module(f'{package}.msg'), kind)


def main() -> None:
    """Listen until the end of standard input."""
    rclpy.init()
    words = remove_ros_args(sys.argv)[1:]
    Listener(words).serve()


if __name__ == '__main__':
    try:
        main()
    except KeyboardInterrupt:
        sys.exit(0)
