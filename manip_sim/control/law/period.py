# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Intervals of a control period in compiled code: control of a robot in each, and its physics."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.law.compiling import compiled, inlined, inner, Layout
from manip_sim.control.law.gripping import move_fingers
from manip_sim.control.law.leading import act, lead, press_on, put_ahead
from manip_sim.control.law.loads import no_loads
from manip_sim.control.law.records import (
    ACTS, ASIDE, AWAITED, BRAKES, DUE, EXERTS, FINGERS_MOVE, Gripper, IDLE, JOINT, LEADS,
    MOST_SOLUTIONS, MOTION, MOVES, NEARER, no_gripper, PAIR, readable, RENEWED, RESTS, RobotJoints,
    SERVO, STREAMS, TAKES, Targets, targets_of, TWISTS, WRITTEN)
from manip_sim.control.law.seat import begin_all
from manip_sim.control.law.servo_rates import drive
from manip_sim.control.law.setpoint_motion import advance, drive_base, follow
from manip_sim.control.law.stepping import (
    any_force, compute_end, find_places, LastStep, Notes, notes_of, remember, take_steps, Watch)
from manip_sim.control.law.streams import wait
from manip_sim.physics.physics import (
    address_of, Addresses, BECAME, ENDED, Kinematics, PERIODS, ROW, STEPS, STOOD, WENT_ON,
    WorldArrays)

