# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Servos of joints: what lets MuJoCo's own actuators follow setpoints, with feedforward.

The activation of an actuator is the position of a servo plus feedforward force / stiffness; the
force covers damping, friction, inertia and, with gravity compensation, Coriolis forces. ``ctrl``
is the rate at which the activation changes, so setpoints are linear in an interval.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.control.law.compiling import compiled, inner
from manip_sim.control.law.joint_records import Drives
from manip_sim.control.law.small_matrices import clip
from manip_sim.physics.physics import WorldArrays

#: Share of the lead of a joint: with a smaller error, setpoints are planned for as long as they
#: travel less than the lead. All figures of docs/explanation/contact.md are those without plans.
CALM = 0.25
#: Dry friction sets in up to this velocity, so that joints at rest are not pushed to and fro;
#: MuJoCo's noslip solver, which all worlds have, lets it act in full at any [rad/s or m/s].
_SLIDING = 0.05


@compiled
def find_rates(world: WorldArrays, drives: Drives, joints: Any, duration: float,
               goals: FloatArray, rates: FloatArray) -> None:
    """
    Write the rates of activations in an interval.

    :param joints: records at its end, shape (n,)
    :param duration: of the interval [s]
    :param goals: the activations at its beginning, shape (n,), changed to those at its end
    :param rates: shape (n,), written
    """
    for i in range(len(joints)):
        x, dof, before = joints[i], drives.dofs[i], goals[i]
        if drives.gives[i]:
            rates[i] = 0.0
            continue
        force = drives.drag[i] * x.velocity + drives.friction[i] * clip(
            x.velocity / _SLIDING, -1.0, 1.0)
        if drives.compensated[i]:
            # The bias force minus the weight, which the actuators carry already.
            force += world.bias[dof] - world.carried[dof]
        for j in range(len(joints)):
            if drives.places[i, j] >= 0 and not drives.gives[j]:
                force += world.inertia[drives.places[i, j]] * joints[j].acceleration
        goals[i] = drives.gear[i] * (x.position + force / drives.stiffness[i])
        rates[i] = (goals[i] - before) / duration


@compiled
def drive(world: WorldArrays, drives: Drives, joints: Any, states: Any, ends: FloatArray,
          rates: FloatArray) -> int:
    """
    Find how servos follow setpoints in an interval, and how they follow a plan after it.

    Setpoints that are too far ahead of joints that cannot keep up are held back.

    :param joints: records, shape (n,), at the end of the first interval, which may be changed
    :param states: records at the ends of intervals, shape (k, n), of which the first is not read
    :param ends: of the intervals, since now [s], shape (k,)
    :param rates: of activations in the intervals, shape (k, n), written
    :returns: how many intervals may be run as planned: one where joints do not follow, and as many
        as setpoints take to go as far as they may be ahead
    """
    held = _hold_back(world, drives, joints, ends[0])
    planned = 1 if held else _calm_intervals(world, drives, joints, states, ends)
    goals = np.empty(len(joints))
    for i in range(len(joints)):
        goals[i] = world.activations[drives.activations[i]]
    begin = 0.0
    for k in range(planned):
        find_rates(world, drives, joints if k == 0 else states[k], ends[k] - begin, goals,
                   rates[k])
        begin = ends[k]
    return planned


@inner
def _hold_back(world: WorldArrays, drives: Drives, joints: Any, duration: float) -> bool:
    """Keep setpoints from running ahead of joints that cannot keep up; return whether any was."""
    held = False
    for i in range(len(joints)):
        x, top = joints[i], drives.top[i]
        place, velocity = world.positions[drives.qpos[i]], world.velocities[drives.dofs[i]]
        if abs(velocity) > top:
            # It goes far in an interval, and must not stop at once.
            place += duration * (velocity - clip(velocity, -top, top))
        if not drives.gives[i] and abs(x.position - place) > drives.lead[i]:
            x.position = clip(x.position, place - drives.lead[i], place + drives.lead[i])
            x.raw = x.first = x.second = x.rate = x.velocity = x.acceleration = 0.0
            x.held, held = 1.0, True
    return held


@inner
def _calm_intervals(world: WorldArrays, drives: Drives, joints: Any, states: Any,
                    ends: FloatArray) -> int:
    """Return in how many intervals setpoints stay near their joints, by one look at these."""
    calm = len(states)
    for i in range(len(joints)):
        x = joints[i]
        behind = x.position - ends[0] * x.velocity - world.positions[drives.qpos[i]]
        if drives.gives[i] or abs(behind) > CALM * drives.lead[i]:
            return 1
        fastest = abs(x.velocity)
        for k in range(1, calm):
            fastest = max(fastest, abs(states[k, i].velocity))
            if fastest * ends[k] > drives.lead[i]:
                calm = k
                break
    return calm
