# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Draw the animation of the README: the example pick_cube in the viewer, seen by a browser.

It needs the extras viewer and test, and chromium. The simulation runs slowly and is stopped while
the browser draws, so that a machine without a graphics card keeps up; the animation plays it at
twice real time.

usage: python3 docs/animate_viewer.py [FILE]
"""

from __future__ import annotations

import io
from pathlib import Path
import shutil
import signal
import subprocess
import sys
from typing import Any

from PIL import Image
from playwright.sync_api import sync_playwright
import rclpy
from rosgraph_msgs.msg import Clock

ARGUMENTS = ['--no-sandbox', '--use-gl=angle', '--use-angle=swiftshader',
             '--enable-unsafe-swiftshader', '--ignore-gpu-blocklist']
SIZE = {'width': 960, 'height': 540}
#: Real-time factor, simulation time between two frames [s], and speed that they are shown at.
FACTOR, STEP_S, SPEED = 0.25, 0.18, 2.0
#: How long the page takes to show the newest state [ms].
SETTLE_MS = 300
#: Hidden: the page's line of state, which shows the slow speed, and the notice of slow graphics.
STYLE = 'div[style*=overflow-wrap]:has(> span) { visibility: hidden }'
CLOSE = "document.querySelector('.mantine-Notification-closeButton')?.click()"


def record(page: Any, node_process: subprocess.Popen[bytes], picker: subprocess.Popen[str]
           ) -> tuple[list[Image.Image], list[float]]:
    """Return frames until the example has ended, and their simulation times [s]."""
    rclpy.init()
    node = rclpy.create_node('animate_viewer')
    now = [0.0]
    node.create_subscription(Clock, '/clock', lambda message: now.__setitem__(
        0, message.clock.sec + message.clock.nanosec * 1e-9), 1)
    frames: list[Image.Image] = []
    times_s: list[float] = []
    while picker.poll() is None:
        rclpy.spin_once(node, timeout_sec=0.1)
        if now[0] >= (times_s[-1] + STEP_S if times_s else 1e-9):
            node_process.send_signal(signal.SIGSTOP)
            page.wait_for_timeout(SETTLE_MS)
            frames.append(Image.open(io.BytesIO(page.screenshot(timeout=60_000))).convert('RGB'))
            node_process.send_signal(signal.SIGCONT)
            times_s.append(now[0])
    node.destroy_node()
    rclpy.shutdown()
    return frames, times_s


def main() -> None:
    """Write the animation."""
    default = Path(__file__).resolve().parent / 'viewer.webp'
    file = Path(sys.argv[1]) if len(sys.argv) > 1 else default
    run = [sys.executable, '-m']
    node = subprocess.Popen([*run, 'manip_sim', '--ros-args', '-p', 'arena:=table', '-p',
                             f'real_time_factor:={FACTOR}'], stderr=subprocess.DEVNULL)
    viewer = subprocess.Popen([*run, 'manip_sim.viewer', '--port', '0'], text=True,
                              stdout=subprocess.PIPE)
    try:
        assert viewer.stdout is not None
        address = viewer.stdout.readline().split()[1]
        with sync_playwright() as library:
            browser = library.chromium.launch(executable_path=shutil.which('chromium'),
                                              args=ARGUMENTS)
            page = browser.new_page(viewport=SIZE)
            page.goto(address)
            page.get_by_text('arm [rad]').wait_for(timeout=60_000)
            page.wait_for_timeout(8000)
            page.evaluate(CLOSE)
            page.add_style_tag(content=STYLE)
            page.wait_for_timeout(4000)
            picker = subprocess.Popen([*run, 'manip_sim.examples', 'pick_cube'], text=True,
                                      stdout=subprocess.PIPE)
            assert picker.stdout is not None
            print(picker.stdout.readline(), end='')  # It has found the node.
            frames, times_s = record(page, node, picker)
            browser.close()
    finally:
        for process in (viewer, node):
            process.send_signal(signal.SIGINT)
            process.wait(timeout=20.0)
    frames[0].save(file, save_all=True, append_images=frames[1:], loop=0, quality=70, method=6,
                   duration=[round(1000.0 * (b - a) / SPEED)
                             for a, b in zip(times_s, [*times_s[1:], times_s[-1] + 1.0])])
    print(f'{file}: {len(frames)} frames, {file.stat().st_size / 1e6:.2f} MB')


if __name__ == '__main__':
    main()
