# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Connect the page to the node, send commands, keep it up to date in one thread, run as a process.

With ``--native``, MuJoCo's own viewer shows the node in a window, and drives nothing.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping, Sequence
import contextlib
from functools import partial
import math
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import threading
import time
from typing import Any

from geometry_msgs.msg import Point, PoseStamped, Twist
import mujoco
import mujoco.viewer
import numpy as np
from numpy.typing import NDArray
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, SetParameters
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import Marker

from manip_sim.arrays import FloatArray
from manip_sim.errors import ManipSimError
from manip_sim.interface.topics import BY_NAME
from manip_sim.models import untrusted_models
from manip_sim.quoting import pluralize
from manip_sim.rclpy_internals import RCLError, start_ros, without_source
from manip_sim.ros.executor import BACKGROUND_THREAD
from manip_sim.startup import EndSignals, leave
from manip_sim.viewer.discovery import Discovery, name_of, PolledExecutor, Readers, States
from manip_sim.viewer.page.interaction import Poses
from manip_sim.viewer.page.latest import RealTimeFactor, ShownStatus, WARN
from manip_sim.viewer.page.model_scene import first_view, Kinematics
from manip_sim.viewer.page.page import Page
from manip_sim.viewer.page.server import Access, close_server, open_server, page_address

_ACTION_SIZE, _MAX_ACTION_SIZE = 'action_size', 100
_SERVICES = {'pause': SetBool, 'step': Trigger, 'reset': Trigger, 'tare_wrench': Trigger,
             'describe_parameters': DescribeParameters, 'set_parameters': SetParameters}
#: The constraint in the description of a parameter that has choices.
_CHOICES = re.compile(r'One of: (?P<names>[\w:, -]+)\.')


