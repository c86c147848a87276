# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Velocities and accelerations that commands for positions demand."""

from __future__ import annotations

import numpy as np

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.controlled_joints import ControlledJoints
from manip_sim.control.streamed_trajectories import STREAM_INTERVAL_S


class Discontinuities:
    """
    The positions that were commanded last, and what the next ones demand beyond them.

    The velocity of a joint is the difference of two commanded positions over the time between
    them, and its acceleration the difference of two such velocities over that time. A command that
    no other one preceded within the longest interval of a stream continues from the setpoint.

    :param joints: of the robot
    """

    remembered = ('_last',)

    def __init__(self, joints: ControlledJoints) -> None:
        self._joints = joints
        #: Time [s], position and velocity of the last command, by joint.
        self._last: dict[int, tuple[float, float, float]] = {}

    def clear(self) -> None:
        """Forget all commands."""
        self._last.clear()

    def forget(self, indices: IntArray) -> None:
        """Forget the commands of joints, which something else moves."""
        for index in indices.tolist():
            self._last.pop(index, None)

    def demands(self, indices: IntArray, positions: FloatArray, now_s: float, period_s: float
                ) -> FloatArray:
        """
        Return the shares of velocity and acceleration limits that positions demand, and keep them.

        :param indices: of the joints, shape (n,)
        :param positions: that are commanded [rad or m], shape (n,)
        :param now_s: simulation time since the last reset [s]
        :param period_s: length of a control period [s]
        :returns: shape (n, 2)
        """
        setpoints, shares = self._joints.setpoints, np.zeros((len(indices), 2))
        limits = np.stack([self._joints.velocity_limits(indices),
                           self._joints.acceleration_limits(indices)], axis=1)
        for row, (index, position) in enumerate(zip(indices.tolist(), positions.tolist())):
            last_s, before, velocity = self._last.get(index, (now_s, 0.0, 0.0))
            interval_s = now_s - last_s
            if not 0.0 < interval_s <= STREAM_INTERVAL_S:
                interval_s, before, velocity = period_s, setpoints.position.item(
                    index), setpoints.velocity.item(index)
            demanded = (position - before) / interval_s
            shares[row] = abs(demanded), abs(demanded - velocity) / interval_s
            self._last[index] = now_s, position, demanded
        return shares / limits
