# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The flange without a gripper."""

from __future__ import annotations

from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.models.grippers.gripper_model import GripperModel
from manip_sim.resources import asset_path


class NullGripper(GripperModel):
    """A grasp frame and a force-torque sensor, without mass and without shape."""

    def __init__(self, idn: int | str = 0) -> None:
        super().__init__(asset_path('grippers', 'null_gripper'), idn=idn)

    def format_action(self, action: ArrayLike) -> FloatArray:
        """Return the action, which has no numbers, shape (0,)."""
        return self._checked(action).copy()

    @property
    def init_qpos(self) -> None:
        """Nothing moves."""
        return None
