# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A node that is served for a test, in this process or in its own."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
import subprocess
import sys
import tempfile
import threading
from typing import Any

from rclpy.context import Context
from rclpy.parameter import Parameter
import yaml

from manip_sim.errors import ManipSimError
from manip_sim.ros.executor import GuardedExecutor
from manip_sim.ros.sim_node import SimNode
from manip_sim.testing.controllers import guard

#: How long a node is given to end; a machine with many other processes takes long [s].
_END_S = 300.0


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
        self._thread.join(_END_S)
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
            code = self._process.wait(_END_S)
            if code:
                raise ManipSimError(f'the node ended with exit code {code}: {self._last_line()}')
        finally:
            self.kill()


ServedNode = NodeInProcess | NodeProcess
