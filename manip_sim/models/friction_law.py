# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""How friction and torque limit of one joint depend on its velocity."""

from __future__ import annotations

from dataclasses import dataclass
import math


@dataclass(frozen=True)
class FrictionLaw:
    """
    How friction and torque limit of a joint depend on its velocity; infinite velocities: not.

    Friction is ``coulomb + (static - coulomb) / (1 + (v / stribeck_velocity)^2)`` (D. P. Hess and
    A. Soom, Journal of Tribology 112(1), 1990). The torque limit in the direction of motion falls
    linearly from all of it at ``knee`` to nothing at ``no_load``.

    :ivar coulomb: dry friction at speed [N m or N]
    :ivar static: dry friction at rest [N m or N]
    :ivar stribeck_velocity: at which half of the difference is left [rad/s or m/s]
    :ivar knee: [rad/s or m/s]
    :ivar no_load: [rad/s or m/s]
    """

    coulomb: float = 0.0
    static: float = 0.0
    stribeck_velocity: float = math.inf
    knee: float = math.inf
    no_load: float = math.inf

    @property
    def acts(self) -> bool:
        """Whether anything depends on the velocity."""
        return math.isfinite(self.stribeck_velocity) or math.isfinite(self.no_load)
