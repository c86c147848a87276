# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A board eraser: a gripper without joints."""

from __future__ import annotations

from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.models.grippers.gripper_model import GripperModel
from manip_sim.resources import asset_path


class WipingGripper(GripperModel):
    """Eraser with a touch sensor at each corner of its surface."""

    _important_geoms = {
        'left_finger': [], 'right_finger': [], 'left_fingerpad': [], 'right_fingerpad': [],
        'corners': ['wiping_corner1', 'wiping_corner2', 'wiping_corner3', 'wiping_corner4']}

    def __init__(self, idn: int | str = 0) -> None:
        super().__init__(asset_path('grippers', 'wiping_gripper'), idn=idn)

    def format_action(self, action: ArrayLike) -> FloatArray:
        """Return the action, which has no numbers, shape (0,)."""
        return self._checked(action).copy()

    @property
    def init_qpos(self) -> None:
        """Nothing moves."""
        return None
