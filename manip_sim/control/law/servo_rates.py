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
from manip_sim.control.law.compiling import inlined
from manip_sim.control.law.loads import carry, Loads
from manip_sim.control.law.small_matrices import clip
from manip_sim.physics.physics import WorldArrays

#: Dry friction sets in up to this velocity, so that joints at rest are not pushed to and fro;
#: MuJoCo's noslip solver, which all worlds have, lets it act in full at any [rad/s or m/s].
_SLIDING = 0.05
#: Share of the highest effort that integral terms exert at most; errors for which a servo exerts
#: more are not integrated, so that nothing winds up where something blocks a joint.
_INTEGRAL_SHARE = 0.2
#: Errors that are not integrated, so that joints with dry friction do not hunt [rad or m].
_INTEGRAL_DEADBAND = 5e-6
#: Share of the highest effort that a servo may exert where the weight takes more.
_LEAST_SHARE = 0.05
#: A joint presses on something that takes more than this share of the effort that is left to it.
_PRESSING_SHARE = 0.5
#: Time constant of the mean velocity of a joint that presses [s].
_SLIDE_S = 0.05


@inlined
def find_rates(world: WorldArrays, servos: Any, places: IntArray, joints: Any,
               beside: FloatArray, duration: float, goals: FloatArray, rates: FloatArray) -> None:
    """
    Write the rates of activations in an interval.

    :param servos: records, shape (n,)
    :param places: of their inertia in ``M``, -1 where it is zero, shape (n, n)
    :param joints: records at the end of the interval, shape (n,)
    :param beside: efforts that carry payloads, and integral terms [N m or N], shape (n,)
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
        force += beside[i]
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


@inlined
def find_efforts_beside(world: WorldArrays, servos: Any, joints: Any, loads: Loads,
                        integrals: FloatArray, beside: FloatArray) -> None:
    """
    Write the efforts that carry and move payloads, and the efforts of integral terms.

    :param servos: records, shape (n,)
    :param joints: records of the motion, shape (n,)
    :param integrals: leads over setpoints [rad or m], shape (n,)
    :param beside: efforts [N m or N], shape (n,), written
    """
    for i in range(len(servos)):
        beside[i] = servos[i].stiffness * integrals[i]
    if len(loads.loads):
        accelerations = np.zeros(len(world.velocities))
        for i in range(len(joints)):
            if not servos[i].gives:
                accelerations[servos[i].dof] = joints[i].acceleration
        carry(world, loads, servos, accelerations, True, beside)


@inlined
def drive(world: WorldArrays, servos: Any, places: IntArray, joints: Any, loads: Loads,
          integrals: FloatArray, efforts: FloatArray, duration: float) -> None:
    """
    Write the controls with which servos follow setpoints in an interval, and the other efforts.

    Setpoints that are too far ahead of joints that cannot keep up are held back.

    :param servos: records, shape (n,)
    :param places: of their inertia in ``M``, -1 where it is zero, shape (n, n)
    :param joints: records at the end of the interval, shape (n,), which may be changed
    :param loads: payloads
    :param integrals: leads of integral terms over setpoints [rad or m], shape (n,), changed
    :param efforts: of the joints that are sources of effort [N m or N], shape (n,)
    :param duration: of the interval [s]
    """
    count = len(joints)
    goals, rates, beside = np.empty(count), np.empty(count), np.empty(count)
    find_efforts_beside(world, servos, joints, loads, integrals, beside)
    _hold_back(world, servos, joints, beside, duration)
    _integrate(world, servos, joints, integrals, beside, duration)
    for i in range(count):
        goals[i] = world.activations[servos[i].activation]
    find_rates(world, servos, places, joints, beside, duration, goals, rates)
    for i in range(count):
        servo = servos[i]
        world.controls[servo.control] = rates[i]
        if servo.gives:
            world.activations[servo.activation] = (efforts[i] + beside[i]) / servo.gear


@inlined
def _integrate(world: WorldArrays, servos: Any, joints: Any, integrals: FloatArray,
               beside: FloatArray, duration: float) -> None:
    """Let integral terms of servos go on, where neither the effort nor the error is too great."""
    for i in range(len(joints)):
        x, servo = joints[i], servos[i]
        if servo.integral == 0.0 or servo.gives or x.held != 0.0:
            continue
        most = _INTEGRAL_SHARE * max(servo.high, -servo.low) / servo.stiffness
        begin = x.position - duration * (x.velocity - duration / 2.0 * x.acceleration)
        error = begin - world.kinematics.positions[servo.qpos]
        if _INTEGRAL_DEADBAND < abs(error) <= most:
            before = integrals[i]
            integrals[i] = clip(before + servo.integral * duration * error, -most, most)
            beside[i] += servo.stiffness * (integrals[i] - before)


@inlined
def _room(world: WorldArrays, servo: Any, beside: float) -> tuple[float, float]:
    """
    Return how far a setpoint may be behind its joint, as a negative number, and ahead of it.

    :param beside: effort that carries payloads, and that of an integral term [N m or N]

    There the servo exerts all of the effort that the weight leaves, or, where the weight helps,
    all that its actuator can exert. Farther away, it would not damp the joint either, whose
    velocity changes nothing as long as the effort is at its limit.
    """
    carried = beside + (world.carried[servo.dof] if servo.compensated else 0.0)
    low, high = max(servo.low - carried, servo.least - beside), min(
        servo.high - carried, servo.most - beside)
    return (min(low, _LEAST_SHARE * servo.low) / servo.stiffness,
            max(high, _LEAST_SHARE * servo.high) / servo.stiffness)


@inlined
def _presses(world: WorldArrays, servo: Any, room: float) -> bool:
    """
    Return whether something resists a joint with much of the effort that its setpoint may use.

    A setpoint that goes on with its joint takes the damping from it while it moves that way. One
    that presses would swing for ever on contacts that let go and take hold again, so there the
    setpoint goes on with the mean velocity.

    :param room: how far the setpoint may be ahead of its joint [rad or m]
    """
    effort = room * servo.stiffness
    return bool(world.constraints[servo.dof] * effort < -_PRESSING_SHARE * effort * effort)


@inlined
def _hold_back(world: WorldArrays, servos: Any, joints: Any, beside: FloatArray,
               duration: float) -> None:
    """Keep setpoints from running ahead of joints that cannot keep up."""
    for i in range(len(joints)):
        x, servo = joints[i], servos[i]
        low, high = _room(world, servo, beside[i])
        place = world.kinematics.positions[servo.qpos]
        velocity = world.velocities[servo.dof]
        x.slide += duration / (_SLIDE_S + duration) * (velocity - x.slide)
        if _presses(world, servo, high if x.position > place else low):
            velocity = clip(x.slide, min(velocity, 0.0), max(velocity, 0.0))
        # It goes on with its joint, but never against its own motion.
        velocity = clip(velocity, min(x.velocity, 0.0), max(x.velocity, 0.0))
        place += duration * velocity
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
