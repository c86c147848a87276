# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The whole page: the scene, the panels, and what changes in them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
import itertools
from typing import Any

import mujoco

from manip_sim.quoting import one_line
from manip_sim.viewer.page.latest import (
    command_fields, control_modes, in_words, Latest, Robot, ShownPart, ShownStatus)
from manip_sim.viewer.page.model_scene import BodyLabels, Kinematics, Overlays, Scene
from manip_sim.viewer.page.page_commands import Events, PageCommands, PosePanel, Poses
from manip_sim.viewer.page.panels import (
    CameraPanel, DrivePanel, JointPanel, SavePanel, SimulationPanel, ViewPanel)
from manip_sim.viewer.page.plain_text import PlainText
from manip_sim.viewer.page.pointer import Aiming, EndEffectorTarget, Pulling
from manip_sim.viewer.page.server import save_picture, set_theme
from manip_sim.viewer.page.timeline import LookBack, PlotPanel

#: Parts with more joints, and all parts after the first ones, are folded up at first.
_MANY_JOINTS, _UNFOLDED = 8, 2
_POSITION = 'position'
#: Least time between two updates of the sliders [s].
_SLIDERS_S = 0.1


class Page:
    """
    The content of the page.

    :param commands: receives what people command; None: the page can only be watched
    :param watch: starts or stops listening to the images of a camera
    :param dark: whether it begins dark
    :param poses: those saved before
    """

    def __init__(self, server: Any, commands: PageCommands | None,
                 watch: Callable[[str, bool], None], dark: bool = False,
                 poses: Poses | None = None) -> None:
        self._server, self._commands, self._watch = server, commands, watch
        self._saved_poses = poses or Poses()
        self.events = Events()
        self._dark = dark
        self._posture: Kinematics | None = None
        self._scene: Scene | None = None
        self._labels: BodyLabels
        self._aiming = Aiming(server)
        self._overlays = Overlays(server.scene)
        self._robots: tuple[Robot, ...] = ()
        self._fields: dict[str, str] = {}
        self._modes: dict[str, str] = {}
        self._sliders_s = 0.0
        set_theme(server, dark)
        server.gui.set_panel_label('manip_sim')
        self._build((), ())

    @property
    def is_watched(self) -> bool:
        return bool(self._server.get_clients())

    @property
    def wants_markers(self) -> bool:
        return self._view.wants_markers

    def _build(self, robots: Sequence[Robot], cameras: Sequence[str]) -> None:
        gui, scene = self._server.gui, self._server.scene
        self._robots, self._fields, self._modes = tuple(robots), {}, {}
        self._simulation = SimulationPanel(gui, self._commands, self.events)
        self._look_back = LookBack(gui, self.events)
        self._save = SavePanel(gui, self._commands, partial(save_picture, self._server),
                               self.events)
        self._forget()
        tabs = gui.add_tab_group()
        #: By namespace and part: what the panel was made for, and the panel.
        self._panels: dict[tuple[str, str], tuple[Any, JointPanel | DrivePanel]] = {}
        self._targets: dict[tuple[str, str], EndEffectorTarget] = {}
        self._poses: PosePanel | None = None
        if self._commands is not None:
            self._control = tabs.add_tab('Control')
            with self._control:
                self._poses = PosePanel(gui, self._saved_poses, robots, self._commands,
                                        self.events, self.notify)
            for robot in robots:
                for arm in robot.end_effectors:
                    self._targets[robot.space, arm] = EndEffectorTarget(
                        scene, robot.space, arm, self._commands)
        with tabs.add_tab('View'):
            self._view = ViewPanel(gui, self._dark, {
                robot.titled(arm): self._targets[robot.space, arm]
                for robot in robots for arm in robot.end_effectors
                if self._commands is not None}, self._set_dark, self._look, self.events)
            self._pulling = None if self._commands is None else Pulling(
                gui, self._commands, self.events)
        with tabs.add_tab('Plots') as tab:
            self._plots = PlotPanel(gui, tab, robots)
        with tabs.add_tab('Health'):
            self._health = PlainText(gui, in_words([]))
        with tabs.add_tab('Cameras'):
            self._cameras = CameraPanel(gui, cameras, self._watch, self.events)
        self._attach()

    def _attach(self) -> None:
        if self._scene is not None:
            self._view.attach(self._scene, self._labels)
            if self._pulling is not None:
                self._pulling.attach(self._scene)

    def _look(self, number: int | None, view: str) -> None:
        if self._posture is not None:
            self._aiming.look(number, view, self._posture)

    def _set_dark(self, dark: bool) -> None:
        self._dark = dark
        set_theme(self._server, dark)

    def show_robots(self, robots: Sequence[Robot], cameras: Sequence[str]) -> None:
        """Replace the panels by those for other robots and cameras."""
        self._server.gui.reset()
        for target in self._targets.values():
            target.remove()
        self._build(robots, cameras)

    def show_model(self, model: mujoco.MjModel, latest: Latest) -> None:
        """Replace the model in the scene, at the newest positions of joints and objects."""
        if self._scene is not None:
            self._scene.remove()
            self._labels.show(False)
        self._posture = Kinematics(model)
        self._forget()
        self._take(latest)
        self._scene = Scene(self._server, model, self._posture.data)
        self._labels = BodyLabels(self._server, model)
        self._attach()
        self._aiming.begin(self._posture)

    def show_state(self, state: str, text: str, paused: bool | None = None) -> None:
        self._simulation.show(state, text, paused)

    def show_recording(self, recording: bool) -> None:
        self._save.show(recording)

    def notify(self, text: str, done: bool = False) -> None:
        """Notify all browsers of something that was done, or could not be done."""
        title, color = ('Done', 'green') if done else ('Command failed', 'orange')
        for client in self._server.get_clients().values():
            client.add_notification(title, one_line(text), color=color, auto_close_seconds=8.0)

    def show_diagnostics(self, statuses: Sequence[ShownStatus]) -> None:
        """Show the diagnostics, and take the fields that the sliders command from them."""
        self._health.show(in_words(statuses))
        self._fields, self._modes = command_fields(statuses), control_modes(statuses)

    def update(self, now_s: float, latest: Latest, paused: bool) -> None:
        """
        Send what people have requested, and show the newest states.

        :param now_s: wall time [s]
        :param paused: whether the simulation is paused
        """
        if self._poses is not None:
            self._poses.update(latest, self._fields)
        self.events.run()
        for _, panel in self._panels.values():
            panel.send(now_s)
        for key, target in self._targets.items():
            target.send()
            if key in latest.end_effectors:
                pose = latest.end_effectors[key]
                target.follow(now_s, pose.position, pose.quat_wxyz, paused)
        if self._posture is not None and self._scene is not None:
            self._take(latest, now_s)
            self._scene.update(self._posture.data)
            self._aiming.update(self._posture)
            self._labels.update(now_s, self._posture)
        self._show_overlays(now_s, latest)
        self._cameras.show(now_s, latest.images, self.is_watched)
        self._plots.show(now_s, latest)
        if now_s > self._sliders_s + _SLIDERS_S:
            self._sliders_s = now_s
            self._follow(now_s, latest, paused)

    def _show_overlays(self, now_s: float, latest: Latest) -> None:
        if self._look_back.shown is not None:
            self._overlays.clear()
            if self._pulling is not None:  # The picture shows bodies where they were.
                self._pulling.release()
            return
        points, arrows = self._view.chosen(latest)
        if self._pulling is not None and self._posture is not None:
            self._pulling.send(now_s)
            arrows['pull'] = self._pulling.arrow(self._posture)
        self._overlays.show(points, arrows)

    def _forget(self) -> None:
        """Let the last minute begin now, as earlier instants show another world."""
        if self._posture is not None:
            self._look_back.forget(self._posture.model.nq)

    def _take(self, latest: Latest, now_s: float = 0.0) -> None:
        """Let the posture be the newest one, or the one that a person looks back at."""
        assert self._posture is not None
        for states in latest.joints.values():
            self._posture.set_joints(states.names, states.position)
        for name, pose in latest.objects.items():
            self._posture.place(name, pose.position, pose.quat_wxyz)
        if latest.joints:
            time_s = next(iter(latest.joints.values())).time_s
            self._look_back.update(now_s, time_s, self._posture.data.qpos)
        if self._look_back.shown is not None:
            self._posture.data.qpos[:] = self._look_back.shown
        self._posture.compute()

    def _follow(self, now_s: float, latest: Latest, paused: bool) -> None:
        if not self._fields or self._commands is None:  # Sliders depend on them.
            return
        numbers = itertools.count()
        for robot in self._robots:
            states = latest.joints.get(robot.space)
            measured = () if states is None else (
                dict(zip(states.names, states.position)), dict(zip(states.names, states.velocity)))
            for part in robot.parts:
                name = robot.status_name(part.name)
                panel = self._panel(self._commands, robot, part,
                                    self._fields.get(name, _POSITION), next(numbers))
                if name in self._modes:
                    panel.mode.show(now_s, self._modes[name])
                if measured and isinstance(panel, JointPanel):
                    panel.show(now_s, *measured, paused)

    def _panel(self, commands: PageCommands, robot: Robot, part: ShownPart, field: str, number: int
               ) -> JointPanel | DrivePanel:
        """Return the panel of a part for its present commands and control modes."""
        key = robot.space, part.name
        drives = part.name == 'base' and robot.twist is not None and field == 'velocity'
        needs = field, drives, tuple(commands.modes(*key))
        made_for, panel = self._panels.get(key, (None, None))
        if panel is not None and made_for == needs:
            return panel
        if panel is not None:
            panel.remove()
        gui = self._server.gui
        with self._control:
            panel = DrivePanel(gui, robot, commands, self.events) if drives else JointPanel(
                gui, robot, part, field, commands, self.events, order=float(number),
                folded=len(part.joints) > _MANY_JOINTS or number >= _UNFOLDED)
        self._panels[key] = needs, panel
        return panel
