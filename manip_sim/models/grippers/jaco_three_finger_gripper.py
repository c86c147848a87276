# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The three-finger hand of the Kinova Jaco (KG-3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.models.grippers.catalogue_gripper import CatalogueGripper


class JacoThreeFingerGripperBase(CatalogueGripper, registered=False):
    """
    Kinova hand whose fingers are commanded one by one: thumb, index, pinky; +1 is open.

    Each fingertip follows the proximal joint of its finger.
    """

    _folder = 'jaco_three_finger_gripper'
    #: Upright: a finger and then its tip, for the thumb, the index and the pinky [rad].
    _start = 0.5, 0.0, 0.5, 0.0, 0.5, 0.0
    _important_geoms = {
        'left_finger': ['index_proximal_collision', 'index_distal_collision',
                        'index_tip_collision', 'pinky_proximal_collision',
                        'pinky_distal_collision', 'pinky_tip_collision', 'index_tip_collision',
                        'pinky_pad_collision'],
        'right_finger': ['thumb_proximal_collision', 'thumb_distal_collision',
                         'thumb_tip_collision', 'thumb_pad_collision'],
        'left_fingerpad': ['index_pad_collision', 'pinky_pad_collision'],
        'right_fingerpad': ['thumb_pad_collision']}


class JacoThreeFingerGripper(JacoThreeFingerGripperBase):
    """Kinova hand that opens and closes."""

    speed = 0.01

    def format_action(self, action: ArrayLike) -> FloatArray:
        """
        Close or open by one step.

        :param action: the sign counts: + closes, - opens, 0 holds; shape (1,)
        :returns: the same command for each finger, +1 open, shape (3,), a copy
        :raises CommandError: if the length is wrong or a number is not finite
        """
        return np.repeat(self._integrate(-self.speed * np.sign(self._checked(action))), 3)

    @property
    def dof(self) -> int:
        """One number for all fingers."""
        return 1


class JacoThreeFingerDexterousGripper(JacoThreeFingerGripperBase):
    """Kinova hand that opens and closes each finger."""

    speed = 0.01

    def format_action(self, action: ArrayLike) -> FloatArray:
        """
        Close or open each finger by one step.

        :param action: the sign counts: + closes, - opens, 0 holds; thumb, index, pinky;
            shape (3,)
        :returns: commands of the thumb, the index and the pinky, +1 open, shape (3,), a copy
        :raises CommandError: if the length is wrong or a number is not finite
        """
        return self._integrate(-self.speed * np.sign(self._checked(action)))
