# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A spline through the points of a joint trajectory; what follows it is not decided here."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.errors import CommandError

#: Fractions of a segment at which its velocity is sampled.
_SAMPLES = np.linspace(0.0, 1.0, 17)


class Trajectory:
    """
    A motion through points in time: quintic where accelerations are given, else cubic.

    Points without velocities get the slopes of a shape-preserving (Fritsch-Butland) cubic, zero
    at the end. The first segment begins where :meth:`begin_at` sets it.

    :param times_s: of the points [s], increasing, not negative
    :param positions: [rad or m], shape (n_points, n)
    :param velocities: [rad/s or m/s], shape (n_points, n), or None
    :param accelerations: [rad/s^2 or m/s^2], shape (n_points, n), or None; only with velocities
    :ivar end_s: time of the last point [s]
    :raises CommandError: if the times do not increase, or the spline through the points is not
        finite
    """

    def __init__(self, times_s: FloatArray, positions: FloatArray,
                 velocities: FloatArray | None = None,
                 accelerations: FloatArray | None = None) -> None:
        check_times(times_s)
        self.times_s = np.asarray(times_s, dtype=float)
        self.positions = np.asarray(positions, dtype=float)
        self.end_s = float(self.times_s[-1])
        self._velocities, self._accelerations = velocities, accelerations
        count = self.positions.shape[1]
        self.begin_at(self.positions[0], np.zeros(count))

    def points_after(self, time_s: float) -> int:
        """Return how many points are later than a time [s]."""
        return len(self.times_s) - int(np.searchsorted(self.times_s, time_s, side='right'))

    def begin_at(self, position: FloatArray, velocity: FloatArray, time_s: float = 0.0) -> None:
        """
        Set the start of the motion; points up to its time are dropped, except the last one.

        :param position: [rad or m], shape (n,)
        :param velocity: [rad/s or m/s], shape (n,)
        :param time_s: of the start [s]
        :raises CommandError: if the spline is not finite
        """
        last = len(self.times_s) - 1
        first = min(int(np.searchsorted(self.times_s, time_s, side='right')), last)
        times, positions = self.times_s[first:], self.positions[first:]
        velocities = None if self._velocities is None else self._velocities[first:]
        accelerations = None if self._accelerations is None else self._accelerations[first:]
        if times[0] > time_s:
            times = np.concatenate([[time_s], times])
            positions = np.vstack([position, positions])
            if velocities is not None:
                velocities = np.vstack([velocity, velocities])
            if accelerations is not None:
                accelerations = np.vstack([np.zeros_like(position), accelerations])
        with np.errstate(all='ignore'):
            if velocities is None:
                velocities = _shape_preserving(times, positions)
                velocities[0], velocities[-1] = velocity, 0.0
            if accelerations is None:
                self._coefficients = _cubic(times, positions, velocities)
            else:
                self._coefficients = _quintic(times, positions, velocities, accelerations)
            derived = self._coefficients * np.maximum(np.diff(times), 1.0)[:, None, None] ** 5
        if not (np.isfinite(derived).all() and np.isfinite(velocities).all()):
            raise CommandError('the spline through the points is not finite: positions, '
                               'velocities or accelerations are too large')
        self._knots = times
        self._end = (positions[-1].copy(), velocities[-1].copy(), np.zeros(positions.shape[1]))

    def slowed(self, factor: float, from_s: float = 0.0) -> Trajectory:
        """
        Return the rest of the path in ``factor`` times the time; its time zero is ``from_s``.

        :param from_s: points up to this time are dropped, except the last one [s]
        """
        rest = self.times_s > from_s if from_s > 0.0 else self.times_s >= 0.0
        rest[-1] = True
        return Trajectory(
            np.maximum(self.times_s[rest] - from_s, 0.0) * factor, self.positions[rest],
            None if self._velocities is None else self._velocities[rest] / factor,
            None if self._accelerations is None else self._accelerations[rest] / factor**2)

    def of(self, columns: IntArray) -> Trajectory:
        """Return the motion of some of the joints."""
        return Trajectory(
            self.times_s, self.positions[:, columns],
            None if self._velocities is None else self._velocities[:, columns],
            None if self._accelerations is None else self._accelerations[:, columns])

    def highest_velocity(self) -> FloatArray:
        """Return the highest sampled speed of each joint [rad/s or m/s], shape (n,)."""
        if len(self._knots) == 1:
            return np.zeros(self.positions.shape[1])
        reach = np.diff(self._knots)[:, None] * _SAMPLES
        powers = np.stack([k * reach**(k - 1) for k in range(1, self._coefficients.shape[1])])
        speeds = np.einsum('kst,skn->stn', powers, self._coefficients[:, 1:])
        return np.asarray(np.abs(speeds).max(axis=(0, 1)))

    def at(self, times_s: ArrayLike) -> FloatArray:
        """
        Return position, velocity and acceleration at some times.

        :param times_s: since time zero [s]; after the end the last point counts
        :returns: the three on the first axis, then the shape of ``times_s``, then the joints
        """
        times = np.asarray(times_s, dtype=float)
        motion = np.zeros((3, *times.shape, self.positions.shape[1]))
        ended = times >= self.end_s
        motion[:, ended] = np.stack(self._end)[:, None]
        if not ended.all():
            segments = np.maximum(np.searchsorted(self._knots, times[~ended], 'right') - 1, 0)
            since = np.maximum(times[~ended] - self._knots[segments], 0.0)[:, None]
            position, velocity, acceleration = np.zeros((3, len(segments), motion.shape[-1]))
            for power in range(self._coefficients.shape[1] - 1, -1, -1):
                acceleration = acceleration * since + 2.0 * velocity
                velocity = velocity * since + position
                position = position * since + self._coefficients[segments, power]
            motion[:, ~ended] = position, velocity, acceleration
        return motion


