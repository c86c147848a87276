# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Instants that a person scrubs and plays through, and the last minute of a live node."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.viewer.page.page_commands import Events
from manip_sim.viewer.page.plain_text import Line, PlainText
from manip_sim.viewer.page.plots import History

_SPEEDS = {'1/4': 0.25, '1': 1.0, '4': 4.0}
#: Stamps are nanoseconds; differences of floating-point times may be shorter by less [s].
_TOLERANCE_S = 1e-9


class Timeline:
    """
    A slider over instants, and a box that plays them.

    :param label: what the slider shows
    :param step: of the values of the slider
    :param show: shows the instant of an index
    :ivar index: of the instant that is shown; -1 before :meth:`begin`
    """

    def __init__(self, gui: Any, events: Events, label: str, step: float,
                 show: Callable[[int], None]) -> None:
        self._show = show
        self.index = -1
        self._times: FloatArray = np.zeros(0)
        self._values: list[float] = []
        self._last_s: float | None = None
        self._ahead_s = 0.0
        self._slider = gui.add_slider(label, 0 * step, step, step, 0 * step)
        self._slider.on_update(lambda event: events.add(
            lambda: self.go(self._index_of(event.target.value))))
        self._play = gui.add_checkbox('Play', False)
        self._speed = gui.add_dropdown('Speed', tuple(_SPEEDS), initial_value='1')

    def _index_of(self, value: float) -> int:
        found = np.abs(np.subtract(self._values, value))
        return int(found.argmin()) if found.size else -1

    def begin(self, times: FloatArray, values: list[float], index: int) -> None:
        """
        Take other instants.

        :param times: of the instants, ascending [s], shape (n,), n >= 1
        :param values: those of the slider, ascending, length n
        :param index: of the instant to show first
        """
        self._times, self._values = times, values
        self._slider.min = values[0]
        self._slider.max = max(values[-1], values[0] + self._slider.step)
        self.index, self._last_s, self._ahead_s = -1, None, 0.0
        self.go(index)

    def go(self, index: int) -> None:
        """Show an instant; an index past the ends is the nearest one."""
        index = min(max(index, 0), len(self._times) - 1)  # Without instants, it stays -1.
        if index != self.index:
            self.index = index
            self._slider.value = self._values[index]
            self._show(index)

    def reveal(self, shown: bool) -> None:
        """Show or hide it; a hidden one does not play."""
        for element in (self._slider, self._play, self._speed):
            element.visible = shown
        self._play.value = self._play.value and shown

    def update(self, now_s: float) -> None:
        """Play; ``now_s`` is wall time [s]."""
        elapsed_s = 0.0 if self._last_s is None else now_s - self._last_s
        self._last_s = now_s
        if not self._play.value:
            self._ahead_s = 0.0
            return
        if self.index >= len(self._times) - 1:
            self._play.value, self._ahead_s = False, 0.0
            return
        present_s = self._times[self.index]
        self._ahead_s += elapsed_s * _SPEEDS[self._speed.value]
        reached = int(np.searchsorted(
            self._times, present_s + self._ahead_s + _TOLERANCE_S, 'right')) - 1
        if reached > self.index:
            self.go(reached)
            self._ahead_s -= self._times[self.index] - present_s


#: How far it looks back in simulation time [s], how many instants it keeps of that at most, and
#: how many bytes they take at most; a view is updated 30 times a second.
_SPAN_S, _MAX_INSTANTS, _MAX_BYTES = 60.0, 3600, 2**26
_LIVE, _BACK = 'Live', 'Last minute'


class LookBack:
    """
    The last minute of a node: a person stops the view, not the node, and scrubs back.

    What is kept goes on to grow while the view is stopped; what is scrubbed through does not
    change.
    """

    def __init__(self, gui: Any, events: Events) -> None:
        self._kept = History()
        self._rows: FloatArray | None = None
        self._times: FloatArray = np.zeros(0)
        self._buttons = gui.add_button_group('History', (_BACK,))
        self._buttons.on_click(lambda event: events.add(
            self._begin if event.target.value == _BACK else self.end))
        self._text = PlainText(gui)
        self._timeline = Timeline(gui, events, 'Seconds', 0.01, self._say)
        self._timeline.reveal(False)

    @property
    def shown(self) -> FloatArray | None:
        """The positions that are shown in place of the present ones; None while it is live."""
        return None if self._rows is None else self._rows[self._timeline.index]

    def forget(self, size: int) -> None:
        """Begin anew, live, as in another world, with so many positions in a state."""
        self._kept = History(_SPAN_S, min(_MAX_INSTANTS, _MAX_BYTES // (8 * max(size, 1))))
        self.end()

    def update(self, now_s: float, time_s: float, positions: FloatArray) -> None:
        """
        Keep the present instant, and play.

        :param now_s: wall time [s]
        :param time_s: simulation time [s]
        :param positions: ``qpos`` of the model, shape (nq,)
        """
        self._kept.add(time_s, positions)
        if self._rows is not None:
            self._timeline.update(now_s)

    def _begin(self) -> None:
        times, rows = self._kept.columns()
        if not len(times) or self._rows is not None:
            return
        self._times, self._rows = times + self._kept.newest_s, rows
        self._buttons.options = (_LIVE,)
        self._timeline.begin(self._times, times.round(2).tolist(), len(times) - 1)
        self._timeline.reveal(True)

    def end(self) -> None:
        if self._rows is not None:
            self._rows = None
            self._timeline.reveal(False)
            self._text.show([])
            self._buttons.options = (_BACK,)

    def _say(self, index: int) -> None:
        ago_s = self._times[-1] - self._times[index]
        self._text.show([Line(f'The picture shows {self._times[index]:.2f} s, {ago_s:.2f} s '
                              'before it was stopped.')])
