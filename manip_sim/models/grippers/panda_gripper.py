# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The two-finger hand of the Franka Emika Panda."""

from __future__ import annotations

from manip_sim.models.grippers.catalogue_gripper import CatalogueGripper
from manip_sim.models.grippers.open_close_gripper import OpenCloseGripper


class PandaGripperBase(CatalogueGripper, registered=False):
    """Franka hand whose fingers are commanded one by one."""

    _folder = 'panda_gripper'
    #: Half open [m].
    _start = 0.020833, -0.020833
    _important_geoms = {
        'left_finger': ['finger1_collision', 'finger1_pad_collision'],
        'right_finger': ['finger2_collision', 'finger2_pad_collision'],
        'left_fingerpad': ['finger1_pad_collision'],
        'right_fingerpad': ['finger2_pad_collision']}


class PandaGripper(OpenCloseGripper, PandaGripperBase):
    """Franka hand that opens and closes."""

    _closed = (-1.0, 1.0)
