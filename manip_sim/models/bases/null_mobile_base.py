# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A mobile base without a vehicle: joints in the plane."""

from __future__ import annotations

from manip_sim.models.bases.robot_base_model import MobileBaseModel
from manip_sim.resources import asset_path


class NullMobileBase(MobileBaseModel):
    """
    Forward, side and yaw joints without mass, so the robot's root must have mass.

    :param idn: number or word in names
    """

    def __init__(self, idn: int | str = 0) -> None:
        super().__init__(asset_path('bases', 'null_mobile_base'), idn=idn)