def check_times(times: FloatArray) -> None:
    """
    Check the times of a trajectory's points.

    :raises CommandError: if there are none, one is negative, or they do not increase
    """
    if len(times) == 0:
        raise CommandError('a trajectory needs at least one point')
    steps = np.diff(times)
    if times[0] < 0.0 or (steps <= 0.0).any():
        where = int(np.argmax(steps <= 0.0)) + 1 if times[0] >= 0.0 else 0
        raise CommandError('time_from_start must not be negative and must increase from point to '
                           f'point, got {times[where]:g} s at point {where}'
                           + (f' after {times[where - 1]:g} s' if where else ''))


def _shape_preserving(times: FloatArray, positions: FloatArray) -> FloatArray:
    """
    Return the velocities of a cubic that does not overshoot, zero at both ends.

    At inner points they are the weighted harmonic mean of the slopes before and after, or zero
    where these differ in sign (F. N. Fritsch and J. Butland, SIAM Journal on Scientific and
    Statistical Computing 5, 1984). Importing that of scipy would double the start-up time.
    """
    velocities = np.zeros_like(positions)
    h = np.diff(times)[:, None]
    slopes = np.diff(positions, axis=0) / h
    before, after = slopes[:-1], slopes[1:]
    of_before, of_after = 2.0 * h[1:] + h[:-1], h[1:] + 2.0 * h[:-1]
    mean = 1.0 / ((of_before / before + of_after / after) / (of_before + of_after))
    velocities[1:-1] = np.where(np.sign(before) * np.sign(after) > 0.0, mean, 0.0)
    return velocities


def _cubic(times: FloatArray, p: FloatArray, v: FloatArray) -> FloatArray:
    """Return coefficients of 1, t, t^2, t^3 by segment and joint, shape (segments, 4, n)."""
    h = np.diff(times)[:, None]
    slope = np.diff(p, axis=0) / h
    return np.stack([p[:-1], v[:-1], (3.0 * slope - 2.0 * v[:-1] - v[1:]) / h,
                     (v[:-1] + v[1:] - 2.0 * slope) / h**2], axis=1)


def _quintic(times: FloatArray, p: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
    """Return coefficients of 1 to t^5 by segment and joint, shape (segments, 6, n)."""
    h = np.diff(times)[:, None]
    rest = np.diff(p, axis=0) - v[:-1] * h - a[:-1] * h**2 / 2.0
    speed = (v[1:] - v[:-1] - a[:-1] * h) * h
    change = (a[1:] - a[:-1]) * h**2
    return np.stack([p[:-1], v[:-1], a[:-1] / 2.0,
                     (10.0 * rest - 4.0 * speed + change / 2.0) / h**3,
                     (-15.0 * rest + 7.0 * speed - change) / h**4,
                     (6.0 * rest - 3.0 * speed + change / 2.0) / h**5], axis=1)
