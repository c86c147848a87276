# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The description of a camera in YAML or a mapping: keys, units and limits."""

from __future__ import annotations

import math
from typing import Annotated

from manip_sim.models.cameras import (
    MAX_FOVY_DEG, MAX_PIXELS, MAX_RATE_HZ, MIN_FOVY_DEG, MIN_RATE_HZ)
from manip_sim.models.object_descriptions import Coordinate, PlacedDescription
from manip_sim.models.strict_descriptions import (
    Field, model_validator, Number, StrictBool, StrictInt)

#: A point nearer to the camera than this gives no direction to look in [m].
_MIN_DISTANCE_M = 1e-6
_Pixels = Annotated[StrictInt, Field(ge=1, le=MAX_PIXELS)]


class CameraDescription(PlacedDescription):
    """
    A camera: its name, where it is and what it sees.

    The pose is that of a frame that looks along x, with y to the left and z up, in the frame of
    the body.

    :ivar position: in the frame of the body [m], the origin if it is not given
    :ivar look_at: instead of ``rpy`` and ``quat_xyzw``, the point in the middle of the image, in
        the frame of the body [m]; up is the body's z, or its x if the camera looks along z
    :ivar body: the body that it is fixed to; None is the world
    :ivar fovy: vertical field of view [degrees]
    :ivar width: of the images [pixels], as ``height``
    :ivar rate: images per second of simulation time [Hz]
    :ivar depth: also publish depth images
    """

    name: str
    look_at: Annotated[list[Coordinate], Field(min_length=3, max_length=3)] | None = None
    body: str | None = None
    fovy: Annotated[Number, Field(ge=MIN_FOVY_DEG, le=MAX_FOVY_DEG, allow_inf_nan=False)] = 45.0
    width: _Pixels | None = None
    height: _Pixels | None = None
    rate: Annotated[Number, Field(ge=MIN_RATE_HZ, le=MAX_RATE_HZ, allow_inf_nan=False)
                    ] | None = None
    depth: StrictBool | None = None

    @model_validator(mode='after')
    def _check_look_at(self) -> CameraDescription:
        if self.look_at is None:
            return self
        if self.rpy is not None or self.quat_xyzw is not None:
            raise ValueError("give 'look_at', 'rpy' or 'quat_xyzw', not two of them")
        if math.dist(self.look_at, self.position or [0.0, 0.0, 0.0]) < _MIN_DISTANCE_M:
            raise ValueError(f"'look_at' must not be where the camera is, got {self.look_at}")
        return self
