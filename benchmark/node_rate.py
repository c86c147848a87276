# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
How well the node keeps its rate, seen from another process, as ratios to what is nominal.

usage: python3 benchmark/node_rate.py [seconds]
"""

from __future__ import annotations

import os
from pathlib import Path
import signal
import subprocess
import sys
import time

import numpy as np
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState

RUNS = [('realtime', 100), ('realtime', 500), ('free', 500), ('free', 50)]
CLOCK_TICK_S = 1.0 / os.sysconf('SC_CLK_TCK')


def cpu_s(process: subprocess.Popen[bytes]) -> float:
    """Return the CPU time that a process has used [s]."""
    fields = Path(f'/proc/{process.pid}/stat').read_text().split()
    return (int(fields[13]) + int(fields[14])) * CLOCK_TICK_S


def measure(node: Node, stepping: str, rate: int, duration_s: float) -> None:
    """Run the node once and print a row."""
    process = subprocess.Popen(
        [sys.executable, '-m', 'manip_sim', '--ros-args', '-p', f'stepping:={stepping}',
         '-p', f'publish_rate:={rate}'], stderr=subprocess.DEVNULL)
    wall: list[float] = []
    stamps: list[float] = []

    def take(message: JointState) -> None:
        wall.append(time.perf_counter())
        stamps.append(message.header.stamp.sec + message.header.stamp.nanosec * 1e-9)

    subscription = node.create_subscription(JointState, 'joint_states', take, 10)
    try:
        while len(wall) < 50:
            rclpy.spin_once(node, timeout_sec=1.0)
        first, used, begin = len(wall), cpu_s(process), time.perf_counter()
        while time.perf_counter() < begin + duration_s:
            rclpy.spin_once(node, timeout_sec=1.0)
        used = (cpu_s(process) - used) / (time.perf_counter() - begin)
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(timeout=10.0)
        node.destroy_subscription(subscription)
    factor = (stamps[-1] - stamps[first]) / (wall[-1] - wall[first])
    late = np.quantile(np.diff(wall[first:]), 0.99) * rate * (factor if stepping == 'free' else 1)
    print(f'{stepping:9s} {rate:4d} Hz: {factor:9.4f} x real time, '
          f'99 % of the periods below {late:.2f} x nominal, {100 * used:.0f} % of a core')


def main() -> None:
    """Print a row for each run."""
    duration_s = float(sys.argv[1]) if len(sys.argv) > 1 else 10.0
    rclpy.init()
    node = rclpy.create_node('node_rate')
    for stepping, rate in RUNS:
        measure(node, stepping, rate, duration_s)
    node.destroy_node()
    rclpy.shutdown()


if __name__ == '__main__':
    main()
