# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The five-finger hands of Fourier's GR-1, a left and a right one."""

from __future__ import annotations

from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.models.grippers.catalogue_gripper import CatalogueGripper

#: The motor behind each actuator: little, ring, middle and index finger, bend of the thumb, swing
#: of the thumb.
_MOTOR_OF_ACTUATOR = [0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5]
_FINGERS = ('index', 'middle', 'ring', 'pinky')


def _geoms_by_role(side: str) -> dict[str, list[str]]:
    thumb = [f'{side}_thumb_{link}_link_col' for link in ('proximal_base', 'proximal', 'distal')]
    fingers = [f'{side}_{finger}_{link}_link_col' for finger in _FINGERS
               for link in ('proximal', 'intermediate')]
    return {'left_finger': thumb, 'right_finger': fingers,
            'left_fingerpad': thumb, 'right_fingerpad': fingers}


class FourierHand(CatalogueGripper, registered=False):
    """
    Hand with eleven joints and six motors; the action is a position for each motor.

    :cvar speed: as in robosuite, without effect: actions are positions, not steps
    """

    speed = 0.15
    #: All fingers straight, the thumb to the side [rad].
    _start = (0.0,) * 11

    def format_action(self, action: ArrayLike) -> FloatArray:
        """
        Give both joints of a finger the command of its motor.

        :param action: little, ring, middle and index finger, bend of the thumb, swing of the
            thumb; -1 is straight, +1 is bent; not clamped; shape (6,)
        :returns: commands of the actuators, shape (11,), a copy
        :raises CommandError: if the length is wrong or a number is not finite
        """
        return self._checked(action)[_MOTOR_OF_ACTUATOR]

    def start_at(self, command: ArrayLike) -> None:
        """
        Change nothing: an action does not depend on the ones before.

        :param command: commands in [-1, 1], one for each actuator
        """

    @property
    def dof(self) -> int:
        """One number for each motor."""
        return 6


class FourierLeftHand(FourierHand):
    """Left hand of the GR-1."""

    _folder = 'fourier_left_hand'
    _important_geoms = _geoms_by_role('L')


class FourierRightHand(FourierHand):
    """Right hand of the GR-1, the mirror image of the left one."""

    _folder = 'fourier_right_hand'
    _important_geoms = _geoms_by_role('R')
