# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What all bases share: a prefix and the point that the robot stands on."""

from __future__ import annotations

from typing import Any

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.models.mjcf import MujocoXMLModel
from manip_sim.models.registry import Registry


class RobotBaseModel(MujocoXMLModel):
    """
    What a robot stands on; a subclass of one of the kinds below declares its offsets.

    :attr:`bottom_offset`, the position of the root body in the file, is the position of the floor
    in the frame of the base.
    """

    #: The subsystem of joints whose names contain no keyword.
    subsystem_of_others = 'arm'
    _top_offset: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __init_subclass__(cls, registered: bool = True, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if registered:
            BASES.register(cls)

    @property
    def top_offset(self) -> FloatArray:
        """Where the robot stands, in the frame of the base [m], shape (3,), a copy."""
        return np.array(self._top_offset)


BASES: Registry[RobotBaseModel] = Registry('base', RobotBaseModel)


class MountModel(RobotBaseModel, registered=False):
    """
    A mount without joints; it is attached below the robot's root body.

    Prefix ``fixed_mount{idn}_``.
    """

    @property
    def _prefix_of_idn(self) -> str:
        return f'fixed_mount{self.idn}_'


class MobileBaseModel(RobotBaseModel, registered=False):
    """
    A base that may have joints and carries the robot on its body ``support``.

    Prefix ``mobilebase{idn}_``.
    """

    #: The body that the robot is mounted on.
    support_body = 'support'
    #: Whether it drives sideways; else twists along y are clamped to zero.
    sideways: bool = True

    @property
    def _prefix_of_idn(self) -> str:
        return f'mobilebase{self.idn}_'
