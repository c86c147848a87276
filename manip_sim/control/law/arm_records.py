# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Inputs and outputs of the laws of arms; numba is not needed."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.control.law.joint_records import MOTION, readable


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
    :ivar brakes: dampers along and about these axes [N s/m, N m s/rad] and velocities that motions
        there do not exceed [m/s, rad/s], shape (2, 2, 6)
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

    @classmethod
    def of(cls, count: int) -> Motion:
        """Return arrays for a number of joints."""
        return cls(np.zeros(count), np.zeros(6), np.zeros(6), np.zeros(count, dtype=np.bool_))


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

    @classmethod
    def of(cls, count: int) -> Velocities:
        """Return arrays for a number of joints."""
        return cls(np.zeros(count), np.zeros(count), np.zeros(count, dtype=np.bool_))


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
        :data:`~manip_sim.control.law.joint_records.MOTION`, shape (2, 6)
    :ivar arms: the joints of each
    :ivar starts: where the ways of the end effectors began, in the frames of the goals [m], shape
        (2, 3)
    :ivar springs: stiffness of impedances along and about axes [N/m, N m/rad], shape (2, 6)
    :ivar pushes: their wrenches beside, in axes of their own [N, N m], shape (2, 6)
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
