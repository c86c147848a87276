# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
What the viewer costs: the real-time factor of a node with it, and the CPU time of both.

The node publishes 500 states per second in real time and has a camera of 640 x 480 pixels. Four
rounds: alone, with the viewer, with chromium on its page, and with the images of the camera shown
there. A browser draws with its graphics card, or on another machine; chromium without a screen
draws with the processor, so it gets the lowest priority here.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from typing import Any

import rclpy
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from targets.processes import cpu_s

CAMERA, RATE = 'birdview', 500
#: Of the browser.
_NICENESS = 19
PYTHON = [sys.executable, '-m']
ARGUMENTS = ['--no-sandbox', '--use-gl=angle', '--use-angle=swiftshader',
             '--enable-unsafe-swiftshader', '--ignore-gpu-blocklist']


class Rounds:
    """
    Measures rounds of one node.

    :param node: listens to the time
    :param process: the node that is measured
    """

    def __init__(self, node: Node, process: subprocess.Popen[Any]) -> None:
        self._node = node
        self._process = process
        self._seen: list[tuple[float, float]] = []
        node.create_subscription(Clock, '/clock', self._take, 1)

    def _take(self, message: Clock) -> None:
        self._seen.append((time.perf_counter(),
                           message.clock.sec + message.clock.nanosec * 1e-9))

    def spin(self, duration_s: float) -> None:
        """Take the time now and then for a while [s]."""
        end = time.perf_counter() + duration_s
        while time.perf_counter() < end:
            rclpy.spin_once(self._node, timeout_sec=0.1)
            time.sleep(0.02)

    def measure(self, what: str, duration_s: float, viewer: Any = None) -> None:
        """Print the figures of a round of this duration [s]."""
        processes = [self._process, *([viewer] if viewer else [])]
        del self._seen[:]
        begin, used = time.perf_counter(), [cpu_s(process.pid) for process in processes]
        self.spin(duration_s)
        wall_s = time.perf_counter() - begin
        cores = [100.0 * (cpu_s(process.pid) - before) / wall_s
                 for process, before in zip(processes, used)]
        (first_wall, first), (last_wall, last) = self._seen[0], self._seen[-1]
        print(f'{what:22s}: {(last - first) / (last_wall - first_wall):.4f} x real time, node '
              f'{cores[0]:.0f} % of a core'
              + (f', viewer {cores[1]:.0f} %' if viewer else ''), flush=True)


@contextlib.contextmanager
def chromium(address: str) -> Any:
    """Open the page in a browser without a screen."""
    from playwright.sync_api import sync_playwright
    with sync_playwright() as library:
        browser = library.chromium.launch(executable_path=shutil.which('chromium'),
                                          args=ARGUMENTS)
        page = browser.new_page(viewport={'width': 480, 'height': 360})
        page.goto(address)
        page.get_by_text('arm [rad]').wait_for(timeout=60_000)
        yield page
        browser.close()


def main() -> None:
    """Print the rounds."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('duration_s', nargs='?', type=float, default=20.0, metavar='SECONDS',
                        help='of a round, %(default)s by default')
    duration_s = parser.parse_args().duration_s
    rclpy.init()
    node: subprocess.Popen[Any] = subprocess.Popen(
        [*PYTHON, 'manip_sim', '--ros-args', '-p', 'arena:=table', '-p', f'publish_rate:={RATE}',
         '-p', f'cameras:=[{CAMERA}]'], stderr=subprocess.DEVNULL)
    viewer: subprocess.Popen[Any] | None = None
    rounds = Rounds(rclpy.create_node('viewer_benchmark'), node)
    try:
        rounds.spin(8.0)
        rounds.measure('node alone', duration_s)
        viewer = subprocess.Popen([*PYTHON, 'manip_sim.viewer', '--port', '0'], text=True,
                                  stdout=subprocess.PIPE)
        assert viewer.stdout is not None
        address = viewer.stdout.readline().split()[1]
        rounds.spin(5.0)
        rounds.measure('viewer, nobody looks', duration_s, viewer)
        os.nice(_NICENESS)
        with chromium(address) as page:
            rounds.spin(10.0)
            rounds.measure('one browser', duration_s, viewer)
            page.get_by_role('tab', name='Cameras').press('Enter')
            page.get_by_label('Show', exact=True).last.press('Space')
            rounds.spin(5.0)
            rounds.measure('and the camera', duration_s, viewer)
    finally:
        for process in [node] if viewer is None else [viewer, node]:
            process.send_signal(signal.SIGINT)
            process.wait(timeout=20.0)


if __name__ == '__main__':
    main()
