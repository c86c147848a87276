# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
The numbers of joints, end effectors and grippers, as the laws take them; numba is not needed.

The record of a *coordinate* has limits, setpoint, the goals of its stream and when they were sent.
A coordinate is a joint, or any other number with limits, such as a component of a translation.
"""

from __future__ import annotations

from functools import cache
import os
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.control.streamed_trajectories import STREAM_INTERVAL_S

#: Fields of a record, each a float [s, rad or m, and per s]; flags are 0 or 1.
FIELDS = (
    # Limits of position, velocity and acceleration; longest interval of a stream, and how long it
    # goes on after a message was due, 0 for two intervals.
    'low', 'high', 'top', 'limit', 'longest', 'hold',
    # The setpoint at the end of the last interval.
    'position', 'velocity', 'acceleration',
    # The reference: its velocity, what that comes to and how fast, until when.
    'rate', 'rate_goal', 'slope', 'until',
    # The motion tracked beside it: the target, velocities before and after two low-pass stages,
    # and their time constant; the limit of all accelerations.
    'target', 'raw', 'first', 'second', 'smoothing', 'bound',
    # Flags: comes to the target, brakes before that, moves, was held back at rest; mean velocity
    # of the joint.
    'seeks', 'brakes', 'moves', 'held', 'slide',
    # A goal that came at this instant: how many messages, their stamp and the control period.
    'waiting', 'waiting_goal', 'waiting_messages', 'waiting_stamp', 'waiting_period',
    # When messages came and were sent: the last arrival, its stamp and number in the stream; the
    # line through the arrivals (time due, time per message or per stamped second); interval,
    # deviations from the line, the last one; how many in a row were on it, far off, or after lost
    # ones, how many these were, and how many had no stamp among stamped ones.
    'velocities', 'arrived', 'stamp', 'number', 'due', 'scale', 'interval', 'jitter', 'off',
    'even', 'astray', 'skipped', 'skipped_lost', 'guessed',
    # Times of sending between the line and the arrivals: share of the arrivals, errors of goals
    # predicted by both, the last two intervals by both; the slack of ramps.
    'share', 'line_error', 'arrival_error', 'line_1', 'line_2', 'arrival_1', 'arrival_2', 'sent',
    'elapsed', 'elapsed_before', 'slack',
    # The goals: the last one, the last two steps, velocity of the last one and by how much it had
    # changed, and its own acceleration; messages in a row without a jump, and by
    # turns with a step and without.
    'goal', 'step_1', 'step_2', 'last', 'change', 'own', 'steady',
    'alternating',
    # A parabola through them, its memory, and their noise by third differences.
    'level', 'pace', 'bend', 'memory', 'curve', 'third', 'product', 'noise',
    # Counts: goals beyond the velocity limit, messages that seem to have been lost.
    'limited', 'lost')
#: Where they are in the numbers of a coordinate.
PLACES = {name: place for place, name in enumerate(FIELDS)}
JOINT = np.dtype([(name, np.float64) for name in FIELDS])
#: Motion of a coordinate of a stream until another message comes: the velocity that it comes to,
#: at which acceleration and when, and the most of that which is the stream's own; where it would
#: be at which time if it always had that velocity.
MOTION_FIELDS = ('velocity', 'slope', 'reached', 'own', 'position', 'due')
MOTION = np.dtype([(name, np.float64) for name in MOTION_FIELDS])
#: True if laws are plain Python, which reads attributes of records of another type alone.
PLAIN = os.environ.get('NUMBA_DISABLE_JIT', '0') != '0'
#: Shortest time constant of the tracked difference to the reference [s].
SMOOTHING_S = 0.02
#: Flags of the joints of a robot: any setpoint moves, efforts have yet to be written, controls are
#: those of setpoints that move, controls have to be written in each interval.
MOVES, DUE, WRITTEN, ACTS = range(4)
#: A servo: addresses of the joint in ``qpos`` and ``qvel`` and of the actuator in ``act`` and
#: ``ctrl``; joint to actuator, stiffness [N m/rad or N/m], damping of servo and joint [N m s/rad
#: or N s/m], dry friction [N m or N], lowest and highest effort, with what compensates the weight
#: [N m or N], and of the actuator alone, rate of the integral term [1/s]; whether the weight is
#: compensated, and whether it is a source of effort.
SERVO = np.dtype([
    *((name, np.int64) for name in ('qpos', 'dof', 'activation', 'control')),
    *((name, np.float64) for name in ('gear', 'stiffness', 'drag', 'friction', 'low', 'high',
                                      'least', 'most', 'damping', 'velocity', 'effort',
                                      'integral')),
    *((name, np.bool_) for name in ('compensated', 'gives', 'leads', 'damps'))], align=True)


def records(state: FloatArray, kind: Any = JOINT) -> Any:
    """
    Return a view of numbers as records.

    :param state: shape (..., number of fields), contiguous
    :param kind: :data:`JOINT` or :data:`MOTION`
    :returns: shape (...)
    """
    return readable(state.view(kind).reshape(state.shape[:-1]))


def readable(structured: Any) -> Any:
    """Return structured numbers as the law reads them, by attributes of its elements."""
    return structured.view(np.recarray) if PLAIN else structured


def blank_state(limit: FloatArray) -> FloatArray:
    """
    Return the numbers of coordinates without a range that have had no messages.

    :param limit: of their acceleration [1/s^2], shape (n,)
    :returns: shape (n, len(FIELDS))
    """
    state = np.zeros((len(limit), len(FIELDS)))
    joints = records(state)
    joints['low'], joints['high'], joints['top'] = -np.inf, np.inf, np.inf
    joints['limit'] = joints['slope'] = joints['bound'] = limit
    joints['smoothing'] = SMOOTHING_S
    joints['longest'], joints['arrived'], joints['until'] = STREAM_INTERVAL_S, -np.inf, np.inf
    return state


def blank_motion(count: int) -> FloatArray:
    """Return the numbers of coordinates at rest, by :data:`MOTION`, shape (count, 6)."""
    motion = np.zeros((count, len(MOTION_FIELDS)))
    motion[:, MOTION_FIELDS.index('reached')] = -np.inf
    return motion


class RobotJoints(NamedTuple):
    """
    The joints of a robot.

    :ivar setpoints: records, shape (n,)
    :ivar servos: records of ``SERVO``, shape (n,)
    :ivar places: of their inertia in ``M``, -1 where it is zero, shape (n, n)
    :ivar efforts: of those that are sources of effort [N m or N], shape (n,)
    :ivar counts: of goals beyond the velocity limit and of lost messages, shape (2, n)
    :ivar postures: that redundant arms tend to [rad], shape (n,)
    :ivar flags: by :data:`MOVES`, :data:`DUE`, :data:`WRITTEN`, :data:`ACTS`, shape (4,)
    :ivar led: those that trajectories lead, shape (m,)
    :ivar path: their position, velocity and acceleration at the ends of intervals, shape
        (k, m, 3), with k = 0 where no trajectory runs or waits
    :ivar base: the joints x, y and yaw of a base that follows a twist, or no joints, shape (3,)
    :ivar owned: which of these the twist owns, shape (j,)
    :ivar twist: in the frame of the base, records of :data:`MOTION`, shape (3,)
    :ivar loads: payloads, see :class:`~manip_sim.control.law.loads.Loads`
    :ivar integrals: leads of integral terms over setpoints [rad or m], shape (n,)
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
    twist: NDArray[np.void]
    loads: Any
    integrals: FloatArray


