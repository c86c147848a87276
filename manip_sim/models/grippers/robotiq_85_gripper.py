# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The Robotiq 2F-85, a gripper with two fingers on parallelogram linkages."""

from __future__ import annotations

from manip_sim.models.grippers.catalogue_gripper import CatalogueGripper
from manip_sim.models.grippers.open_close_gripper import OpenCloseGripper


class Robotiq85GripperBase(CatalogueGripper, registered=False):
    """Robotiq 2F-85 whose outer knuckles are commanded one by one, +1 closed."""

    _folder = 'robotiq_85_gripper'
    #: Open [rad]. These values of robosuite are up to 0.2 rad outside the joint ranges and
    #: leave the pads tilted by 0.29 rad; ``Simulation`` lets the linkage settle before the start.
    _start = -0.026, -0.267, -0.2, -0.026, -0.267, -0.2
    _important_geoms = {
        f'{side}_{part}': [f'{side}_{link}_collision' for link in links]
        for side in ('left', 'right')
        for part, links in (
            ('finger', ('outer_finger', 'inner_finger', 'fingertip', 'fingerpad')),
            ('fingerpad', ('fingerpad',)))}


class Robotiq85Gripper(OpenCloseGripper, Robotiq85GripperBase):
    """Robotiq 2F-85 that opens and closes."""

    _closed = (1.0, 1.0)
