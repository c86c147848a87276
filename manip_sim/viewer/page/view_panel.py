# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What of the scene is shown: frames, names, contacts, wrenches, targets; light or dark."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.viewer.page.aiming import VIEWS
from manip_sim.viewer.page.commands import Events
from manip_sim.viewer.page.hand_target import HandTarget
from manip_sim.viewer.page.latest import Latest
from manip_sim.viewer.page.scene import Scene

_CONTACTS, _FORCES = 'contact_points', 'contact_forces'
_WRENCHES = ('force', 'torque')


class ViewPanel:
    """
    Check boxes for what is shown.

    :param gui: ``viser.ViserServer.gui``
    :param dark: whether the page is dark
    :param targets: those of the hands, by title
    :param set_dark: makes the page dark or light
    :param look: aims the camera of a browser, by its number and the name of a view
    :param events: queue to the thread that updates the page
    """

    def __init__(self, gui: Any, dark: bool, targets: Mapping[str, HandTarget],
                 set_dark: Callable[[bool], None], look: Callable[[int | None, str], None],
                 events: Events) -> None:
        self._scene: Scene | None = None
        gui.add_button_group('Camera', tuple(VIEWS), hint='look at the robot from there').on_click(
            lambda event: events.add(lambda: look(event.client_id, event.target.value)))
        for title, target in targets.items():
            box = gui.add_checkbox(f'Target {title}', False,
                                   hint='drag the hand: arrows move it, arcs turn it')
            box.on_update(lambda _, box=box, target=target: events.add(
                lambda: target.show(box.value)))
        self._contacts = gui.add_checkbox('Contacts', True, hint='points, and forces in yellow')
        self._wrenches = gui.add_checkbox('Wrenches', True, hint='what the world does to the '
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
