# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Write the URDF of a robot; reading URDF is in ``manip_sim.models.files.urdf``."""

from manip_sim.models.urdf_writer.kinematic_tree import build_tree, KinematicTree, robot_tree
from manip_sim.models.urdf_writer.ros2_control_tag import (
    Hardware, OWN_PLUGIN, PLUGINS, TOPIC_PLUGIN)
from manip_sim.models.urdf_writer.writer import choose_robot, Urdf, urdf_of, urdfs_of, write_urdf

__all__ = ['build_tree', 'choose_robot', 'Hardware', 'KinematicTree', 'OWN_PLUGIN', 'PLUGINS',
           'robot_tree', 'TOPIC_PLUGIN', 'Urdf', 'urdf_of', 'urdfs_of', 'write_urdf']
