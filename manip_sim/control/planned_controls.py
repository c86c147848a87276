# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The controls of joints in the intervals of a control period, of which several may be planned."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.servos import Servos
from manip_sim.control.setpoints import SetpointGenerator


class PlannedRates(NamedTuple):
    """
    What is written for the joints of a robot in each of several intervals.

    :ivar where: the places of the joints in the controls of the world, shape (n,)
    :ivar rates: of their setpoints, shape (k, n)
    """

    where: IntArray
    rates: FloatArray


class PlannedControls:
    """
    Rates of servos that follow their setpoints, in an interval or in several planned ones.

    :param servos: of all driven joints
    :param setpoints: of all driven joints
    """

    #: Computed anew in each control period.
    not_in_digest = ('_rates',)

    def __init__(self, servos: Servos, setpoints: SetpointGenerator) -> None:
        self._servos, self._setpoints = servos, setpoints
        #: Rates of the setpoints of servos.
        self._rates = np.zeros((1, len(servos.lead)))

    @property
    def intervals(self) -> int:
        """Number of planned intervals, with the present one."""
        return self._setpoints.planned - self._setpoints.row

    def write(self, duration_s: float, efforts: FloatArray) -> None:
        """
        Write the controls of an interval, once setpoints are advanced.

        :param duration_s: of the interval [s]
        :param efforts: of the sources of effort [N m or N], shape (n,)
        """
        setpoints = self._setpoints
        if not setpoints.row:
            self._rates = self._servos.find_rates(*setpoints.ahead(duration_s))
            setpoints.keep(len(self._rates))
        self._servos.write(self._rates[setpoints.row], efforts)

    def take(self, count: int) -> PlannedRates:
        """Return the controls of planned intervals from the present one on, and leave these."""
        row = self._setpoints.row
        rates = self._rates[row:row + count]
        self._setpoints.follow_plan(count)
        return PlannedRates(self._servos.controls, rates)
