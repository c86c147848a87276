# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The two kinds of drives."""

from typing import Union

from manip_sim.simulation.gripper_drive import GRIPPER_RATE_HZ, GripperDrive
from manip_sim.simulation.subsystem_drive import SubsystemDrive

Drive = Union[SubsystemDrive, GripperDrive]

__all__ = ['Drive', 'GRIPPER_RATE_HZ', 'GripperDrive', 'SubsystemDrive']
