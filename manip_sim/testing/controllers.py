# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The controllers under test, in threads and processes, and the node that is served for them."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
import contextlib
from contextlib import ExitStack
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from typing import Any
import weakref

from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
import yaml

from manip_sim.errors import ManipSimError
from manip_sim.ros.executor import GuardedExecutor
from manip_sim.ros.sim_node import SimNode

#: Longest wait for the callback of a controller to return at the end [s].
_END_S = 3.0
#: Lines of a process's standard error in an error message.
_LINES = 5
#: Kills its argument, a process or with a minus a group, when its standard input ends.
_GUARD = ['sh', '-c', 'read _; kill -s KILL -- "$0"']
#: The guards that have been started; other processes must not keep their pipes open.
_GUARDS: weakref.WeakSet[subprocess.Popen[Any]] = weakref.WeakSet()


class ControllerProcess(subprocess.Popen[Any]):
    """
    A controller as a process; its standard error goes to that of this process too.

    :param command: such as ``['ros2', 'run', 'my_package', 'my_controller']``
    :param arguments: further arguments of ``subprocess.Popen``
    :ivar is_known: whether the test has sent it a signal or waited for it, and expects its end
    """

    is_known = False

    def __init__(self, command: Sequence[str], **arguments: Any) -> None:
        self._tee = None if 'stderr' in arguments else _Tee()
        if self._tee:
            arguments['stderr'] = self._tee.end
        try:
            super().__init__(command, **{**arguments, 'start_new_session': True})
        finally:
            if self._tee:
                os.close(self._tee.end)
        self._guard = guard(f'-{self.pid}')

    def send_signal(self, sig: int) -> None:
        """Send a signal, as ``terminate`` and ``kill`` do too."""
        self.is_known = True
        super().send_signal(sig)

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end, as ``communicate`` does too."""
        code = super().wait(timeout)
        self.is_known = True
        return code

    def describe(self, errors: bool = True) -> str:
        """Return what it does now, or how it has ended, and with what on standard error."""
        if self.poll() is None:
            return f'{self.args!r} runs'
        text = f': {self._tee.text()}' if errors and self._tee else ''
        return f'{self.args!r} has ended with exit code {self.poll()}{text.removesuffix(": ")}'

    def end(self) -> None:
        """End it, and what it has started and left."""
        self._guard.kill()
        self._guard.communicate()
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
        self.wait()


class Controllers:
    """
    The controllers of a simulation under test.

    :param domain: the ROS domain of processes
    :ivar started_s: when the last process was started [s], of ``time.monotonic``
    """

    def __init__(self, domain: int) -> None:
        self._domain = domain
        self._spinning: list[tuple[SingleThreadedExecutor, threading.Thread]] = []
        self._processes: list[ControllerProcess] = []
        #: Those that have not been raised yet.
        self._errors: list[BaseException] = []
        self._hook_before, threading.excepthook = threading.excepthook, self._take
        self.started_s = -float('inf')

    def _take(self, thread: threading.ExceptHookArgs) -> None:
        error = thread.exc_value
        if isinstance(error, Exception) and not isinstance(error, ExternalShutdownException):
            self._errors.append(error)
        else:
            self._hook_before(thread)

    def spin(self, node: Node) -> None:
        """
        Run the callbacks of a node in a thread of its own.

        :param node: of any context in the domain
        :raises ManipSimError: if it is in another domain, where nothing of the simulation is seen
        """
        domain = node.context.get_domain_id()
        if domain != self._domain:
            raise ManipSimError(
                f"node '{node.get_name()}' is in ROS domain {domain}, and the simulation in "
                f'{self._domain}: call rclpy.init() after sim_node(...), which selects the domain')
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
        except (Exception, SystemExit) as error:
            # Callbacks fail where a test shuts their context down before this ends them.
            if executor.context.ok():
                self._errors.append(error)

    def start(self, command: Sequence[str], **arguments: Any) -> ControllerProcess:
        """Start a process in the domain, as :class:`ControllerProcess`."""
        # Another simulation of the same test may have changed this process's environment.
        arguments['env'] = {**(arguments.get('env') or os.environ),
                            'ROS_DOMAIN_ID': str(self._domain)}
        process = ControllerProcess(command, **arguments)
        self._processes.append(process)
        self.started_s = time.monotonic()
        return process

    def check(self) -> None:
        """
        Check that no controller has failed; each error is raised once.

        :raises Exception: that of a callback, or of any thread
        :raises ManipSimError: if a process has ended with an error that the test does not know
        """
        if self._errors:
            raise self._errors.pop(0)
        for process in self._processes:
            if process.poll() and not process.is_known:
                process.is_known = True
                raise ManipSimError(process.describe())

    def check_running(self) -> None:
        """
        Check that there is a controller left, if there were some.

        :raises ManipSimError: if all processes have ended, and no node spins
        """
        if self._processes and not any(thread.is_alive() for _, thread in self._spinning) and all(
                process.poll() is not None for process in self._processes):
            raise ManipSimError(self._processes[-1].describe())

    def describe(self) -> str:
        """Return what each controller does now, in one line."""
        frames = sys._current_frames()
        states = []
        for _, thread in self._spinning:
            frame = frames.get(thread.ident or 0)
            lines = [line for line in traceback.extract_stack(frame) if '/rclpy/' not in
                     line.filename and line.filename not in (threading.__file__, __file__)]
            states.append(f"node '{thread.name}' " + (
                'has ended' if frame is None else
                f'is in {lines[-1].name} ({lines[-1].filename}:{lines[-1].lineno})' if lines
                else 'waits for messages'))
        return '; '.join([*states, *(process.describe(errors=False)
                                     for process in self._processes)])

    def close(self) -> None:
        """
        End processes, also those that they have started, and threads.

        :raises Exception: of a controller, if the test has not waited since it failed
        :raises ManipSimError: if a callback does not return, or as :meth:`check`
        """
        if threading.excepthook == self._take:
            threading.excepthook = self._hook_before
        try:
            self.check()
        finally:
            self._end()
        self.check()

    def _end(self) -> None:
        for process in self._processes:
            process.end()
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


def guard(process: str) -> subprocess.Popen[Any]:
    """
    Start a process that kills another one when this process ends, also by SIGKILL.

    :param process: its number, or with a minus that of a group
    :returns: to be killed when the other one has ended
    """
    started = subprocess.Popen(
        [*_GUARD, process], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL, start_new_session=True)
    _GUARDS.add(started)
    return started


def _let_go() -> None:
    """Close the pipes of guards in a fork, which would keep them open after its parent's end."""
    for started in _GUARDS:
        if started.stdin is not None:
            started.stdin.close()


