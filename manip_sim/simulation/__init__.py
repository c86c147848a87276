# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Simulation says what happens: no clock, no thread, no ROS; time is a count of steps."""

from manip_sim.simulation.robot import SimulatedRobot
from manip_sim.simulation.simulation import Simulation
from manip_sim.simulation.state import State, Wrench

__all__ = ['SimulatedRobot', 'Simulation', 'State', 'Wrench']
