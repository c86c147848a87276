# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Joints in the plane without a vehicle around them."""

from __future__ import annotations

from manip_sim.models.bases.robot_base_model import MobileBaseModel
from manip_sim.resources import asset_path


class NullMobileBase(MobileBaseModel):
    """
    Forward, side and yaw below the robot; it has no mass, so the robot's root must.

    :param idn: number or word in names
    """

    def __init__(self, idn: int | str = 0) -> None:
        super().__init__(asset_path('bases', 'null_mobile_base'), idn=idn)
