# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Run the node as a process: executor, end and exit code."""

from __future__ import annotations

from collections.abc import Sequence
import gc
import sys
import threading
import warnings

import rclpy

from manip_sim.errors import ManipSimError
from manip_sim.models import untrusted_models
from manip_sim.ros.arguments import for_other_nodes, start_ros
from manip_sim.ros.executor import BACKGROUND_THREAD, GuardedExecutor
from manip_sim.ros.real_time import run_in_real_time
from manip_sim.ros.sim_node import SimNode
from manip_sim.runtime import camera_thread
from manip_sim.startup import EndSignals, leave

#: Period at which the main thread checks whether the other threads still run [s].
_WATCH_S = 0.5
#: After how long Python lets another thread run [s]; the default of 5 ms delays the physics.
_SWITCH_S = 5e-4


def run(arguments: Sequence[str]) -> int:
    """
    Serve a robot until SIGINT, SIGTERM or SIGHUP.

    :param arguments: ROS arguments, such as ``--ros-args -p robot:=Panda``
    :returns: the exit code: 0, or 1 if the node cannot start or fails
    """
    asked_to_end = EndSignals()
    sys.setswitchinterval(_SWITCH_S)
    # rclpy warns of a node that could not be created, in addition to the error.
    warnings.filterwarnings('ignore', 'Failed to fini', RuntimeWarning)
    try:
        start_ros(arguments)
        code = _serve(asked_to_end, arguments)
    except ManipSimError as error:
        code = _fail(str(error))
    finally:
        rclpy.try_shutdown()
    untrusted_models.give_up()
    return leave(code, camera_thread.THREAD_NAME, BACKGROUND_THREAD)


def _serve(asked_to_end: EndSignals, arguments: Sequence[str]) -> int:
    node = SimNode()
    # The garbage collector need not examine what lasts as long as the process.
    gc.freeze()
    gc.enable()
    for warning in for_other_nodes(arguments, node.get_fully_qualified_name()):
        node.get_logger().warning(warning)
    executor = GuardedExecutor(node.rejections)
    executor.add_node(node)
    spinner = threading.Thread(target=executor.spin, name='executor')
    try:
        node.start()
        spinner.start()
        run_in_real_time(node.declared, node.get_logger())
        while not asked_to_end.wait(_WATCH_S):
            if node.thread.error is not None:
                raise node.thread.error
            ended = node.ended_thread if spinner.is_alive() else 'the executor'
            if ended:
                return _fail(f'{ended} ended unexpectedly')
        return 0
    finally:
        if spinner.is_alive():
            node.end_goals()
        # Callbacks that wait for the simulation are answered before it ends.
        executor.end()
        if spinner.is_alive():
            spinner.join()
        executor.shutdown()
        node.stop()
        node.destroy_node()


def _fail(message: str) -> int:
    print(f'sim_node: {message}', file=sys.stderr)
    return 1
