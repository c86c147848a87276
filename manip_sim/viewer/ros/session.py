# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Connect the page to the node, keep it up to date in one thread, and run as a process."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from functools import partial
import os
from pathlib import Path
import signal
import subprocess
import sys
import time
from typing import Any

from geometry_msgs.msg import PoseStamped, Twist
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from visualization_msgs.msg import Marker

from manip_sim.errors import ManipSimError
from manip_sim.models import untrusted_models
from manip_sim.quoting import counted
from manip_sim.rclpy_internals import RCLError, without_source
from manip_sim.ros.arguments import start_ros
from manip_sim.ros.executor import BACKGROUND_THREAD
from manip_sim.startup import EndSignals, leave
from manip_sim.viewer.page.latest import RealTimeFactor, ShownStatus, WARN
from manip_sim.viewer.page.page import Page
from manip_sim.viewer.page.page_commands import Poses
from manip_sim.viewer.page.server import Access, close_server, open_server, page_address
from manip_sim.viewer.ros.command_sender import CommandSender
from manip_sim.viewer.ros.discovery import Discovery, name_of
from manip_sim.viewer.ros.readers import PolledExecutor, Readers
from manip_sim.viewer.ros.states import States

#: Longest wait for a record to be completed when the viewer ends [s].
_CLOSING_S = 10.0