#: A joint of an arm: its index among the joints of the robot, its addresses in ``qpos`` and
#: ``qvel``; range [rad], infinite where there is none; velocity limit, and that of setpoints
#: [rad/s]; their acceleration limit [rad/s^2]; lowest and highest effort [N m]; damping of the
#: joint itself [N m s/rad]; 2 pi where whole turns make no difference, 0 elsewhere [rad]; whether
#: it moves the end effector.
CHAIN = np.dtype([
    *((name, np.int64) for name in ('joint', 'qpos', 'dof')),
    *((name, np.float64) for name in (
        'low', 'high', 'velocity_limit', 'cruising_velocity', 'acceleration_limit', 'weakest',
        'strongest', 'damping', 'turn')),
    ('moves', np.bool_)], align=True)


class Arm(NamedTuple):
    """
    The joints of an arm.

    :ivar joints: records of :data:`CHAIN`, shape (n,)
    :ivar places: of their inertia in ``M``, -1 where it is zero, shape (n, n)
    :ivar root: body at the root of the tree of bodies
    """

    joints: NDArray[np.void]
    places: IntArray
    root: int


class Spring(NamedTuple):
    """
    Settings of an end effector.

    :ivar stiffness: acceleration per error [1/s^2]
    :ivar damping: acceleration per velocity [1/s]
    :ivar linear_velocity: limit [m/s]
    :ivar angular_velocity: limit [rad/s]
    """

    stiffness: float
    damping: float
    linear_velocity: float
    angular_velocity: float


