# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""An end effector and its target: led there by setpoints of joints, or by efforts."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from manip_sim.arrays import BoolArray, FloatArray
from manip_sim.control.law.compiling import compiled, inlined, inner
from manip_sim.control.law.inverse_kinematics import approach, follow_twist
from manip_sim.control.law.loads import Loads
from manip_sim.control.law.operational_space import (
    exert, find_error, find_jacobian, impede, Springs)
from manip_sim.control.law.records import (
    ArmMotion, BRAKES, Goal, LEADS, MISSED, MISSED_TURN, Motion, RESTS, Spring, STREAMS, Targets,
    TWISTS, Velocities)
from manip_sim.control.law.setpoint_motion import ramp_to
from manip_sim.control.law.small_matrices import (
    clip, dot, multiply_matrices, norm3, rotation_matrix, rotation_vector)
from manip_sim.control.law.streams import own_accelerations_at, positions_at, velocities_at
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
#: Distance and angle by which an action of 1 moves and turns the goal [m], [rad]; robosuite's
#: defaults for OSC_POSE.
_STEP, _TURN = 0.05, 0.5
#: Largest lead of a goal that a twist moves over the end effector [m], [rad].
_LEAD, _TURN_LEAD = 0.05, 0.3


@inner
def pose_of(kinematics: Kinematics, number: int, is_site: int) -> tuple[FloatArray, FloatArray]:
    """Return position and axes in the world of a site or a body, views."""
    if is_site:
        return kinematics.sites[number], kinematics.site_axes[number]
    return kinematics.bodies[number], kinematics.body_axes[number]


@inner
def goal_of(kinematics: Kinematics, targets: Targets, number: int, now: float) -> Goal:
    """
    Return where a target is.

    :param now: simulation time, for a stream of poses [s]
    """
    task = targets.tasks[number]
    origin, axes = pose_of(kinematics, task.anchor, task.anchor_is_site)
    position, rotation = targets.positions[number], targets.rotations[number]
    if task.follows == STREAMS:
        way, turn = positions_at(targets.streams[number], now), np.empty((3, 3))
        position, rotation = np.empty(3), np.empty((3, 3))
        for i in range(3):
            position[i] = targets.positions[number, i] + way[i]
        rotation_matrix(way, 3, 1.0, turn)
        multiply_matrices(turn, targets.rotations[number], rotation)
    return Goal(position, rotation, origin, axes, np.zeros(6))


@inner
def _in_world(axes: FloatArray, twist: FloatArray, result: FloatArray) -> None:
    """Write a velocity in the world, shape (6,)."""
    for i in range(3):
        result[i] = axes[i, 0] * twist[0] + axes[i, 1] * twist[1] + axes[i, 2] * twist[2]
        result[3 + i] = axes[i, 0] * twist[3] + axes[i, 1] * twist[4] + axes[i, 2] * twist[5]


@inner
def _turn_back(origin: FloatArray, axes: FloatArray, place: FloatArray, turned: FloatArray,
               position: FloatArray, rotation: FloatArray) -> None:
    """Write a pose in the world in a frame."""
    for i in range(3):
        position[i] = 0.0
        for j in range(3):
            position[i] += axes[j, i] * (place[j] - origin[j])
            rotation[i, j] = (
                axes[0, i] * turned[0, j] + axes[1, i] * turned[1, j] + axes[2, i] * turned[2, j])


@inner
def _stay_at(kinematics: Kinematics, targets: Targets, number: int, place: FloatArray,
             turned: FloatArray) -> None:
    """Set a goal to a pose in the world."""
    task = targets.tasks[number]
    origin, axes = pose_of(kinematics, task.anchor, task.anchor_is_site)
    _turn_back(origin, axes, place, turned, targets.positions[number], targets.rotations[number])


