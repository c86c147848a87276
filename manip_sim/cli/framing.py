# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Place cameras so that what is shown fills the picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TYPE_CHECKING

import numpy as np

from manip_sim.errors import UnknownNameError

if TYPE_CHECKING:
    import mujoco

#: Width of the view over that of its content.
_MARGIN = 1.05
#: Number of corrections of an aim; after a few times the margins differ by less than a pixel.
_CORRECTIONS = 10


@dataclass(frozen=True)
class View:
    """
    The direction that a picture is taken in; it shows everything, as large as possible.

    :ivar azimuth: looking along x is 0, along y is 90 [degrees]
    :ivar elevation: looking down is negative [degrees]
    :ivar camera: name of a camera of the model, used instead of the angles
    """

    azimuth: float = 140.0
    elevation: float = -12.0
    camera: str | None = None


TWO_SIDES = (View(), View(220.0))
#: To see into bins and onto tables.
TWO_SIDES_OF_ARENAS = tuple(View(view.azimuth, -35.0) for view in TWO_SIDES)


def cameras(views: Sequence[View], model: mujoco.MjModel, points: Any, aspect: float) -> list[Any]:
    """
    Return a camera for each view.

    Cameras that are not the model's see all points and share one distance, the least possible:
    their pictures have the same scale.

    :param points: in the world, (n, 3) [m]
    :param aspect: aspect ratio of each picture, width / height
    :raises UnknownNameError: if there is no such camera
    """
    import mujoco
    names = [model.camera(index).name for index in range(model.ncam)]
    for view in views:
        if view.camera is not None and view.camera not in names:
            raise UnknownNameError('camera', view.camera, names)
    upward = np.tan(np.radians(model.vis.global_.fovy / 2.0)) / _MARGIN
    tangents = np.array([upward * aspect, upward])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    seen = {view: (points - middle) @ _axes(view).T for view in views if view.camera is None}
    distance = max((_nearest(of_view, tangents) for of_view in seen.values()), default=0.0)
    found: list[Any] = [view.camera for view in views]
    for index, view in enumerate(views):
        if view in seen:
            found[index] = camera = mujoco.MjvCamera()
            camera.azimuth, camera.elevation = view.azimuth, view.elevation
            camera.lookat[:] = middle + _aim(seen[view], distance) @ _axes(view)
            camera.distance = distance
    return found


def _axes(view: View) -> Any:
    """Return the right, up and forward directions of a camera, as rows."""
    turn, tilt = np.radians(view.azimuth), np.radians(view.elevation)
    away = np.array([np.cos(turn) * np.cos(tilt), np.sin(turn) * np.cos(tilt), np.sin(tilt)])
    aside = np.array([np.sin(turn), -np.cos(turn), 0.0])
    return np.array([aside, np.cross(aside, away), away])


def _nearest(seen: Any, tangents: Any) -> float:
    """Return the least distance from which a well aimed camera sees all points [m]."""
    reach = seen[:, 2:] * tangents
    spread = (seen[:, :2] - reach).max(axis=0) - (seen[:, :2] + reach).min(axis=0)
    return float((spread / tangents / 2.0).max())


def _aim(seen: Any, distance: float) -> Any:
    """Return where to aim so that opposite margins are equal, along the camera's axes [m]."""
    aim = np.zeros(3)
    for _ in range(_CORRECTIONS):  # Near points shift more than far ones.
        at = (seen - aim)[:, :2] / (seen[:, 2:] + distance)
        aim[:2] += distance * (at.min(axis=0) + at.max(axis=0)) / 2.0
    return aim