class Goal(NamedTuple):
    """
    Pose and velocity of the goal of an end effector.

    :ivar position: in its frame [m], shape (3,)
    :ivar rotation: in its frame, shape (3, 3)
    :ivar origin: of the frame in the world [m], shape (3,), a view
    :ivar axes: of the frame in the world, shape (3, 3), a view
    :ivar along: velocity in the world, and acceleration / damping [m/s, rad/s], shape (6,)
    """

    position: FloatArray
    rotation: FloatArray
    origin: FloatArray
    axes: FloatArray
    along: FloatArray


class Motion(NamedTuple):
    """
    Arrays into which the law writes.

    :ivar efforts: of the joints [N m], shape (n,)
    :ivar error: translation [m] and rotation vector [rad] to the goal, shape (6,)
    :ivar twist: of the end effector [m/s, rad/s], shape (6,)
    :ivar held: whether the range of a joint keeps it from doing more, shape (n,)
    """

    efforts: FloatArray
    error: FloatArray
    twist: FloatArray
    held: BoolArray


class ArmMotion(NamedTuple):
    """
    Setpoints and limits of the joints of an arm, all of shape (n,).

    :ivar position: where the present velocities bring the joints in the interval [rad]
    :ivar velocity: at present [rad/s]
    :ivar low: lowest position, may be infinite [rad]
    :ivar high: highest position [rad]
    :ivar velocity_limit: [rad/s]
    :ivar acceleration_limit: [rad/s^2]
    :ivar posture: to which a redundant arm tends [rad]
    :ivar turn: 2 pi where whole turns make no difference, 0 elsewhere [rad]
    """

    position: FloatArray
    velocity: FloatArray
    low: FloatArray
    high: FloatArray
    velocity_limit: FloatArray
    acceleration_limit: FloatArray
    posture: FloatArray
    turn: FloatArray


class Velocities(NamedTuple):
    """
    Arrays into which the law writes, all of shape (n,).

    :ivar velocity: of the joints at the end of the interval [rad/s]
    :ivar acceleration_limit: of the joints, if the motion needs more than their own [rad/s^2]
    :ivar held: whether the range of a joint keeps it from doing more
    """

    velocity: FloatArray
    acceleration_limit: FloatArray
    held: BoolArray


#: Actions of an arm: none, its joints are led to the target, it exerts efforts.
IDLE, LEADS, EXERTS = range(3)
#: Motions of a target: none, with a stream of poses, with a twist; the last lets the arm brake.
RESTS, STREAMS, TWISTS, BRAKES = range(4)
#: A target of an end effector: what the arm does, how it moves, ids of the end effector, of the
#: frame that the goal stays fixed in, of the axes of a twist, of those of the springs of an
#: impedance and of its wrench beside, and whether they are sites; whether the end effector is as
#: near as it can come, whether its setpoints have come to rest, whether its way has begun, whether
#: efforts are to be noted, how many solutions are, whether the arm is an impedance, whether that
#: has a reference, whether somebody waits for the target to be reached; whether ranges of joints
#: held the end effector, it could hardly move, it was off its way, and limits slowed it down when
#: Python looked last, and whether nothing has changed in that; settings of the spring and of the
#: impedance; share of the acceleration of a stream; when the kinematics are solved next, for how
#: long, and when the target was looked at last [s].
TASK = np.dtype([
    *((name, np.int64) for name in (
        'acts', 'follows', 'tip', 'tip_is_site', 'anchor', 'anchor_is_site', 'axes',
        'axes_is_site', 'frame', 'frame_is_site', 'push_frame', 'push_is_site', 'rests',
        'settled', 'begun', 'notes', 'solutions', 'impedes', 'refers', 'awaited',
        'was_held', 'was_singular', 'was_aside', 'was_slowed', 'usual')),
    *((name, np.float64) for name in (
        'stiffness', 'damping', 'linear_velocity', 'angular_velocity', 'damping_ratio',
        'null_stiffness', 'smooth', 'solve_s', 'interval_s', 'seen_s'))], align=True)