@inner
def _move_goal(world: WorldArrays, targets: Targets, number: int, along: FloatArray,
               duration: float) -> None:
    """
    Move a goal with a twist, not far ahead of the end effector.

    :param along: in the world [m/s, rad/s], shape (6,)
    """
    task = targets.tasks[number]
    here, turned = pose_of(world.kinematics, task.tip, task.tip_is_site)
    error, turn, moved = np.zeros(6), np.empty((3, 3)), np.empty((3, 3))
    find_error(here, turned, goal_of(world.kinematics, targets, number, 0.0), error)
    for i in range(3):
        error[i] += duration * along[i]
    share = min(1.0, _LEAD / max(norm3(error, 0), 1e-12))
    place = np.empty(3)
    for i in range(3):
        place[i] = here[i] + share * error[i]
    # The turn to the goal, and then that of the twist.
    rotation_matrix(error, 3, 1.0, turn)
    rotation_matrix(along, 3, duration, moved)
    ahead = np.empty((3, 3))
    multiply_matrices(moved, turn, ahead)
    rotation_vector(ahead, error)
    rotation_matrix(error, 3, min(1.0, _TURN_LEAD / max(norm3(error, 3), 1e-12)), turn)
    multiply_matrices(turn, turned, moved)
    _stay_at(world.kinematics, targets, number, place, moved)


@compiled
def act(kinematics: Kinematics, tip: int, tip_is_site: int, anchor: int, anchor_is_site: int,
        action: FloatArray, position: FloatArray, rotation: FloatArray) -> None:
    """
    Write the goal of an action of OSC_POSE: the present pose of an end effector, moved and turned.

    :param tip: number of the end effector
    :param anchor: number of the frame in which the goal is
    :param action: in [-1, 1], shape (6,)
    :param position: [m], shape (3,), written
    :param rotation: shape (3, 3), written
    """
    place, turned = pose_of(kinematics, tip, tip_is_site)
    here, axes = pose_of(kinematics, anchor, anchor_is_site)
    turn, before = np.empty((3, 3)), np.empty((3, 3))
    _turn_back(here, axes, place, turned, position, before)
    for i in range(3):
        position[i] += _STEP * action[i]
    rotation_matrix(action, 3, _TURN, turn)
    multiply_matrices(turn, before, rotation)


@inner
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


@inner
def _note(targets: Targets, number: int, goal: Goal, now: float, progress: float, reached: bool,
          singular: bool, slowed: bool, held: BoolArray) -> None:
    """Note the outcome of a solution, whose error is noted already."""
    task, arm, k = targets.tasks[number], targets.arms[number], targets.tasks[number].solutions
    facts, error = targets.facts[number, k], targets.errors[number, k]
    close = _within(error, MISSED, MISSED_TURN)
    # A stream of poses that is slowed down, but is where it should be, is not late.
    slowed = slowed and (
        task.follows == TWISTS or task.follows == STREAMS and task.acts == LEADS and not close)
    facts.now_s, facts.progress, facts.aside = now, progress, 0.0
    if task.follows == RESTS:
        facts.aside = _aside(targets, number, goal, error)
    facts.reached, facts.close, facts.singular, facts.slowed, facts.held = (
        int(reached), int(close), int(singular), int(slowed), 0)
    for i in range(len(arm.joints)):
        targets.held[number, k, arm.joints[i].joint] = held[i]
        if held[i]:
            facts.held = 1
    task.solutions = k + 1


@inner
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
    task, arm, k = targets.tasks[number], targets.arms[number], targets.tasks[number].solutions
    count = len(arm.joints)
    jacobian, indices = np.empty((6, count)), np.empty(count, np.int64)
    result = Velocities(np.empty(count), np.empty(count), np.zeros(count, np.bool_))
    place, turned = pose_of(scratch, task.tip, task.tip_is_site)
    goal = goal_of(scratch, targets, number, now + task.interval_s)
    error = targets.errors[number, k]
    find_jacobian(scratch, arm, place, jacobian)
    find_error(place, turned, goal, error)
    motion = _find_motion(scratch, setpoints, postures, targets, number)
    pace, progress, singular, slowed = _find_velocities(
        scratch, targets, number, now, jacobian, error, motion, result)
    fastest = 0.0
    for i in range(count):
        indices[i] = arm.joints[i].joint
        fastest = max(fastest, abs(result.velocity[i]), abs(motion.velocity[i]))
    plain = task.follows == TWISTS or task.follows == BRAKES
    ramp_to(setpoints, indices, result.velocity, task.interval_s,
            np.empty(0) if plain else result.acceleration_limit)
    if fastest < _AT_REST and (task.follows == RESTS or task.follows == BRAKES):
        ramp_to(setpoints, indices, np.zeros(count), task.interval_s, np.empty(0))
        task.settled = 1
    reached = task.follows == RESTS and pace < _SLOW_PACE and _within(
        error, _REACHED, _REACHED_TURN)
    if reached:
        place, turned = pose_of(world.kinematics, task.tip, task.tip_is_site)
        find_error(place, turned, goal_of(world.kinematics, targets, number, now),
                   targets.missed[number, k])
    _note(targets, number, goal, now, progress, reached, singular, slowed, result.held)
    task.solve_s = now + task.interval_s


