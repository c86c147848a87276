# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The whole page: the scene, the panels, and what changes in them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
import itertools
import math
import time
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import FloatArray
from manip_sim.quoting import one_line
from manip_sim.viewer.page.interaction import (
    Aiming, EndEffectorTarget, Events, Following, PageCommands, PosePanel, Poses, Pulling, VIEWS)
from manip_sim.viewer.page.latest import (
    command_fields, control_modes, in_words, Latest, Line, plain, PlainText, Robot, ShownJoint,
    ShownPart, ShownStatus)
from manip_sim.viewer.page.model_scene import BodyLabels, Kinematics, Overlays, Scene
from manip_sim.viewer.page.server import save_picture, set_theme
from manip_sim.viewer.page.timeline import LookBack, PlotPanel

_COLORS = {'running': '#2f9e44', 'paused': '#f08c00', 'waiting': '#868e96', 'gone': '#e03131',
           'trouble': '#e8590c'}


class SimulationPanel:
    """A line of state and, if people can command, the buttons of the whole simulation."""

    def __init__(self, gui: Any, commands: PageCommands | None, events: Events) -> None:
        self._paused = False
        self._buttons: Any = None
        self._state = PlainText(gui)
        if commands is None:
            return
        actions = {'Pause': lambda: commands.pause(True), 'Resume': lambda: commands.pause(False),
                   'Step': commands.step, 'Reset': commands.reset, 'Tare wrench': commands.tare}
        self._buttons = gui.add_button_group('Simulation', ('Pause', 'Step', 'Reset'))
        for buttons in (self._buttons, gui.add_button_group('Sensors', ('Tare wrench',))):
            buttons.on_click(lambda event: events.add(
                actions.get(event.target.value, lambda: None)))

    def show(self, state: str, text: str, paused: bool | None = None) -> None:
        """
        Show the state of the simulation.

        :param state: ``running``, ``paused``, ``trouble``, ``waiting`` or ``gone``
        :param paused: whether it is paused, so that the button resumes it; None if not known
        """
        self._state.show([Line(text, color=_COLORS[state])])
        if paused is not None and paused != self._paused:
            self._paused = paused
            if self._buttons is not None:
                self._buttons.options = ('Resume' if paused else 'Pause', 'Step', 'Reset')


_PICTURE, _RECORD, _STOP = 'Picture', 'Record', 'Stop recording'


class SavePanel:
    """
    Buttons that save a picture of the scene and, if people can command, a record of the node.

    :param picture: lets a browser, by its number, save what it shows
    """

    def __init__(self, gui: Any, commands: PageCommands | None,
                 picture: Callable[[int | None], None], events: Events) -> None:
        self._records = commands is not None
        self._buttons = gui.add_button_group(
            'Save', (_PICTURE, _RECORD) if self._records else (_PICTURE,))

        def pressed(event: Any) -> None:
            label, number = event.target.value, event.client_id
            if label == _PICTURE:
                events.add(lambda: picture(number))
            elif commands is not None and label in (_RECORD, _STOP):
                events.add(lambda: commands.record(label == _RECORD))
        self._buttons.on_click(pressed)

    def show(self, recording: bool) -> None:
        """Show whether the node is recorded."""
        options = (_PICTURE, _STOP if recording else _RECORD)
        if self._records and self._buttons.options != options:
            self._buttons.options = options


_FORCES = 'contact_forces'
_WRENCHES = ('force', 'torque')


