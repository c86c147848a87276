# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A base that does not move, for robots that stand on their own feet."""

from __future__ import annotations

from manip_sim.models.bases.robot_base_model import MobileBaseModel
from manip_sim.resources import asset_path


class NoActuationBase(MobileBaseModel):
    """
    A fixed frame without mass or shape.

    :param idn: number or word in names
    """

    def __init__(self, idn: int | str = 0) -> None:
        super().__init__(asset_path('bases', 'no_actuation_base'), idn=idn)