@inlined
def _find_velocities(scratch: Kinematics, targets: Targets, number: int, now: float,
                     jacobian: FloatArray, error: FloatArray, motion: ArmMotion,
                     result: Velocities) -> tuple[float, float, bool, bool]:
    """
    Write the velocities of joints at the end of an interval.

    :returns: as the first four of :func:`approach`
    """
    task, before, along = targets.tasks[number], np.zeros(6), np.zeros(6)
    interval, stream = task.interval_s, targets.streams[number]
    if task.follows == BRAKES:
        for i in range(len(motion.velocity)):
            change = interval * motion.acceleration_limit[i]
            result.velocity[i] = clip(
                0.0, motion.velocity[i] - change, motion.velocity[i] + change)
        return 0.0, 1.0, False, False
    goes = task.follows == STREAMS
    if task.follows == TWISTS:
        _, axes = pose_of(scratch, task.axes, task.axes_is_site)
        _in_world(axes, velocities_at(stream, now + interval), along)
        # A literal False would compile all that follows once more.
        pace, progress, singular, slowed, _ = follow_twist(
            jacobian, along, motion, interval, goes, result)
        place, turned = pose_of(scratch, task.tip, task.tip_is_site)
        _stay_at(scratch, targets, number, place, turned)
        return pace, progress, singular, slowed
    if goes:
        _, axes = pose_of(scratch, task.anchor, task.anchor_is_site)
        _in_world(axes, velocities_at(stream, now), before)
        _in_world(axes, velocities_at(stream, now + interval), along)
        for i in range(6):
            error[i] -= (along[i] - before[i]) * interval / 2.0
    pace, progress, singular, slowed, rests = approach(
        jacobian, error, motion, interval, task.linear_velocity, task.angular_velocity, before,
        along, goes, task.smooth, task.rests != 0, result)
    task.rests = int(rests)
    return pace, progress, singular, slowed and goes


@inner
def press_on(world: WorldArrays, loads: Loads, efforts: FloatArray, postures: FloatArray,
             targets: Targets, number: int, now: float, duration: float) -> None:
    """
    Write the efforts that bring an end effector nearer to its target; note them if that is due.

    :param loads: payloads
    :param efforts: of the joints of the robot [N m], shape (n,), written
    :param postures: of the joints of the robot [rad], shape (n,)
    :param number: of the target
    :param now: simulation time [s]
    :param duration: of the interval [s]
    """
    task, arm = targets.tasks[number], targets.arms[number]
    count, along, lost = len(arm.joints), np.zeros(6), np.zeros(6)
    motion = Motion(np.empty(count), np.empty(6), np.empty(6), np.zeros(count, np.bool_))
    place, turned = pose_of(world.kinematics, task.tip, task.tip_is_site)
    stream = targets.streams[number]
    if task.follows == TWISTS:
        _, axes = pose_of(world.kinematics, task.axes, task.axes_is_site)
        _in_world(axes, velocities_at(stream, now + duration / 2.0), along)
        _in_world(axes, own_accelerations_at(stream, now), lost)
        _move_goal(world, targets, number, along, duration)
    elif task.follows == STREAMS:
        _, axes = pose_of(world.kinematics, task.anchor, task.anchor_is_site)
        _in_world(axes, velocities_at(stream, now), along)
        _in_world(axes, own_accelerations_at(stream, now), lost)
    if not task.impedes:  # An impedance gets the acceleration itself.
        for i in range(6):
            lost[i] /= task.damping
    goal = goal_of(world.kinematics, targets, number, now)
    rests = singular = slowed = False
    if task.impedes:
        _impede(world, loads, postures, targets, number, goal, along, lost, duration, motion)
    else:
        for i in range(6):
            goal.along[i] = along[i] + lost[i]
        spring = Spring(task.stiffness, task.damping, task.linear_velocity, task.angular_velocity)
        rests, singular, slowed = exert(world, loads, arm, place, turned, goal, postures,
                                        spring, task.rests != 0, motion)
    for i in range(count):
        efforts[arm.joints[i].joint] = motion.efforts[i]
    task.rests = int(rests)
    if task.notes == 0:
        return
    # Limits of the end effector, and its rest, are noted once in a period.
    if task.impedes:
        find_error(place, turned, goal, motion.error)
    row, goes, comes = task.solutions, np.empty(6), np.empty(6)
    for i in range(6):
        comes[i] = motion.twist[i] - along[i]
        targets.errors[number, row, i] = targets.missed[number, row, i] = motion.error[i]
        goes[i] = task.stiffness / task.damping * motion.error[i]
    reached = task.follows == RESTS and _within(
        motion.error, _PRESSED, _PRESSED_TURN) and _within(
        motion.twist, _SLOW_TWIST, _SLOW_TWIST)
    progress = dot(comes, goes) / max(dot(goes, goes), 1e-12)
    # An impedance yields: it is not late where something holds it off.
    _note(targets, number, goal, now, 1.0 if task.impedes else progress, reached,
          singular and not reached, slowed, motion.held)
    if reached:
        targets.facts[number, row].held = 0
    task.notes, task.solve_s = 0, now


