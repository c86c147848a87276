# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Runtime says when it happens: wall time, waiting, one thread for the physics; no ROS."""

from manip_sim.runtime.simulation_thread import Observer, Progress, SimulationThread

__all__ = ['Observer', 'Progress', 'SimulationThread']
