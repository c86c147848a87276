# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Setpoints of joints at each instant, and the trajectories that lead them.

Trajectories are motions, or the next points of a stream; the time along their paths may pass
slower than simulation time. How actuators follow setpoints is not decided here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.commands import (
    CommandHandle, JointTrajectory, Ledger, Status, TrajectoryReference)
from manip_sim.control.law.records import blank_state, PLACES, records
from manip_sim.control.streamed_trajectories import PointStreams
from manip_sim.derived import Derived
from manip_sim.errors import CommandError

_MOVES = PLACES['moves']
#: Share of the acceleration limit with which joints come to rest that no command moves any more:
#: servos add up to 15 % while they take over.
_BRAKING = 0.87
#: Share below which joints that move begin a path as if it was this: they nearly rest.
_LEAST_SHARE = 0.05


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
        from manip_sim.control.law.setpoint_motion import set_state  # It imports numba.
        set_state(self.joints, np.array(indices), np.array(position, np.float64),
                  np.array(velocity, np.float64))
        self.moving = True

    def set_velocity(self, indices: IntArray, velocity: FloatArray) -> None:
        """
        Let setpoints come to a velocity with the acceleration limit; zero holds them.

        :param velocity: [rad/s or m/s], shape of ``indices``
        """
        from manip_sim.control.law.setpoint_motion import set_velocity  # It imports numba.
        set_velocity(self.joints, np.array(indices), np.array(velocity, np.float64))
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

    def go_to(self, indices: IntArray, goals: FloatArray, period_s: float, messages: int = 1,
              stamp_s: float = 0.0, are_velocities: bool = False) -> None:
        """
        Let setpoints come to goals; goals that come regularly are followed as a stream.

        Of several goals at one instant the newest counts.

        :param goals: positions [rad or m], or velocities [rad/s or m/s], shape of ``indices``
        :param period_s: length of a control period [s]
        :param messages: how many messages came since the last call, of which this is the last
        :param stamp_s: when it was sent, by any clock [s]; 0: unknown
        """
        from manip_sim.control.law.streams import wait

        # Copies, as compiled code is for arrays that can be written.
        wait(self.joints, np.array(indices), np.array(goals, np.float64), float(period_s),
             float(messages), float(stamp_s), are_velocities)
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
        if self.moving or np.count_nonzero(self._numbers_of('held')):
            from manip_sim.control.law.setpoint_motion import advance  # It imports numba.
            self.moving = advance(self.joints, self.counts, self.now_s, duration_s)
        self.now_s += duration_s


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


