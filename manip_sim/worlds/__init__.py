# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Many copies of one world in one process; no clock, no ROS."""

from manip_sim.worlds.robot_in_worlds import RobotInWorlds, RobotStates
from manip_sim.worlds.worlds import Worlds

__all__ = ['RobotInWorlds', 'RobotStates', 'Worlds']
