# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Load the compiled laws of control before a command needs them, and compile them if need be."""

from __future__ import annotations

from manip_sim.models import compose
from manip_sim.simulation.simulation import Simulation


def load_laws() -> None:
    """Load or compile all laws, by commands to a robot that nobody sees."""
    simulation = Simulation(compose('Panda'))
    robot, period_s = simulation.robot, simulation.timestep_s
    # Operational space control in effort mode, inverse kinematics in position mode.
    for mode in ('effort', 'position'):
        robot.set_control_mode('arm', mode)
        for _ in range(2):  # A stream.
            robot.apply(robot.parse_cartesian.action('right', [0.1] * 6), period_s=period_s)
            simulation.advance(1)
    robot.apply(*robot.parse.joint_command(robot.joint_names[:1], position=[0.0]),
                period_s=period_s)
    simulation.advance(1)
