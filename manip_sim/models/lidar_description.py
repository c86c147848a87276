# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The description of a lidar in YAML or a mapping: keys, units and limits."""

from __future__ import annotations

import math
from typing import Annotated

from manip_sim.models.cameras import MAX_RATE_HZ, MIN_RATE_HZ
from manip_sim.models.lidars import MAX_NOISE_M, MAX_RANGE_M, MAX_RAYS, MAX_RINGS
from manip_sim.models.object_descriptions import PlacedDescription
from manip_sim.models.strict_descriptions import Field, Number, StrictInt

_TURN = Annotated[Number, Field(ge=-math.pi - 1e-3, le=math.pi + 1e-3, allow_inf_nan=False)]
_TILT = Annotated[Number, Field(ge=-math.pi / 2, le=math.pi / 2, allow_inf_nan=False)]
_RANGE = Annotated[Number, Field(gt=0.0, le=MAX_RANGE_M, allow_inf_nan=False)]


class LidarDescription(PlacedDescription):
    """
    A lidar: its name, where it is and what it sees; its frame has x ahead and z up.

    What is not given is as in :class:`manip_sim.sensing.lidars.Rays`.

    :ivar position: in the frame of the body [m], the origin if it is not given
    :ivar body: the body that it is fixed to, which it does not see; None is the world
    :ivar samples: rays of a ring
    :ivar rings: 1 is a planar scanner, with a LaserScan; more make a PointCloud2
    :ivar angle_min: of the first ray of a ring, about z [rad]
    :ivar angle_max: of the last one; of a full turn, of the one after the last one [rad]
    :ivar elevation_min: of the first of several rings [rad]
    :ivar elevation_max: of the last one [rad]
    :ivar range_min: below it is too near to measure [m]
    :ivar range_max: beyond it is nothing [m]
    :ivar rate: scans per second of simulation time [Hz]
    :ivar noise: standard deviation of the white noise on distances [m]
    """

    name: str
    body: str | None = None
    samples: Annotated[StrictInt, Field(ge=2, le=MAX_RAYS)] = 360
    rings: Annotated[StrictInt, Field(ge=1, le=MAX_RINGS)] = 1
    angle_min: _TURN | None = None
    angle_max: _TURN | None = None
    elevation_min: _TILT | None = None
    elevation_max: _TILT | None = None
    range_min: _RANGE | None = None
    range_max: _RANGE | None = None
    rate: Annotated[Number, Field(ge=MIN_RATE_HZ, le=MAX_RATE_HZ, allow_inf_nan=False)] = 10.0
    noise: Annotated[Number, Field(ge=0.0, le=MAX_NOISE_M, allow_inf_nan=False)] = 0.0