@inlined
def _impede(world: WorldArrays, loads: Loads, postures: FloatArray, targets: Targets, number: int,
            goal: Goal, along: FloatArray, acceleration: FloatArray, duration: float,
            motion: Motion) -> None:
    """
    Write the efforts of an impedance, whose reference goes to a goal no faster than its limits.

    :param along: velocity of the goal in the world [m/s, rad/s], shape (6,)
    :param acceleration: of the goal [m/s^2, rad/s^2], shape (6,)
    """
    task, kinematics = targets.tasks[number], world.kinematics
    place, turned = pose_of(kinematics, task.tip, task.tip_is_site)
    _, axes = pose_of(kinematics, task.frame, task.frame_is_site)
    _, own_axes = pose_of(kinematics, task.push_frame, task.push_is_site)
    push = np.empty(6)
    _in_world(own_axes, targets.pushes[number], push)
    _move_reference(kinematics, targets, number, goal, duration)
    reference = Goal(targets.places[number], targets.attitudes[number], goal.origin, goal.axes,
                     along)
    springs = Springs(targets.springs[number], targets.brakes[number], axes, task.damping_ratio,
                      task.null_stiffness, push)
    impede(world, loads, targets.arms[number], place, turned, reference, acceleration, postures,
           springs, duration, motion)


@inner
def _move_reference(kinematics: Kinematics, targets: Targets, number: int, goal: Goal,
                    duration: float) -> None:
    """Bring the reference of an impedance nearer to a goal, or to one that moves at once."""
    task, place = targets.tasks[number], targets.places[number]
    attitude = targets.attitudes[number]
    if task.refers == 0:
        here, turned = pose_of(kinematics, task.tip, task.tip_is_site)
        _turn_back(goal.origin, goal.axes, here, turned, place, attitude)
        task.refers = 1
    way, turn, turned_on = np.empty(6), np.empty((3, 3)), np.empty((3, 3))
    for i in range(3):
        way[i] = goal.position[i] - place[i]
        for j in range(3):
            turn[i, j] = (goal.rotation[i, 0] * attitude[j, 0]
                          + goal.rotation[i, 1] * attitude[j, 1]
                          + goal.rotation[i, 2] * attitude[j, 2])
    rotation_vector(turn, way)
    share = turned_share = 1.0
    if task.follows == RESTS:
        share = duration * task.linear_velocity / max(norm3(way, 0), 1e-12)
        turned_share = duration * task.angular_velocity / max(norm3(way, 3), 1e-12)
    for i in range(3):
        place[i] = goal.position[i] if share >= 1.0 else place[i] + share * way[i]
    if turned_share < 1.0:
        rotation_matrix(way, 3, turned_share, turn)
        multiply_matrices(turn, attitude, turned_on)
    for i in range(3):
        for j in range(3):
            attitude[i, j] = turned_on[i, j] if turned_share < 1.0 else goal.rotation[i, j]
