# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Run the node as a process: signals, executor and exit code."""

from __future__ import annotations

from collections.abc import Sequence
import contextlib
import signal
import sys
import threading

import rclpy
from rclpy._rclpy_pybind11 import RCLError, UnknownROSArgsError
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from manip_sim.errors import ManipSimError
from manip_sim.ros.sim_node import SimNode

#: How often the main thread looks whether the other threads are well [s].
_WATCH_S = 0.5
#: Python lets another thread run after so long [s]; the default of 5 ms would delay the physics.
_SWITCH_S = 5e-4


def run(arguments: Sequence[str]) -> int:
    """
    Serve a robot until SIGINT or SIGTERM.

    :param arguments: ROS arguments, such as ``--ros-args -p robot:=Panda``
    :returns: the exit code: 0, or 1 if the node cannot start or fails
    """
    asked_to_end = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: asked_to_end.set())
    sys.setswitchinterval(_SWITCH_S)
    try:
        rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
    except (UnknownROSArgsError, RCLError) as error:
        return _fail(f'bad ROS arguments: {str(error).splitlines()[0]}')
    try:
        return _serve(asked_to_end)
    except ManipSimError as error:
        return _fail(str(error))
    finally:
        rclpy.try_shutdown()


def _serve(asked_to_end: threading.Event) -> int:
    node = SimNode()
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    spinner = threading.Thread(target=_spin, args=(executor,), name='executor')
    try:
        node.start()
        spinner.start()
        while not asked_to_end.wait(_WATCH_S):
            if node.runner.error is not None:
                raise node.runner.error
            if not spinner.is_alive():
                return _fail('the executor ended unexpectedly')
        return 0
    finally:
        # Callbacks that wait for the simulation are answered before it ends.
        executor.shutdown()
        if spinner.is_alive():
            spinner.join()
        node.stop()
        node.destroy_node()


def _spin(executor: SingleThreadedExecutor) -> None:
    with contextlib.suppress(ExternalShutdownException):
        executor.spin()


def _fail(message: str) -> int:
    print(f'sim_node: {message}', file=sys.stderr)
    return 1
