# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Show a node on the page, as a process: pace, end and exit code."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import os
import time
from typing import Any

import rclpy
from rclpy.node import Node

from manip_sim.errors import ManipSimError
from manip_sim.models import trial
from manip_sim.rclpy_internals import RCLError
from manip_sim.ros import background
from manip_sim.ros.arguments import start_ros, without_source
from manip_sim.startup import EndSignals, leave
from manip_sim.viewer.page.access import Access
from manip_sim.viewer.page.saved_poses import Poses
from manip_sim.viewer.page.server import close_server, open_server, page_address
from manip_sim.viewer.ros.readers import PolledExecutor, Readers
from manip_sim.viewer.ros.session import Session

#: Least time between two updates of the browser [s].
_PERIOD_S = 1.0 / 30.0


def show(options: argparse.Namespace, arguments: Sequence[str]) -> int:
    """
    Serve the page until SIGINT, SIGTERM or SIGHUP.

    :param options: of the command line, such as ``listen`` and ``port``
    :param arguments: of ROS, such as ``--ros-args -r __ns:=/cell``
    :returns: the exit code, 0
    :raises ManipSimError: if it cannot listen, read the saved poses, or start ROS
    """
    ended = EndSignals()
    node = _start_ros(arguments)
    try:
        simulation = node.resolve_topic_name(options.node).lstrip('/')
        readers = Readers(node)
        executor = PolledExecutor(readers.log)
        executor.add_node(node)
        if options.native:
            from manip_sim.viewer.ros.native import show_native
            show_native(node, readers, simulation, executor.run_ready, ended)
        else:
            _serve(node, readers, simulation, executor, options, ended)
        executor.shutdown()
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    trial.give_up()
    return leave(0, background.THREAD_NAME)


def _start_ros(arguments: Sequence[str]) -> Node:
    start_ros(arguments)
    try:
        node: Node = rclpy.create_node('sim_view')
    except RCLError as error:
        raise ManipSimError(without_source(error)) from error
    return node


def _serve(node: Node, readers: Readers, simulation: str, executor: PolledExecutor,
           options: argparse.Namespace, ended: EndSignals) -> None:
    access = Access.of(os.environ, options.allow_host)
    poses = Poses(options.poses)
    server: Any = open_server(options.listen, options.port, access)
    try:
        session = Session(node, readers, simulation, server, options.dark,
                          commands=not options.no_commands, poses=poses)
        address = page_address(server, options.listen, access)
        print(f'sim_view: {address} shows the node /{simulation} while it runs', flush=True)
        due_s = time.monotonic()
        while not ended.wait(due_s - time.monotonic()):
            executor.run_ready()
            try:
                session.update(time.monotonic())
            except Exception as error:  # The next round may succeed, as after another model.
                readers.log.failure('callbacks', 'the page', error)
            # The delay of a slow round is not made up for.
            due_s = max(due_s + _PERIOD_S, time.monotonic())
    finally:
        close_server(server)
