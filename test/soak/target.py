# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The node under load: a process whose memory, threads and descriptors are watched."""

from __future__ import annotations

import math
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import time

from harness import Client
import numpy as np
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from typing_extensions import Self
from usage import Usage


#: A row of the table, by column.
Row = dict[str, str]
#: Growth of memory that is no leak [MB].
MAX_GROWTH_MB = 40.0


class SoakError(Exception):
    """The node did not withstand."""


class Watched:
    """
    A process under load, with a client beside it.

    :param words: of its command line, after ``python3 -m``
    """

    def __init__(self, *words: str) -> None:
        # A pipe that nobody reads would block the process.
        self._output = tempfile.TemporaryFile('w+', errors='replace')  # noqa: SIM115
        self.process = subprocess.Popen([sys.executable, '-m', *words],
                                        stdout=self._output, stderr=subprocess.STDOUT)
        self.client = Client()

    def wait_until_ready(self) -> None:
        """Wait until there is something to put under load."""

    def __enter__(self) -> Self:
        self.wait_until_ready()
        self.settle()
        self.before = Usage.of(self.process.pid)
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self._output.close()
        self.client.close()

    def mark(self) -> Usage:
        """Let growth count from now on, when all caches are filled."""
        self.before = Usage.of(self.process.pid)
        return self.before

    def growth(self) -> str:
        """Return what the process holds more than at the start."""
        return Usage.of(self.process.pid).since(self.before)

    def settle(self) -> None:
        """Wait until the process has loaded what it loads while it runs, such as laws."""
        last, end = -1.0, time.monotonic() + 20.0
        while time.monotonic() < end:
            present = Usage.of(self.process.pid).memory_mb
            if abs(present - last) < 0.5:
                return
            last = present
            time.sleep(0.7)

    def checked_growth(self, most_mb: float = MAX_GROWTH_MB) -> str:
        """
        Return what the process holds more than at the start.

        :param most_mb: how much memory it may be [MB]
        :raises SoakError: if it is more
        """
        growth = self.growth()
        if Usage.of(self.process.pid).memory_mb - self.before.memory_mb > most_mb:
            raise SoakError(f'growth is {growth}, and at most {most_mb:g} MB are no leak')
        return growth

    def check_alive(self) -> None:
        """Check that the node lives."""
        if self.process.poll() is not None:
            raise SoakError(f'the node ended with {self.process.returncode}: {self.output()}')

    def output(self, most: int = 2000) -> str:
        """Return the end of what the process wrote, so many characters at most."""
        self._output.seek(0)
        return self._output.read()[-most:]

    def stop(self, number: int = signal.SIGINT) -> float:
        """
        End the node by a signal; it must end cleanly.

        :returns: how long it took [s]
        """
        begin = time.monotonic()
        self.process.send_signal(number)
        while self.process.poll() is None:
            if time.monotonic() - begin > 10.0:
                raise SoakError('the node did not end within 10 s')
            self.client.executor.spin_once(timeout_sec=0.001)
        output = self.output()
        if self.process.returncode != 0 or 'Traceback' in output:
            raise SoakError(f'the node ended with {self.process.returncode}: {output}')
        return time.monotonic() - begin


class Target(Watched):
    """
    The node as a process.

    :param parameters: as ``NAME:=VALUE``
    """

    def __init__(self, *parameters: str) -> None:
        super().__init__('manip_sim', '--ros-args', *(
            word for parameter in parameters for word in ('-p', parameter)))
        self._tare = self.client.node.create_client(Trigger, 'manip_sim/tare_wrench')
        self._clock: list[tuple[float, float]] = []

    def wait_until_ready(self) -> None:
        """Wait for the first states."""
        self.client.state()

    def watch_clock(self) -> None:
        """Take wall time and simulation time from now on."""
        self.client.node.create_subscription(Clock, '/clock', lambda m: self._clock.append(
            (time.monotonic(), m.clock.sec + m.clock.nanosec * 1e-9)), 10)

    def real_time_factor(self) -> float:
        """Return simulation time per wall time since the last call."""
        # The queue holds old messages after a time without spinning.
        for _ in range(3):
            seen = len(self._clock)
            self.client.spin_until(lambda n=seen: len(self._clock) > n + 10)
        (begin, first), (end, last) = self._clock[0], self._clock[-1]
        del self._clock[:-1]
        return (last - first) / (end - begin)

    def latency_ms(self) -> float:
        """Return how long a service takes to answer."""
        self.client.spin_until(self._tare.service_is_ready)
        begin = time.monotonic()
        answer = self._tare.call_async(Trigger.Request())
        self.client.spin_until(answer.done)
        if not answer.result().success:
            raise SoakError(f'tare_wrench was rejected: {answer.result().message}')
        return (time.monotonic() - begin) * 1e3

    def check(self) -> None:
        """Check that the node lives, that its state is finite, and that it obeys."""
        self.check_alive()
        self.client.call(Trigger, 'manip_sim/reset')
        for goal in (0.2, -0.2):
            end = time.monotonic() + 20.0
            joint, position = 'robot0_joint1', math.inf
            while abs(position - goal) > 0.02:
                if time.monotonic() > end:
                    raise SoakError(f'{joint} is at {position} instead of {goal}')
                # Commands that were sent before may still be waiting.
                self.client.publish('arm/joint_command', JointState(
                    name=[joint], position=[goal]))
                state = self.client.state('arm/joint_states')
                position = state.position[state.name.index(joint)]
        state = self.client.state()
        if not np.isfinite([*state.position, *state.velocity, *state.effort]).all():
            raise SoakError(f'the state is not finite: {state}')


def wait_for_handlers(process: subprocess.Popen[str]) -> None:
    """Wait until a process catches SIGTERM; before that the interpreter is still starting."""
    term = 1 << (signal.SIGTERM - 1)
    status = Path(f'/proc/{process.pid}/status')
    while process.poll() is None:
        caught = next(line for line in status.read_text().splitlines()
                      if line.startswith('SigCgt'))
        if int(caught.split()[1], 16) & term:
            return
        time.sleep(0.001)