class CommandSender:
    """
    The publishers and service clients for commands.

    :param simulation: full name of the node that is seen, without the first slash
    :param frames: those in which the node gives the poses of end effectors, by namespace and arm
    :param notify: called with what could not be done, for people
    :ivar paused: called when the simulation has been paused or goes on
    """

    def __init__(self, node: Node, simulation: str, frames: Mapping[tuple[str, str], str],
                 notify: Callable[[str], None],
                 record: Callable[[bool], None] = lambda wanted: None) -> None:
        self._node, self._name, self._frames, self._notify = node, simulation, frames, notify
        self._publishers: dict[str, Any] = {}
        self._clients: dict[str, Any] = {}
        self._waiting: dict[str, Any] = {}
        self._action_sizes: dict[str, int] = {}
        #: The control modes of parts, by the name of their parameter; None if not asked for.
        self._modes: dict[str, list[str]] | None = None
        self._parts: set[str] = set()
        self.paused: Callable[[bool], None] = lambda paused: None
        self.record = record

    def notice(self, base: str, statuses: list[ShownStatus]) -> None:
        """Take from the diagnostics how many numbers the actions of grippers have."""
        sizes = {f'{base}{status.name}': status.number(_ACTION_SIZE) for status in statuses}
        self._action_sizes = {name: int(size) for name, size in sizes.items()
                              if size is not None and 1.0 <= size <= _MAX_ACTION_SIZE}

    def prepare(self, topics: Mapping[str, Any]) -> None:
        """Create publishers and clients early: a message sent before discovery is lost."""
        for topic in self._publishers.keys() - topics.keys():
            self._node.destroy_publisher(self._publishers.pop(topic))
        for topic, kind in topics.items():
            if topic not in self._publishers:
                self._publishers[topic] = self._node.create_publisher(kind, topic, 10)
        self._modes = None
        self._parts = set(filter(None, map(BY_NAME['<part>/joint_command'].of_name, topics)))
        for name, kind in _SERVICES.items():
            if name not in self._clients:
                self._clients[name] = self._node.create_client(kind, f'/{self._name}/{name}')

    def _publish(self, topic: str, message: Any) -> None:
        if topic not in self._publishers:
            self._notify(f'{topic}: the node no longer subscribes to this topic')
        elif self._publishers[topic].get_subscription_count():
            self._waiting.pop(topic, None)
            self._publishers[topic].publish(message)
        else:
            self._waiting[topic] = message

    def send_waiting(self) -> None:
        """Send what waits for the node to be discovered: the last message of each topic."""
        self._ask_modes()
        for topic in list(self._waiting):
            self._publish(topic, self._waiting.pop(topic))

    def forget_waiting(self) -> None:
        """Drop the messages that wait for a node that is gone."""
        self._waiting.clear()

    def _ask_modes(self) -> None:
        client = self._clients.get('describe_parameters')
        if self._modes is not None or client is None or not client.service_is_ready():
            return
        self._modes = modes = {}

        def answered(future: Any, name: str) -> None:
            for descriptor in future.result().descriptors:
                if match := _CHOICES.fullmatch(descriptor.additional_constraints):
                    modes[name] = match['names'].split(', ')
        # Each by itself: a name that the node does not know leaves its answer empty.
        for name in sorted(self._mode_parameter('', part) for part in self._parts):
            client.call_async(DescribeParameters.Request(names=[name])).add_done_callback(
                partial(answered, name=name))

    def _mode_parameter(self, space: str, part: str) -> str:
        base = f'/{self._name}'.rpartition('/')[0]
        *scope, name = f'{space}{part}'.removeprefix(f'{base}/').strip('/').split('/')
        return '.'.join((*scope, 'control_mode', name))

    def modes(self, space: str, part: str) -> Sequence[str]:
        return (self._modes or {}).get(self._mode_parameter(space, part), ())

    def switch_mode(self, space: str, part: str, mode: str) -> None:
        self._call('set_parameters', SetParameters.Request(parameters=[Parameter(
            name=self._mode_parameter(space, part), value=ParameterValue(
                type=ParameterType.PARAMETER_STRING, string_value=mode))]))

    def move_joints(self, space: str, part: str, field: str, goals: Mapping[str, float]) -> None:
        """Publish goals of joints; see :class:`PageCommands`, as for all further methods."""
        message = JointState(name=list(goals), **{field: list(goals.values())})
        self._publish(name_of(space, '<part>/joint_command', part), message)

    def act(self, space: str, part: str, action: float) -> None:
        size = self._action_sizes.get(f'{space}{part}')
        if size is None:
            self._notify(f'{part}: the length of an action is not known yet')
            return
        self._publish(name_of(space, '<part>/command', part),
                      Float64MultiArray(data=[action] * size))

    def drive(self, space: str, twist: tuple[float, float, float]) -> None:
        message = Twist()
        message.linear.x, message.linear.y, message.angular.z = twist
        self._publish(name_of(space, 'base/cmd_vel'), message)

    def reach(self, space: str, arm: str, position: FloatArray, quat_wxyz: FloatArray) -> None:
        message = PoseStamped()
        message.header.frame_id = self._frames.get((space, arm), 'world')
        at, turn = message.pose.position, message.pose.orientation
        at.x, at.y, at.z = (float(value) for value in position)
        turn.w, turn.x, turn.y, turn.z = (float(value) for value in quat_wxyz)
        self._publish(name_of(space, '<arm>/target_pose', arm), message)

    def pull(self, body: str, number: int, point: FloatArray, target: FloatArray) -> None:
        self._pull(Marker(ns=body, id=number, points=[
            Point(x=x, y=y, z=z) for x, y, z in (point.tolist(), target.tolist())]))

    def let_go(self, body: str) -> None:
        self._pull(Marker(ns=body, action=Marker.DELETE))

    def _pull(self, message: Marker) -> None:
        publisher = self._publishers.get(f'/{self._name}/pull')
        # One that would wait for the node would pull when nobody drags any more.
        if publisher is not None and publisher.get_subscription_count():
            publisher.publish(message)
        elif message.action == Marker.DELETE:
            self._notify('pull: the node does not take pulls')

    def pause(self, paused: bool) -> None:
        self._call('pause', SetBool.Request(data=paused), lambda: self.paused(paused))

    def step(self) -> None:
        self._call('step', Trigger.Request())

    def reset(self) -> None:
        self._call('reset', Trigger.Request())

    def tare(self) -> None:
        self._call('tare_wrench', Trigger.Request())

    def _call(self, name: str, request: Any, done: Callable[[], None] = lambda: None) -> None:
        client = self._clients.get(name)
        if client is None or not client.service_is_ready():
            self._notify(f'{name}: the node does not answer')
            return

        def answered(future: Any) -> None:
            answer = future.result()
            if isinstance(answer, SetParameters.Response):
                success, message = answer.results[0].successful, answer.results[0].reason
            else:
                success, message = answer.success, answer.message
            if success:
                done()
            else:
                self._notify(f'{name}: {message}')
        client.call_async(request).add_done_callback(answered)


