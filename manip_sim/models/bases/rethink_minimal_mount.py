# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The pedestal on castors that Rethink Robotics sold for Baxter."""

from __future__ import annotations

from manip_sim.models.bases.robot_base_model import MountModel
from manip_sim.resources import asset_path


class RethinkMinimalMount(MountModel):
    """
    Pedestal without controller box, 0.862 m from the floor to the robot's foot.

    :param idn: number or word in names
    """

    _top_offset = (0.0, 0.0, -0.062)
    _horizontal_radius = 0.25

    def __init__(self, idn: int | str = 0) -> None:
        super().__init__(asset_path('bases', 'rethink_minimal_mount'), idn=idn)
