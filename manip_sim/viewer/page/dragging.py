# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What people drag in the scene: the targets of end effectors, and bodies that are pulled."""

from __future__ import annotations

from dataclasses import dataclass
import itertools
import random
import time
from typing import Any

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.viewer.page.kinematics import Kinematics
from manip_sim.viewer.page.model_scene import Scene
from manip_sim.viewer.page.page_commands import Events, Following, PageCommands

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