#: Outcome of a solution: when it was found [s], which share of the wanted motion is made, how far
#: the end effector is off its way [m]; whether it has reached the target, whether it comes near
#: enough to it, whether a motion is wanted in a direction in which it can hardly move, whether
#: ranges of joints keep it from doing more, and whether velocity limits slow down a twist, or a
#: stream that gets late so.
FACTS = np.dtype([
    *((name, np.float64) for name in ('now_s', 'progress', 'aside')),
    *((name, np.int64) for name in ('reached', 'close', 'singular', 'held', 'slowed'))],
    align=True)
#: So many solutions of a task can be noted.
MOST_SOLUTIONS = 16
#: A target is missed if the end effector is farther from it than this [m], [rad].
MISSED, MISSED_TURN = 2e-3, 2e-2
#: An end effector comes nearer to its target with more than this share of the wanted motion.
NEARER = 0.1
#: It has left its way if it is farther from it than this [m].
ASIDE = 0.01


class Targets(NamedTuple):
    """
    Targets of the arms of a robot, and what has become of them; of two arms at most.

    :ivar tasks: records of :data:`TASK`, shape (2,)
    :ivar positions: of the goals in their frames [m], shape (2, 3)
    :ivar rotations: of the goals in their frames, shape (2, 3, 3)
    :ivar streams: way from the goal to the reference of a stream of poses, as translation and
        rotation vector in the frame of the goal, or twists in their axes, records of
        :data:`~manip_sim.control.law.records.MOTION`, shape (2, 6)
    :ivar arms: the joints of each
    :ivar starts: where the ways of the end effectors began, in the frames of the goals [m], shape
        (2, 3)
    :ivar springs: stiffness of impedances along and about axes [N/m, N m/rad], shape (2, 6)
    :ivar pushes: their wrenches beside, in axes of their own [N, N m], shape (2, 6)
    :ivar brakes: dampers along and about axes [N s/m, N m s/rad] and velocities that motions there
        do not exceed [m/s, rad/s], shape (2, 2, 6)
    :ivar places: where the references of impedances are, in the frames of the goals [m], (2, 3)
    :ivar attitudes: their rotations, shape (2, 3, 3)
    :ivar facts: records of :data:`FACTS`, shape (2, k)
    :ivar errors: translation [m] and rotation vector [rad] from the end effector, as led, to its
        goal, shape (2, k, 6)
    :ivar missed: the same, as measured, of targets that are reached, shape (2, k, 6)
    :ivar held: whether the range of a joint of the robot keeps it from doing more, (2, k, n)
    :ivar actions: last actions of OSC_POSE that came while periods went on, shape (2, 6)
    """

    tasks: NDArray[np.void]
    positions: FloatArray
    rotations: FloatArray
    streams: NDArray[np.void]
    arms: tuple[Arm, Arm]
    starts: FloatArray
    springs: FloatArray
    pushes: FloatArray
    brakes: FloatArray
    places: FloatArray
    attitudes: FloatArray
    facts: NDArray[np.void]
    errors: FloatArray
    missed: FloatArray
    held: BoolArray
    actions: FloatArray


def targets_of(joints: int, solutions: int = MOST_SOLUTIONS) -> Targets:
    """
    Return room for the targets of a robot, whose arms do nothing yet.

    :param joints: of the robot
    :param solutions: how many of each target can be noted
    """
    nobody = Arm(readable(np.zeros(0, CHAIN)), np.zeros((0, 0), np.int64), 0)
    rows = 2, solutions
    return Targets(readable(np.zeros(2, TASK)), np.zeros((2, 3)), np.zeros((2, 3, 3)),
                   readable(np.zeros((2, 6), MOTION)),
                   (nobody, nobody), np.zeros((2, 3)), np.zeros((2, 6)), np.zeros((2, 6)),
                   np.zeros((2, 2, 6)), np.zeros((2, 3)), np.zeros((2, 3, 3)),
                   readable(np.zeros(rows, FACTS)), np.zeros((*rows, 6)), np.zeros((*rows, 6)),
                   np.zeros((*rows, joints), np.bool_), np.zeros((2, 6)))


