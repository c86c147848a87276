# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What single arms share that stand on the Rethink pedestal in robosuite."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.models.robots.manipulator_model import ManipulatorModel
from manip_sim.models.robots.robot_model import Placement
from manip_sim.resources import asset_path


class PedestalArm(ManipulatorModel, registered=False):
    """
    One arm on the Rethink pedestal; a subclass declares the rest.

    :param idn: number or word in names
    """

    _asset: ClassVar[str]
    _gripper: ClassVar[str]
    _controller_config: ClassVar[str]
    #: Start positions of the joints [rad].
    _init_qpos: ClassVar[tuple[float, ...]]
    _horizontal_radius = 0.5
    _top_offset = (0.0, 0.0, 1.0)

    def __init__(self, idn: int | str = 0) -> None:
        super().__init__(asset_path('robots', self._asset), idn=idn)

    @property
    def arm_type(self) -> str:
        """``single``: one arm."""
        return 'single'

    @property
    def default_base(self) -> str:
        """The Rethink pedestal."""
        return 'RethinkMount'

    @property
    def default_gripper(self) -> dict[str, str]:
        """Name of the gripper by arm."""
        return {'right': self._gripper}

    @property
    def default_controller_config(self) -> dict[str, str]:
        """Names of robosuite's controller settings, by arm."""
        return {'right': self._controller_config}

    @property
    def init_qpos(self) -> FloatArray:
        """Elbow up, hand pointing down [rad], shape (dof,), a copy."""
        return np.array(self._init_qpos)

    @property
    def base_xpos_offset(self) -> dict[str, Placement]:
        """Where to place the robot by arena [m]."""
        return {'bins': (-0.5, -0.1, 0.0), 'empty': (-0.6, 0.0, 0.0),
                'table': lambda table_length: (-0.16 - table_length / 2.0, 0.0, 0.0)}
