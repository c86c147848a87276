# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A target for each hand that can be dragged; it sits at the hand while nobody drags it."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.viewer.page.page_commands import Following, PageCommands

_SCALE = 0.18
#: A hand that moves less between two calls [m] is still.
_STILL_M = 2e-4
_SAME = 1e-4


class HandTarget:
    """
    The target of one hand.

    :param space: namespace of the robot's topics, such as ``/left/``
    :param arm: whose hand it is
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
        """Show or hide it."""
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
        Move the target to the hand, unless the hand is on its way to the target.

        :param now_s: wall time [s]
        :param position: of the hand in ``world`` [m]
        :param quat_wxyz: of the hand
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
        """Remove it from the scene."""
        self._control.remove()
