# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Arrows and points over the scene: contacts with their forces, and external wrenches."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from manip_sim.arrays import FloatArray

_NOTHING = np.zeros((0, 3))
_POINT = (255, 140, 0)
_COLORS = {'contact_forces': (255, 200, 20), 'force': (230, 40, 40), 'torque': (70, 120, 255)}
_SHAFT_M, _HEAD_M, _HEAD_LENGTH_M = 0.004, 0.01, 0.02
#: Smaller changes are not sent [m].
_SAME = 2e-4


class Overlays:
    """
    What is drawn over the scene.

    :param scene: ``viser.ViserServer.scene``
    """

    def __init__(self, scene: Any) -> None:
        self._scene = scene
        self._arrows: dict[str, tuple[FloatArray, Any]] = {}
        self._points: tuple[FloatArray, Any] | None = None

    def show(self, points: FloatArray, arrows: Mapping[str, FloatArray]) -> None:
        """
        Show these points and arrows in place of the former ones.

        :param points: where bodies touch, in ``world`` [m], shape (n, 3)
        :param arrows: by what they show, from and to in ``world`` [m], shape (n, 2, 3)
        """
        self._show_points(points)
        for what, color in _COLORS.items():
            self._show_arrows(what, color, arrows.get(what, np.zeros((0, 2, 3))))

    def clear(self) -> None:
        """Remove all points and arrows."""
        self.show(_NOTHING, {})

    def _show_points(self, points: FloatArray) -> None:
        if self._points is not None:
            before, handle = self._points
            if before.shape == points.shape and np.allclose(before, points, atol=_SAME, rtol=0.0):
                return
            if len(points):
                handle.points = points.astype(np.float32)
                self._points = points, handle
                return
            handle.remove()
            self._points = None
        elif len(points):
            self._points = points, self._scene.add_point_cloud(
                '/overlays/contacts', points.astype(np.float32), _POINT, point_size=0.012,
                point_shape='circle', precision='float32')

    def _show_arrows(self, what: str, color: tuple[int, int, int], arrows: FloatArray) -> None:
        before, handle = self._arrows.pop(what, (np.zeros((0, 2, 3)), None))
        if handle is not None and (before.shape != arrows.shape or not len(arrows)):
            handle.remove()
            handle = None
        if not len(arrows):
            return
        if handle is None:
            handle = self._scene.add_arrows(
                f'/overlays/{what}', arrows, color, shaft_radius=_SHAFT_M, head_radius=_HEAD_M,
                head_length=_HEAD_LENGTH_M)
        elif not np.allclose(before, arrows, atol=_SAME, rtol=0.0):
            handle.points = arrows.astype(np.float32)
        else:
            arrows = before
        self._arrows[what] = arrows, handle
