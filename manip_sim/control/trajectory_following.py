# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Trajectories that start and lead joints: as motions, or as the next points of a stream.

The time along their paths may pass slower than simulation time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
import math

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.commands import (
    CommandHandle, JointTrajectory, Ledger, Status, TrajectoryReference)
from manip_sim.control.setpoints import SetpointGenerator
from manip_sim.control.streamed_trajectories import PointStreams
from manip_sim.errors import CommandError

#: Share below which joints that move begin a path as if it was this: they nearly rest.
_LEAST_SHARE = 0.05


class PathClock:
    """
    The time along paths; it passes at a share of simulation time.

    The share changes gradually while anything follows a path, and else at once.

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
        :param now_s: simulation time since the last reset [s]
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
        return any([isinstance(command, JointTrajectory) for command in self._commands.running])

    def forget(self) -> None:
        """Let the next points be no part of a stream, at the start of an episode."""
        self._points = PointStreams(self._count)
        self.clock.reset()

    def start_due(self, modes: tuple[str, ...], now_s: float, duration_s: float, period_s: float
                  ) -> None:
        """
        Start the trajectories that are due in the next interval.

        :param modes: of all joints
        :param now_s: simulation time since the last reset [s]
        :param duration_s: length of the interval [s]
        :param period_s: length of a control period [s]
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

        :param now_s: simulation time since the last reset [s]
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

        :param now_s: simulation time since the last reset [s]
        """
        for command in self._commands.running:
            if command.handle is handle and isinstance(command, JointTrajectory):
                position, velocity, acceleration = self.clock.motion(command, now_s)
                since_s = float(self.clock.at(now_s)) - (command.start_s or 0.0)
                return TrajectoryReference(position, velocity, acceleration,
                                           command.trajectory.points_after(since_s))
        return None
