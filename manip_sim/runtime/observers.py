# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Functions that see a simulation at the end of control periods."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from manip_sim.simulation import Simulation

#: Is called with the simulation at the end of control periods, in the simulation's thread.
Observer = Callable[[Simulation], None]
#: Returns whether an observer has to be called.
Look = Callable[[], bool]
#: Period of checks which observers have to be called while the simulation runs, wall time [s].
_LOOK_S = 0.02


@dataclass(frozen=True)
class _Entry:
    observer: Observer
    every: int
    look: Look | None


class Observers:
    """The observers of a simulation; those that nobody needs at present are not called."""

    def __init__(self) -> None:
        self._all: tuple[_Entry, ...] = ()
        self._present: tuple[_Entry, ...] = ()
        self._look_at = 0.0

    def add(self, observer: Observer, every: int, look: Look | None) -> None:
        """
        Add an observer; any thread may call this.

        :raises ValueError: if the divider is less than 1
        """
        if every < 1:
            raise ValueError(f'the divider of an observer must be 1 or more, got {every}')
        self._all = (*self._all, _Entry(observer, every, look))
        self.refresh()

    def remove(self, observer: Observer) -> None:
        """Call an observer no more; to be called where :meth:`show` is."""
        self._all = tuple(entry for entry in self._all if entry.observer != observer)
        self._present = tuple(entry for entry in self._present if entry.observer != observer)

    def refresh(self) -> None:
        """Check at the next state which observers have to be called; any thread may call this."""
        self._look_at = 0.0

    @property
    def absent(self) -> bool:
        """True if no observer had to be called at the last check, and no new one is requested."""
        return not self._present and self._look_at > 0.0

    def show(self, simulation: Simulation, number: int, now_s: float, look: bool) -> None:
        """
        Call the observers that have to be called.

        :param number: of the control period; observers are called at multiples of their divider
        :param now_s: monotonic wall time [s]
        :param look: whether to check which observers have to be called even if that is not due
        """
        if look or now_s >= self._look_at:
            # Set first, or a refresh() that comes meanwhile would be lost.
            self._look_at = now_s + _LOOK_S
            self._present = tuple(
                entry for entry in self._all if entry.look is None or entry.look())
        for entry in self._present:
            if number % entry.every == 0:
                entry.observer(simulation)
