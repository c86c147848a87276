# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The electric parallel gripper of Rethink Robotics, for Baxter and Sawyer."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.models.grippers.gripper_model import GripperModel
from manip_sim.models.grippers.open_close_gripper import OpenCloseGripper
from manip_sim.resources import asset_path


class RethinkGripperBase(GripperModel, registered=False):
    """Rethink gripper whose fingers are commanded one by one, the right one first."""

    _important_geoms = {
        'left_finger': ['l_finger_g0', 'l_finger_g1', 'l_fingertip_g0', 'l_fingerpad_g0'],
        'right_finger': ['r_finger_g0', 'r_finger_g1', 'r_fingertip_g0', 'r_fingerpad_g0'],
        'left_fingerpad': ['l_fingerpad_g0'],
        'right_fingerpad': ['r_fingerpad_g0']}

    def __init__(self, idn: int | str = 0) -> None:
        super().__init__(asset_path('grippers', 'rethink_gripper'), idn=idn)

    def format_action(self, action: ArrayLike) -> FloatArray:
        """Return the action itself: a finger command each, the right one first, shape (2,)."""
        return self._checked(action).copy()

    @property
    def init_qpos(self) -> FloatArray:
        """Fingers fully open [m], the left one first, shape (2,)."""
        return np.array([0.020833, -0.020833])


class RethinkGripper(OpenCloseGripper, RethinkGripperBase):
    """Rethink gripper that opens and closes."""

    _closed = (1.0, -1.0)
