# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The Robotiq 2F-140, a two-finger gripper with parallel fingertips."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.models.grippers.gripper_model import GripperModel
from manip_sim.models.grippers.open_close_gripper import OpenCloseGripper
from manip_sim.resources import asset_path


class Robotiq140GripperBase(GripperModel, registered=False):
    """
    Robotiq 2F-140 whose two actuators are commanded one by one.

    One motor moves both fingers of the real gripper, so with two different commands both fingers
    go to the same place between them.
    """

    _important_geoms = {
        'left_finger': ['left_outer_finger_collision', 'left_inner_finger_collision',
                        'left_fingertip_collision', 'left_fingerpad_collision'],
        'right_finger': ['right_outer_finger_collision', 'right_inner_finger_collision',
                         'right_fingertip_collision', 'right_fingerpad_collision'],
        'left_fingerpad': ['left_fingerpad_collision'],
        'right_fingerpad': ['right_fingerpad_collision']}

    def __init__(self, idn: int | str = 0) -> None:
        super().__init__(asset_path('grippers', 'robotiq_140_gripper'), idn=idn)

    def format_action(self, action: ArrayLike) -> FloatArray:
        """Return the action itself: a command of the left and the right finger, shape (2,)."""
        return self._checked(action).copy()

    @property
    def init_qpos(self) -> FloatArray:
        """
        Fingers open [rad], shape (6,).

        These are the reference's values. They miss the closed linkage by up to 0.08 rad; the
        constraints of the linkage take that up in the first steps.
        """
        return np.array([0.012, 0.065, 0.065, -0.012, 0.065, 0.065])


class Robotiq140Gripper(OpenCloseGripper, Robotiq140GripperBase):
    """Robotiq 2F-140 that opens and closes."""

    _closed = (1.0, -1.0)
