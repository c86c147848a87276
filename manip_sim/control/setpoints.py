# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Setpoints of joints at each instant; how actuators follow them is not decided here."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.law.joint_records import blank_state, PLACES, records
from manip_sim.derived import Derived

_MOVES = PLACES['moves']
#: Share of the acceleration limit with which joints come to rest that no command moves any more:
#: servos add up to 15 % while they take over.
_BRAKING = 0.87


class SetpointGenerator:
    """
    A generator of setpoints that are continuous in position and velocity and keep to limits.

    Goals that come regularly are followed as a stream, one and a half intervals late; others are
    reached without going past. The laws, from :mod:`manip_sim.control.law`, are for one
    coordinate at a time: a joint, or any other number with such limits.

    :param position_range: lowest and highest setpoint [rad or m], shape (n, 2)
    :param velocity_limit: [rad/s or m/s], shape (n,)
    :param acceleration_limit: of steps, velocities and stops [rad/s^2 or m/s^2], shape (n,)
    :ivar counts: how often a streamed goal required more than the velocity limit, and how many
        messages of streams seem to have been lost, shape (2, n)
    :ivar now_s: simulation time, which the caller may set [s]
    :ivar interval_s: length of the next interval, if the caller has set it, else zero [s]
    :ivar moving: whether any setpoint moves or is about to
    """

    remembered = ('counts', '_state', 'interval_s', 'now_s', 'moving')
    #: Only counted, or set anew in each control period.
    undigested = ('counts', 'interval_s')

    def __init__(self, position_range: FloatArray, velocity_limit: FloatArray,
                 acceleration_limit: FloatArray) -> None:
        count, self._derived = len(velocity_limit), Derived()
        self.counts = np.zeros((2, count), dtype=np.int64)
        self._state = blank_state(acceleration_limit)
        joints = self.joints
        joints['low'], joints['high'] = position_range.T
        joints['top'] = velocity_limit
        self.interval_s = 0.0
        self.reset(np.zeros(count))

    @property
    def joints(self) -> Any:
        """The state as records, a view."""
        state, joints = self._derived.of.get('joints', (None, None))
        if state is not self._state:
            joints = records(self._state)
            self._derived.of['joints'] = self._state, joints
        return joints

    @property
    def limited(self) -> IntArray:
        """Counts of streamed goals that required more than the velocity limit, shape (n,)."""
        return np.asarray(self.counts[0])

    @property
    def lost(self) -> IntArray:
        """Counts of messages of streams that seem to have been lost, shape (n,)."""
        return np.asarray(self.counts[1])

    def _numbers_of(self, field: str) -> FloatArray:
        """Return a field of all joints, a view, sooner than :attr:`joints` does."""
        return self._state[:, PLACES[field]]

    @property
    def position(self) -> FloatArray:
        """Setpoints at the end of the last interval [rad or m], shape (n,), a copy."""
        return self._numbers_of('position').copy()

    @property
    def velocity(self) -> FloatArray:
        """Their velocity there [rad/s or m/s], shape (n,), a copy."""
        return self._numbers_of('velocity').copy()

    @property
    def acceleration(self) -> FloatArray:
        """Their acceleration there [rad/s^2 or m/s^2], shape (n,), a copy."""
        return self._numbers_of('acceleration').copy()

    def reset(self, position: FloatArray) -> None:
        """
        Hold all setpoints at a position, and forget what came; settings and counts stay.

        :param position: [rad or m], shape (n,)
        """
        before, self._state = self.joints, blank_state(self.joints['limit'])
        joints = self.joints
        for name in ('low', 'high', 'top', 'longest', 'hold'):
            joints[name] = before[name]
        self.now_s = 0.0
        joints['position'] = np.clip(position, joints['low'], joints['high'])
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
            self.joints['longest'][indices] = longest_s
        if hold_s is not None:
            self.joints['hold'][indices] = hold_s

    def stream_settings(self, index: int) -> tuple[float, float]:
        """Return what :meth:`set_stream` has set for a setpoint [s]."""
        joint = self.joints[index]
        return float(joint['longest']), float(joint['hold'])

    def at_rest(self, indices: IntArray) -> bool:
        """Return whether all of the given setpoints rest at their goals."""
        # The first one alone mostly says enough.
        return not self.moving or not (len(indices) and self._state.item(
            (indices.item(0), _MOVES)) or np.count_nonzero(self._state[indices, _MOVES]))

    @property
    def settled(self) -> bool:
        """True if :meth:`advance` has nothing to do."""
        return not (self.moving or np.count_nonzero(self._numbers_of('held')))

    def resume(self) -> None:
        """Resume setpoints that were held back after they had come to rest."""
        joints = self.joints
        joints['moves'] = np.maximum(joints['moves'], joints['held'])
        self.moving = bool(np.count_nonzero(self._numbers_of('moves')))

    # ------------------------------------------------------------------ goals

    def set_state(self, indices: IntArray, position: FloatArray, velocity: FloatArray) -> None:
        """
        Set position and velocity of setpoints, which come to rest from there.

        Beyond an end of the range, they stop at it.

        :param position: [rad or m], shape of ``indices``
        :param velocity: [rad/s or m/s], shape of ``indices``
        """
        from manip_sim.control.law.setpoint_changes import set_state  # It imports numba.
        set_state(self.joints, np.array(indices), _numbers(position), _numbers(velocity))
        self.moving = True

    def set_velocity(self, indices: IntArray, velocity: FloatArray) -> None:
        """
        Let setpoints come to a velocity with the acceleration limit; zero holds them.

        :param velocity: [rad/s or m/s], shape of ``indices``
        """
        from manip_sim.control.law.setpoint_changes import set_velocity  # It imports numba.
        set_velocity(self.joints, np.array(indices), _numbers(velocity))
        self.moving = True

    def ramp_to(self, indices: IntArray, velocity: FloatArray, duration_s: float,
                limit: FloatArray | None = None) -> None:
        """
        Let setpoints come to a velocity in a time, or later at the acceleration limit.

        :param velocity: [rad/s or m/s], shape of ``indices``
        :param duration_s: the time [s]
        :param limit: of the acceleration, if it is not that of the joints
            [rad/s^2 or m/s^2], shape of ``indices``
        """
        from manip_sim.control.law.setpoint_changes import ramp_to  # It imports numba.
        ramp_to(self.joints, np.array(indices), _numbers(velocity), float(duration_s),
                _numbers(() if limit is None else limit))
        self.moving = True

    def brake(self, indices: IntArray) -> None:
        """
        Let setpoints come to rest together, as soon as their acceleration limits allow.

        Where the range would end before, they slow down evenly up to there.
        """
        joints = self.joints
        velocity = joints['velocity'][indices]
        self.set_velocity(indices, np.zeros(len(indices)))
        # They are at rest at the end of an interval, at the earliest of the first one.
        slope = _evenly_braked(
            velocity, joints['position'][indices], joints['low'][indices], joints['high'][indices],
            _BRAKING * joints['limit'][indices],
            self.interval_s)
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
        """Let goals wait until the next interval."""
        # Copies, as compiled code is for arrays that can be written.
        _law_of_goals().wait(self.joints, np.array(indices), _numbers(goals), float(period_s),
                             float(messages), float(stamp_s), velocities)
        self.moving = True

    def come_back(self, indices: IntArray, goal: FloatArray) -> None:
        """
        Let moving setpoints brake, and then come to a position.

        :param goal: [rad or m], shape of ``indices``
        """
        self.set_velocity(indices, np.zeros(len(indices)))
        joints = self.joints
        joints['goal'][indices] = joints['target'][indices] = goal
        joints['seeks'][indices] = joints['brakes'][indices] = 1.0

    def shift(self, indices: IntArray, position: FloatArray, velocity: FloatArray) -> None:
        """
        Move setpoints at once, by less than a servo would notice.

        :param position: by which they move [rad or m], shape of ``indices``
        :param velocity: by which they become faster [rad/s or m/s], shape of ``indices``
        """
        self.joints['position'][indices] += position
        self.joints['velocity'][indices] += velocity

    # ------------------------------------------------------------------ motion

    def advance(self, duration_s: float) -> None:
        """
        Advance all setpoints that move.

        :param duration_s: length of the interval [s]
        """
        if not self.settled:
            from manip_sim.control.law.setpoint_motion import advance  # It imports numba.
            self.moving = advance(self.joints, self.counts, self.now_s, duration_s)
        self.now_s += duration_s


