# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The Rethink Robotics Baxter."""

from __future__ import annotations

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.models.robots.manipulator_model import ManipulatorModel
from manip_sim.models.robots.robot_model import Placement
from manip_sim.resources import asset_path


class Baxter(ManipulatorModel):
    """
    Two seven-joint arms and a screen, 2.2 kg payload each, 1.2 m reach.

    :param idn: number or word in names
    """

    _horizontal_radius = 0.5
    _top_offset = (0.0, 0.0, 1.0)
    _foot_offset = (0.0, 0.0, -0.062)

    def __init__(self, idn: int | str = 0) -> None:
        super().__init__(asset_path('robots', 'baxter'), idn=idn)

    @property
    def arm_type(self) -> str:
        """``bimanual``: two arms."""
        return 'bimanual'

    @property
    def _eef_name(self) -> dict[str, str]:
        return {'right': 'right_hand', 'left': 'left_hand'}

    @property
    def default_base(self) -> str:
        """Baxter's pedestal."""
        return 'RethinkMinimalMount'

    @property
    def default_gripper(self) -> dict[str, str]:
        """A Rethink gripper on each arm."""
        return {'right': 'RethinkGripper', 'left': 'RethinkGripper'}

    @property
    def default_controller_config(self) -> dict[str, str]:
        """Names of robosuite's controller settings, by arm."""
        return {'right': 'osc_pose', 'left': 'osc_pose'}

    @property
    def init_qpos(self) -> FloatArray:
        """Hands in front of the chest, the right arm first [rad], shape (14,)."""
        return np.array([0.403, -0.636, 0.114, 1.432, 0.735, 1.205, -0.269,
                         -0.403, -0.636, -0.114, 1.432, -0.735, 1.205, 0.269])

    @property
    def base_xpos_offset(self) -> dict[str, Placement]:
        """Where to place the robot by arena [m]."""
        return {'bins': (-0.5, -0.1, 0.0), 'empty': (-0.29, 0.0, 0.0),
                'table': lambda table_length: (-0.26 - table_length / 2.0, 0.0, 0.0)}
