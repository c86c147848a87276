# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The Rethink Robotics Sawyer."""

from __future__ import annotations

import numpy as np

from manip_sim.models.robots.manipulator_model import ManipulatorModel
from manip_sim.models.robots.robot_model import Placement
from manip_sim.resources import asset_path
from manip_sim.typing import FloatArray


class Sawyer(ManipulatorModel):
    """Seven-joint arm with a screen, 4 kg payload, 1.26 m reach."""

    _horizontal_radius = 0.5
    _top_offset = (0.0, 0.0, 1.0)

    def __init__(self, idn: int | str = 0) -> None:
        super().__init__(asset_path('robots', 'sawyer'), idn=idn)

    @property
    def arm_type(self) -> str:
        """One arm."""
        return 'single'

    @property
    def default_base(self) -> str:
        """Stands on the Rethink pedestal."""
        return 'RethinkMount'

    @property
    def default_gripper(self) -> dict[str, str]:
        """Holds the Rethink gripper."""
        return {'right': 'RethinkGripper'}

    @property
    def default_controller_config(self) -> dict[str, str]:
        """Names of the reference's controller settings, by arm."""
        return {'right': 'default_sawyer'}

    @property
    def init_qpos(self) -> FloatArray:
        """Elbow up, hand pointing down [rad], shape (7,)."""
        return np.array([0.0, -1.18, 0.0, 2.18, 0.0, 0.57, -1.57])

    @property
    def base_xpos_offset(self) -> dict[str, Placement]:
        """Where to place the robot by arena [m]."""
        return {'bins': (-0.5, -0.1, 0.0), 'empty': (-0.6, 0.0, 0.0),
                'table': lambda table_length: (-0.16 - table_length / 2.0, 0.0, 0.0)}