class ViewPanel:
    """Buttons that aim the camera of a browser, by its number, and boxes of visible things."""

    def __init__(self, gui: Any, dark: bool, targets: Mapping[str, EndEffectorTarget],
                 set_dark: Callable[[bool], None], look: Callable[[int | None, str], None],
                 events: Events) -> None:
        self._scene: Scene | None = None
        gui.add_button_group('Camera', tuple(VIEWS)).on_click(
            lambda event: events.add(lambda: look(event.client_id, event.target.value)))
        for title, target in targets.items():
            box = gui.add_checkbox(f'Target {title}', False,
                                   hint='drag the target: arrows move it, arcs turn it')
            box.on_update(lambda _, box=box, target=target: events.add(
                lambda: target.show(box.value)))
        self._contacts = gui.add_checkbox('Contacts', True, hint='points, and forces in yellow')
        self._wrenches = gui.add_checkbox('Wrenches', True, hint='what the world exerts on the '
                                          'tools: forces red, torques blue')
        self._frames = gui.add_checkbox('Frames', False, hint='x red, y green, z blue')
        self._names = gui.add_checkbox('Names', False, hint='of the bodies that move')
        self._collision = gui.add_checkbox('Collision', False, hint='the shapes that collide')
        dark_box = gui.add_checkbox('Dark', dark)
        for box in (self._frames, self._names, self._collision):
            box.on_update(lambda _: events.add(self._apply))
        dark_box.on_update(lambda _: events.add(lambda: set_dark(bool(dark_box.value))))

    def attach(self, scene: Scene, labels: BodyLabels) -> None:
        """Let the boxes act on this scene and the names of its bodies from now on."""
        self._scene, self._labels = scene, labels
        self._apply()

    def _apply(self) -> None:
        if self._scene is not None:
            self._scene.show_frames(bool(self._frames.value))
            self._labels.show(bool(self._names.value))
            self._scene.show_collision(bool(self._collision.value))

    @property
    def wants_markers(self) -> bool:
        return bool(self._contacts.value or self._wrenches.value)

    def chosen(self, latest: Latest) -> tuple[FloatArray, dict[str, FloatArray]]:
        """Return the points and arrows to be shown: those whose boxes are ticked."""
        points = latest.contacts if self._contacts.value else np.zeros((0, 3))
        shown = ((_FORCES,) if self._contacts.value else ()) + (
            _WRENCHES if self._wrenches.value else ())
        return points, {name: latest.arrows[name] for name in shown if name in latest.arrows}


#: Least time between two images of a camera [s].
_PERIOD_S = 0.1
_QUALITY = 80


class CameraPanel:
    """A box to tick for each camera, which lets listen to its images, and its image below."""

    def __init__(self, gui: Any, cameras: Iterable[str], watch: Callable[[str, bool], None],
                 events: Events) -> None:
        self._gui, self._watch = gui, watch
        self._images: dict[str, Any] = {}
        self._shown_s: dict[str, float] = {}
        self._folders = {name: gui.add_folder(plain(name)) for name in cameras}
        for name, folder in self._folders.items():
            with folder:
                box = gui.add_checkbox('Show', False, hint=f'the images of {plain(name)}')
            box.on_update(lambda _, name=name, box=box: events.add(
                lambda: self._tick(name, bool(box.value))))
        if not self._folders:
            PlainText(gui, [Line('The node has no cameras. Start it with, for example, '
                                 '-p "cameras:=[birdview]".')])

    def _tick(self, name: str, wanted: bool) -> None:
        self._watch(name, wanted)
        if not wanted and name in self._images:
            self._images.pop(name).remove()

    def show(self, now_s: float, images: dict[str, NDArray[Any]], wanted: bool) -> None:
        """
        Show images, each at most ten times a second; ``now_s`` is wall time [s].

        :param images: by camera, shape (h, w, 3); those that are due are removed
        """
        for name in list(images):
            if now_s < self._shown_s.get(name, 0.0) + _PERIOD_S:
                continue
            pixels = images.pop(name)
            if not wanted or name not in self._folders:
                continue
            self._shown_s[name] = now_s
            if name in self._images:
                self._images[name].image = pixels
            else:
                with self._folders[name]:
                    self._images[name] = self._gui.add_image(pixels, jpeg_quality=_QUALITY)


