# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What grippers share that open and close two actuators together."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.models.grippers.gripper_model import GripperModel


class OpenCloseGripper(GripperModel, registered=False):
    """A gripper with one action for two actuators; a mixin, before the class with the file."""

    speed = 0.2

    #: The command of each actuator at which the gripper is closed.
    _closed: ClassVar[tuple[float, float]]

    def format_action(self, action: ArrayLike) -> FloatArray:
        """
        Close or open by one step.

        :param action: the sign counts: + closes, - opens, 0 holds; shape (1,)
        :returns: commands in the order of :attr:`actuators`, in [-1, 1], shape (2,), a copy
        :raises CommandError: if the length is wrong or a number is not finite
        """
        return self._integrate(np.array(self._closed) * self.speed
                               * np.sign(self._checked(action)))

    @property
    def dof(self) -> int:
        """One number for both actuators."""
        return 1
