# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Run the node as a process: real-time priority, processors, memory, executor and exit code."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import contextlib
import ctypes
import gc
import itertools
import os
from pathlib import Path
import resource
import sys
import threading
import warnings

import rclpy
from rclpy.impl.rcutils_logger import RcutilsLogger
import yaml

from manip_sim.control.law.kept import all_are_kept
from manip_sim.errors import ManipSimError, ParameterError
from manip_sim.interface.parameter_spec import matches, sections_of
from manip_sim.models import untrusted_models
from manip_sim.quoting import quoted, quoted_names
from manip_sim.rclpy_internals import import_type_supports, start_ros
from manip_sim.ros.camera_publishers import THREAD_NAME
from manip_sim.ros.declared_parameters import Parameters
from manip_sim.ros.executor import BACKGROUND_THREAD, begin, GuardedExecutor
from manip_sim.ros.sim_node import SimNode
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
    import_type_supports()
    try:
        start_ros(arguments)
        code = _serve(asked_to_end, arguments)
    except ManipSimError as error:
        code = _fail(str(error))
    finally:
        rclpy.try_shutdown()
    untrusted_models.give_up()
    return leave(code, THREAD_NAME, BACKGROUND_THREAD)


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
        if not all_are_kept() and not _compile_laws(node, asked_to_end):
            return 0
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


def _compile_laws(node: SimNode, asked_to_end: EndSignals) -> bool:
    """Compile control laws until a signal comes; return whether they are all there."""
    compilation = begin(node.compile_laws)
    while not compilation.done():
        if asked_to_end.wait(_WATCH_S):
            return False
    compilation.result()
    return True


def _fail(message: str) -> int:
    print(f'sim_node: {message}', file=sys.stderr)
    return 1


def for_other_nodes(arguments: Sequence[str], node_name: str) -> Iterator[str]:
    """
    Yield warnings about parameters of the command line that are for other nodes only.

    :param arguments: of the command line
    :param node_name: the node's name with its namespace
    :returns: a warning for each parameters file and each parameter that is not for this node
    """
    for option, value in itertools.pairwise(arguments):
        if option == '--params-file':
            nodes = _nodes_in(Path(value))
            if nodes and not any(matches(node, node_name) for node in nodes):
                yield (f'the parameters file {quoted(value, 200)} has no effect: it is for '
                       f'{quoted_names(nodes)}, this node is {node_name}')
        elif option in ('-p', '--param'):
            node, colon, _ = value.partition(':=')[0].rpartition(':')
            if colon and not matches(node, node_name):
                yield (f'the parameter {quoted(value)} has no effect: it is for {quoted(node)}, '
                       f'this node is {node_name}')


def _nodes_in(file: Path) -> list[str]:
    """Return the node names and patterns that a parameters file is for."""
    try:
        return [node for node, _ in sections_of(yaml.safe_load(file.read_text()))]
    except (OSError, ValueError, RecursionError, yaml.YAMLError):
        # ROS has read it; only the warning is lost.
        return []


#: Stands for all processors that the process may use.
ALL = -1
_THREADS = Path('/proc/self/task')
#: ``MCL_CURRENT | MCL_FUTURE`` of Linux.
_ALL_MEMORY = 3
_REMEDY = ("for a user, a file below /etc/security/limits.d with '* - rtprio 99' and '* - memlock "
           "unlimited'; in a container, docker run --cap-add SYS_NICE --ulimit rtprio=99 "
           '--ulimit memlock=-1')


def run_in_real_time(parameters: Parameters, logger: RcutilsLogger) -> None:
    """
    Apply ``thread_priority``, ``cpu_affinity`` and ``lock_memory`` to the threads of this process.

    Threads that render are left out, and those that begin later have the usual priority. Where the
    priority is not permitted, a line of the log says what would permit it.

    :param parameters: of a node that runs
    :raises ManipSimError: if the memory cannot be locked
    :raises ParameterError: if a processor is not there
    """
    if not hasattr(os, 'sched_setscheduler') or not _THREADS.is_dir():
        return  # Not Linux.
    threads, processors = _threads(), os.sched_getaffinity(0)
    _set_processors(threads, processors, parameters.value('cpu_affinity'))
    if parameters.value('lock_memory'):
        _lock_memory()
    priority = parameters.value('thread_priority')
    # With a single processor nothing else could run while the physics is late.
    if not priority or parameters.value('stepping') != 'realtime' or len(processors) < 2:
        return
    try:
        for thread in threads:
            with contextlib.suppress(ProcessLookupError):  # It has ended.
                os.sched_setscheduler(thread, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK,
                                      os.sched_param(priority))
    except PermissionError:  # The priority that somebody else gave the process stays.
        logger.info(f'real-time priority {priority} is not permitted, which costs punctuality on '
                    f'a busy machine; permit it ({_REMEDY}), or set thread_priority to 0')


def _threads() -> list[int]:
    """Return the ids of the threads that do not render."""
    rendering = {
        thread.native_id for thread in threading.enumerate() if thread.name == THREAD_NAME}
    return sorted({int(task.name) for task in _THREADS.iterdir()} - rendering)


def _set_processors(threads: list[int], present: set[int], numbers: list[int]) -> None:
    if list(numbers) == [ALL]:
        return
    if not present.issuperset(numbers):
        raise ParameterError(f"parameter 'cpu_affinity': this process may use the processors "
                             f'{sorted(present)}, got {list(numbers)}')
    for thread in threads:
        with contextlib.suppress(ProcessLookupError):  # It has ended.
            os.sched_setaffinity(thread, numbers)


def _lock_memory() -> None:
    """Keep all pages of the process in memory; ManipSimError if that is not permitted."""
    if ctypes.CDLL(None, use_errno=True).mlockall(_ALL_MEMORY):
        soft, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
        raise ManipSimError(
            f"parameter 'lock_memory': {os.strerror(ctypes.get_errno())}; {soft} bytes may be "
            f'locked: {_REMEDY}')
