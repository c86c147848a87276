# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""An end effector and its target that rests: led there by setpoints of joints, or by efforts."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from manip_sim.arrays import BoolArray, FloatArray
from manip_sim.control.law.approach import approach
from manip_sim.control.law.arm_records import (
    ArmMotion, Goal, MISSED, MISSED_TURN, Motion, Spring, Targets, Velocities)
from manip_sim.control.law.compiling import compiled, inner
from manip_sim.control.law.operational_space import exert, find_error, find_jacobian
from manip_sim.control.law.setpoint_changes import ramp_to
from manip_sim.control.law.small_matrices import dot
from manip_sim.physics.physics import Kinematics, WorldArrays

#: A pose is reached if the setpoints are within this of it [m], [rad].
_REACHED, _REACHED_TURN = 1e-4, 1e-3
#: And if they are slower than this share of the joint velocity limits.
_SLOW_PACE = 0.005
#: Slower setpoints have come to rest [rad/s].
_AT_REST = 1e-4
#: By efforts it is reached within this [m], [rad], by an end effector slower than this [m/s,
#: rad/s].
_PRESSED, _PRESSED_TURN, _SLOW_TWIST = 1e-3, 1e-2, 2e-3


@inner
def pose_of(kinematics: Kinematics, number: int, is_site: int) -> tuple[FloatArray, FloatArray]:
    """Return position and axes in the world of a site or a body, views."""
    if is_site:
        return kinematics.sites[number], kinematics.site_axes[number]
    return kinematics.bodies[number], kinematics.body_axes[number]


@inner
def goal_of(kinematics: Kinematics, targets: Targets, number: int) -> Goal:
    """Return where a target is."""
    task = targets.tasks[number]
    origin, axes = pose_of(kinematics, task.anchor, task.anchor_is_site)
    return Goal(targets.positions[number], targets.rotations[number], origin, axes, np.zeros(6))


@compiled
def put_ahead(world: WorldArrays, scratch: Kinematics, setpoints: Any, targets: Targets,
              number: int) -> None:
    """Set positions of joints, for the time when the next solution ends if they go on as now."""
    for i in range(len(scratch.positions)):
        scratch.positions[i] = world.kinematics.positions[i]
    joints = targets.arms[number].joints
    for i in range(len(joints)):
        x = setpoints[joints[i].joint]
        scratch.positions[joints[i].qpos] = (
            x.position + targets.tasks[number].interval_s * x.velocity)


@inner
def _within(error: FloatArray, distance: float, turn: float) -> bool:
    """Return whether no component of an error is larger than these [m], [rad]."""
    inside = True
    for i in range(3):
        inside = inside and abs(error[i]) <= distance and abs(error[3 + i]) <= turn
    return inside


@inner
def _aside(targets: Targets, number: int, goal: Goal, error: FloatArray) -> float:
    """Return how far an end effector is from the line to its goal, which the first call begins."""
    task, start, here = targets.tasks[number], targets.starts[number], np.empty(3)
    for i in range(3):
        here[i] = goal.position[i] - (goal.axes[0, i] * error[0] + goal.axes[1, i] * error[1]
                                      + goal.axes[2, i] * error[2])
        if task.begun == 0:
            start[i] = here[i]
    task.begun = 1
    along = length = 0.0
    for i in range(3):
        along += (here[i] - start[i]) * (goal.position[i] - start[i])
        length += (goal.position[i] - start[i]) * (goal.position[i] - start[i])
    share, aside = along / max(length, 1e-12), 0.0
    for i in range(3):
        off = here[i] - start[i] - share * (goal.position[i] - start[i])
        aside += off * off
    return math.sqrt(aside)


@inner
def _note(targets: Targets, number: int, goal: Goal, now: float, progress: float, reached: bool,
          singular: bool, held: BoolArray) -> None:
    """Note what has become of a solution, whose error is noted already."""
    task, arm, k = targets.tasks[number], targets.arms[number], targets.tasks[number].solutions
    facts, error = targets.facts[number, k], targets.errors[number, k]
    facts.now_s, facts.progress, facts.aside = now, progress, _aside(targets, number, goal, error)
    facts.reached, facts.singular, facts.held = int(reached), int(singular), 0
    facts.close = int(_within(error, MISSED, MISSED_TURN))
    for i in range(len(arm.joints)):
        targets.held[number, k, arm.joints[i].joint] = held[i]
        if held[i]:
            facts.held = 1
    task.solutions = k + 1


