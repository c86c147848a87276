# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Aim the view at bodies, and pull bodies, with the pointer."""

from __future__ import annotations

from dataclasses import dataclass
import itertools
import random
import time
from typing import Any

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.viewer.page.model_scene import FIELD_OF_VIEW, FIRST, first_view, Kinematics, Scene
from manip_sim.viewer.page.page_commands import Events, Following, PageCommands

#: Width of the panel, and of the widest window that has it below.
_PANEL_PIXELS, _PHONE_PIXELS = 400, 576
#: Share of its height that the open panel of a phone covers; the page's style says so.
_SHEET = 0.45
#: Aspect ratio of the first view until a browser has sent the size of its window.
_ASPECT = 1.4
#: Directions of view, by their names in the menu; x is forward, y to the left.
VIEWS = {'Home': FIRST, 'Front': (1.0, 0.0, 0.2), 'Left': (0.0, 1.0, 0.2),
         'Top': (-0.02, 0.0, 1.0)}
#: Cameras that are nearer to one another are the same [m].
_SAME_M = 0.01


@dataclass(frozen=True)
class _Aimed:
    """
    The place and the target of a camera that was aimed, for a window of a size [pixels].

    :ivar direction: of view
    """

    position: FloatArray
    look_at: FloatArray
    size: tuple[int, int]
    direction: tuple[float, float, float]


