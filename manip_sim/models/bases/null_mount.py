# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""An empty mount, for robots that stand on the floor."""

from __future__ import annotations

from manip_sim.models.bases.robot_base_model import MountModel
from manip_sim.resources import asset_path


class NullMount(MountModel):
    """
    A frame without mass or shape at the robot's foot.

    :param idn: number or word in names
    """

    def __init__(self, idn: int | str = 0) -> None:
        super().__init__(asset_path('bases', 'null_mount'), idn=idn)
