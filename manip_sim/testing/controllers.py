# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The controllers under test: nodes in threads, and processes, until the test ends."""

from __future__ import annotations

from collections.abc import Sequence
import contextlib
import os
import signal
import subprocess
import threading
from typing import Any

from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

from manip_sim.errors import ManipSimError


class Controllers:
    """
    The controllers of a simulation under test.

    :param domain: the ROS domain of processes
    """

    def __init__(self, domain: int) -> None:
        self._domain = domain
        self._spinning: list[tuple[SingleThreadedExecutor, threading.Thread]] = []
        self._processes: list[subprocess.Popen[Any]] = []

    def spin(self, node: Node) -> None:
        """
        Run the callbacks of a node in a thread of its own.

        :param node: of any context
        """
        executor = SingleThreadedExecutor(context=node.context)
        executor.add_node(node)
        thread = threading.Thread(target=_spin, args=(executor,), name=node.get_name())
        thread.start()
        self._spinning.append((executor, thread))

    def start(self, command: Sequence[str], **arguments: Any) -> subprocess.Popen[Any]:
        """
        Start a process in the domain.

        :param command: such as ``['ros2', 'run', 'my_package', 'my_controller']``
        :param arguments: further arguments of ``subprocess.Popen``
        """
        # Another simulation of the same test may have changed this process's environment.
        environment = {**(arguments.pop('env', None) or os.environ),
                       'ROS_DOMAIN_ID': str(self._domain)}
        process = subprocess.Popen(command, start_new_session=True, env=environment, **arguments)
        self._processes.append(process)
        return process

    def check(self) -> None:
        """
        Check that all processes are running.

        :raises ManipSimError: if one has ended
        """
        for process in self._processes:
            if process.poll() is not None:
                raise ManipSimError(f'{process.args!r} has ended with exit code '
                                    f'{process.returncode}')

    def close(self) -> None:
        """End processes, also those that they have started, and threads."""
        for process in self._processes:
            # Those that it has started are left where it has ended.
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        for executor, thread in self._spinning:
            executor.shutdown()
            thread.join()


def _spin(executor: SingleThreadedExecutor) -> None:
    with contextlib.suppress(ExternalShutdownException):
        executor.spin()
