# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Servos of joints: what lets MuJoCo's own actuators follow setpoints, with feedforward.

The activation of an actuator is the position of a servo plus feedforward force / stiffness; the
force covers damping, friction, inertia and, with gravity compensation, Coriolis forces. ``ctrl``
is the rate at which the activation changes, so setpoints are linear in an interval.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.law.compiling import compiled, inner
from manip_sim.control.law.small_matrices import clip
from manip_sim.physics.physics import WorldArrays

#: Dry friction sets in up to this velocity, so that joints at rest are not pushed to and fro;
#: MuJoCo's noslip solver, which all worlds have, lets it act in full at any [rad/s or m/s].
_SLIDING = 0.05
#: Share of the highest effort that a servo may exert where the weight takes more.
_LEAST_SHARE = 0.05


@compiled
def find_rates(world: WorldArrays, servos: Any, places: IntArray, joints: Any, duration: float,
               goals: FloatArray, rates: FloatArray) -> None:
    """
    Write the rates of activations in an interval.

    :param servos: records, shape (n,)
    :param places: of their inertia in ``M``, -1 where it is zero, shape (n, n)
    :param joints: records at the end of the interval, shape (n,)
    :param duration: of the interval [s]
    :param goals: the activations at its beginning, shape (n,), changed to those at its end
    :param rates: shape (n,), written
    """
    for i in range(len(joints)):
        x, servo, before = joints[i], servos[i], goals[i]
        if servo.gives:
            rates[i] = 0.0
            continue
        force = servo.drag * x.velocity + servo.friction * clip(x.velocity / _SLIDING, -1.0, 1.0)
        if servo.compensated:
            # The bias force minus the weight, which the actuators carry already.
            force += world.bias[servo.dof] - world.carried[servo.dof]
        if servo.leads:
            force += servo.effort
        if servo.damps:  # With respect to the velocity of the command, not that of the setpoint.
            force += servo.damping * (servo.velocity - x.velocity)
        for j in range(len(joints)):
            if places[i, j] >= 0 and not servos[j].gives:
                force += world.inertia[places[i, j]] * joints[j].acceleration
        goals[i] = servo.gear * (x.position + force / servo.stiffness)
        rates[i] = (goals[i] - before) / duration


@compiled
def drive(world: WorldArrays, servos: Any, places: IntArray, joints: Any, efforts: FloatArray,
          duration: float) -> None:
    """
    Write the controls with which servos follow setpoints in an interval, and the other efforts.

    Setpoints that are too far ahead of joints that cannot keep up are held back.

    :param servos: records, shape (n,)
    :param places: of their inertia in ``M``, -1 where it is zero, shape (n, n)
    :param joints: records at the end of the interval, shape (n,), which may be changed
    :param efforts: of the joints that are sources of effort [N m or N], shape (n,)
    :param duration: of the interval [s]
    """
    count = len(joints)
    goals, rates = np.empty(count), np.empty(count)
    _hold_back(world, servos, joints, duration)
    for i in range(count):
        goals[i] = world.activations[servos[i].activation]
    find_rates(world, servos, places, joints, duration, goals, rates)
    for i in range(count):
        servo = servos[i]
        world.controls[servo.control] = rates[i]
        if servo.gives:
            world.activations[servo.activation] = efforts[i] / servo.gear


@inner
def _room(world: WorldArrays, servo: Any) -> tuple[float, float]:
    """
    Return how far a setpoint may be behind its joint, as a negative number, and ahead of it.

    There the servo exerts all of the effort that the weight leaves. Farther away, it would not
    damp the joint either, whose velocity changes nothing as long as the effort is at its limit.
    """
    carried = world.carried[servo.dof] if servo.compensated else 0.0
    return (min(servo.low - carried, _LEAST_SHARE * servo.low) / servo.stiffness,
            max(servo.high - carried, _LEAST_SHARE * servo.high) / servo.stiffness)


@inner
def _hold_back(world: WorldArrays, servos: Any, joints: Any, duration: float) -> None:
    """Keep setpoints from running ahead of joints that cannot keep up."""
    for i in range(len(joints)):
        x, servo = joints[i], servos[i]
        low, high = _room(world, servo)
        # It goes on with its joint, but never against its own motion.
        velocity = clip(world.velocities[servo.dof], min(x.velocity, 0.0), max(x.velocity, 0.0))
        place = world.kinematics.positions[servo.qpos] + duration * velocity
        if servo.gives or low <= x.position - place <= high:
            continue
        x.position = clip(clip(x.position, place + low, place + high), x.low, x.high)
        # Nor beyond the end of its range, whatever the joint does.
        velocity = clip(velocity, 0.0 if x.position <= x.low else -math.inf,
                        0.0 if x.position >= x.high else math.inf)
        x.rate = 0.0 if x.seeks != 0.0 else velocity
        x.raw = x.first = x.second = velocity - x.rate
        x.velocity, x.acceleration = velocity, 0.0
        x.held = 1.0