class Aiming:
    """
    The cameras of browsers.

    The server gives every new browser the same first view, whatever the shape of its window. A
    slow browser may apply that view after its camera was aimed, and the button that resets the
    view always does; so any camera found at the first view is aimed again. So is one that nobody
    has moved since, in a window of another size, such as that of a phone that was turned.
    """

    def __init__(self, server: Any) -> None:
        self._server = server
        self._aimed: dict[int, _Aimed] = {}
        self._world: object = None

    def begin(self, posture: Kinematics) -> None:
        """
        Set the first view of browsers that come; in another world, that of all browsers.

        Objects that come and go leave the world the same.

        :param posture: of the world in view
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
        self._aimed = {number: aimed for number, aimed in self._aimed.items() if number in clients}
        for number, client in clients.items():
            camera, aimed = client.camera, self._aimed.get(number)
            if aimed is None or _is_at(camera, self._server.initial_camera):
                self._aimed[number] = _aim(camera, posture, FIRST)
            elif aimed.size != _size(camera) and _is_at(camera, aimed):
                self._aimed[number] = _aim(camera, posture, aimed.direction)

    def look(self, number: int | None, view: str, posture: Kinematics) -> None:
        """
        Aim the camera of one browser.

        :param number: of the browser; one that is gone is ignored
        :param view: one of :data:`VIEWS`
        :param posture: of the world in view
        """
        client = self._server.get_clients().get(number)
        if number is not None and client is not None and view in VIEWS:
            self._aimed[number] = _aim(client.camera, posture, VIEWS[view])


def _is_at(camera: Any, other: Any) -> bool:
    """Return whether a camera is where another one is, and looks at the same."""
    return bool(np.abs(camera.position - other.position).max() < _SAME_M
                and np.abs(camera.look_at - other.look_at).max() < _SAME_M)


def _size(camera: Any) -> tuple[int, int]:
    """Return width and height of the window of a camera [pixels]."""
    return camera.image_width, max(1, camera.image_height)


def _fixed_bodies(model: mujoco.MjModel) -> set[tuple[Any, ...]]:
    """Return names and places of the bodies that never move: the arena, and where robots stand."""
    return {(model.body(i).name, *model.body_pos[i].round(3).tolist())
            for i in range(model.nbody) if model.body_weldid[i] == 0}


def _aim(camera: Any, posture: Kinematics, direction: tuple[float, float, float]) -> _Aimed:
    width, height = _size(camera)
    # On a phone the panel is below the picture.
    phone = width <= _PHONE_PIXELS
    position, target = first_view(
        posture.model, posture.data, width / height,
        0.0 if phone else min(0.5, _PANEL_PIXELS / width), _SHEET if phone else 0.0,
        direction)
    camera.fov = FIELD_OF_VIEW
    camera.position = position
    camera.look_at = target
    return _Aimed(position, target, (width, height), direction)


_SCALE = 0.18
#: An end effector that moves less between two calls [m] is still.
_STILL_M = 2e-4
_SAME = 1e-4


class EndEffectorTarget:
    """
    The target of one end effector.

    :param space: namespace of the robot's topics, such as ``/left/``
    :param arm: whose end effector it is
    """

    def __init__(self, scene: Any, space: str, arm: str, commands: PageCommands) -> None:
        self._space, self._arm, self._commands = space, arm, commands
        self._following = Following()
        self._asked = False
        self._last = np.zeros(3)
        self._dragged = False
        self._control = scene.add_transform_controls(
            f'/targets{space}{arm}', scale=_SCALE, visible=False, depth_test=False, opacity=0.85)
        self._control.on_update(self._moved)

    def _moved(self, event: Any) -> None:
        self._dragged = event.phase != 'end'
        self._following.asked(time.monotonic())
        if event.phase == 'update':
            self._asked = True

    def show(self, shown: bool) -> None:
        self._control.visible = shown

    def send(self) -> None:
        """Send its pose if it has been dragged since the last call."""
        if self._asked:
            self._asked = False
            self._commands.reach(self._space, self._arm, np.array(self._control.position),
                                 np.array(self._control.wxyz))

    def follow(self, now_s: float, position: FloatArray, quat_wxyz: FloatArray,
               paused: bool) -> None:
        """
        Move the target to the end effector, unless the end effector is on its way to the target.

        :param now_s: wall time [s]
        :param position: of the end effector in ``world`` [m]
        :param quat_wxyz: of the end effector
        :param paused: whether the simulation is paused, so that nothing can move
        """
        moving = paused or self._dragged or np.linalg.norm(position - self._last) > _STILL_M
        self._last = position
        if not self._control.visible or not self._following.follows(now_s, bool(moving)):
            return
        if np.abs(position - self._control.position).max() > _SAME:
            self._control.position = position
        if 1.0 - abs(float(quat_wxyz @ self._control.wxyz)) > _SAME ** 2:
            self._control.wxyz = quat_wxyz

    def remove(self) -> None:
        self._control.remove()


#: A pull of the node ends 0.2 s after it was last asked for; time between two requests [s].
_PERIOD_S = 0.05
#: So that the pulls of two pages are two.
_FIRST = 2**30


@dataclass
class _Drag:
    """
    A body that a person drags.

    :ivar number: of the drag
    :ivar body: its name
    :ivar begin: where it was taken hold of, in ``world`` [m], shape (3,)
    :ivar target: where the mouse is, in ``world`` [m], shape (3,)
    :ivar held: where it was taken hold of, in the frame of the body; None until it is known
    """

    number: int
    body: str
    begin: FloatArray
    target: FloatArray
    held: FloatArray | None = None


class Pulling:
    """A box to tick, and while it is ticked, bodies that can be dragged."""

    def __init__(self, gui: Any, commands: PageCommands, events: Events) -> None:
        self._commands, self._events = commands, events
        self._scene: Scene | None = None
        self._drag: _Drag | None = None
        self._numbers = itertools.count(random.randrange(_FIRST))
        self._sent_s = 0.0
        self._box = gui.add_checkbox('Pull', False, hint='drag objects and links: a spring pulls '
                                     'them to the mouse. Beside them, the mouse turns the view')
        self._box.on_update(lambda _: events.add(self._apply))

    def attach(self, scene: Scene) -> None:
        """Let the bodies of this scene be dragged from now on."""
        self._scene = scene
        self._apply()

    def _apply(self) -> None:
        self.release()
        if self._scene is not None:
            self._scene.let_drag(self._dragged if self._box.value else None)

    def _dragged(self, body: str, phase: str, begin: Any, end: Any) -> None:
        """Queue what the mouse does; called by the server, with what a browser sent."""
        try:
            ends = np.array([begin, end], dtype=float)
        except (TypeError, ValueError):
            return
        if ends.shape == (2, 3) and np.isfinite(ends).all():
            self._events.add(lambda: self._follow(body, phase, ends))

    def _follow(self, body: str, phase: str, ends: FloatArray) -> None:
        if phase == 'end':
            self.release()
        elif not self._box.value:
            return
        elif phase == 'start':
            self.release()
            self._drag = _Drag(next(self._numbers), body, ends[0], ends[1])
        elif self._drag is not None:
            self._drag.target = ends[1]

    def release(self) -> None:
        if self._drag is not None:
            self._commands.let_go(self._drag.body)
            self._drag = None

    def send(self, now_s: float) -> None:
        """Ask for the pull again if it is due; ``now_s`` is wall time [s]."""
        drag = self._drag
        if drag is not None and now_s >= self._sent_s + _PERIOD_S:
            self._sent_s = now_s
            self._commands.pull(drag.body, drag.number, drag.begin, drag.target)

    def arrow(self, posture: Kinematics) -> FloatArray:
        """
        Return the spring as an arrow, in ``world`` [m].

        :param posture: where the bodies are
        :returns: shape (1, 2, 3); (0, 2, 3) if nothing is dragged
        """
        drag = self._drag
        body = -1 if drag is None else mujoco.mj_name2id(
            posture.model, mujoco.mjtObj.mjOBJ_BODY, drag.body)
        if drag is None or body < 0:
            return np.zeros((0, 2, 3))
        rotation, origin = posture.data.xmat[body].reshape(3, 3), posture.data.xpos[body]
        if drag.held is None:
            drag.held = rotation.T @ (drag.begin - origin)
        return np.array([[origin + rotation @ drag.held, drag.target]])
