# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A board eraser: a gripper without joints."""

from __future__ import annotations

from manip_sim.models.grippers.catalogue_gripper import CatalogueGripper


class WipingGripper(CatalogueGripper):
    """Eraser with a touch sensor at each corner of its wiping surface."""

    _folder = 'wiping_gripper'
    _start = None
    _important_geoms = {
        'left_finger': [], 'right_finger': [], 'left_fingerpad': [], 'right_fingerpad': [],
        'corners': ['wiping_corner1', 'wiping_corner2', 'wiping_corner3', 'wiping_corner4']}
