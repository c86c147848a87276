# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Intervals of a control period in compiled code: control of a robot in each, and its physics."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.law.arm_records import EXERTS, LEADS, MOST_SOLUTIONS, Targets
from manip_sim.control.law.compiling import compiled, inner
from manip_sim.control.law.driving import drive_base
from manip_sim.control.law.finger_records import Gripper
from manip_sim.control.law.gripping import move_fingers
from manip_sim.control.law.leading import lead, press_on, put_ahead
from manip_sim.control.law.servo_rates import drive
from manip_sim.control.law.setpoint_changes import follow
from manip_sim.control.law.setpoint_motion import advance
from manip_sim.control.law.stepping import begin_notes, find_places, Notes, take_steps
from manip_sim.physics.physics import Addresses, Kinematics, WorldArrays

#: Flags of the joints of a robot: any setpoint moves, efforts have yet to be written, controls are
#: those of setpoints that move.
MOVES, DUE, WRITTEN = range(3)


class RobotJoints(NamedTuple):
    """
    The joints of a robot.

    :ivar setpoints: records, shape (n,)
    :ivar servos: records of ``SERVO``, shape (n,)
    :ivar places: of their inertia in ``M``, -1 where it is zero, shape (n, n)
    :ivar efforts: of those that are sources of effort [N m or N], shape (n,)
    :ivar counts: of goals beyond the velocity limit and of lost messages, shape (2, n)
    :ivar postures: that redundant arms tend to [rad], shape (n,)
    :ivar flags: by :data:`MOVES`, :data:`DUE`, :data:`WRITTEN`, shape (3,)
    :ivar led: those that trajectories lead, shape (m,)
    :ivar path: their position, velocity and acceleration at the ends of intervals, shape
        (k, m, 3), with k = 0 where no trajectory runs or waits
    :ivar base: the joints x, y and yaw of a base that follows a twist, or no joints, shape (3,)
    :ivar owned: which of these the twist owns, shape (j,)
    :ivar twists: what it wants at the ends of intervals, in the frame of the base, shape (k, 3)
    """

    setpoints: NDArray[np.void]
    servos: NDArray[np.void]
    places: IntArray
    efforts: FloatArray
    counts: IntArray
    postures: FloatArray
    flags: NDArray[np.bool_]
    led: IntArray
    path: FloatArray
    base: IntArray
    owned: IntArray
    twists: FloatArray


class Time(NamedTuple):
    """
    The time of a run.

    :ivar step: number of the first physics step since the last reset
    :ivar step_ns: length of a step [ns]
    :ivar step_s: the same as the physics has it [s]
    """

    step: int
    step_ns: int
    step_s: float


@inner
def _waits(targets: Targets, now: float) -> bool:
    """Return whether there is no room to note what is solved now."""
    for number in range(2):
        task = targets.tasks[number]
        if task.acts == LEADS and task.settled == 0 and now >= task.solve_s - 1e-9 and (
                task.solutions >= MOST_SOLUTIONS):
            return True
    return False


@inner
def _lead_arms(addresses: Addresses, world: WorldArrays, scratch: Kinematics, joints: RobotJoints,
               targets: Targets, k: int, now: float, duration: float) -> bool:
    """Let arms bring their end effectors nearer to targets; return whether any of them does."""
    acts = False
    for number in range(2):
        task = targets.tasks[number]
        if task.acts == EXERTS:
            press_on(world, joints.efforts, joints.postures, targets, number, k, now, duration)
            acts = True
        elif task.acts == LEADS and task.settled == 0:
            if now >= task.solve_s - 1e-9:
                put_ahead(world, scratch, joints.setpoints, targets, number)
                find_places(addresses)
                lead(world, scratch, joints.setpoints, joints.postures, targets, number, now)
                joints.flags[MOVES] = True
            acts = True
    return acts


@inner
def _move_joints(world: WorldArrays, joints: RobotJoints, k: int, acts: bool, now: float,
                 duration: float) -> bool:
    """Write the controls of joints in an interval; return whether they do not just rest."""
    flags, held = joints.flags, False
    if not (acts or len(joints.path) or flags[MOVES] or flags[DUE]):
        if flags[WRITTEN]:
            for i in range(len(joints.servos)):
                world.controls[joints.servos[i].control] = 0.0
            flags[WRITTEN] = False
        return False
    for i in range(len(joints.setpoints)):
        held = held or joints.setpoints[i].held != 0.0
    if flags[MOVES] or held:
        flags[MOVES] = advance(joints.setpoints, joints.counts, now, duration)
    if len(joints.led):
        follow(joints.setpoints, joints.led, joints.path[k])
        flags[MOVES] = True
    drive(world, joints.servos, joints.places, joints.setpoints, joints.efforts, duration)
    flags[DUE], flags[WRITTEN] = False, True
    return True


@inner
def _act(addresses: Addresses, k: int, now: float, duration: float, world: WorldArrays,
         scratch: Kinematics, joints: RobotJoints, targets: Targets,
         grippers: tuple[Gripper, Gripper]) -> bool:
    """Write the controls of a robot for an interval; return whether joints do not just rest."""
    leads = _lead_arms(addresses, world, scratch, joints, targets, k, now, duration)
    if len(joints.base):
        drive_base(world, joints.servos, joints.setpoints, joints.base, joints.owned,
                   joints.twists[k], duration)
        joints.flags[MOVES] = True
    moved = _move_joints(world, joints, k, leads, now, duration)
    for number in range(2):
        move_fingers(world, grippers[number], duration)
    return moved


@compiled
def act(addresses: Addresses, k: int, now: float, duration: float, world: WorldArrays,
        scratch: Kinematics, joints: RobotJoints, targets: Targets,
        grippers: tuple[Gripper, Gripper]) -> bool:
    """
    Write the controls of a robot for an interval.

    :param k: number of the interval
    :param now: simulation time [s]
    :param duration: of the interval [s]
    :param scratch: views into the data for kinematics
    :param grippers: grippers of the robot, those that are not there without fingers
    :returns: whether joints do not just rest
    """
    return _act(addresses, k, now, duration, world, scratch, joints, targets, grippers)


@compiled
def run(addresses: Addresses, time: Time, intervals: IntArray, resumes: bool, world: WorldArrays,
        scratch: Kinematics, joints: RobotJoints, targets: Targets,
        grippers: tuple[Gripper, Gripper], notes: Notes) -> tuple[int, float]:
    """
    Run intervals: control of a robot at the beginning of each as by :func:`act`, and its steps.

    :param intervals: steps of each, shape (k,)
    :param resumes: whether the first half of the first step has been computed
    :returns: how many steps were made, fewer where no room is left to note what has become of
        targets; simulation time when setpoints stopped to move, as far as that is known, or -1 [s]
    """
    done, moved_s = 0, -1.0
    begin_notes(notes)
    for k in range(len(intervals)):
        now = (time.step + done) * time.step_ns * 1e-9
        if _waits(targets, now):
            break
        duration = intervals[k] * time.step_s
        if _act(addresses, k, now, duration, world, scratch, joints, targets, grippers):
            moved_s = now + duration
        take_steps(addresses, intervals[k], resumes and k == 0, notes)
        done += intervals[k]
    return done, moved_s