@cache
def no_targets() -> Targets:
    """Return the targets of a robot without any."""
    return targets_of(0, 0)


#: An actuator of a gripper: its id, its address in ``act`` where it integrates; gain of a servo
#: and its bias, constant and per length, 1 and 0 elsewhere; range of setpoints, their highest
#: speed, how far they are below and above the place at full force, and with the present limits of
#: force; setpoints that differ by less than the tolerance are the same; whether it has a setpoint,
#: and whether its control is the rate of that.
FINGER = np.dtype([
    *((name, np.int64) for name in ('id', 'activation')),
    *((name, np.float64) for name in (
        'gain', 'offset', 'per_length', 'low', 'high', 'speed', 'below', 'above', 'reach_below',
        'reach_above', 'tolerance')),
    *((name, np.bool_) for name in ('is_servo', 'integrates'))], align=True)
#: Flags of a gripper: setpoints move, or a finger that was sent to an end has yet to stop; the
#: goals are new; an action will be taken again; there are two independent fingers that close on
#: each other; the law takes actions by a rule; Python has to look as soon as setpoints do not move
#: any more; another action has come in compiled code.
FINGERS_MOVE, TURNED, TAKES, PAIR, RULED, AWAITED, RENEWED = range(7)
#: Rate at which an action of a gripper is taken again and again, that of robosuite [Hz].
GRIPPER_RATE_HZ = 20.0


class Rule(NamedTuple):
    """
    Meaning of the actions of a gripper, see :class:`~manip_sim.models.grippers.ActionRule`.

    :ivar numbers: shape (m,), as ``commands``
    :ivar steps: shape (m,), or (0,)
    :ivar proportional: shape (1,)
    :ivar sources: shape (n,), as ``still``
    :ivar commands: the present ones, which the law changes
    """

    numbers: IntArray
    steps: FloatArray
    proportional: BoolArray
    sources: IntArray
    still: FloatArray
    commands: FloatArray


class Grip(NamedTuple):
    """
    Goals of the setpoints of a gripper, which the law changes.

    :ivar goal: shape (n,)
    :ivar to_end: whether each was sent to the lower and the upper end of its range, and its finger
        is not there, shape (n, 2)
    :ivar pressing: whether its finger has stopped before that, shape (n,)
    :ivar pace: of setpoints, at most [1/s], shape (n,)
    :ivar stopped: where the fingers were when all had come to rest, as setpoints, shape (n,)
    :ivar flags: by :data:`FINGERS_MOVE` and those that follow it, shape (7,)
    :ivar action: that is taken again and again, in [-1, 1], shape (dof,)
    :ivar call: simulation time when it is taken next, and half a physics step [s], shape (2,)
    :ivar rule: its meaning, if the law takes it
    """

    goal: FloatArray
    to_end: BoolArray
    pressing: BoolArray
    pace: FloatArray
    stopped: FloatArray
    flags: NDArray[np.bool_]
    action: FloatArray
    call: FloatArray
    rule: Rule


class Gripper(NamedTuple):
    """
    A gripper.

    :ivar fingers: records of :data:`FINGER`, shape (n,)
    :ivar grip: where they go
    """

    fingers: NDArray[np.void]
    grip: Grip


@cache
def no_rule() -> Rule:
    """Return the rule of a gripper whose actions Python takes."""
    none, nobody = np.zeros(0), np.zeros(0, np.int64)
    return Rule(nobody, none, none > 0.0, nobody, none, none)


@cache
def no_gripper() -> Gripper:
    """Return a gripper without fingers, which does nothing."""
    none = np.zeros(0)
    return Gripper(readable(np.zeros(0, FINGER)), Grip(
        none, np.zeros((0, 2), np.bool_), none > 0.0, none, none, np.zeros(7, np.bool_), none,
        np.zeros(2), no_rule()))
