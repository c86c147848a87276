# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Write a MoveIt 2 configuration of a composed robot; without ROS."""

from manip_sim.moveit.package import write_package

__all__ = ['write_package']
