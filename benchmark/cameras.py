# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
What a camera costs the node, as ratios to the same node without one that listens.

The node publishes 500 states per second in real time. A process of its own listens to colour and
depth of one camera with 640 x 480 pixels at 15 Hz, in every second round.
"""

from __future__ import annotations

import argparse
import contextlib
import signal
import statistics
import subprocess
import sys
import time

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import Image, JointState
from targets.processes import cpu_s

CAMERA, RATE, IMAGES = 'robot0_eye_in_hand', 500, 15
LISTEN = 'listen'


def listen() -> None:
    """Take the images until the process is ended."""
    rclpy.init()
    node = rclpy.create_node('listener')
    for topic in ('color', 'depth'):
        node.create_subscription(Image, f'{CAMERA}/{topic}/image_raw', lambda _: None, 2)
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


class Rounds:
    """
    Measures rounds of one node.

    :param node: listens to the states
    :param process: the node that is measured
    """

    def __init__(self, node: Node, process: subprocess.Popen[bytes]) -> None:
        self._node = node
        self._process = process
        self._wall: list[float] = []
        self._stamps: list[float] = []
        self._of_cameras: dict[str, str] = {}
        node.create_subscription(JointState, 'joint_states', self._take, 100)
        node.create_subscription(DiagnosticArray, '/diagnostics', self._diagnose, 10)

    def _take(self, message: JointState) -> None:
        self._wall.append(time.perf_counter())
        self._stamps.append(message.header.stamp.sec + message.header.stamp.nanosec * 1e-9)

    def _diagnose(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name.endswith(': cameras'):
                self._of_cameras = {pair.key: pair.value for pair in status.values}

    def spin(self, duration_s: float) -> None:
        """Take messages for a while [s]."""
        end = time.perf_counter() + duration_s
        while time.perf_counter() < end:
            rclpy.spin_once(self._node, timeout_sec=0.1)

    def measure(self, duration_s: float) -> dict[str, float]:
        """Return the figures of a round of this duration [s]."""
        first, used, begin = len(self._wall), cpu_s(self._process.pid), time.perf_counter()
        self.spin(duration_s)
        used = (cpu_s(self._process.pid) - used) / (time.perf_counter() - begin)
        wall, stamps = self._wall[first:], self._stamps[first:]
        took = self._of_cameras.get(f'{CAMERA}.milliseconds', '-')
        return {'factor': (stamps[-1] - stamps[0]) / (wall[-1] - wall[0]),
                'late': float(np.quantile(np.diff(wall), 0.99)) * RATE, 'core': used,
                'images': float(self._of_cameras.get(f'{CAMERA}.rate', 'nan')),
                'ms': float('nan') if took == '-' else float(took)}


def report(what: str, rounds: list[dict[str, float]]) -> dict[str, float]:
    """Print and return the medians over some rounds."""
    found = {key: statistics.median(values[key] for values in rounds) for key in rounds[0]}
    print(f'{what}: {found["factor"]:.4f} x real time, 99 % of the periods below '
          f'{found["late"]:.2f} x nominal, {100 * found["core"]:.0f} % of a core', flush=True)
    return found


def main() -> None:
    """Print the figures without and with a listener, and their ratios."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('duration_s', nargs='?', type=float, default=10.0, metavar='SECONDS',
                        help='of a round, %(default)s by default')
    parser.add_argument('rounds', nargs='?', type=int, default=5, metavar='ROUNDS',
                        help='%(default)s by default')
    options = parser.parse_args()
    duration_s, count = options.duration_s, options.rounds
    rclpy.init()
    process = subprocess.Popen(
        [sys.executable, '-m', 'manip_sim', '--ros-args', '-p', 'arena:=table', '-p',
         f'publish_rate:={RATE}', '-p', f'cameras:=[{CAMERA}]', '-p',
         f'camera.{CAMERA}.rate:={IMAGES}'], stderr=subprocess.DEVNULL)
    rounds = Rounds(rclpy.create_node('cameras'), process)
    without, with_camera = [], []
    try:
        rounds.spin(8.0)
        for _ in range(count):
            without.append(rounds.measure(duration_s))
            listener = subprocess.Popen([sys.executable, __file__, LISTEN])
            rounds.spin(3.0)
            with_camera.append(rounds.measure(duration_s))
            # One that is killed would seem to listen for a while.
            listener.send_signal(signal.SIGINT)
            listener.wait(timeout=20.0)
            rounds.spin(3.0)
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(timeout=20.0)
    alone, seen = report('without', without), report('with   ', with_camera)
    print(f'ratios : {seen["factor"] / alone["factor"]:.4f} of the real-time factor, '
          f'{seen["late"] / alone["late"]:.2f} of the 99 % quantile; {seen["images"]:.1f} images '
          f'per second of {IMAGES}, {seen["ms"]:.1f} ms each')


if __name__ == '__main__':
    listen() if sys.argv[1:] == [LISTEN] else main()
