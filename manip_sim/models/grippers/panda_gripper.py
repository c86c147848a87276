# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The two-finger hand of the Franka Emika Panda."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.models.grippers.gripper_model import GripperModel
from manip_sim.models.grippers.open_close_gripper import OpenCloseGripper
from manip_sim.resources import asset_path


class PandaGripperBase(GripperModel, registered=False):
    """Franka hand whose fingers are commanded one by one."""

    _important_geoms = {
        'left_finger': ['finger1_collision', 'finger1_pad_collision'],
        'right_finger': ['finger2_collision', 'finger2_pad_collision'],
        'left_fingerpad': ['finger1_pad_collision'],
        'right_fingerpad': ['finger2_pad_collision']}

    def __init__(self, idn: int | str = 0) -> None:
        super().__init__(asset_path('grippers', 'panda_gripper'), idn=idn)

    def format_action(self, action: ArrayLike) -> FloatArray:
        """Return the action itself: a finger command each, shape (2,)."""
        return self._checked(action).copy()

    @property
    def init_qpos(self) -> FloatArray:
        """Fingers half open [m], shape (2,)."""
        return np.array([0.020833, -0.020833])


class PandaGripper(OpenCloseGripper, PandaGripperBase):
    """Franka hand that opens and closes."""

    _closed = (-1.0, 1.0)
