# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The Robotiq 3-Finger Adaptive Robot Gripper."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.models.grippers.catalogue_gripper import CatalogueGripper


class RobotiqThreeFingerGripperBase(CatalogueGripper, registered=False):
    """
    Robotiq gripper whose three fingers and scissor are commanded one by one.

    Order: finger 1, finger 2, middle finger (+1 closes), scissor (-1 brings the tips of fingers 1
    and 2 together, +1 spreads them).
    """

    _folder = 'robotiq_three_finger_gripper'
    #: Open, fingers 1 and 2 parallel [rad].
    _start = (0.0,) * 11
    _important_geoms = {
        'left_finger': [
            'f1_l0', 'f1_l1', 'f1_l2', 'f1_l3', 'f2_l0', 'f2_l1', 'f2_l2', 'f2_l3',
            'f1_tip_collision', 'f2_tip_collision', 'f1_pad_collision', 'f2_pad_collision'],
        'right_finger': [
            'f3_l0', 'f3_l1', 'f3_l2', 'f3_l3',
            'finger_middle_tip_collision', 'finger_middle_pad_collision'],
        'left_fingerpad': ['f1_pad_collision', 'f2_pad_collision'],
        'right_fingerpad': ['finger_middle_pad_collision']}


class RobotiqThreeFingerGripper(RobotiqThreeFingerGripperBase):
    """Robotiq gripper that opens and closes all fingers, fingers 1 and 2 side by side."""

    speed = 0.2

    def format_action(self, action: ArrayLike) -> FloatArray:
        """
        Close or open by one step, in proportion to the action.

        :param action: + closes, - opens; the magnitude counts; shape (1,)
        :returns: commands of finger 1, finger 2 and middle finger, all equal, and -1 for the
            scissor, shape (4,), a copy
        :raises CommandError: if the length is wrong or a number is not finite
        """
        closing = self._integrate(self.speed * self._checked(action))
        return np.concatenate([np.repeat(closing, 3), [-1.0]])

    @property
    def dof(self) -> int:
        """One number for all fingers."""
        return 1


class RobotiqThreeFingerDexterousGripper(RobotiqThreeFingerGripperBase):
    """Robotiq gripper whose three fingers and scissor move by steps, one by one."""

    speed = 0.2

    def format_action(self, action: ArrayLike) -> FloatArray:
        """
        Move each finger and the scissor by one step.

        :param action: finger 1, finger 2, middle finger, scissor; the sign counts: + closes or
            spreads, - opens or brings together, 0 holds; shape (4,)
        :returns: commands in the same order, shape (4,), a copy
        :raises CommandError: if the length is wrong or a number is not finite
        """
        return self._integrate(self.speed * np.sign(self._checked(action)))
