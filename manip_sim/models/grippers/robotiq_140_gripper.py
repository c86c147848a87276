# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The Robotiq 2F-140, a two-finger gripper with parallel fingertips."""

from __future__ import annotations

from manip_sim.models.grippers.catalogue_gripper import CatalogueGripper
from manip_sim.models.grippers.open_close_gripper import OpenCloseGripper


class Robotiq140GripperBase(CatalogueGripper, registered=False):
    """
    Robotiq 2F-140 whose two actuators are commanded one by one, the left one first.

    One motor moves both fingers of the real gripper, so with two different commands both fingers
    go to the same place between them.
    """

    _folder = 'robotiq_140_gripper'
    #: Open [rad]. These values from robosuite violate the closed linkage by up to 0.08 rad;
    #: ``Simulation`` lets the linkage settle before the start.
    _start = 0.012, 0.065, 0.065, -0.012, 0.065, 0.065
    _important_geoms = {
        'left_finger': ['left_outer_finger_collision', 'left_inner_finger_collision',
                        'left_fingertip_collision', 'left_fingerpad_collision'],
        'right_finger': ['right_outer_finger_collision', 'right_inner_finger_collision',
                         'right_fingertip_collision', 'right_fingerpad_collision'],
        'left_fingerpad': ['left_fingerpad_collision'],
        'right_fingerpad': ['right_fingerpad_collision']}


class Robotiq140Gripper(OpenCloseGripper, Robotiq140GripperBase):
    """Robotiq 2F-140 that opens and closes."""

    _closed = (1.0, -1.0)
