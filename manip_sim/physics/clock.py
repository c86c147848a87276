# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The time of a simulation: a count of physics steps."""

from __future__ import annotations

import numpy as np

from manip_sim.arrays import FloatArray, IntArray


class Clock:
    """
    Counts of physics steps, and the times that they make.

    :param timestep_ns: length of a step [ns]
    :ivar step_ns: the same
    :ivar counts: :attr:`step_count` and :attr:`control_steps`, shape (2,); compiled code goes on
        with them too
    """

    def __init__(self, timestep_ns: int) -> None:
        self.step_ns = timestep_ns
        self.counts: IntArray = np.zeros(2, np.int64)

    @property
    def step_count(self) -> int:
        """Steps since construction; a reset does not change it."""
        return self.counts.item(0)

    @step_count.setter
    def step_count(self, count: int) -> None:
        self.counts[0] = count

    @property
    def control_steps(self) -> int:
        """
        Steps since the last reset.

        Control counts from there, so that an episode is the same to the last bit whatever came
        before.
        """
        return self.counts.item(1)

    @control_steps.setter
    def control_steps(self, count: int) -> None:
        self.counts[1] = count

    def count(self, steps: int) -> None:
        """Go on by steps of the physics, or back."""
        self.counts += steps

    @property
    def time_ns(self) -> int:
        """Simulation time [ns]."""
        return self.counts.item(0) * self.step_ns

    @property
    def control_s(self) -> float:
        """Simulation time since the last reset [s]."""
        return self.counts.item(1) * self.step_ns * 1e-9

    def begins_s(self, intervals: IntArray) -> FloatArray:
        """
        Return what :attr:`control_s` will be when intervals begin, shape (k,).

        :param intervals: steps of each, shape (k,)
        """
        steps = self.control_steps + np.cumsum(intervals) - intervals
        return np.asarray(steps * self.step_ns * 1e-9)

    def ends_s(self, intervals: IntArray, step_s: float) -> FloatArray:
        """
        Return what :attr:`control_s` will be at the ends of intervals, shape (k,).

        :param intervals: steps of each, shape (k,)
        :param step_s: length of a step, as the physics has it [s]
        """
        return np.asarray(self.begins_s(intervals) + intervals * step_s)

    def since_reset_s(self, time_ns: int) -> float:
        """Return the time from the last reset to a simulation time [s]."""
        return (time_ns - (self.step_count - self.control_steps) * self.step_ns) * 1e-9