_WINDOW_PERIOD_S = 1.0 / 60.0
_LOOK_S = 0.5
#: Aspect ratio of the part of the picture that the panels of the window never cover.
_ASPECT = 0.6
#: Time that a window may take to close [s].
_WINDOW_CLOSING_S = 5.0


def show_native(node: Node, readers: Readers, simulation: str, run_ready: Callable[[], None],
                ended: EndSignals) -> None:
    """Show a node, by its full name without the first slash, until the window or process ends."""
    discovery = Discovery(node, readers, simulation)
    states = States(node, readers, simulation, discovery.base)
    print(f'sim_view: waiting for the node /{simulation}', flush=True)
    while not ended.wait(0.0):
        while discovery.model is None:
            if ended.wait(_LOOK_S / 5.0):
                return
            run_ready()
            discovery.look()
        models = discovery.models
        posture = Kinematics(discovery.model)
        with _open_window(posture) as window:
            with window.lock():
                aim(window.cam, *first_view(posture.model, posture.data, _ASPECT))
            print(f'sim_view: a window shows /{simulation}', flush=True)
            look_s = 0.0
            while window.is_running() and discovery.models == models:
                if ended.wait(_WINDOW_PERIOD_S):
                    return
                run_ready()
                if time.monotonic() > look_s:
                    look_s = time.monotonic() + _LOOK_S
                    discovery.look()
                    if discovery.layout is not None:
                        states.listen(discovery.layout)
                with window.lock():
                    for joints in states.latest.joints.values():
                        posture.set_joints(joints.names, joints.position)
                    for name, pose in states.latest.objects.items():
                        posture.place(name, pose.position, pose.quat_wxyz)
                    posture.compute()
                window.sync()
            if not window.is_running():
                return


@contextlib.contextmanager
def _open_window(posture: Kinematics) -> Iterator[mujoco.viewer.Handle]:
    """Open a window, and close it; its thread must not outlive the interpreter."""
    others = set(threading.enumerate())
    with mujoco.viewer.launch_passive(posture.model, posture.data) as window:
        drawing = set(threading.enumerate()) - others
        yield window
    for thread in drawing:
        thread.join(_WINDOW_CLOSING_S)


def aim(camera: mujoco.MjvCamera, position: NDArray[np.float64], target: NDArray[np.float64]
        ) -> None:
    """Let a free camera look from a position to a target in ``world`` [m], shape (3,) each."""
    way = target - position
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.lookat = target
    camera.distance = np.linalg.norm(way)
    camera.azimuth = math.degrees(math.atan2(way[1], way[0]))
    camera.elevation = math.degrees(math.atan2(way[2], math.hypot(way[0], way[1])))


#: Longest wait for a record to be completed when the viewer ends [s].
_CLOSING_S = 10.0


class NodeRecording:
    """
    A record that begins and ends when people say so.

    :param node: full name of the node, such as ``/manip_sim``
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

    :param simulation: full name of the node that is seen, without the first slash
    :param commands: whether people can command the node; else there is nothing that could
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
            WARN, 'viewer', f'{pluralize(rejected, "message")} rejected, see its log')]
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
    Serve the page until SIGINT, SIGTERM or SIGHUP, and return the exit code, 0.

    :param arguments: of ROS, such as ``--ros-args -r __ns:=/cell``
    :raises ManipSimError: if it cannot listen, read the saved poses, or start ROS
    """
    ended = EndSignals()
    start_ros(arguments)
    try:
        node: Node = rclpy.create_node('sim_view')
    except RCLError as error:
        raise ManipSimError(without_source(error)) from error
    try:
        simulation = node.resolve_topic_name(options.node).lstrip('/')
        readers = Readers(node)
        executor = PolledExecutor(readers.log)
        executor.add_node(node)
        if options.native:
            show_native(node, readers, simulation, executor.run_ready, ended)
        else:
            _serve(node, readers, simulation, executor, options, ended)
        executor.shutdown()
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    untrusted_models.give_up()
    return leave(0, BACKGROUND_THREAD)


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
