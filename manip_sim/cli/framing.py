# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""From where pictures are taken, so that what is shown fills them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TYPE_CHECKING

from manip_sim.errors import UnknownNameError

if TYPE_CHECKING:
    import mujoco

#: How much more is seen than what is shown.
_MARGIN = 1.05
#: Of an aim; the margins differ by less than a pixel after a few.
_CORRECTIONS = 10


@dataclass(frozen=True)
class View:
    """
    From where a picture is taken; it shows all there is, as large as it can be.

    :ivar azimuth: looking along x is 0, along y is 90 [degrees]
    :ivar elevation: looking down is negative [degrees]
    :ivar camera: of the model, instead of these
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

    Those that are not the model's see all points, are as near as that allows, and as near as each
    other: what they show has the same size.

    :param points: in the world, (n, 3) [m]
    :param aspect: width by height of each picture
    :raises UnknownNameError: if there is no such camera
    """
    import mujoco
    import numpy as np
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
    """Return the directions aside, up and away of a camera, as rows."""
    import numpy as np
    turn, tilt = np.radians(view.azimuth), np.radians(view.elevation)
    away = np.array([np.cos(turn) * np.cos(tilt), np.sin(turn) * np.cos(tilt), np.sin(tilt)])
    aside = np.array([np.sin(turn), -np.cos(turn), 0.0])
    return np.array([aside, np.cross(aside, away), away])


def _nearest(seen: Any, tangents: Any) -> float:
    """Return the least distance from which a camera sees all points, wherever it is aimed."""
    reach = seen[:, 2:] * tangents
    spread = (seen[:, :2] - reach).max(axis=0) - (seen[:, :2] + reach).min(axis=0)
    return float((spread / tangents / 2.0).max())


def _aim(seen: Any, distance: float) -> Any:
    """Return what has to be in the middle, so that all margins are equal, along the axes [m]."""
    import numpy as np
    aim = np.zeros(3)
    for _ in range(_CORRECTIONS):  # What is near moves more than what is far.
        at = (seen - aim)[:, :2] / (seen[:, 2:] + distance)
        aim[:2] += distance * (at.min(axis=0) + at.max(axis=0)) / 2.0
    return aim
