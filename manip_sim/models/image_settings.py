# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Size and rate of a camera's images, and their limits."""

from __future__ import annotations

from dataclasses import dataclass

MAX_PIXELS = 4096
MIN_RATE_HZ, MAX_RATE_HZ = 0.01, 10_000.0
MIN_FOVY_DEG, MAX_FOVY_DEG = 1.0, 170.0


@dataclass(frozen=True)
class ImageSettings:
    """
    Size and rate of a camera's images, and whether there are depth images.

    :ivar width: [pixels], as ``height``
    :ivar rate_hz: images per second of simulation time [Hz]
    :ivar depth: also depth images
    """

    width: int = 640
    height: int = 480
    rate_hz: float = 20.0
    depth: bool = True
