# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Connect the page to the node, and keep the page up to date; all in one thread."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import PoseStamped, Twist
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from visualization_msgs.msg import Marker

from manip_sim.quoting import counted
from manip_sim.viewer.page.diagnosis import ShownStatus, WARN
from manip_sim.viewer.page.latest import RealTimeFactor
from manip_sim.viewer.page.page import Page
from manip_sim.viewer.page.saved_poses import Poses
from manip_sim.viewer.ros.command_sender import CommandSender
from manip_sim.viewer.ros.discovery import Discovery
from manip_sim.viewer.ros.readers import Readers
from manip_sim.viewer.ros.states import States

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
    """

    def __init__(self, node: Node, readers: Readers, simulation: str, server: Any, dark: bool,
                 commands: bool = True, poses: Poses | None = None) -> None:
        self._name, self._readers = simulation, readers
        self._discovery = Discovery(node, readers, simulation)
        self._states = States(node, readers, simulation, self._discovery.base)
        self._states.on_statuses = self._diagnosed
        self._sender: CommandSender | None = None
        if commands:
            self._sender = CommandSender(node, simulation, self._states.frames, self._complain)
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

    def _complain(self, text: str) -> None:
        self._page.show_trouble(text)

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
        """
        Look at the node and bring the page up to date, after callbacks have run.

        :param now_s: wall time [s]
        """
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
            for part in robot.parts:
                topics[f'{robot.space}{part}/joint_command'] = JointState
                if part.endswith('/gripper'):
                    topics[f'{robot.space}{part}/command'] = Float64MultiArray
            for arm in robot.hands:
                topics[f'{robot.space}{arm}/target_pose'] = PoseStamped
            if robot.drives:
                topics[f'{robot.space}base/cmd_vel'] = Twist
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
