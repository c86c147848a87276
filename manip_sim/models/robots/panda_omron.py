# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The Franka Emika Panda on a mobile base with a lifting column."""

from __future__ import annotations

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.models.robots.panda import Panda
from manip_sim.models.robots.robot_model import Placement


class PandaOmron(Panda):
    """The Panda, by default on the Omron base."""

    #: Upper arm upright, hand pointing down [rad].
    _init_qpos = (0.0, np.pi / 16.0 - 0.2, 0.0, -np.pi / 2.0 - np.pi / 3.0, 0.0, np.pi - 0.4,
                  np.pi / 4.0)

    @property
    def default_base(self) -> str:
        """The Omron base."""
        return 'OmronMobileBase'

    @property
    def init_torso_qpos(self) -> FloatArray:
        """Start position of the column, lifted by 0.2 m [m], shape (1,)."""
        return np.array([0.2])

    @property
    def init_base_qpos(self) -> FloatArray | None:
        """Start positions of the base: the torso lifted, if it has one, else zero [m or rad]."""
        if self.base is None:
            return None
        lifted = dict(zip(self.torso_joints, self.init_torso_qpos))
        return np.array([lifted.get(joint, 0.0) for joint in self.base.joints])

    @property
    def base_xpos_offset(self) -> dict[str, Placement]:
        """Where to place the robot by arena [m]."""
        return {**super().base_xpos_offset, 'bins': (-0.6, -0.1, 0.0)}
