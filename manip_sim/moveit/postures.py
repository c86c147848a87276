# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Postures of a robot: its start, and each gripper opened and closed by the simulation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.simulation import Simulation
from manip_sim.simulation.robot import SimulatedRobot

START, OPEN, CLOSED = 'start', 'open', 'closed'
#: Gripper actions; +1 closes.
_ACTIONS = {OPEN: -1.0, CLOSED: 1.0}
#: Fingers slower than this are at rest [rad/s or m/s]; longest wait for them to settle [s].
_RESTS, _PATIENCE_S = 1e-4, 6.0
_PERIOD_S = 0.05
#: Of positions where fingers have come to rest.
_DIGITS = 4


@dataclass(frozen=True)
class Posture:
    """
    Where the joints are.

    :ivar name: ``start``, ``open`` or ``closed``
    :ivar part: the gripper that was moved, or None at the start
    :ivar position: of all scalar joints by name, within their limits [rad or m]
    """

    name: str
    part: str | None
    position: dict[str, float]


def find_postures(simulation: Simulation, robot: SimulatedRobot) -> list[Posture]:
    """
    Return the start posture, and those of each empty gripper opened (-1) and closed (+1).

    :param simulation: at its start; it is there again afterwards
    :param robot: of this simulation
    """
    start = _positions(simulation, robot)
    postures = [Posture(START, None, start)]
    for part, gripper in robot.grippers.items():
        if not gripper.part.joints or not gripper.dof:
            continue
        for name, action in _ACTIONS.items():
            simulation.reset()
            robot.apply(robot.parse.action(part, np.full(gripper.dof, action)))
            _settle(simulation, robot, gripper.part.dof_addresses)
            moved = _positions(simulation, robot, _DIGITS)
            postures.append(Posture(name, part, {
                **start, **{joint: moved[joint] for joint in gripper.part.joints}}))
    simulation.reset()
    return postures


def _settle(simulation: Simulation, robot: SimulatedRobot, dofs: Any) -> None:
    steps = max(1, round(_PERIOD_S / simulation.timestep_s))
    for _ in range(round(_PATIENCE_S / _PERIOD_S)):
        simulation.advance(steps)
        velocity: FloatArray = np.abs(simulation.data.qvel[dofs])
        if not robot.moving and velocity.max(initial=0.0) < _RESTS:
            return


def _positions(simulation: Simulation, robot: SimulatedRobot, digits: int = 15
               ) -> dict[str, float]:
    positions = {}
    for name, value in zip(robot.joint_names, robot.state().position):
        joint = simulation.model.joint(name)
        low, high = joint.range if joint.limited[0] else (-np.inf, np.inf)
        positions[name] = float(np.clip(round(value, digits), low, high))
    return positions