os.register_at_fork(after_in_child=_let_go)


#: Time for a node to end; a machine with many other processes takes long [s].
_NODE_END_S = 300.0


class NodeInProcess:
    """
    A node in this process, with an executor thread of its own.

    :param context: of the node
    :param parameters: of the node, by name
    :raises ManipSimError: if the node cannot start
    :ivar node: the node
    """

    def __init__(self, context: Context, parameters: Mapping[str, Any]) -> None:
        self._context = context
        self.node = SimNode(context=self._context, parameter_overrides=[
            Parameter(name, value=value) for name, value in parameters.items()])
        self._executor = GuardedExecutor(self.node.rejections, context=self._context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._executor.spin, name='sim_node')
        self._thread.start()
        self.node.start()

    def check(self) -> None:
        """
        Check that the node still runs.

        :raises ManipSimError: with the reason why it has ended
        """
        if self.node.thread.error is not None:
            raise ManipSimError(f'the node has ended: {self.node.thread.error}')

    def kill(self) -> None:
        """
        Say that the node cannot be killed.

        :raises ManipSimError: in any case
        """
        raise ManipSimError('a node in the process of the test cannot be killed: start it with '
                            'as_process=True')

    def close(self) -> None:
        """
        End the node; after a signal, rclpy has shut its context down already.

        :raises ManipSimError: if it has failed
        """
        interrupted = not self._context.ok()
        self.node.end_goals()
        self._executor.end()
        self._thread.join(_NODE_END_S)
        self._executor.shutdown()
        self.node.stop()
        self.node.destroy_node()
        if not interrupted:
            self.check()


class NodeProcess:
    """
    A node in a process of its own, as ``sim_node`` starts it.

    The process takes its domain from the environment.

    :param parameters: of the node, by name
    """

    def __init__(self, parameters: Mapping[str, Any]) -> None:
        self._files = ExitStack()
        folder = Path(self._files.enter_context(tempfile.TemporaryDirectory()))
        file, self._log = folder / 'parameters.yaml', folder / 'log'
        file.write_text(yaml.safe_dump({'/**': {'ros__parameters': dict(parameters)}}))
        with self._log.open('w') as log:
            self._process = subprocess.Popen(
                [sys.executable, '-m', 'manip_sim', '--ros-args', '--params-file', str(file)],
                stdout=log, stderr=subprocess.STDOUT)
        self._guard = guard(str(self._process.pid))

    def check(self) -> None:
        """Check that the node still runs, as :meth:`NodeInProcess.check`."""
        code = self._process.poll()
        if code is not None:
            raise ManipSimError(f'the node has ended with exit code {code}: {self._last_line()}')

    def _last_line(self) -> str:
        return (self._log.read_text().strip().splitlines() or ['no output'])[-1]

    def kill(self) -> None:
        """End the node without warning, as a crash does: send SIGKILL to the process."""
        self._guard.kill()
        self._guard.communicate()
        self._process.kill()
        self._process.wait()
        self._files.close()

    def close(self) -> None:
        """End the node, as :meth:`NodeInProcess.close`."""
        self._process.terminate()
        try:
            code = self._process.wait(_NODE_END_S)
            if code:
                raise ManipSimError(f'the node ended with exit code {code}: {self._last_line()}')
        finally:
            self.kill()


ServedNode = NodeInProcess | NodeProcess
