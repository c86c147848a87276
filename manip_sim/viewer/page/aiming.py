# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Aim the cameras of browsers, so that robots and objects are seen beside the panel."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from manip_sim.viewer.page.kinematics import Kinematics
from manip_sim.viewer.page.model_scene import FIELD_OF_VIEW, FIRST, first_view

#: Width of the panel, and of the widest window that has it below.
_PANEL_PIXELS, _PHONE_PIXELS = 400, 576
#: Share of its height that the open panel of a phone covers; the page's style says so.
_SHEET = 0.45
#: Aspect ratio of the first view until a browser has sent the size of its window.
_ASPECT = 1.4
#: Where to look from, by what people choose; x is forward, y to the left.
VIEWS = {'Home': FIRST, 'Front': (1.0, 0.0, 0.2), 'Left': (0.0, 1.0, 0.2),
         'Top': (-0.02, 0.0, 1.0)}
#: Cameras that are nearer to one another are the same [m].
_SAME_M = 0.01


class Aiming:
    """
    The cameras of browsers.

    The server gives every new browser the same first view, whatever the shape of its window. A
    slow browser may apply that view after its camera was aimed, and the button that resets the
    view always does; so any camera found at the first view is aimed again.
    """

    def __init__(self, server: Any) -> None:
        self._server = server
        self._aimed: set[int] = set()
        self._world: object = None

    def begin(self, posture: Kinematics) -> None:
        """
        Set the first view of browsers that come; in another world, that of all browsers.

        Objects that come and go leave the world the same.

        :param posture: what is seen
        """
        world = set(posture.scalar_joints), _fixed_bodies(posture.model)
        if world != self._world:
            self._world = world
            self._aimed.clear()
        camera = self._server.initial_camera
        camera.fov = FIELD_OF_VIEW
        camera.position, camera.look_at = first_view(posture.model, posture.data, _ASPECT)

    def update(self, posture: Kinematics) -> None:
        """Aim the cameras that are new or at the first view, after :meth:`begin`."""
        clients = self._server.get_clients()
        self._aimed &= clients.keys()
        for number, client in clients.items():
            if number not in self._aimed or self._is_at_first_view(client.camera):
                self._aimed.add(number)
                _aim(client.camera, posture)

    def look(self, number: int | None, view: str, posture: Kinematics) -> None:
        """
        Aim the camera of one browser.

        :param number: of the browser; one that is gone is ignored
        :param view: one of :data:`VIEWS`
        :param posture: what is seen
        """
        client = self._server.get_clients().get(number)
        if client is not None and view in VIEWS:
            _aim(client.camera, posture, VIEWS[view])

    def _is_at_first_view(self, camera: Any) -> bool:
        first = self._server.initial_camera
        return bool(np.abs(camera.position - first.position).max() < _SAME_M
                    and np.abs(camera.look_at - first.look_at).max() < _SAME_M)


def _fixed_bodies(model: mujoco.MjModel) -> set[tuple[Any, ...]]:
    """Return names and places of the bodies that never move: the arena, and where robots stand."""
    return {(model.body(i).name, *model.body_pos[i].round(3).tolist())
            for i in range(model.nbody) if model.body_weldid[i] == 0}


def _aim(camera: Any, posture: Kinematics, direction: tuple[float, float, float] = FIRST) -> None:
    width, height = camera.image_width, max(1, camera.image_height)
    # On a phone the panel is below the picture.
    phone = width <= _PHONE_PIXELS
    position, target = first_view(
        posture.model, posture.data, width / height,
        0.0 if phone else min(0.5, _PANEL_PIXELS / width), _SHEET if phone else 0.0,
        direction)
    camera.fov = FIELD_OF_VIEW
    camera.position = position
    camera.look_at = target
