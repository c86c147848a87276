# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The simulation of a world: no clock, no threads, no ROS; time is a count of physics steps."""

from manip_sim.physics.parts import Wrench
from manip_sim.physics.payload import Payload
from manip_sim.simulation.payload_estimation import PayloadEstimate
from manip_sim.simulation.robot import SimulatedRobot
from manip_sim.simulation.robot_state import State
from manip_sim.simulation.saved_state import SimulationState
from manip_sim.simulation.simulation import Simulation

__all__ = ['Payload', 'PayloadEstimate', 'SimulatedRobot', 'Simulation', 'SimulationState',
           'State', 'Wrench']
