# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The flange without a gripper."""

from __future__ import annotations

from manip_sim.models.grippers.catalogue_gripper import CatalogueGripper


class NullGripper(CatalogueGripper):
    """A grasp frame and a force-torque sensor, without mass and without shape."""

    _folder = 'null_gripper'
    _start = None
