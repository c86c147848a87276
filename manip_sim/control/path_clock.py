# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The time along the paths of trajectories, which may pass slower than simulation time."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.control.commands import JointTrajectory

#: Share below which joints that move begin a path as if it was this: they nearly rest.
_LEAST_SHARE = 0.05


class PathClock:
    """
    The time along paths; it passes at a share of simulation time, which changes gradually.

    :param slew: how fast the share may change [1/s]
    :ivar scaling: share of simulation time that it comes to, from 0 to 1
    """

    remembered = ('scaling', '_share', '_since_s', '_path_s')

    def __init__(self, slew: float) -> None:
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
        self._path_s, self._share, self._since_s = path_s, float(share), now_s
        self.scaling = scaling

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
