# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Common parts of all bases: a prefix and the point that the robot stands on."""

from __future__ import annotations

from typing import Any

from manip_sim.models.mjcf import MujocoXMLModel
from manip_sim.models.registry import Registry


class RobotBaseModel(MujocoXMLModel):
    """
    A base of a robot; a subclass of one of the kinds below declares its offsets.

    :attr:`bottom_offset`, the position of the root body in the file, is the position of the floor
    in the frame of the base; the robot stands at :attr:`top_offset`.
    """

    #: The subsystem of joints whose names contain no keyword.
    subsystem_of_others = 'arm'

    def __init_subclass__(cls, registered: bool = True, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if registered:
            BASES.register(cls)


BASES: Registry[RobotBaseModel] = Registry('base', RobotBaseModel)


class MountModel(RobotBaseModel, registered=False):
    """
    A mount without joints; it is attached below the robot's root body.

    Prefix ``fixed_mount{idn}_``.
    """

    _prefix_word = 'fixed_mount'


class MobileBaseModel(RobotBaseModel, registered=False):
    """
    A base that may have joints and carries the robot on its body ``support``.

    Prefix ``mobilebase{idn}_``.
    """

    _prefix_word = 'mobilebase'
    subsystem_of_others = 'base'
    #: The body that the robot is mounted on.
    support_body = 'support'
    #: True if it drives sideways; else twists along y are clamped to zero.
    sideways: bool = True
