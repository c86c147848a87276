# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Intervals of a control period in compiled code: control of a robot in each, and its physics."""

from __future__ import annotations

from typing import Any, NamedTuple

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.law.arm_records import (
    EXERTS, LEADS, MOST_SOLUTIONS, Targets, targets_of)
from manip_sim.control.law.compiling import compiled, inner
from manip_sim.control.law.driving import drive_base
from manip_sim.control.law.finger_records import Gripper, no_gripper
from manip_sim.control.law.gripping import move_fingers
from manip_sim.control.law.joint_records import (
    DUE, JOINT, MOVES, readable, RobotJoints, SERVO, WRITTEN)
from manip_sim.control.law.leading import lead, press_on, put_ahead
from manip_sim.control.law.rows import Layout
from manip_sim.control.law.seat import begin_all
from manip_sim.control.law.servo_rates import drive
from manip_sim.control.law.setpoint_changes import follow
from manip_sim.control.law.setpoint_motion import advance
from manip_sim.control.law.stepping import (
    begin_notes, compute_end, find_places, LastStep, Notes, notes_of, remember, take_steps, Watch)
from manip_sim.physics.physics import address_of, Addresses, Kinematics, WorldArrays

#: Orders for a period: remember the state that it begins with, compute all of the one that it ends
#: in; the first half of the first step is computed, which is cleared if the state has changed.
BEGINS, ENDS, RESUMES = range(3)


class Time(NamedTuple):
    """
    The time of a world.

    :ivar counts: physics steps since construction and since the last reset, shape (2,)
    :ivar step_ns: length of a step [ns]
    :ivar step_s: the same as the physics has it [s]
    """

    counts: IntArray
    step_ns: int
    step_s: float


class Robot(NamedTuple):
    """
    The part of a robot in a period.

    :ivar joints: of the robot
    :ivar targets: of its end effectors
    :ivar grippers: of the robot, those that are not there without fingers
    :ivar moved_s: simulation time when its setpoints stopped to move, or -1 [s], shape (1,)
    """

    joints: RobotJoints
    targets: Targets
    grippers: tuple[Gripper, Gripper]
    moved_s: FloatArray


class Period(NamedTuple):
    """
    Intervals of a control period in one world: control of robots in each, and its steps.

    :ivar place: addresses of the model and of its data
    :ivar time: of the world, which goes on
    :ivar orders: flags by :data:`BEGINS`, :data:`ENDS`, :data:`RESUMES`, shape (3,)
    :ivar intervals: steps of each, shape (k,)
    :ivar world: arrays of the data
    :ivar robots: addresses of the rows of those that act, shape (n,)
    :ivar seats: addresses of the rows of laws of users, which act in each step, shape (s,)
    :ivar notes: of contacts and forces on tools
    :ivar watch: states at begin and end
    :ivar outcome: physics steps that were made, fewer than wanted where no room is left to note
        what has become of targets, and where a law of a user has failed; and whether the last
        instant has to be looked at, shape (2,)
    """

    place: tuple[Any, Any]
    time: Time
    orders: IntArray
    intervals: IntArray
    world: WorldArrays
    robots: IntArray
    seats: IntArray
    notes: Notes
    watch: Watch
    outcome: IntArray


class ScratchArrays(NamedTuple):
    """
    Data for the kinematics of other positions.

    :ivar address: of an ``MjData``
    :ivar kinematics: views into it
    """

    address: Any
    kinematics: Kinematics


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


def _example_of_robot() -> Robot:
    """Return a robot without joints."""
    none, nobody = np.zeros(0), np.zeros(0, np.int64)
    nowhere = np.zeros((0, 0), np.int64)
    joints = RobotJoints(
        readable(np.zeros(0, JOINT)), readable(np.zeros(0, SERVO)), nowhere, none, nowhere, none,
        np.zeros(3, np.bool_), nobody, np.zeros((0, 0, 3)), nobody, nobody, np.zeros((0, 3)))
    return Robot(joints, targets_of(0), (no_gripper(), no_gripper()), np.zeros(1))


def _example() -> tuple[Period, ScratchArrays]:
    """Return a period in which nothing happens, of a world in which nothing is."""
    model = mujoco.MjModel.from_xml_string('<mujoco/>')
    data, none, nobody = mujoco.MjData(model), np.zeros(0), np.zeros(0, np.int64)
    world, place = WorldArrays.of(data), (address_of(model), address_of(data))
    period = Period(
        place, Time(np.zeros(2, np.int64), 1, 1.0), np.zeros(3, np.int64), nobody, world, nobody,
        nobody, notes_of(data, np.zeros((0, 3), np.int64), 0),
        Watch(none, none, np.zeros((0, 2), np.int64), 0, data.qpos, data.qacc,
              LastStep.of(model, data, none)), np.zeros(2, np.int64))
    return period, ScratchArrays(place[1], world.kinematics)


#: The places of a robot, of a period and of the scratch in their rows.
ROBOT = Layout(_example_of_robot())
PERIOD, SCRATCH = (Layout(example) for example in _example())
_read_robot, _read_period, _read_scratch = ROBOT.reader(), PERIOD.reader(), SCRATCH.reader()


@inner
def _begin_robots(robots: IntArray) -> None:
    """Let no setpoints have stopped yet."""
    for row in robots:
        _read_robot(row).moved_s[0] = -1.0


@inner
def _act_all(addresses: Addresses, period: Period, k: int, now: float, duration: float,
             scratch: Kinematics) -> bool:
    """Write the controls of all robots; return False, and write none, where one has to wait."""
    for row in period.robots:
        if _waits(_read_robot(row).targets, now):
            return False
    for row in period.robots:
        robot = _read_robot(row)
        if _act(addresses, k, now, duration, period.world, scratch, robot.joints, robot.targets,
                robot.grippers):
            robot.moved_s[0] = now + duration
    return True


@inner
def _run(period: Period, scratch: ScratchArrays) -> None:
    """Run intervals: control of robots at the beginning of each, and its steps."""
    addresses = Addresses(period.place[0], period.place[1], scratch.address)
    time, orders, resumes = period.time, period.orders, period.orders[RESUMES] != 0
    if orders[BEGINS]:
        resumes = remember(addresses, period.watch) and resumes
        orders[RESUMES] = resumes
    begin_notes(period.notes)
    _begin_robots(period.robots)
    done, ends = 0, orders[ENDS] != 0
    for k in range(len(period.intervals)):
        steps, now = period.intervals[k], time.counts[1] * time.step_ns * 1e-9
        begin_all(period.seats)
        if not _act_all(addresses, period, k, now, steps * time.step_s, scratch.kinematics):
            ends = False
            break
        failed = take_steps(addresses, steps, resumes and k == 0, period.notes, period.seats, now,
                            time.step_s)
        time.counts[0] += steps
        time.counts[1] += steps
        done += steps
        if failed:
            ends = False
            break
    period.outcome[0] = done
    period.outcome[1] = ends and not compute_end(addresses, period.watch)


@compiled
def run_rows(rows: IntArray, scratch: int) -> None:
    """
    Run periods of several worlds, one after another.

    :param rows: addresses of rows by :data:`PERIOD`, shape (n,)
    :param scratch: of a row by :data:`SCRATCH`, whose data nobody else uses meanwhile
    """
    room = _read_scratch(scratch)
    for row in rows:
        _run(_read_period(row), room)