#: Orders for a period: remember the state that it begins with, compute all of the one that it ends
#: in; what of the first step is computed, which is less if the state has changed; the same for a
#: period that goes on like the one before; run the steps, or else just write the controls of the
#: first interval.
BEGINS, ENDS, RESUMES, RESUMES_AFTER, STEPPING = range(5)


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
    :ivar owners: of each joint the number of the command that ends as soon as its joints rest, or
        -1, shape (n,)
    :ivar acts: 1 if it acts whether setpoints move or not, shape (1,)
    :ivar until_s: simulation times from which it does not go on: when a command times out, when a
        target is not known in all of a period, and a path [s], shape (3,)
    :ivar goals: last goals of commands that go on, by joint, shape (n,)
    :ivar renewed_s: simulation time when these came, or -1 [s], shape (n,)
    """

    joints: RobotJoints
    targets: Targets
    grippers: tuple[Gripper, Gripper]
    moved_s: FloatArray
    owners: IntArray
    acts: IntArray
    until_s: FloatArray
    goals: FloatArray
    renewed_s: FloatArray


class Weight(NamedTuple):
    """
    Weight of compensated links that robots with a free root carry themselves.

    :ivar dofs: their degrees of freedom, shape (k,)
    :ivar applied: ``qfrc_applied``, a view, shape (nv,)
    """

    dofs: IntArray
    applied: FloatArray


class Standing(NamedTuple):
    """
    Conditions under which a period goes on like the one before.

    :ivar contacts: most contacts, and 1 if nothing has touched tools, shape (2,)
    :ivar pushes: ``xfrc_applied``, a view, shape (nbody, 6)
    :ivar options: of the model, a view, shape (k,)
    :ivar kept: what they have to be, shape (k,)
    """

    contacts: IntArray
    pushes: FloatArray
    options: NDArray[np.int32]
    kept: NDArray[np.int32]


class Period(NamedTuple):
    """
    Intervals of a control period in one world: control of robots in each, and its steps.

    :ivar place: addresses of the model and of its data
    :ivar time: of the world, which goes on
    :ivar orders: by :data:`BEGINS` and those that follow it, shape (5,)
    :ivar intervals: steps of each, shape (k,)
    :ivar world: arrays of the data
    :ivar weight: of robots with a free root
    :ivar robots: addresses of the rows of those that act, shape (n,)
    :ivar seats: addresses of the rows of laws of users, which act in each step, shape (s,)
    :ivar notes: of contacts and forces on tools
    :ivar watch: states at begin and end
    :ivar outcome: physics steps that were made, fewer than wanted where no room is left to note
        what has become of targets, and where a law of a user has failed; and whether the last
        instant has to be looked at, shape (2,)
    :ivar standing: conditions under which the next period goes on like this one
    """

    place: tuple[Any, Any]
    time: Time
    orders: IntArray
    intervals: IntArray
    world: WorldArrays
    weight: Weight
    robots: IntArray
    seats: IntArray
    notes: Notes
    watch: Watch
    outcome: IntArray
    standing: Standing


class ScratchArrays(NamedTuple):
    """
    Data for the kinematics of other positions.

    :ivar address: of an ``MjData``
    :ivar kinematics: views into it
    """

    address: Any
    kinematics: Kinematics


@inner
def _waits(tasks: Any, now: float) -> bool:
    """Return whether room for the notes of a solution is missing."""
    for number in range(2):
        task = tasks[number]
        if task.acts == LEADS and task.settled == 0 and now >= task.solve_s - 1e-9 and (
                task.solutions >= MOST_SOLUTIONS):
            return True
    return False


@inlined
def _lead_arms(addresses: Addresses, world: WorldArrays, scratch: Kinematics, joints: RobotJoints,
               targets: Targets, now: float, duration: float) -> bool:
    """Let arms bring their end effectors nearer to targets; return whether any of them does."""
    acts = False
    for number in range(2):
        task = targets.tasks[number]
        if task.acts == EXERTS:
            press_on(world, joints.loads, joints.efforts, joints.postures, targets, number, now,
                     duration)
            acts = True
        elif task.acts == LEADS and task.settled == 0:
            if now >= task.solve_s - 1e-9:
                put_ahead(world, scratch, joints.setpoints, targets, number)
                find_places(addresses)
                lead(world, scratch, joints.setpoints, joints.postures, targets, number, now)
                joints.flags[MOVES] = True
            acts = True
    return acts


@inlined
def _move_joints(world: WorldArrays, joints: RobotJoints, place: int, acts: bool, now: float,
                 duration: float) -> bool:
    """
    Write the controls of joints in an interval; return whether they do not just rest.

    :param place: of the interval on the path along which trajectories lead joints
    """
    flags, held = joints.flags, False
    if not (acts or len(joints.path) or flags[MOVES] or flags[DUE] or flags[ACTS]):
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
        follow(joints.setpoints, joints.led, joints.path[place])
        flags[MOVES] = True
    drive(world, joints.servos, joints.places, joints.setpoints, joints.loads,
          joints.integrals, joints.efforts, duration)
    flags[DUE], flags[WRITTEN] = False, True
    return True


@inlined
def _act(addresses: Addresses, place: int, now: float, duration: float,
         world: WorldArrays, scratch: Kinematics, joints: RobotJoints, targets: Targets,
         grippers: tuple[Gripper, Gripper]) -> bool:
    """Write the controls of a robot for an interval; return whether joints do not just rest."""
    leads = _lead_arms(addresses, world, scratch, joints, targets, now, duration)
    if len(joints.base):
        drive_base(world, joints.servos, joints.setpoints, joints.base, joints.owned,
                   joints.twist, now, duration)
        joints.flags[MOVES] = True
    moved = _move_joints(world, joints, place, leads, now, duration)
    for number in range(2):
        flags, pressing = grippers[number].grip.flags, grippers[number].grip.pressing
        if flags[FINGERS_MOVE] or flags[PAIR] and pressing[0] and pressing[1]:
            move_fingers(world, grippers[number], now, duration)
    return moved


def _example_of_robot() -> Robot:
    """Return a robot without joints."""
    none, nobody = np.zeros(0), np.zeros(0, np.int64)
    nowhere = np.zeros((0, 0), np.int64)
    joints = RobotJoints(
        readable(np.zeros(0, JOINT)), readable(np.zeros(0, SERVO)), nowhere, none, nowhere, none,
        np.zeros(4, np.bool_), nobody, np.zeros((0, 0, 3)), nobody, nobody,
        readable(np.zeros(0, MOTION)), no_loads(), none)
    return Robot(joints, targets_of(0), (no_gripper(), no_gripper()), np.zeros(1), nobody, nobody,
                 none, none, none)


def _example() -> tuple[Period, ScratchArrays]:
    """Return a period in which nothing happens, of a world in which nothing is."""
    model = mujoco.MjModel.from_xml_string('<mujoco/>')
    data, none, nobody = mujoco.MjData(model), np.zeros(0), np.zeros(0, np.int64)
    world, place = WorldArrays.of(data), (address_of(model), address_of(data))
    words = np.zeros(0, np.int32)
    period = Period(
        place, Time(np.zeros(2, np.int64), 1, 1.0), np.zeros(5, np.int64), nobody, world,
        Weight(nobody, data.qfrc_applied), nobody, nobody,
        notes_of(data, np.zeros((0, 3), np.int64), 0),
        Watch(none, none, np.zeros((0, 2), np.int64), 0, data.qpos, data.qacc,
              words, words, LastStep.of(
                  model, data, none, np.zeros(1, np.bool_), none, np.zeros(3, np.bool_))),
        np.zeros(2, np.int64), Standing(nobody, data.xfrc_applied, words, words))
    return period, ScratchArrays(place[1], world.kinematics)


#: The places of a robot, of a period and of the scratch in their rows.
ROBOT = Layout(_example_of_robot())
PERIOD, SCRATCH = (Layout(example) for example in _example())
_read_robot, _read_period, _read_scratch = ROBOT.reader(), PERIOD.reader(), SCRATCH.reader()


@inlined
def _act_all(addresses: Addresses, period: Period, place: int, now: float, duration: float,
             scratch: Kinematics) -> bool:
    """Write the controls of all robots; return False, and write none, where one has to wait."""
    for row in period.robots:
        if _waits(_read_robot(row).targets.tasks, now):
            return False
    for row in period.robots:
        robot = _read_robot(row)
        if _act(addresses, place, now, duration, period.world, scratch, robot.joints,
                robot.targets, robot.grippers):
            robot.moved_s[0] = now + duration
    return True


@inner
def _compare_targets(tasks: Any, facts_of: Any) -> None:
    """Note of each target whether nothing new has become of it, and when that was seen last."""
    for number in range(2):
        task = tasks[number]
        if task.acts == IDLE:
            continue
        # Joints that come to rest in the last solution are news, those that rested are none.
        task.usual = int(task.settled == 0 or task.solutions == 0)
        for k in range(task.solutions if task.follows != BRAKES else 0):
            facts = facts_of[number, k]
            if (facts.held != task.was_held or facts.singular != task.was_singular
                    or facts.slowed != task.was_slowed or facts.reached and task.awaited
                    or task.follows == RESTS and not task.impedes and (
                        facts.aside > ASIDE) != (task.was_aside != 0)
                    or task.follows != TWISTS and facts.progress <= NEARER and not facts.close):
                task.usual = 0
        if task.usual and task.solutions and task.follows in (RESTS, STREAMS):
            task.seen_s = facts_of[number, task.solutions - 1].now_s


@inlined
def _run(period: Period, scratch: ScratchArrays, passed: int) -> None:
    """
    Run intervals: control of robots at the beginning of each, and its steps.

    :param passed: intervals that have been run on the same rows before
    """
    addresses = Addresses(period.place[0], period.place[1], scratch.address)
    time, orders = period.time, period.orders
    if orders[BEGINS]:
        orders[RESUMES] = remember(addresses, period.watch, orders[RESUMES])
    period.notes.counts[:] = 0
    for row in period.robots:
        _read_robot(row).moved_s[0] = -1.0
    done, ends = 0, orders[ENDS] != 0
    for k in range(len(period.intervals)):
        steps, now = period.intervals[k], time.counts[1] * time.step_ns * 1e-9
        begin_all(period.seats)
        if not _act_all(addresses, period, passed + k, now, steps * time.step_s,
                        scratch.kinematics):
            ends = False
            break
        if not orders[STEPPING]:
            break
        for dof in period.weight.dofs:
            period.weight.applied[dof] = -period.world.carried[dof]
        failed = take_steps(addresses, steps, orders[RESUMES] if k == 0 else 0, period.notes,
                            period.seats, now, time.step_s)
        time.counts[0] += steps
        time.counts[1] += steps
        done += steps
        if failed:
            ends = False
            break
    for row in period.robots:
        targets = _read_robot(row).targets
        _compare_targets(targets.tasks, targets.facts)
    period.outcome[0] = done
    period.outcome[1] = ends and not compute_end(addresses, period.watch)


@inlined
def _rests(robot: Robot) -> bool:
    """Return whether a robot has nothing to do any more, or one of its commands is done."""
    setpoints, owners = robot.joints.setpoints, robot.owners
    if not (robot.acts[0] or robot.joints.flags[MOVES] or robot.joints.flags[WRITTEN]):
        return True
    for i in range(len(owners)):
        moves = owners[i] < 0
        for other in range(len(owners)):
            moves = moves or owners[other] == owners[i] and setpoints[other].moves != 0.0
        if not (moves and (owners[i] < 0 or robot.joints.flags[MOVES])):
            return True
    return False


@inner
def _is_usual(tasks: Any) -> bool:
    """Return whether nothing new has become of any target."""
    usual = True
    for number in range(2):
        task = tasks[number]
        usual = usual and (task.acts == IDLE or task.usual != 0)
    return usual


@inlined
def _are_awaited(grippers: tuple[Gripper, Gripper]) -> bool:
    """Return whether fingers have come to rest for which Python waits."""
    awaited = False
    for number in range(2):
        flags = grippers[number].grip.flags
        awaited = awaited or flags[AWAITED] and not flags[FINGERS_MOVE]
    return awaited


@inner
def _begin_targets(tasks: Any) -> None:
    """Let what becomes of targets in a period be noted."""
    for number in range(2):
        task = tasks[number]
        if task.acts != IDLE:
            task.notes, task.solutions, task.solve_s = 1, 0, -math.inf


@inlined
def _goes_on(period: Period) -> bool:
    """Return whether a period goes on like the one before."""
    time, standing, tools = period.time, period.standing, period.notes.tools
    if period.notes.contacts[0] > standing.contacts[0]:
        return False
    for k in range(len(standing.options)):
        if standing.options[k] != standing.kept[k]:
            return False
    for tool in range(len(tools)):
        if any_force(standing.pushes, tools[tool, 0], tools[tool, 1]):
            return False
    acts, now = True, time.counts[1] * time.step_ns * 1e-9
    for row in period.robots:
        robot = _read_robot(row)
        for until_s in robot.until_s:
            acts = acts and now < until_s
        acts = acts and not _rests(robot)
    return acts


@inlined
def _is_quiet(period: Period) -> bool:
    """Return whether nothing has happened in a period that Python has to look at."""
    left = -period.outcome[0]
    for steps in period.intervals:
        left += steps
    if left != 0 or period.outcome[1] != 0 or period.standing.contacts[1] == 0:
        return False
    touched = False
    for count in period.notes.counts:
        touched = touched or count != 0
    return not touched


@inlined
def _stands(known: IntArray, steps: int) -> bool:
    """Return whether a world goes on like in its last period, and let it begin one."""
    known[BECAME] = STOOD
    if known[STEPS] != steps:
        return False
    period = _read_period(known[ROW])
    if not _goes_on(period):
        return False
    period.orders[RESUMES] = period.orders[RESUMES_AFTER]
    for row in period.robots:
        _begin_targets(_read_robot(row).targets.tasks)
    known[PERIODS] += 1
    return True


@inlined
def _become(period: Period) -> int:
    """Return what has become of a world that went on."""
    quiet = _is_quiet(period)
    for row in period.robots:
        robot = _read_robot(row)
        quiet = quiet and _is_usual(robot.targets.tasks) and not _are_awaited(robot.grippers)
    return int(WENT_ON if quiet else ENDED)


@compiled
def run_rows(rows: IntArray, table: IntArray, worlds: IntArray, steps: int, scratch: int) -> None:
    """
    Run periods of several worlds, one after another.

    :param rows: addresses of rows by :data:`PERIOD`, shape (n,)
    :param table: ``Physics.standing`` of all worlds, shape (count, 5)
    :param worlds: which of them go on as in their last periods, if Python has nothing to do for
        them, shape (n,); shape (0,): all run periods that have been prepared
    :param steps: of the periods of worlds that go on
    :param scratch: of a row by :data:`SCRATCH`, whose data nobody else uses meanwhile
    """
    room, prepared = _read_scratch(scratch), len(worlds) == 0
    # Both kinds in one function: what it calls is compiled into it, which takes seconds.
    for k in range(len(rows)):
        if prepared or _stands(table[worlds[k]], steps):
            period, passed = _read_period(rows[k]), 0
            if not prepared:
                passed = (table[worlds[k], PERIODS] - 1) * len(period.intervals)
            _run(period, room, passed)
            if not prepared:
                table[worlds[k], BECAME] = _become(period)


@compiled
def renew(table: IntArray, robots: IntArray, worlds: IntArray, indices: IntArray,
          goals: FloatArray, period_s: float, velocities: bool) -> None:
    """
    Give commands that run other goals, as if equal ones had replaced them, in worlds that go on.

    :param table: ``Physics.standing`` of all worlds, shape (count, 5)
    :param robots: address of the row of the robot in each world, shape (count,)
    :param worlds: which of them do, shape (k,)
    :param indices: of the joints of the command, shape (n,)
    :param goals: shape (count, n)
    :param period_s: length of a control period [s]
    :param velocities: whether goals are velocities
    """
    for world in worlds:
        time, robot = _read_period(table[world, ROW]).time, _read_robot(robots[world])
        wait(robot.joints.setpoints, indices, goals[world], period_s, 1.0, 0.0, velocities)
        robot.joints.flags[MOVES] = True
        for k in range(len(indices)):
            robot.goals[indices[k]] = goals[world, k]
            robot.renewed_s[indices[k]] = time.counts[1] * time.step_ns * 1e-9


@compiled
def renew_actions(table: IntArray, robots: IntArray, worlds: IntArray, indices: IntArray,
                  actions: FloatArray) -> None:
    """
    Give actions of OSC_POSE that run other numbers, as if equal ones had replaced them.

    :param table: ``Physics.standing`` of all worlds, shape (count, 5)
    :param robots: address of the row of the robot in each world, shape (count,)
    :param worlds: which of them do, shape (k,)
    :param indices: of the joints of the arm, shape (n,)
    :param actions: shape (count, 6)
    """
    for world in worlds:
        period, robot = _read_period(table[world, ROW]), _read_robot(robots[world])
        targets, number = robot.targets, 1
        if targets.arms[0].joints[0].joint == indices[0]:
            number = 0
        task = targets.tasks[number]
        act(period.world.kinematics, task.tip, task.tip_is_site, task.anchor, task.anchor_is_site,
            actions[world], targets.positions[number], targets.rotations[number])
        task.rests = task.begun = 0
        for k in range(6):
            targets.actions[number, k] = actions[world, k]
        for joint in indices:
            robot.renewed_s[joint] = period.time.counts[1] * period.time.step_ns * 1e-9


@compiled
def renew_grips(robots: IntArray, worlds: IntArray, number: int, actions: FloatArray) -> None:
    """
    Give actions of grippers other numbers, as if equal ones had replaced them, in some worlds.

    :param robots: address of the row of the robot in each world, shape (count,)
    :param worlds: which of them, shape (k,)
    :param number: of the gripper of the robot
    :param actions: in [-1, 1], shape (count, dof)
    """
    for world in worlds:
        grip = _read_robot(robots[world]).grippers[number].grip
        for k in range(len(grip.action)):
            grip.action[k] = actions[world, k]
        grip.flags[TAKES] = grip.flags[FINGERS_MOVE] = grip.flags[RENEWED] = True
        grip.flags[AWAITED] = False
