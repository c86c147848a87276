# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The Robotiq 2F-85, a gripper with two fingers on parallelogram linkages."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.models.grippers.gripper_model import GripperModel
from manip_sim.models.grippers.open_close_gripper import OpenCloseGripper
from manip_sim.resources import asset_path


class Robotiq85GripperBase(GripperModel, registered=False):
    """Robotiq 2F-85 whose outer knuckles are commanded one by one."""

    _important_geoms = {
        f'{side}_{part}': [f'{side}_{link}_collision' for link in links]
        for side in ('left', 'right')
        for part, links in (
            ('finger', ('outer_finger', 'inner_finger', 'fingertip', 'fingerpad')),
            ('fingerpad', ('fingerpad',)))}

    def __init__(self, idn: int | str = 0) -> None:
        super().__init__(asset_path('grippers', 'robotiq_85_gripper'), idn=idn)

    def format_action(self, action: ArrayLike) -> FloatArray:
        """Return the action itself: a knuckle command each, +1 closed, shape (2,)."""
        return self._checked(action).copy()

    @property
    def init_qpos(self) -> FloatArray:
        """
        Open [rad], shape (6,).

        These are the reference's values. They lie up to 0.2 rad outside the joint ranges and leave
        the pads tilted by 0.29 rad; the linkage takes them to the open pose within 0.1 s.
        """
        return np.array([-0.026, -0.267, -0.2, -0.026, -0.267, -0.2])


class Robotiq85Gripper(OpenCloseGripper, Robotiq85GripperBase):
    """Robotiq 2F-85 that opens and closes."""

    _closed = (1.0, 1.0)
