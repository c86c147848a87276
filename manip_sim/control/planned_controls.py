# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The controls of joints in the intervals left of a control period, where all is planned."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from manip_sim.arrays import FloatArray, IntArray
from manip_sim.control.motion_profiles import Plan
from manip_sim.control.servos import Servos
from manip_sim.control.setpoints import SetpointGenerator

#: Setpoints that go less than this share of how far they may be ahead of their joints, in a plan,
#: are looked at once in it.
CALM = 0.25


class PlannedRates(NamedTuple):
    """
    What is written for the joints of a robot in each of several intervals.

    :ivar controls: of all actuators of the world, into which it is written
    :ivar where: the places of the joints
    :ivar rates: of their setpoints, shape (k, n)
    """

    controls: FloatArray
    where: slice | IntArray
    rates: FloatArray


class PlannedControls:
    """
    What servos need to follow the plan of their setpoints, computed when it begins.

    :param servos: of all driven joints
    :param setpoints: of all driven joints
    """

    #: Computed anew in each control period.
    not_in_digest = ('_rates', '_calm')

    def __init__(self, servos: Servos, setpoints: SetpointGenerator) -> None:
        self._servos, self._setpoints = servos, setpoints
        #: How fast the servos follow the plan, and whether that is slow.
        self._rates: FloatArray | None = None
        self._calm = False

    def __bool__(self) -> bool:
        """Return whether all intervals that follow in the control period are planned."""
        return self._setpoints.plan is not None and self._calm and self._rates is not None

    def write(self) -> bool:
        """Write the controls of the present interval of a plan; return whether there is one."""
        plan, row = self._setpoints.plan, self._setpoints.row
        if plan is None or self._servos.any_gives_effort:
            self._rates = None
            return False
        if row == 0 or self._rates is None:
            self._rates, self._calm = self._servos.rates(plan), self._is_calm(plan)
        self._servos.write_rate(self._rates[row])
        return True

    def begin(self, rates: FloatArray) -> None:
        """
        Begin to follow the plan of the setpoints, for which something else has computed rates.

        :param rates: as :meth:`Servos.rates` would return, shape (k, n)
        """
        assert self._setpoints.plan is not None
        self._rates, self._calm = rates, self._is_calm(self._setpoints.plan)
        self._servos.write_rate(rates[0])

    def take(self) -> PlannedRates:
        """Return the controls from the present interval of a plan on, which then is past."""
        assert self._rates is not None
        rates = self._rates[self._setpoints.row:]
        self._setpoints.end_plan()
        return PlannedRates(*self._servos.controls, rates)

    def _is_calm(self, plan: Plan) -> bool:
        """Tell whether setpoints go so slowly that one look in a plan holds them back in time."""
        way = np.abs(plan.velocities) * float(np.add.reduce(plan.durations_s)[0])
        return not np.count_nonzero(way > CALM * self._servos.reach)
