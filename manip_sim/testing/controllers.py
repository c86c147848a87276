# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The controllers under test: nodes in threads, and processes, until the test ends."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
import traceback
from typing import Any

from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

from manip_sim.errors import ManipSimError

#: Longest wait for the callback of a controller to return at the end [s].
_END_S = 3.0
#: Lines of a process's standard error in an error message.
_LINES = 5
#: Kills its argument, a process or with a minus a group, when its standard input ends.
_GUARD = ['sh', '-c', 'read _; kill -s KILL -- "$0"']


class ControllerProcess(subprocess.Popen[Any]):
    """
    A controller as a process.

    :ivar ends: whether the test has sent it a signal, so that its end is no failure
    """

    ends = False

    def send_signal(self, sig: int) -> None:
        """Send a signal, as ``terminate`` and ``kill`` do too."""
        self.ends = True
        super().send_signal(sig)


class Controllers:
    """
    The controllers of a simulation under test.

    :param domain: the ROS domain of processes
    :ivar started_s: when the last process was started [s], of ``time.monotonic``
    """

    def __init__(self, domain: int) -> None:
        self._domain = domain
        self._spinning: list[tuple[SingleThreadedExecutor, threading.Thread]] = []
        self._processes: list[tuple[ControllerProcess, subprocess.Popen[Any], _Tee | None]] = []
        self._errors: list[BaseException] = []
        self._of_threads: list[threading.ExceptHookArgs] = []
        self._hook_before, threading.excepthook = threading.excepthook, self._of_threads.append
        self.started_s = -float('inf')

    def spin(self, node: Node) -> None:
        """
        Run the callbacks of a node in a thread of its own.

        :param node: of any context
        """
        executor = SingleThreadedExecutor(context=node.context)
        executor.add_node(node)
        # A callback that does not return must not keep this process.
        thread = threading.Thread(target=self._spin, args=(executor,), name=node.get_name(),
                                  daemon=True)
        thread.start()
        self._spinning.append((executor, thread))

    def _spin(self, executor: SingleThreadedExecutor) -> None:
        try:
            executor.spin()
        except ExternalShutdownException:
            pass
        except (Exception, SystemExit) as error:
            # Callbacks fail where a test shuts their context down before this ends them.
            if executor.context.ok():
                self._errors.append(error)

    def start(self, command: Sequence[str], **arguments: Any) -> ControllerProcess:
        """
        Start a process in the domain.

        :param command: such as ``['ros2', 'run', 'my_package', 'my_controller']``
        :param arguments: further arguments of ``subprocess.Popen``
        """
        # Another simulation of the same test may have changed this process's environment.
        environment = {**(arguments.pop('env', None) or os.environ),
                       'ROS_DOMAIN_ID': str(self._domain)}
        tee = None if 'stderr' in arguments else _Tee()
        try:
            process = ControllerProcess(command, **{
                'stderr': tee.end if tee else None, **arguments, 'start_new_session': True,
                'env': environment})
        finally:
            if tee:
                os.close(tee.end)
        self._processes.append((process, guard(f'-{process.pid}'), tee))
        self.started_s = time.monotonic()
        return process

    def check(self) -> None:
        """
        Check that no controller has failed; what has been raised once is not raised again.

        :raises Exception: that of a callback, or of any thread
        :raises ManipSimError: if a process has ended with an error that the test does not know
        """
        if self._errors:
            raise self._errors.pop(0)
        for thread in list(self._of_threads):
            error = thread.exc_value
            if isinstance(error, Exception) and not isinstance(error, ExternalShutdownException):
                self._of_threads.remove(thread)
                raise error
        for process, _, tee in self._processes:
            if process.returncode is None and process.poll() and not process.ends:
                raise ManipSimError(_end_of(process, tee))

    def check_running(self) -> None:
        """
        Check that there is a controller left, if there were some.

        :raises ManipSimError: if all processes have ended, and no node spins
        """
        if self._processes and not any(thread.is_alive() for _, thread in self._spinning) and all(
                process.poll() is not None for process, *_ in self._processes):
            process, _, tee = self._processes[-1]
            raise ManipSimError(_end_of(process, tee))

    def describe(self) -> str:
        """Return what each controller does now, in one line."""
        frames = sys._current_frames()
        found = []
        for _, thread in self._spinning:
            frame = frames.get(thread.ident or 0)
            lines = [line for line in traceback.extract_stack(frame) if '/rclpy/' not in
                     line.filename and line.filename not in (threading.__file__, __file__)]
            found.append(f"node '{thread.name}' " + (
                'has ended' if frame is None else
                f'is in {lines[-1].name} ({lines[-1].filename}:{lines[-1].lineno})' if lines
                else 'waits for messages'))
        found += [f'{process.args!r} runs' if process.poll() is None else _end_of(process)
                  for process, *_ in self._processes]
        return '; '.join(found)

    def close(self) -> None:
        """
        End processes, also those that they have started, and threads.

        :raises Exception: of a controller, if the test has not waited since it failed
        :raises ManipSimError: if a callback does not return, or as :meth:`check`
        """
        if threading.excepthook == self._of_threads.append:
            threading.excepthook = self._hook_before
        for thread in self._of_threads:
            self._hook_before(thread)
        self._of_threads.clear()
        try:
            self.check()
        finally:
            self._end()
        self.check()

    def _end(self) -> None:
        for process, watch, _ in self._processes:
            watch.kill()
            watch.communicate()
            # Those that it has started are left where it has ended.
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        for executor, thread in self._spinning:
            executor.shutdown(_END_S)
            thread.join(_END_S)
        stuck = [thread.name for _, thread in self._spinning if thread.is_alive()]
        if stuck:
            raise ManipSimError(f'a callback of the nodes {", ".join(stuck)} does not return: '
                                f'{self.describe()}')


class _Tee:
    """
    A pipe whose content goes to standard error; its last lines are kept.

    :ivar end: descriptor to write to
    """

    def __init__(self) -> None:
        self._begin, self.end = os.pipe()
        self.lines: deque[str] = deque(maxlen=200)
        self._thread = threading.Thread(target=self._copy, daemon=True)
        self._thread.start()

    def _copy(self) -> None:
        with os.fdopen(self._begin, 'rb') as pipe:
            for line in pipe:
                self.lines.append(line.decode(errors='replace').rstrip())
                os.write(2, line)

    def text(self) -> str:
        """Return the last traceback, or the last lines."""
        self._thread.join(0.5)  # Processes that it has started may keep the pipe open.
        lines = [line for line in self.lines if line]
        begins = [n for n, line in enumerate(lines) if line.startswith('Traceback ')]
        return '\n'.join(lines[begins[-1]:] if begins else lines[-_LINES:])


def _end_of(process: ControllerProcess, tee: _Tee | None = None) -> str:
    text = tee.text() if tee else ''
    return f'{process.args!r} has ended with exit code {process.returncode}' + (
        f': {text}' if text else '')


def guard(process: str) -> subprocess.Popen[Any]:
    """
    Start a process that kills another one when this process ends, also by SIGKILL.

    :param process: its number, or with a minus that of a group
    :returns: to be killed when the other one has ended
    """
    return subprocess.Popen([*_GUARD, process], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL,
                            stderr=subprocess.DEVNULL, start_new_session=True)
