# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Motion of the setpoints of a gripper in an interval, and the force of fingers that stand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.control.law.compiling import inlined, inner
from manip_sim.control.law.records import (
    FINGERS_MOVE, Grip, Gripper, GRIPPER_RATE_HZ, PAIR, RULED, TAKES, TURNED)
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
#: Time from one call of an action to the next one [s].
_CALL_S = 1.0 / GRIPPER_RATE_HZ


@inner
def move_fingers(world: WorldArrays, gripper: Gripper, now: float, duration: float) -> None:
    """
    Write the controls of a gripper for an interval, if its setpoints move or centre fingers.

    :param gripper: whose grip is changed
    :param now: simulation time since the last reset [s]
    :param duration: of the interval [s]
    """
    fingers, grip = gripper.fingers, gripper.grip
    if grip.flags[RULED] and grip.flags[TAKES] and now >= grip.call[0] - grip.call[1]:
        _take_action(world, fingers, grip, now)
    centres = grip.flags[PAIR] and grip.pressing[0] and grip.pressing[1]
    if not (grip.flags[FINGERS_MOVE] or centres):
        return
    count = len(fingers)
    place, present, target, speed = (
        np.empty(count), np.empty(count), np.empty(count), np.empty(count))
    for i in range(count):
        place[i] = _place(world, fingers[i])
    _end_at_ends(fingers, grip, place)
    for i in range(count):
        finger = fingers[i]
        present[i] = _setpoint(world, finger)
        speed[i] = -finger.per_length / finger.gain * world.speeds[finger.id]
        target[i] = _find_target(finger, grip, i, place[i], present[i], speed[i])
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
        setpoint = begin + _stride(finger, grip, i, target[i] - begin, speed[i], centres, duration)
        change = abs(setpoint - present[i])
        if change <= finger.tolerance and finger.is_servo:
            setpoint = present[i]
        world.controls[finger.id] = (
            (setpoint - present[i]) / duration if finger.integrates else setpoint)
        waits = (grip.to_end[i, 0] or grip.to_end[i, 1]) and not grip.pressing[i]
        steady = _STEADY * (finger.high - finger.low) if centres else finger.tolerance
        moves = moves or waits or not change <= steady
    moves = moves or grip.flags[TAKES]
    if grip.flags[FINGERS_MOVE] and not moves:
        for i in range(count):
            grip.stopped[i] = place[i]
    grip.flags[FINGERS_MOVE], grip.flags[TURNED] = moves, False


@inlined
def _place(world: WorldArrays, finger: Any) -> float:
    """Return the setpoint at which a servo would rest where it is; zero for another actuator."""
    return float(-(finger.offset + finger.per_length * world.lengths[finger.id]) / finger.gain)


@inlined
def _setpoint(world: WorldArrays, finger: Any) -> float:
    """Return the present setpoint of a servo, or the control of another actuator."""
    return float(world.activations[finger.activation] if finger.integrates
                 else world.controls[finger.id])


@inlined
def _take_action(world: WorldArrays, fingers: Any, grip: Grip, now: float) -> None:
    """Take an action that is due by its rule, as the controller does with other grippers."""
    late, count = now - grip.call[0], len(fingers)
    grip.call[0] = _CALL_S + (grip.call[0] if late < _CALL_S else now)
    goal, place, back = np.empty(count), np.empty(count), False
    _find_goal(fingers, grip, goal)
    for i in range(count):
        place[i] = _place(world, fingers[i])
        ahead, left = grip.goal[i] - place[i], goal[i] - place[i]
        back = back or (fingers[i].is_servo and ahead * left > 0.0 and abs(left) < abs(ahead))
    if back:
        _start_at(fingers, grip, place)
        _find_goal(fingers, grip, goal)
    same = True
    for i in range(count):
        same = same and abs(goal[i] - grip.goal[i]) <= fingers[i].tolerance
    for i in range(count):
        finger = fingers[i]
        grip.goal[i] = clip(goal[i], finger.low, finger.high)
        below = grip.goal[i] - finger.low <= finger.tolerance and finger.below > 0.0
        above = finger.high - grip.goal[i] <= finger.tolerance and finger.above > 0.0
        grip.pressing[i] = grip.pressing[i] and (
            grip.to_end[i, 0] and below or grip.to_end[i, 1] and above)
        grip.to_end[i, 0], grip.to_end[i, 1] = below, above
        # Until the next call the setpoints move evenly, not in jumps.
        grip.pace[i] = math.inf if same else abs(goal[i] - _setpoint(world, finger)) / _CALL_S
    grip.flags[TAKES], grip.flags[TURNED] = not same, True


@inner
def _find_goal(fingers: Any, grip: Grip, goal: FloatArray) -> None:
    """Let commands follow an action by a step of its rule, and write the goals."""
    rule = grip.rule
    for k in range(len(rule.commands)):
        number = grip.action[rule.numbers[k]]
        if len(rule.steps):
            if not rule.proportional[0]:
                number = 1.0 if number > 0.0 else -1.0 if number < 0.0 else 0.0
            number = rule.commands[k] + rule.steps[k] * number
        rule.commands[k] = clip(number, -1.0, 1.0)
    for i in range(len(fingers)):
        finger, source = fingers[i], rule.sources[i]
        command = rule.still[i] if source < 0 else rule.commands[source]
        goal[i] = finger.low + (command + 1.0) / 2.0 * (finger.high - finger.low)


@inlined
def _start_at(fingers: Any, grip: Grip, place: FloatArray) -> None:
    """Let commands go on from where fingers are."""
    rule = grip.rule
    for i in range(len(fingers) - 1, -1, -1):
        finger = fingers[i]
        if rule.sources[i] >= 0:
            begin = clip(place[i], finger.low, finger.high) if finger.is_servo else grip.goal[i]
            rule.commands[rule.sources[i]] = (
                (begin - finger.low) / (finger.high - finger.low) * 2.0 - 1.0)


@inlined
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


@inlined
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


@inlined
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


@inlined
def _stride(finger: Any, grip: Grip, i: int, distance: float, speed: float, centres: bool,
            duration: float) -> float:
    """
    Return the displacement of a setpoint in an interval.

    Fingers that press go on with what gives way, at their velocity limit at most.
    """
    if centres and (distance > 0.0) == grip.to_end[i, 0]:
        return distance  # A setpoint beyond the full force comes back at once.
    pace = min(finger.speed, grip.pace[i])
    if grip.pressing[i]:
        pace = max(finger.below, finger.above, 0.0) / _PRESS_S
        if speed * distance > 0.0:
            pace = max(pace, min(pace + abs(speed), finger.speed))
    return clip(distance, -pace * duration, pace * duration) if pace < math.inf else distance
