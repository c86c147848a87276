# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
The record of a coordinate: limits, setpoint, the goals of its stream and when they were sent.

A coordinate is a joint, or any other number with limits, such as a component of a translation.
"""

from __future__ import annotations

import os
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import FloatArray, IntArray
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