class PathClock:
    """
    The time along paths; it passes at a share of simulation time.

    The share changes gradually while anything follows a path, and else at once.

    Times ``now_s`` and ``times_s`` are simulation time since the last reset [s].

    :param slew: how fast the share may change [1/s]
    :param leads: returns whether anything follows a path
    :ivar scaling: share of simulation time that it comes to, from 0 to 1
    """

    remembered = ('scaling', '_share', '_since_s', '_path_s')

    def __init__(self, slew: float, leads: Callable[[], bool]) -> None:
        self._leads = leads
        self._slew, self.scaling, self._share = slew, 1.0, 1.0
        self._since_s = self._path_s = 0.0

    def reset(self) -> None:
        """Begin again, at the start of an episode."""
        self._share, self._since_s, self._path_s = self.scaling, 0.0, 0.0

    def set(self, scaling: float, now_s: float) -> None:
        """
        Let the time pass at another share.

        :param scaling: from 0 to 1
        """
        if scaling == self.scaling:
            return  # Whoever goes on with it comes to the same bits.
        path_s, (share, _) = float(self.at(now_s)), self._shares(now_s)
        self._path_s, self._since_s, self.scaling = path_s, now_s, scaling
        self._share = float(share) if self._leads() else scaling

    def at(self, times_s: ArrayLike) -> FloatArray:
        """
        Return the time along paths at times that are not before the present [s].

        :param times_s: simulation time since the last reset [s]
        """
        since_s = np.asarray(times_s) - self._since_s
        if self._share == self.scaling:
            return np.asarray(self._path_s + self.scaling * since_s)
        change = self.scaling - self._share
        ramp_s = np.minimum(since_s, abs(change) / self._slew)
        return np.asarray(
            self._path_s + self._share * ramp_s + 0.5 * np.sign(change) * self._slew * ramp_s**2
            + self.scaling * (since_s - ramp_s))

    def ahead_s(self, now_s: float) -> float:
        """Return by how much the time along paths is ahead of simulation time, at most 0 [s]."""
        return float(self.at(now_s)) - now_s

    def along_path(self, velocity: FloatArray, now_s: float) -> FloatArray:
        """
        Return velocities as changes of position in time along paths.

        :param velocity: of joints [rad/s or m/s], shape (n,)
        """
        share = float(self._shares(now_s)[0])
        return velocity if share == 1.0 else velocity / max(share, _LEAST_SHARE)

    def motion(self, command: JointTrajectory, times_s: ArrayLike) -> FloatArray:
        """
        Return position, velocity and acceleration of a trajectory that runs.

        :param command: whose start is a time along paths
        :param times_s: simulation time since the last reset [s]
        :returns: the three on the first axis, then the shape of ``times_s``, then the joints
        """
        motion = command.motion(self.at(times_s))
        if self._share == self.scaling == 1.0:
            return motion
        share, change = (values[..., None] for values in self._shares(times_s))
        position, velocity, acceleration = motion
        return np.stack([position, velocity * share,
                         acceleration * share**2 + velocity * change])

    def _shares(self, times_s: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the share at which it passes, and how fast that changes [1/s]."""
        since_s = np.asarray(times_s) - self._since_s
        change = self.scaling - self._share
        slewing = since_s < abs(change) / self._slew
        rate = np.where(slewing, np.sign(change) * self._slew, 0.0)
        return np.where(slewing, self._share + rate * since_s, self.scaling), rate


class TrajectoryFollowing:
    """
    Trajectories that wait for their start, and those that lead setpoints.

    Times ``now_s`` are simulation time since the last reset [s], ``period_s`` is the length of a
    control period [s].

    :param setpoints: of all driven joints
    :param commands: that have not ended
    :param count: number of driven joints
    :param slew: how fast the share of simulation time that passes along paths may change [1/s]
    :ivar clock: of the time along paths, since which those that lead have begun
    """

    remembered = ('_points',)

    def __init__(self, setpoints: SetpointGenerator, commands: Ledger, count: int,
                 slew: float) -> None:
        self._setpoints, self._commands, self._count = setpoints, commands, count
        self.clock = PathClock(slew, self._leads)
        self.forget()

    def _leads(self) -> bool:
        return bool(self._commands.of(JointTrajectory))

    def forget(self) -> None:
        """Let the next points be no part of a stream, at the start of an episode."""
        self._points = PointStreams(self._count)
        self.clock.reset()

    def start_due(self, modes: tuple[str, ...], now_s: float, duration_s: float, period_s: float
                  ) -> None:
        """
        Start the trajectories that are due in the next interval.

        :param modes: of all joints
        :param duration_s: length of the interval [s]
        """
        for command in list(self._commands.waiting):
            start_s = now_s if command.start_s is None else command.start_s
            if start_s >= now_s + duration_s - 1e-9:
                continue
            self._commands.start(command)
            started = command.own_trajectory()
            setpoint = started.as_setpoint(tuple(modes[i] for i in started.indices))
            if self._continues_stream(started, start_s, now_s):
                self._setpoints.go_to(setpoint.indices, setpoint.values, period_s,
                                      started.messages, started.sent_s)
                self._commands.begin(setpoint)
            elif started.trajectory.end_s <= now_s - start_s:
                self._setpoints.come_back(setpoint.indices, setpoint.values)
                self._commands.begin(setpoint)
            else:
                self._begin(started, start_s, now_s)

    def _continues_stream(self, own: JointTrajectory, start_s: float, now_s: float) -> bool:
        """Tell whether a trajectory is the next point of a stream of them."""
        if own.trajectory.points_after(now_s - start_s) > 2:
            return False
        longest_s = min(self._setpoints.stream_settings(i)[0] for i in own.indices.tolist())
        # As a stream, it need not be slowed down to keep to the velocity limits.
        due_s = start_s + own.trajectory.end_s / own.slowed - now_s
        return self._points.take(own.indices, now_s, due_s, longest_s)

    def _begin(self, own: JointTrajectory, start_s: float, now_s: float) -> None:
        try:
            own.trajectory.begin_at(
                self._setpoints.position[own.indices],
                self.clock.along_path(self._setpoints.velocity[own.indices], now_s),
                now_s - start_s)
        except CommandError as error:
            own.handle.end(Status.ABORTED, str(error))
        else:
            self._commands.begin(replace(own, start_s=start_s + self.clock.ahead_s(now_s)))

    def path(self, commands: Sequence[JointTrajectory], ends_s: FloatArray
             ) -> tuple[IntArray, FloatArray]:
        """
        Return where trajectories lead joints in intervals, up to that in which the first one ends.

        :param commands: those that run, after :meth:`start_due` for the first interval
        :param ends_s: of the intervals, simulation time since the last reset [s], shape (k,)
        :returns: the joints, shape (m,), and position, velocity and acceleration at the ends of
            intervals, shape (j, m, 3) with 1 <= j <= k, the last of which alone may end one
        """
        count = len(ends_s)
        for command in self._commands.waiting:
            start_s = -math.inf if command.start_s is None else command.start_s
            count = min(count, int(np.count_nonzero(start_s >= ends_s - 1e-9)))
        for command in commands:
            count = min(count, 1 + sum(not self._ends(command, s) for s in ends_s.tolist()))
        if not commands:
            return np.empty(0, np.int64), np.empty((count, 0, 3))
        motions = [self.clock.motion(command, ends_s[:count]) for command in commands]
        return (np.concatenate([command.indices for command in commands]),
                np.ascontiguousarray(np.concatenate(motions, axis=2).transpose(1, 2, 0)))

    def _ends(self, command: JointTrajectory, now_s: float) -> bool:
        """Return whether a trajectory has come to its end."""
        since_s = float(self.clock.at(now_s)) - (command.start_s or 0.0)
        return since_s >= command.trajectory.end_s - 1e-9

    def end(self, command: JointTrajectory, now_s: float) -> FloatArray | None:
        """
        Return the last position of the joints of a trajectory that has come to its end, or None.

        :returns: shape (n,)
        """
        if not self._ends(command, now_s):
            return None
        position: FloatArray = self.clock.motion(command, now_s)[0]
        return position

    def reference(self, handle: CommandHandle, now_s: float) -> TrajectoryReference | None:
        """
        Return what the joints of a trajectory that runs follow, or None.

        Unlike the setpoints, they are not held back for joints that cannot keep up.
        """
        for command in self._commands.of(JointTrajectory):
            if command.handle is handle:
                position, velocity, acceleration = self.clock.motion(command, now_s)
                since_s = float(self.clock.at(now_s)) - (command.start_s or 0.0)
                return TrajectoryReference(position, velocity, acceleration,
                                           command.trajectory.points_after(since_s))
        return None
