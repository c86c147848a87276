# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Springs as a control mode: joints go to positions as springs with dampers."""

from collections.abc import Sequence
from dataclasses import dataclass

from manip_sim.control.modes import Position


@dataclass(frozen=True)
class Springs(Position):
    """
    Joints go to positions, and yield: an effort on a joint moves it by effort / stiffness.

    :ivar stiffness: [N m/rad or N/m]
    :ivar damping: [N m s/rad or N s/m]
    """

    stiffness: float = 100.0
    damping: float = 20.0
    name = 'springs'

    def gains(self, joints: Sequence[str]) -> tuple[float, float]:
        """Return stiffness and damping, the same for all joints."""
        return self.stiffness, self.damping