#: Steps of a slider under the mouse; the least step [rad or m ...], and the decimal digits shown.
_STEPS, _RESOLUTION, _DIGITS = 500, 1e-4, 4
#: A joint that is slower is still [steps of the slider per second].
_STILL = 2.0
#: Time after which velocities and efforts other than zero are sent again [s]; the timeouts of the
#: node are longer.
_REPEAT_S = 0.1


def rounded_inward(low: float, high: float) -> tuple[float, float]:
    """Return a range of few digits inside another: what a slider sends is within the limits."""
    inner = (round(math.ceil(low / _RESOLUTION) * _RESOLUTION, _DIGITS),
             round(math.floor(high / _RESOLUTION) * _RESOLUTION, _DIGITS))
    return inner if inner[0] < inner[1] else (low, high)


def _marks(low: float, high: float) -> tuple[tuple[float, str], tuple[float, str]]:
    """Return the ends of a slider with their numbers, short enough to stand below it."""
    digits = 2 if high - low >= 1.0 else 3
    return tuple((end, f'{round(end, digits) + 0.0:.{digits}f}'.rstrip('0').rstrip('.'))
                 for end in (low, high))  # type: ignore[return-value]


class ModeChoice:
    """A list of the control modes of a part; there is none if the part has no choice."""

    def __init__(self, gui: Any, robot: Robot, part: str, commands: PageCommands, events: Events
                 ) -> None:
        modes = commands.modes(robot.space, part)
        self._choice = None
        if len(modes) > 1:
            self._choice = choice = gui.add_dropdown('Mode', tuple(modes))
            self._following = Following()

            def chosen(event: Any) -> None:
                if event.client_id is not None:  # Otherwise this program changed it.
                    self._following.asked(time.monotonic())
                    events.add(lambda: commands.switch_mode(
                        robot.space, part, str(choice.value)))
            choice.on_update(chosen)

    def show(self, now_s: float, mode: str) -> None:
        """Show the mode that the node reports, unless a person has just chosen another one."""
        choice = self._choice
        if choice is None or choice.value == mode or not self._following.follows(now_s, False):
            return
        if mode not in choice.options:  # Such as that of two arms with a mode each.
            choice.options = (*choice.options, mode)
        choice.value = mode


