# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The pedestal on castors that Rethink Robotics sold for Sawyer."""

from __future__ import annotations

from manip_sim.models.bases.robot_base_model import MountModel
from manip_sim.resources import asset_path


class RethinkMount(MountModel):
    """
    Pedestal with controller box, 0.912 m from the floor to the arm's foot.

    :param idn: number or word in names
    """

    _top_offset = (0.0, 0.0, -0.01)
    _horizontal_radius = 0.25

    def __init__(self, idn: int | str = 0) -> None:
        super().__init__(asset_path('bases', 'rethink_mount'), idn=idn)
