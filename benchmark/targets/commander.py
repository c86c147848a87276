# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
A controller in a process of its own, as anyone would write it with rclpy.

usage: python3 commander.py (effect JOINT | rounds)

It reads commands from standard input, and answers each with one line of JSON:

- ``effect COUNT``: command efforts at random moments; the answer is how long each took to show
  in a state [s]
- ``rounds SECONDS``: answer each new state by a command with its stamp; how many of them per
  second
"""

from __future__ import annotations

import json
import random
import sys
import time
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import JointState

#: Large enough to be distinguished from what else acts on the joint [N m].
_EFFORT = 0.2
#: Damping and stiffness that keep the joint from drifting away [N m s/rad], [N m/rad].
_DAMPING, _STIFFNESS = 0.05, 0.2


class Commander:
    """
    Listens to states and sends commands.

    :param states: the topic of the states
    """

    def __init__(self, states: str) -> None:
        self.node = rclpy.create_node('commander')
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.publisher = self.node.create_publisher(JointState, 'arm/joint_command', 10)
        self.state: Any = None
        self.answers = False
        self.last, self.count = -1, 0
        self.node.create_subscription(JointState, states, self._take, 10)
        while self.state is None or not self.publisher.get_subscription_count():
            self.executor.spin_once(timeout_sec=0.1)

    def _take(self, state: JointState) -> None:
        self.state = state
        if not self.answers:
            return
        stamp = state.header.stamp.sec * 10**9 + state.header.stamp.nanosec
        if stamp == self.last:
            return
        self.last = stamp
        self.count += 1
        effort = [-v for v in state.velocity]
        command = JointState(name=state.name, effort=effort)
        command.header.stamp = state.header.stamp
        self.publisher.publish(command)

    def rounds(self, duration_s: float) -> float:
        """Return how many states per second were answered."""
        self.answers, self.count, self.last = True, 0, -1
        begin = time.monotonic()
        while (now := time.monotonic()) - begin < duration_s:
            self.executor.spin_once(timeout_sec=0.1)
        self.answers = False
        return self.count / (now - begin)

    def effect(self, joint: str, count: int) -> list[float]:
        """Return how long each effort took from here to the state that shows it [s]."""
        message = JointState(name=[joint])
        old, delays = 0.0, []
        for number in range(count):
            due = time.monotonic() + random.uniform(0.005, 0.015)
            while time.monotonic() < due:
                self.executor.spin_once(timeout_sec=max(0.0, due - time.monotonic()))
            index = self.state.name.index(joint)
            new = (-1) ** number * _EFFORT - (_DAMPING * self.state.velocity[index]
                                              + _STIFFNESS * self.state.position[index])
            message.effort = [new]
            begin = time.monotonic()
            self.publisher.publish(message)
            while abs(self.state.effort[index] - new) > abs(self.state.effort[index] - old):
                if time.monotonic() > begin + 5.0:
                    raise RuntimeError(f'no effect of {new} N m after 5 s: {self.state.effort}')
                self.executor.spin_once(timeout_sec=0.1)
            delays.append(time.monotonic() - begin)
            old = new
        return delays


def main() -> None:
    """Command until the end of standard input."""
    rclpy.init()
    commander = Commander('joint_states' if sys.argv[1] == 'effect' else 'arm/joint_states')
    print(json.dumps(True), flush=True)
    for line in sys.stdin:
        what, _, number = line.partition(' ')
        answer: Any
        if what == 'effect':
            answer = commander.effect(sys.argv[2], int(number))
        else:
            answer = commander.rounds(float(number))
        print(json.dumps(answer), flush=True)


if __name__ == '__main__':
    try:
        main()
    except KeyboardInterrupt:
        sys.exit(0)
