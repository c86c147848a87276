# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The panels of the page for the simulation, the view and the cameras."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import FloatArray
from manip_sim.viewer.page.aiming import VIEWS
from manip_sim.viewer.page.hand_target import HandTarget
from manip_sim.viewer.page.latest import Latest
from manip_sim.viewer.page.model_scene import Scene
from manip_sim.viewer.page.page_commands import Events, PageCommands
from manip_sim.viewer.page.plain_text import Line, plain, PlainText

_COLORS = {'running': '#2f9e44', 'paused': '#f08c00', 'waiting': '#868e96', 'gone': '#e03131',
           'trouble': '#e8590c'}


class SimulationPanel:
    """
    A line of state and the buttons of the whole simulation.

    :param commands: receives what people command; None: there are no buttons
    """

    def __init__(self, gui: Any, commands: PageCommands | None, events: Events) -> None:
        self._paused = False
        self._buttons: Any = None
        self._state = PlainText(gui)
        if commands is not None:
            self._add_buttons(gui, commands, events)

    def _add_buttons(self, gui: Any, commands: PageCommands, events: Events) -> None:
        self._buttons = gui.add_button_group(
            'Simulation', ('Pause', 'Step'),
            hint='Step: one control period of a paused simulation')
        self._again = gui.add_button_group(
            'Start again', ('Reset', 'Tare'),
            hint='Reset: back to the start. Tare: let the external wrenches read zero now')

        def pressed(event: Any) -> None:
            what = event.target.value
            if what == 'Step':
                events.add(commands.step)
            elif what in ('Pause', 'Resume'):
                events.add(lambda: commands.pause(what == 'Pause'))
        self._buttons.on_click(pressed)
        again = {'Reset': commands.reset, 'Tare': commands.tare}
        self._again.on_click(lambda event: events.add(
            again.get(event.target.value, lambda: None)))

    def show(self, state: str, text: str, paused: bool | None = None) -> None:
        """
        Show the state of the simulation.

        :param state: ``running``, ``paused``, ``trouble``, ``waiting`` or ``gone``
        :param text: the details
        :param paused: whether it is paused, so that the button resumes it; None if not known
        """
        self._state.show([Line(text, color=_COLORS[state])])
        if paused is not None and paused != self._paused:
            self._paused = paused
            if self._buttons is not None:
                self._buttons.options = ('Resume' if paused else 'Pause', 'Step')


_CONTACTS, _FORCES = 'contact_points', 'contact_forces'
_WRENCHES = ('force', 'torque')


class ViewPanel:
    """
    Check boxes for what is shown.

    :param dark: whether the page is dark
    :param targets: those of the hands, by title
    :param set_dark: makes the page dark or light
    :param look: aims the camera of a browser, by its number and the name of a view
    """

    def __init__(self, gui: Any, dark: bool, targets: Mapping[str, HandTarget],
                 set_dark: Callable[[bool], None], look: Callable[[int | None, str], None],
                 events: Events) -> None:
        self._scene: Scene | None = None
        gui.add_button_group('Camera', tuple(VIEWS), hint='look at the robot from there').on_click(
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

    def attach(self, scene: Scene) -> None:
        """Let the boxes act on this scene from now on."""
        self._scene = scene
        self._apply()

    def _apply(self) -> None:
        if self._scene is not None:
            self._scene.show_frames(bool(self._frames.value))
            self._scene.show_names(bool(self._names.value))
            self._scene.show_collision(bool(self._collision.value))

    @property
    def wants_markers(self) -> bool:
        """Whether contacts or wrenches are shown."""
        return bool(self._contacts.value or self._wrenches.value)

    def chosen(self, latest: Latest) -> tuple[FloatArray, dict[str, FloatArray]]:
        """Return the points and arrows to be shown: those whose boxes are ticked."""
        points = latest.contacts if self._contacts.value else np.zeros((0, 3))
        shown = ((_FORCES,) if self._contacts.value else ()) + (
            _WRENCHES if self._wrenches.value else ())
        return points, {what: latest.arrows[what] for what in shown if what in latest.arrows}


#: Least time between two images of a camera [s].
_PERIOD_S = 0.1
_QUALITY = 80


class CameraPanel:
    """
    A box to tick for each camera, and its image below.

    :param cameras: names
    :param watch: starts or stops listening to the images of a camera
    """

    def __init__(self, gui: Any, cameras: Iterable[str], watch: Callable[[str, bool], None],
                 events: Events) -> None:
        self._gui, self._watch = gui, watch
        self._images: dict[str, Any] = {}
        self._shown_s: dict[str, float] = {}
        self._folders = {name: gui.add_folder(plain(name)) for name in cameras}
        for name, folder in self._folders.items():
            with folder:
                box = gui.add_checkbox('Show', False, hint=f'the images of {plain(name)}')
            self._couple(name, box, events)
        if not self._folders:
            PlainText(gui, [Line('The node has no cameras. Start it with, for example, '
                                 '-p "cameras:=[birdview]".')])

    def _couple(self, name: str, box: Any, events: Events) -> None:
        box.on_update(lambda _: events.add(lambda: self._tick(name, bool(box.value))))

    def _tick(self, name: str, wanted: bool) -> None:
        self._watch(name, wanted)
        if not wanted and name in self._images:
            self._images.pop(name).remove()

    def show(self, now_s: float, images: dict[str, NDArray[Any]], wanted: bool) -> None:
        """
        Show images, each at most ten times a second; ``now_s`` is wall time [s].

        :param images: by camera, shape (h, w, 3); those that are due are removed
        :param wanted: whether any browser shows the page
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