@cache
def _law_of_goals() -> Any:
    from manip_sim.control.law import stream_timing  # It imports numba.
    return stream_timing


def _numbers(values: ArrayLike) -> FloatArray:
    """Return numbers as the law takes them, of one type and writable."""
    return np.array(values, dtype=np.float64)


def _evenly_braked(velocity: FloatArray, position: FloatArray, low: FloatArray, high: FloatArray,
                   limit: FloatArray, shortest_s: float) -> FloatArray:
    """
    Return decelerations with which velocities end together, and before their ranges do.

    :param velocity: now [rad/s or m/s], shape (n,)
    :param position: now [rad or m], shape (n,); ``low`` and ``high`` end its range
    :param limit: of the deceleration, unless a range ends before [rad/s^2 or m/s^2], shape (n,)
    :param shortest_s: the least time that it takes [s]
    :returns: above 0 [rad/s^2 or m/s^2], shape (n,)
    """
    size, ahead = np.abs(velocity), np.where(velocity > 0.0, high - position, position - low)
    shortest_s = max(shortest_s, 1e-9)
    needed = np.minimum(size**2 / (2.0 * np.maximum(ahead, 1e-6)), size / shortest_s)
    longest_s = (size / np.maximum(limit, needed)).max(initial=0.0)
    return np.asarray(np.maximum(np.maximum(size / max(longest_s, shortest_s), needed), 1e-9))
