# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Setpoints of joints at each instant; how actuators follow them is not decided here."""

from __future__ import annotations

from typing import Any

import numpy as np

from manip_sim.arrays import BoolArray, FloatArray, IntArray
from manip_sim.control.law.joint_records import blank_state, records, SMOOTHING_S
from manip_sim.control.motion_profiles import evenly_braked, Plan, within

#: Share of the acceleration limit with which joints come to rest that no command moves any more:
#: servos add up to 15 % while they take over.
_BRAKING = 0.87


class SetpointGenerator:
    """
    A generator of setpoints that are continuous in position and velocity and keep to limits.

    Goals that come regularly are followed as a stream, one and a half intervals late; others are
    reached without going past. The laws are those of :mod:`manip_sim.control.law`, for one
    coordinate at a time: a joint, or any other number with such limits.

    :param position_range: lowest and highest setpoint [rad or m], shape (n, 2)
    :param velocity_limit: [rad/s or m/s], shape (n,)
    :param acceleration_limit: of steps, velocities and stops [rad/s^2 or m/s^2], shape (n,)
    :ivar limited: how often a streamed goal required more than the velocity limit, shape (n,)
    :ivar lost: how many messages of streams seem to have been lost, shape (n,)
    :ivar now_s: simulation time, which the caller may set [s]
    :ivar moving: whether any setpoint moves or is about to
    :ivar plan: that they follow, where nothing moves but streams on schedule, or None
    :ivar row: which of its intervals was the last one
    """

    #: Only counted, or computed from the rest.
    not_in_digest = ('limited', 'lost', '_ends_s', '_begin_s', '_states', 'plan', 'row')

    def __init__(self, position_range: FloatArray, velocity_limit: FloatArray,
                 acceleration_limit: FloatArray) -> None:
        count = len(velocity_limit)
        self.limited, self.lost = np.zeros((2, count), dtype=np.int64)
        self._state = blank_state(acceleration_limit)
        joints = self._joints
        joints['low'], joints['high'] = position_range.T
        joints['top'] = velocity_limit
        #: When the intervals of a control period end, since it began.
        self._ends_s: FloatArray = np.zeros(0)
        self.reset(np.zeros(count))

    @property
    def _joints(self) -> Any:
        """The state as records, a view."""
        return records(self._state)

    @property
    def position(self) -> FloatArray:
        """Setpoints at the end of the last interval [rad or m], shape (n,), a copy."""
        return np.array(self._joints['position'])

    @property
    def velocity(self) -> FloatArray:
        """Their velocity there [rad/s or m/s], shape (n,), a copy."""
        return np.array(self._joints['velocity'])

    @property
    def acceleration(self) -> FloatArray:
        """Their acceleration there [rad/s^2 or m/s^2], shape (n,), a copy."""
        return np.array(self._joints['acceleration'])

    def reset(self, position: FloatArray) -> None:
        """
        Hold all setpoints at a position, and forget what came; settings and counts stay.

        :param position: [rad or m], shape (n,)
        """
        before, self._state = self._joints, blank_state(self._joints['limit'])
        joints = self._joints
        for name in ('low', 'high', 'top', 'longest', 'hold'):
            joints[name] = before[name]
        self.now_s = self._begin_s = 0.0
        self._states: FloatArray | None = None
        self.plan: Plan | None = None
        self.row = 0
        self.place(np.arange(len(position)), position, np.zeros(len(position)))
        joints['moves'] = 0.0
        self.moving = False

    def set_stream(self, indices: IntArray, longest_s: float | None = None,
                   hold_s: float | None = None) -> None:
        """
        Change what counts as a stream, and what happens when one stops.

        :param longest_s: longest interval between messages of a stream [s]; None: no change
        :param hold_s: how long setpoints go on at the velocity of a stream after a message was
            due [s]; 0: two message intervals; None: no change
        """
        if longest_s is not None:
            self._joints['longest'][indices] = longest_s
        if hold_s is not None:
            self._joints['hold'][indices] = hold_s

    def stream_settings(self, index: int) -> tuple[float, float]:
        """Return what :meth:`set_stream` has set for a setpoint [s]."""
        joint = self._joints[index]
        return float(joint['longest']), float(joint['hold'])

    def at_rest(self, indices: IntArray) -> bool:
        """Return whether all of the given setpoints rest at their goals."""
        return not self.moving or not np.count_nonzero(self._joints['moves'][indices])

    @property
    def settled(self) -> bool:
        """Whether :meth:`advance` has nothing to do."""
        return not (self.moving or np.count_nonzero(self._joints['held']))

    def wake(self) -> None:
        """Resume setpoints that were held back after they had come to rest."""
        joints = self._joints
        joints['moves'] = np.maximum(joints['moves'], joints['held'])
        self.find_moving()

    def find_moving(self) -> None:
        """Find out whether any setpoint moves."""
        self.moving = bool(np.count_nonzero(self._joints['moves']))

    # ------------------------------------------------------------------ goals

    def place(self, indices: IntArray, position: FloatArray, velocity: FloatArray) -> None:
        """
        Set position and velocity of setpoints, which come to rest from there.

        Beyond an end of the range, they stop at it.

        :param position: [rad or m], shape of ``indices``
        :param velocity: [rad/s or m/s], shape of ``indices``
        """
        joints = self._joints
        low, high = joints['low'][indices], joints['high'][indices]
        joints['position'][indices] = np.clip(position, low, high)
        joints['velocity'][indices] = np.clip(velocity, np.where(position < low, 0.0, -np.inf),
                                              np.where(position > high, 0.0, np.inf))
        joints['acceleration'][indices] = 0.0
        self.set_velocity(indices, np.zeros(len(indices)))

    def set_velocity(self, indices: IntArray, velocity: FloatArray) -> None:
        """
        Let setpoints come to a velocity with the acceleration limit; zero holds them.

        :param velocity: [rad/s or m/s], shape of ``indices``
        """
        joints = self._joints
        joints['rate'][indices], joints['rate_goal'][indices] = (
            joints['velocity'][indices], velocity)
        joints['slope'][indices], joints['smoothing'][indices] = (
            joints['limit'][indices], SMOOTHING_S)
        for name in ('raw', 'first', 'second', 'seeks', 'brakes', 'waiting', 'number', 'held'):
            joints[name][indices] = 0.0
        joints['until'][indices], joints['arrived'][indices] = np.inf, -np.inf
        joints['moves'][indices] = 1.0
        self.moving, self.plan = True, None

    def ramp_to(self, indices: IntArray, velocity: FloatArray, duration_s: float,
                limit: FloatArray | None = None) -> None:
        """
        Let setpoints come to a velocity in a time, or later at the acceleration limit.

        :param velocity: [rad/s or m/s], shape of ``indices``
        :param duration_s: the time [s]
        :param limit: of the acceleration, if it is not that of the joints
            [rad/s^2 or m/s^2], shape of ``indices``
        """
        self.set_velocity(indices, velocity)
        joints = self._joints
        change = np.abs(velocity - joints['rate'][indices])
        if limit is None:
            limit = joints['limit'][indices]
        else:
            joints['bound'][indices] = np.maximum(limit, joints['bound'][indices])
        joints['slope'][indices] = np.clip(change / duration_s, 1e-9, limit)

    def brake(self, indices: IntArray) -> None:
        """
        Let setpoints come to rest together, as soon as their acceleration limits allow.

        Where the range would end before, they slow down evenly up to there.
        """
        joints = self._joints
        velocity = joints['velocity'][indices]
        self.set_velocity(indices, np.zeros(len(indices)))
        # They are at rest at the end of an interval, at the earliest of the first one.
        slope = evenly_braked(
            velocity, joints['position'][indices], joints['low'][indices], joints['high'][indices],
            _BRAKING * joints['limit'][indices],
            float(self._ends_s[0]) if len(self._ends_s) else 0.0)
        joints['slope'][indices] = slope
        joints['bound'][indices] = np.maximum(joints['bound'][indices], slope)
        joints['acceleration'][indices] = -np.sign(velocity) * slope

    def go_at(self, indices: IntArray, velocity: FloatArray, period_s: float,
              messages: int = 1, stamp_s: float = 0.0) -> None:
        """
        Let setpoints come to a velocity; velocities that come regularly are followed as a stream.

        :param velocity: [rad/s or m/s], shape of ``indices``
        :param period_s: length of a control period [s]
        :param messages: how many messages came since the last call, of which this is the last
        :param stamp_s: when it was sent, by any clock [s]; 0: unknown
        """
        self._wait(indices, velocity, period_s, messages, stamp_s, True)

    def go_to(self, indices: IntArray, goal: FloatArray, period_s: float, messages: int = 1,
              stamp_s: float = 0.0) -> None:
        """
        Let setpoints come to a position; goals that come regularly are followed as a stream.

        Of several goals at one instant the newest counts.

        :param goal: [rad or m], shape of ``indices``
        :param period_s: length of a control period [s]
        :param messages: how many messages came since the last call, of which this is the last
        :param stamp_s: when it was sent, by any clock [s]; 0: unknown
        """
        self._wait(indices, goal, period_s, messages, stamp_s, False)

    def _wait(self, indices: IntArray, goals: FloatArray, period_s: float, messages: int,
              stamp_s: float, velocities: bool) -> None:
        from manip_sim.control.law.stream_timing import wait  # It imports numba.
        wait(self._joints, indices, np.ascontiguousarray(goals, dtype=np.float64),
             float(period_s), float(messages), float(stamp_s), velocities)
        self.moving, self.plan = True, None

    def come_back(self, indices: IntArray, goal: FloatArray) -> None:
        """
        Let moving setpoints brake, and then come to a position.

        :param goal: [rad or m], shape of ``indices``
        """
        self.set_velocity(indices, np.zeros(len(indices)))
        joints = self._joints
        joints['goal'][indices] = joints['target'][indices] = goal
        joints['seeks'][indices] = joints['brakes'][indices] = 1.0

    def follow(self, indices: IntArray, position: FloatArray, velocity: FloatArray,
               acceleration: FloatArray) -> None:
        """
        Set the present setpoints from another source, such as a trajectory.

        When it ends, they come to rest from there. Beyond the range, they rest at its end.

        :param position: [rad or m], shape of ``indices``; ``velocity`` and ``acceleration`` too
        """
        joints = self._joints
        inside = (position >= joints['low'][indices]) & (position <= joints['high'][indices])
        self.place(indices, position, np.where(inside, velocity, 0.0))
        joints['acceleration'][indices] = np.where(inside, acceleration, 0.0)

    def shift(self, indices: IntArray, position: FloatArray, velocity: FloatArray) -> None:
        """
        Move setpoints at once, by less than a servo would notice.

        :param position: by which they move [rad or m], shape of ``indices``
        :param velocity: by which they become faster [rad/s or m/s], shape of ``indices``
        """
        self._joints['position'][indices] += position
        self._joints['velocity'][indices] += velocity

    # ------------------------------------------------------------------ motion

    def begin_period(self, ends_s: FloatArray) -> None:
        """
        Begin a control period.

        :param ends_s: when its intervals end, since it begins now [s], shape (k, 1)
        """
        self._ends_s, self._begin_s, self.plan = ends_s[:, 0], self.now_s, None

    def ends_left(self, now_s: float, duration_s: float) -> FloatArray:
        """
        Return when the intervals that are left of the period end, since now [s], shape (k,).

        :param now_s: simulation time [s]
        :param duration_s: of the next one, which is alone where the period is divided otherwise
        """
        first = int(np.count_nonzero(self._ends_s <= now_s - self._begin_s + 1e-9))
        ends_s = self._ends_s[first:] - self._ends_s[first - 1] if first else self._ends_s
        if len(ends_s) < 2 or abs(ends_s[0] - duration_s) > 1e-9:
            return np.array([duration_s])
        return ends_s

    def advance(self, duration_s: float) -> None:
        """
        Advance all setpoints.

        :param duration_s: length of the interval [s]
        """
        if self.plan is not None and self.row + 1 < len(self.plan.durations_s):
            self._follow(self.row + 1, duration_s)
            return
        from manip_sim.control.law.setpoint_motion import advance  # It imports numba.
        ends_s = self.ends_left(self.now_s, duration_s)
        states = np.empty((len(ends_s), *self._state.shape))
        count = advance(self._joints, records(states), self.now_s, ends_s)
        self.take_states(states, ends_s if count > 1 else None)
        self._follow(0, duration_s)

    def take_states(self, states: FloatArray, ends_s: FloatArray | None) -> None:
        """
        Take over states at the ends of intervals, of which the first is next.

        :param states: shape (k, n, fields)
        :param ends_s: of the intervals, if they are a plan, shape (k,)
        """
        self._states, self.row = states, 0
        self.plan = None if ends_s is None else plan_of(records(states), ends_s)
        joints = records(states[0])
        if np.count_nonzero(joints['limited']) or np.count_nonzero(joints['lost']):
            self.limited += joints['limited'].astype(np.int64)
            self.lost += joints['lost'].astype(np.int64)
            numbers = records(states)
            numbers['limited'] = numbers['lost'] = 0.0

    def _follow(self, row: int, duration_s: float) -> None:
        assert self._states is not None
        self._state[:] = self._states[row]
        self.row = row
        self.now_s += duration_s
        self.find_moving()

    def end_plan(self) -> None:
        """Follow the plan through all intervals that are left in it."""
        assert self.plan is not None
        self._follow(len(self.plan.durations_s) - 1, 0.0)

    def hold_back(self, measured: FloatArray, lead: FloatArray) -> None:
        """
        Keep setpoints from running ahead of joints that cannot keep up.

        :param measured: where the joints are [rad or m], shape (n,)
        :param lead: how far a setpoint may be from there [rad or m], shape (n,)
        """
        if np.count_nonzero(hold_back(self._joints, measured, lead)):
            self.plan = None


def plan_of(states: Any, ends_s: FloatArray) -> Plan:
    """
    Return what states mean for servos.

    :param states: records at the ends of intervals, shape (k, ..., n)
    :param ends_s: of the intervals, since now [s], shape (k,)
    """
    durations_s = np.diff(ends_s, prepend=0.0).reshape(-1, *(1,) * (states.ndim - 1))
    return Plan(durations_s, *(
        np.array(states[name]) for name in ('position', 'velocity', 'acceleration')))


def hold_back(joints: Any, measured: FloatArray, lead: FloatArray) -> BoolArray:
    """
    Keep setpoints from running ahead of joints that cannot keep up.

    :param joints: records, shape (..., n)
    :param measured: where the joints are [rad or m], shape (..., n)
    :param lead: how far a setpoint may be from there [rad or m], shape (..., n)
    :returns: which had to be held back, shape (..., n)
    """
    position = joints['position']
    held: BoolArray = np.abs(position - measured) > lead
    if not np.count_nonzero(held):
        return held
    position[held] = within(position, measured - lead, measured + lead)[held]
    joints['held'][held] = 1.0
    for name in ('raw', 'first', 'second', 'rate', 'velocity', 'acceleration'):
        joints[name][held] = 0.0
    return held