class JointPanel:
    """A folder with a slider for each joint of a part."""

    def __init__(self, gui: Any, robot: Robot, part: ShownPart, field: str, commands: PageCommands,
                 events: Events, folded: bool = False, order: float = 0.0) -> None:
        self.field = field
        self._robot, self._part = robot, part
        self._commands, self._events = commands, events
        self._sliders: dict[str, Any] = {}
        self._following: dict[str, Following] = {}
        self._asked: dict[str, float] = {}
        self._repeat_s = 0.0
        units = {joint.unit(field) for joint in part.joints}
        self._unit_shown = len(units) > 1
        title = robot.titled(part.name.replace('/', ' '))
        if field != 'position':
            title = f'{title} {field}'
        self.folder = gui.add_folder(f'{title} [{units.pop()}]' if len(units) == 1 else title,
                                     expand_by_default=not folded, order=order)
        with self.folder:
            if part.is_gripper:
                gui.add_button_group('Fingers', ('Open', 'Close')).on_click(
                    lambda event: events.add(lambda: commands.act(
                        robot.space, part.name, 1.0 if event.target.value == 'Close' else -1.0)))
            self.mode = ModeChoice(gui, robot, part.name, commands, events)
            for joint in part.joints:
                self._add_slider(gui, joint)
            if field != 'position':
                gui.add_button('Stop').on_click(lambda _: events.add(self.stop))

    def _add_slider(self, gui: Any, joint: ShownJoint) -> None:
        low, high = rounded_inward(*joint.ranges[self.field])
        unit = joint.unit(self.field)
        slider = gui.add_slider(
            f'{joint.label} [{unit}]' if self._unit_shown else joint.label, min=low, max=high,
            step=max(_RESOLUTION, round((high - low) / _STEPS, _DIGITS)),
            initial_value=min(max(0.0, low), high),
            marks=_marks(low, high), hint=f'{self.field} of {plain(joint.name)} [{unit}]')
        slider.precision = _DIGITS
        self._sliders[joint.name], self._following[joint.name] = slider, Following()

        def moved(event: Any) -> None:
            if event.client_id is not None:  # Otherwise this program changed it.
                self._following[joint.name].asked(time.monotonic())
                self._events.add(lambda: self._asked.update({joint.name: float(slider.value)}))
        slider.on_update(moved)

    def stop(self) -> None:
        for slider in self._sliders.values():
            slider.value = 0.0
        self._asked = dict.fromkeys(self._sliders, 0.0)

    def send(self, now_s: float) -> None:
        """Send what people have requested since the last call; wall time [s]."""
        asked, self._asked = self._asked, {}
        if self.field != 'position' and now_s > self._repeat_s + _REPEAT_S:
            asked = {**{name: float(slider.value) for name, slider in self._sliders.items()
                        if slider.value != 0.0}, **asked}
        if asked:
            self._repeat_s = now_s
            self._commands.move_joints(self._robot.space, self._part.name, self.field, asked)

    def show(self, now_s: float, positions: Mapping[str, float], velocities: Mapping[str, float],
             paused: bool) -> None:
        """
        Let the sliders follow the measured positions, if these are commanded.

        :param now_s: wall time [s]
        :param positions: by joint [rad or m]
        :param velocities: by joint [rad/s or m/s]
        :param paused: whether the simulation is paused, so that nothing can move
        """
        if self.field != 'position':
            return
        for name, slider in self._sliders.items():
            if name not in positions:
                continue
            moving = paused or abs(velocities.get(name, 0.0)) > _STILL * slider.step
            if not self._following[name].follows(now_s, moving):
                continue
            value = min(max(round(positions[name], _DIGITS), slider.min), slider.max)
            if abs(value - slider.value) > 0.5 * _RESOLUTION:
                slider.value = value


class DrivePanel:
    """Sliders for the velocity of a mobile base in its own frame."""

    def __init__(self, gui: Any, robot: Robot, commands: PageCommands, events: Events) -> None:
        assert robot.twist is not None
        self._robot, self._commands = robot, commands
        self._stopped = True
        self._sent_s = 0.0
        self.folder = gui.add_folder(robot.titled('base'), order=-1.0)
        with self.folder:
            self.mode = ModeChoice(gui, robot, 'base', commands, events)
            self._sliders = [gui.add_slider(
                f'{label} [{unit}]', min=-limit, max=limit, step=limit / 50.0, initial_value=0.0,
                marks=_marks(-limit, limit),
                hint=f'velocity of the base {direction} [{unit}]')
                for label, direction, unit, limit in zip(
                    ('forward', 'left', 'turn'),
                    ('along its x', 'along its y', 'about its z, to the left'),
                    ('m/s', 'm/s', 'rad/s'), robot.twist)]
            gui.add_button('Stop').on_click(lambda _: events.add(self.stop))

    def stop(self) -> None:
        for slider in self._sliders:
            slider.value = 0.0

    def send(self, now_s: float) -> None:
        """Send the velocity again while it is not zero, and zero once; wall time [s]."""
        x, y, yaw = (float(slider.value) for slider in self._sliders)
        still = x == y == yaw == 0.0
        if still and self._stopped or not still and now_s < self._sent_s + _REPEAT_S:
            return
        self._stopped, self._sent_s = still, now_s
        self._commands.drive(self._robot.space, (x, y, yaw))


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
        """Send what people have requested, and show the newest states; wall time [s]."""
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
            panel.folder.remove()
        gui = self._server.gui
        with self._control:
            panel = DrivePanel(gui, robot, commands, self.events) if drives else JointPanel(
                gui, robot, part, field, commands, self.events, order=float(number),
                folded=len(part.joints) > _MANY_JOINTS or number >= _UNFOLDED)
        self._panels[key] = needs, panel
        return panel
