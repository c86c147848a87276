# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The electric parallel gripper of Rethink Robotics, for Baxter and Sawyer."""

from __future__ import annotations

from manip_sim.models.grippers.catalogue_gripper import CatalogueGripper
from manip_sim.models.grippers.open_close_gripper import OpenCloseGripper


class RethinkGripperBase(CatalogueGripper, registered=False):
    """Rethink gripper whose fingers are commanded one by one, the right one first."""

    _folder = 'rethink_gripper'
    #: Fully open, the left finger first [m].
    _start = 0.020833, -0.020833
    _important_geoms = {
        'left_finger': ['l_finger_g0', 'l_finger_g1', 'l_fingertip_g0', 'l_fingerpad_g0'],
        'right_finger': ['r_finger_g0', 'r_finger_g1', 'r_fingertip_g0', 'r_fingerpad_g0'],
        'left_fingerpad': ['l_fingerpad_g0'],
        'right_fingerpad': ['r_fingerpad_g0']}


class RethinkGripper(OpenCloseGripper, RethinkGripperBase):
    """Rethink gripper that opens and closes."""

    _closed = (1.0, -1.0)
