# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The humanoid GR-1 of Fourier, with its pelvis fixed above the floor."""

from __future__ import annotations

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.models.robots.manipulator_model import ManipulatorModel
from manip_sim.models.robots.robot_model import Placement
from manip_sim.resources import asset_path

_PELVIS_HEIGHT_M = 0.95


class GR1(ManipulatorModel):
    """
    Humanoid of 1.65 m: torso, head, two seven-joint arms and two six-joint legs.

    :param idn: number or word in names
    """

    _horizontal_radius = 0.5
    _top_offset = (0.0, 0.0, 1.0)

    def __init__(self, idn: int | str = 0) -> None:
        super().__init__(asset_path('robots', 'gr1'), idn=idn)

    @property
    def arm_type(self) -> str:
        """``bimanual``: two arms."""
        return 'bimanual'

    @property
    def _eef_name(self) -> dict[str, str]:
        return {'right': 'right_eef', 'left': 'left_eef'}

    @property
    def default_base(self) -> str:
        """A base that does not move."""
        return 'NoActuationBase'

    @property
    def default_gripper(self) -> dict[str, str]:
        """Fourier's hand on each arm."""
        return {'right': 'FourierRightHand', 'left': 'FourierLeftHand'}

    @property
    def default_controller_config(self) -> dict[str, str]:
        """Names of robosuite's controller settings, by arm or subsystem."""
        return {'right': 'default_gr1', 'left': 'default_gr1', 'head': 'default_gr1_head',
                'torso': 'default_gr1_torso', 'right_leg': 'default_gr1',
                'left_leg': 'default_gr1'}

    @property
    def init_qpos(self) -> FloatArray:
        """Upright, forearms level and pointing ahead [rad], shape (32,)."""
        right_arm = [0.0, -0.1, 0.0, -1.57, 0.0, 0.0, 0.0]
        left_arm = [0.0, 0.1, 0.0, -1.57, 0.0, 0.0, 0.0]
        torso_and_head, legs = [0.0] * 6, [0.0] * 12
        return np.array([*torso_and_head, *right_arm, *left_arm, *legs])

    @property
    def base_xpos_offset(self) -> dict[str, Placement]:
        """Where to place the pelvis by arena [m]."""
        return {'bins': (-0.3, -0.1, _PELVIS_HEIGHT_M), 'empty': (-0.29, 0.0, _PELVIS_HEIGHT_M),
                'table': lambda table_length: (-0.15 - table_length / 2.0, 0.0, _PELVIS_HEIGHT_M)}
