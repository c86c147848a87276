# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A spline through the points of a joint trajectory; who follows it is not decided here."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import BPoly, pchip_interpolate

from manip_sim.errors import CommandError
from manip_sim.typing import FloatArray


class Trajectory:
    """
    A motion through points in time: quintic where accelerations are given, else cubic.

    Where the points have no velocities, those of a shape-preserving (Fritsch-Carlson) cubic are
    taken, zero at the end.

    :param start_position: where the motion starts [rad or m], shape (n,)
    :param start_velocity: how fast it starts [rad/s or m/s], shape (n,)
    :param times_s: of the points after the start [s], increasing, the first one above zero or,
        alone or followed by others, at zero: then that point replaces the start
    :param positions: shape (n_points, n)
    :param velocities: shape (n_points, n), or None
    :param accelerations: shape (n_points, n), or None; only with velocities
    :raises CommandError: if the times do not increase
    """

    def __init__(self, start_position: FloatArray, start_velocity: FloatArray,
                 times_s: Sequence[float], positions: FloatArray,
                 velocities: FloatArray | None = None,
                 accelerations: FloatArray | None = None) -> None:
        times = np.asarray(times_s, dtype=float)
        check_times(times)
        self.end_s = float(times[-1])
        self._end = np.array(positions[-1], dtype=float)
        if times[0] > 0.0:
            times = np.concatenate([[0.0], times])
            positions = np.vstack([start_position, positions])
            if velocities is not None:
                velocities = np.vstack([start_velocity, velocities])
            if accelerations is not None:
                accelerations = np.vstack([np.zeros_like(start_position), accelerations])
        if len(times) == 1:
            self._spline = None
            return
        if velocities is None:
            velocities = pchip_interpolate(times, positions, times, der=1, axis=0)
            velocities[0], velocities[-1] = start_velocity, 0.0
        derivatives = [positions, velocities] + ([] if accelerations is None else [accelerations])
        self._spline = BPoly.from_derivatives(times, np.stack(derivatives, axis=1))

    def position(self, time_s: float) -> FloatArray:
        """
        Return where the joints shall be [rad or m], shape (n,), a copy.

        :param time_s: since the start [s]; after the end the last point is held
        """
        if self._spline is None or time_s >= self.end_s:
            return self._end.copy()
        return np.asarray(self._spline(max(time_s, 0.0)), dtype=float)


def check_times(times: FloatArray) -> None:
    """
    Check the times of a trajectory's points.

    :raises CommandError: if there are none, one is negative, or they do not increase
    """
    if len(times) == 0:
        raise CommandError('a trajectory needs at least one point')
    if times[0] < 0.0 or (np.diff(times) <= 0.0).any():
        raise CommandError('time_from_start must not be negative and must increase from point to '
                           f'point, got {times.tolist()}')