@inner
def _find_motion(scratch: Kinematics, setpoints: Any, postures: FloatArray, targets: Targets,
                 number: int) -> ArmMotion:
    """Return setpoints and limits of the joints of an arm."""
    joints = targets.arms[number].joints
    count = len(joints)
    motion = ArmMotion(np.empty(count), np.empty(count), np.empty(count), np.empty(count),
                       np.empty(count), np.empty(count), np.empty(count), np.empty(count))
    for i in range(count):
        joint = joints[i]
        motion.position[i] = scratch.positions[joint.qpos]
        motion.velocity[i] = setpoints[joint.joint].velocity
        motion.low[i], motion.high[i] = joint.low, joint.high
        motion.velocity_limit[i] = joint.cruising_velocity
        motion.acceleration_limit[i] = joint.acceleration_limit
        motion.posture[i], motion.turn[i] = postures[joint.joint], joint.turn
    return motion


@compiled
def lead(world: WorldArrays, scratch: Kinematics, setpoints: Any, postures: FloatArray,
         targets: Targets, number: int, now: float) -> None:
    """
    Let setpoints of joints bring an end effector nearer to its target, and note what comes of it.

    :param scratch: the kinematics of where :func:`put_ahead` has put the joints
    :param setpoints: of the robot, records, shape (n,), changed
    :param postures: of the joints of the robot [rad], shape (n,)
    :param number: of the target
    :param now: simulation time [s]
    """
    task, arm = targets.tasks[number], targets.arms[number]
    count, k, still = len(arm.joints), task.solutions, np.zeros(6)
    jacobian, indices = np.empty((6, count)), np.empty(count, np.int64)
    result = Velocities(np.empty(count), np.empty(count), np.zeros(count, np.bool_))
    place, turned = pose_of(scratch, task.tip, task.tip_is_site)
    goal, error = goal_of(scratch, targets, number), targets.errors[number, k]
    find_jacobian(scratch, arm, place, jacobian)
    find_error(place, turned, goal, error)
    motion = _find_motion(scratch, setpoints, postures, targets, number)
    pace, progress, singular, _, rests = approach(
        jacobian, error, motion, task.interval_s, task.linear_velocity, task.angular_velocity,
        still, still, False, 0.0, task.rests != 0, result)
    fastest = 0.0
    for i in range(count):
        indices[i] = arm.joints[i].joint
        fastest = max(fastest, abs(result.velocity[i]), abs(motion.velocity[i]))
    ramp_to(setpoints, indices, result.velocity, task.interval_s, result.acceleration_limit)
    if fastest < _AT_REST:
        ramp_to(setpoints, indices, np.zeros(count), task.interval_s, np.empty(0))
        task.settled = 1
    reached = pace < _SLOW_PACE and _within(error, _REACHED, _REACHED_TURN)
    if reached:
        place, turned = pose_of(world.kinematics, task.tip, task.tip_is_site)
        find_error(place, turned, goal_of(world.kinematics, targets, number),
                   targets.missed[number, k])
    _note(targets, number, goal, now, progress, reached, singular, result.held)
    task.rests, task.solve_s = int(rests), now + task.interval_s


@compiled
def press_on(world: WorldArrays, efforts: FloatArray, postures: FloatArray, targets: Targets,
             number: int, now: float) -> None:
    """
    Write the efforts that bring an end effector nearer to its target; note them if that is due.

    :param efforts: of the joints of the robot [N m], shape (n,), written
    :param postures: of the joints of the robot [rad], shape (n,)
    :param number: of the target
    :param now: simulation time [s]
    """
    task, arm = targets.tasks[number], targets.arms[number]
    count = len(arm.joints)
    motion = Motion(np.empty(count), np.empty(6), np.empty(6), np.zeros(count, np.bool_))
    place, turned = pose_of(world.kinematics, task.tip, task.tip_is_site)
    spring = Spring(task.stiffness, task.damping, task.linear_velocity, task.angular_velocity)
    goal = goal_of(world.kinematics, targets, number)
    rests, singular, _ = exert(world, arm, place, turned, goal, postures, spring, task.rests != 0,
                               motion)
    for i in range(count):
        efforts[arm.joints[i].joint] = motion.efforts[i]
    task.rests = int(rests)
    if task.notes == 0:
        return
    # What limits the end effector, and whether it rests, is noted once in a period.
    k, goes = task.solutions, np.empty(6)
    for i in range(6):
        targets.errors[number, k, i] = targets.missed[number, k, i] = motion.error[i]
        goes[i] = task.stiffness / task.damping * motion.error[i]
    reached = _within(motion.error, _PRESSED, _PRESSED_TURN) and _within(
        motion.twist, _SLOW_TWIST, _SLOW_TWIST)
    _note(targets, number, goal, now, dot(motion.twist, goes) / max(dot(goes, goes), 1e-12),
          reached, singular and not reached, motion.held)
    if reached:
        targets.facts[number, k].held = 0
    task.notes, task.solve_s = 0, now
