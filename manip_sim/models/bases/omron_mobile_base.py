# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A vehicle like the Omron LD-60 with a lifting column on it."""

from __future__ import annotations

from manip_sim.models.bases.robot_base_model import MobileBaseModel
from manip_sim.resources import asset_path


class OmronMobileBase(MobileBaseModel):
    """
    Vehicle that drives forward and sideways, turns, and lifts the robot from 0.7 m to 1.04 m.

    :param idn: number or word in names
    """

    _horizontal_radius = 0.25

    def __init__(self, idn: int | str = 0) -> None:
        super().__init__(asset_path('bases', 'omron_mobile_base'), idn=idn)
