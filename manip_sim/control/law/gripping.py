# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Motion of the setpoints of a gripper in an interval, and the force of fingers that stand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.control.law.compiling import compiled, inner
from manip_sim.control.law.finger_records import ACTS, Grip, Gripper, MOVES, PAIR, TURNED
from manip_sim.control.law.small_matrices import clip
from manip_sim.physics.physics import WorldArrays

#: A finger has come to an end of its range if it is nearer than this fraction of the range.
_AT_END = 0.015
#: A finger has stopped if it would take longer than this to cross its range [s].
_STOPPED_S = 20.0
#: Time of a stopped finger from its first to its full force [s].
_PRESS_S = 0.05
#: Time constant with which two fingers that press come to be equally open [s].
_CENTRES_S = 0.1
#: Two fingers that press have settled if their setpoints move less in an interval, as a fraction
#: of the range.
_STEADY = 1e-3


@compiled
def move_fingers(world: WorldArrays, gripper: Gripper, duration: float) -> None:
    """
    Write the controls of a gripper for an interval, if its setpoints move or centre fingers.

    :param gripper: whose grip is changed
    :param duration: of the interval [s]
    """
    fingers, grip = gripper.fingers, gripper.grip
    centres = grip.flags[PAIR] and grip.pressing[0] and grip.pressing[1]
    if not (grip.flags[MOVES] or centres):
        return
    count = len(fingers)
    place, present, target = np.empty(count), np.empty(count), np.empty(count)
    for i in range(count):
        finger = fingers[i]
        place[i] = -(finger.offset + finger.per_length * world.lengths[finger.id]) / finger.gain
    _end_at_ends(fingers, grip, place)
    for i in range(count):
        finger = fingers[i]
        present[i] = (world.activations[finger.activation] if finger.integrates
                      else world.controls[finger.id])
        speed = -finger.per_length / finger.gain * world.speeds[finger.id]
        target[i] = _find_target(finger, grip, i, place[i], present[i], speed)
    centres = grip.flags[PAIR] and grip.pressing[0] and grip.pressing[1]
    if centres:
        _find_centre(fingers, grip, place, present, duration, target)
    moves = False
    for i in range(count):
        finger, begin = fingers[i], present[i]
        if (grip.flags[TURNED] and finger.is_servo
                and (target[i] - place[i]) * (begin - place[i]) < 0.0):
            # A servo that presses the other way lets go at once, or its finger would have to wait
            # until the setpoint has come back to it.
            begin = place[i]
        setpoint = begin + _stride(finger, grip, i, target[i] - begin, centres, duration)
        change = abs(setpoint - present[i])
        if change <= finger.tolerance and finger.is_servo:
            setpoint = present[i]
        world.controls[finger.id] = (
            (setpoint - present[i]) / duration if finger.integrates else setpoint)
        waits = (grip.to_end[i, 0] or grip.to_end[i, 1]) and not grip.pressing[i]
        steady = _STEADY * (finger.high - finger.low) if centres else finger.tolerance
        moves = moves or waits or not change <= steady
    moves = moves or grip.flags[ACTS]
    if grip.flags[MOVES] and not moves:
        for i in range(count):
            grip.stopped[i] = place[i]
    grip.flags[MOVES], grip.flags[TURNED] = moves, False


@inner
def _end_at_ends(fingers: Any, grip: Grip, place: FloatArray) -> None:
    """
    Let fingers stay at ends of their range to which they were sent.

    One of a pair goes on to press there until the other one has come to its end, too, as that may
    push a part, and it with the part.
    """
    arrive, waits = np.empty(len(fingers), np.bool_), False
    for i in range(len(fingers)):
        near = _AT_END * (fingers[i].high - fingers[i].low)
        # Forces may also push a finger past the end.
        arrive[i] = (grip.to_end[i, 0] and place[i] - grip.goal[i] < near
                     or grip.to_end[i, 1] and grip.goal[i] - place[i] < near)
        waits = waits or (grip.to_end[i, 0] or grip.to_end[i, 1]) and not arrive[i]
    for i in range(len(fingers)):
        if arrive[i] and not (grip.flags[PAIR] and waits):
            grip.to_end[i, 0] = grip.to_end[i, 1] = False


@inner
def _find_target(finger: Any, grip: Grip, i: int, place: float, setpoint: float, speed: float
                 ) -> float:
    """Return the goal, or beyond the end of the range where the full force is requested."""
    span, target = finger.high - finger.low, grip.goal[i]
    arrived = abs(setpoint - grip.goal[i]) <= finger.tolerance
    stopped = abs(speed) < span / _STOPPED_S
    grip.pressing[i] = (grip.pressing[i] or arrived and stopped) and (
        grip.to_end[i, 0] or grip.to_end[i, 1])
    if grip.pressing[i] and grip.to_end[i, 0]:
        target -= finger.below
    if grip.pressing[i] and grip.to_end[i, 1]:
        target += finger.above
    return float(target)


@inner
def _find_centre(fingers: Any, grip: Grip, place: FloatArray, setpoints: FloatArray,
                 duration: float, target: FloatArray) -> None:
    """
    Write setpoints at which two fingers exert their full force where they are equally open.

    Where they are not, that of the finger which gives way moves on until they are.
    """
    opening, ahead, opened, led = np.empty(2), np.empty(2), 0.0, 0.0
    for i in range(2):
        inward = -1.0 if grip.to_end[i, 0] else 1.0
        opening[i], ahead[i] = inward * (grip.goal[i] - place[i]), inward * (
            setpoints[i] - grip.goal[i])
        opened, led = opened + opening[i] / 2.0, led + ahead[i] / 2.0
    for i in range(2):
        inward, lead = -1.0 if grip.to_end[i, 0] else 1.0, 0.0
        lead += fingers[i].reach_below if grip.to_end[i, 0] else 0.0
        lead += fingers[i].reach_above if grip.to_end[i, 1] else 0.0
        trim = clip(ahead[i] - led + min(duration / _CENTRES_S, 1.0) * (opening[i] - opened),
                    -lead, lead)
        target[i] = grip.goal[i] + inward * (lead + trim - opened)


@inner
def _stride(finger: Any, grip: Grip, i: int, distance: float, centres: bool, duration: float
            ) -> float:
    """Return how far a setpoint moves in an interval."""
    if centres and (distance > 0.0) == grip.to_end[i, 0]:
        return distance  # A setpoint beyond the full force comes back at once.
    pace = min(finger.speed, grip.pace[i])
    if grip.pressing[i]:
        pace = max(finger.below, finger.above, 0.0) / _PRESS_S
    return clip(distance, -pace * duration, pace * duration) if pace < math.inf else distance