class NodeRecording:
    """
    A record that begins and ends when people say so.

    :param node: full name of the node, such as ``/manip_sim``
    :param folder: where the files are written
    :param report: called with a text, and whether it is a record that was written
    """

    def __init__(self, node: str, folder: Path, report: Callable[[str, bool], None]) -> None:
        self._node, self._folder, self._report = node, folder, report
        self._process: subprocess.Popen[str] | None = None

    @property
    def is_running(self) -> bool:
        return self._process is not None

    def record(self, wanted: bool) -> None:
        """Begin a record, or end the present one; do nothing if that is so already."""
        if self._process is None and wanted:
            name = self._node.rpartition('/')[2]
            file = self._folder / f'{name}_{time.strftime("%Y%m%d_%H%M%S")}.mcap'
            self._process = subprocess.Popen(
                [sys.executable, '-m', 'manip_sim.cli', 'record', str(file), '--node', self._node],
                stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                text=True)
        elif self._process is not None and not wanted:
            self._process.send_signal(signal.SIGINT)

    def update(self) -> None:
        """Report a record that has ended; to be called from time to time."""
        if self._process is not None and self._process.poll() is not None:
            process, self._process = self._process, None
            lines = process.communicate()[0].strip().splitlines()
            self._report(lines[-1] if lines else 'the record has ended', not process.returncode)

    def close(self) -> None:
        """End the present record, and wait for its file."""
        self.record(False)
        if self._process is not None:
            try:
                self._process.communicate(timeout=_CLOSING_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.communicate()
            self._process = None


#: Time between two looks for the node, and between two reports of its state [s].
_SEARCH_S, _REPORT_S = 0.5, 0.5
#: Time without states after which the page says so [s].
_SILENT_S = 2.0


class Session:
    """
    A page that shows a node.

    :param node: the viewer's own
    :param simulation: full name of the node that is seen, without the first slash
    :param dark: whether the page begins dark
    :param commands: whether people can command the node; else there is nothing that could
    :param poses: those saved before
    :param records: folder of the records that people make
    """

    def __init__(self, node: Node, readers: Readers, simulation: str, server: Any, dark: bool,
                 commands: bool = True, poses: Poses | None = None, records: Path = Path()
                 ) -> None:
        self._name, self._readers = simulation, readers
        self._discovery = Discovery(node, readers, simulation)
        self._states = States(node, readers, simulation, self._discovery.base)
        self._states.on_statuses = self._diagnosed
        self._sender: CommandSender | None = None
        if commands:
            self._recording = NodeRecording(
                f'/{simulation}', records, lambda text, written: self._page.notify(text, written))
            self._sender = CommandSender(node, simulation, self._states.frames,
                                         lambda text: self._page.notify(text),
                                         self._recording.record)
            self._sender.paused = self._set_paused
        self._cameras: set[str] = set()
        self._page = Page(server, self._sender, self._watch, dark, poses)
        self._shown: tuple[Any, ...] = ()
        self._models = 0
        self._layout: Any = None
        self._was_there = False
        self._paused = False
        self._level = 0
        self._real_time_factor = RealTimeFactor()
        self._next_search_s = self._next_report_s = 0.0

    def _watch(self, camera: str, wanted: bool) -> None:
        (self._cameras.add if wanted else self._cameras.discard)(camera)

    def _set_paused(self, paused: bool) -> None:
        self._paused = paused
        self._next_report_s = 0.0

    def _diagnosed(self, statuses: list[ShownStatus]) -> None:
        if self._sender is not None:
            self._sender.notice(self._discovery.base, statuses)
        rejected = self._readers.rejected
        self._page.show_diagnostics([*statuses, *([ShownStatus(
            WARN, 'viewer', f'{counted(rejected, "message")} rejected, see its log')]
            if rejected else [])])
        for status in statuses:
            if status.name == 'simulation':
                self._paused = status.values.get('state') == 'paused'
                self._level = status.level

    def update(self, now_s: float) -> None:
        """Bring the page up to date, after callbacks have run; ``now_s`` is wall time [s]."""
        self._discovery.load_model()
        if now_s >= self._next_search_s:
            self._next_search_s = now_s + _SEARCH_S
            self._search()
        for states in self._states.latest.joints.values():
            self._real_time_factor.add(self._states.latest.joints_s, states.time_s)
            break
        self._page.update(now_s, self._states.latest, self._paused)
        if now_s >= self._next_report_s:
            self._next_report_s = now_s + _REPORT_S
            self._page.show_state(*self._state(now_s))
            if self._sender is not None:
                self._recording.update()
                self._page.show_recording(self._recording.is_running)

    def close(self) -> None:
        """Complete the record that is being written."""
        if self._sender is not None:
            self._recording.close()

    def _search(self) -> None:
        discovery = self._discovery
        discovery.look()
        if not discovery.is_there:
            if self._was_there:
                self._states.forget()
                if self._sender is not None:
                    self._sender.forget_waiting()
                self._layout, self._was_there = None, False
                self._real_time_factor = RealTimeFactor()
            return
        layout = discovery.layout
        if layout is None or discovery.model is None:
            return
        self._was_there = True
        if layout != self._layout:
            self._layout = layout
            self._states.listen(layout)
            if self._sender is not None:
                self._sender.prepare(self._command_topics())
        # Joints and limits change with the model, also where the topics stay the same.
        robots = discovery.robots()
        if (robots, layout.cameras) != self._shown:
            self._shown = robots, layout.cameras
            self._cameras.clear()
            self._page.show_robots(robots, layout.cameras)
        if discovery.models != self._models:
            self._models = discovery.models
            self._page.show_model(discovery.model, self._states.latest)
        if self._sender is not None:
            self._sender.send_waiting()
        watched = self._page.is_watched
        self._states.want_markers(watched and self._page.wants_markers)
        self._states.want_images(self._cameras if watched else ())

    def _command_topics(self) -> dict[str, Any]:
        topics: dict[str, Any] = {f'/{self._name}/pull': Marker}
        for robot in self._layout.robots:
            name = partial(name_of, robot.space)
            for part in robot.parts:
                topics[name('<part>/joint_command', part)] = JointState
                if part.endswith('/gripper'):
                    topics[name('<part>/command', part)] = Float64MultiArray
            for arm in robot.end_effectors:
                topics[name('<arm>/target_pose', arm)] = PoseStamped
            if robot.drives:
                topics[name('base/cmd_vel')] = Twist
        return topics

    def _state(self, now_s: float) -> tuple[str, str, bool | None]:
        name = f'/{self._name}'
        if not self._was_there:
            if self._layout is None and self._shown and not self._discovery.is_there:
                return 'gone', f'{name} is gone; waiting for it to come back', None
            if self._discovery.checking is not None:
                return 'waiting', f'checking the model of {name}', None
            return 'waiting', f'waiting for the node {name}', None
        latest = self._states.latest
        if not latest.joints:
            return 'waiting', f'waiting for the states of {name}', None
        silent_s = now_s - latest.joints_s
        if silent_s > _SILENT_S:
            return 'trouble', f'no states for {silent_s:.0f} s', None
        time_s = next(iter(latest.joints.values())).time_s
        new = '' if self._discovery.checking is None else ', checking a new model'
        if self._paused:
            return 'paused', f'paused at {time_s:.2f} s{new}', True
        factor = self._real_time_factor.factor
        text = f'{time_s:.1f} s' + ('' if factor is None else f', {factor:.3f} × real time') + new
        return ('trouble' if self._level else 'running'), text, False


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
    untrusted_models.give_up()
    return leave(0, BACKGROUND_THREAD)


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
    session: Session | None = None
    try:
        session = Session(node, readers, simulation, server, options.dark,
                          commands=not options.no_commands, poses=poses,
                          records=options.records)
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
        if session is not None:
            session.close()
