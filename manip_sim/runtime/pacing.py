# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Deadlines of control periods, and the progress of a simulation; the caller does the waiting."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
import math


@dataclass(frozen=True)
class Progress:
    """
    Progress of the simulation.

    :ivar wall_s: monotonic wall time when the present state was last shown to observers [s]
    :ivar time_ns: simulation time then [ns]
    :ivar missed: control periods that were dropped because the machine could not keep up
    :ivar lost_s: simulation time that was lost with them [s]
    :ivar waits_for: by robot, the parts that lock-step waits for; only filled in when a state is
        repeated, or shown after a start or a reset
    """

    wall_s: float
    time_ns: int
    missed: int = 0
    lost_s: float = 0.0
    waits_for: Mapping[str, list[str]] = field(default_factory=dict)


class Pacer:
    """
    Absolute deadlines for control periods that are to run at a factor of real time.

    Errors do not add up: the n-th deadline is the anchor plus n periods. A change of the factor or
    a backlog of more than ``backlog_s`` sets a new anchor, so lost time is not made up for.

    :param period_s: length of a control period in simulation time [s]
    :param real_time_factor: simulation time per wall time
    :param now_s: the present wall time [s]
    :param backlog_s: how late a period may be before the backlog is dropped, wall time [s]
    :ivar real_time_factor: as given, or as :meth:`set_real_time_factor` has changed it
    :ivar lost_s: simulation time that was lost with the backlog so far [s]
    """

    def __init__(self, period_s: float, real_time_factor: float, now_s: float,
                 backlog_s: float = 0.1) -> None:
        self._period_s = period_s
        self._backlog_s = backlog_s
        self.real_time_factor = real_time_factor
        self.lost_s = 0.0
        self.restart(now_s)

    def restart(self, now_s: float) -> None:
        """Set a new anchor: the next period is due one period from now."""
        self._anchor_s = now_s
        self._count = 1

    def set_real_time_factor(self, factor: float, now_s: float) -> None:
        """Change the real-time factor from now on."""
        self.real_time_factor = factor
        self.restart(now_s)

    @property
    def missed(self) -> int:
        """Number of control periods that were dropped so far, rounded down."""
        return math.floor(self.lost_s / self._period_s + 1e-9)

    @property
    def deadline_s(self) -> float:
        """Wall time at which the next period is due [s]."""
        return self._anchor_s + self._count * self._period_s / self.real_time_factor

    def is_due(self, now_s: float) -> bool:
        """Return whether a period is due, and count it as begun if so."""
        late_s = now_s - self.deadline_s
        if late_s < 0.0:
            return False
        if late_s > self._backlog_s:
            self.lost_s += late_s * self.real_time_factor
            self.restart(now_s)
        else:
            self._count += 1
        return True
