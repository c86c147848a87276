# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Instants that a person plays through, the last minute of a live node, and plots of them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.viewer.page.interaction import Events
from manip_sim.viewer.page.latest import Latest, Line, PlainText, Robot, ShownPart

#: Simulation time that the plots look back [s].
WINDOW_S = 10.0
#: Number of instants in a plot at most.
_POINTS = 200
#: Time between two drawings of the plots [s].
_PERIOD_S = 0.25
_COLORS = ('#2e7bd6', '#e8590c', '#2f9e44', '#c2255c', '#7048e8', '#0c8599', '#f08c00', '#868e96')
_HEIGHT = 170
#: Above, right of, below and left of a plot; of the axis of its values [pixels].
_PADDING = (8, 10, 0, 0)
_AXIS = {'size': 52, 'gap': 3, 'ticks': {'size': 4}}
_TIME_AXIS = {'label': 'time [s]', 'labelSize': 16, 'labelFont': '12px sans-serif', 'size': 34}
#: The scale of a plot reaches so far either way at least, in its unit.
_SMALL = 0.05
_SCALES = {'x': {'time': False, 'range': (-WINDOW_S, 0.0)},
           'y': {'range': {'min': {'pad': 0.1, 'soft': -_SMALL, 'mode': 1},
                           'max': {'pad': 0.1, 'soft': _SMALL, 'mode': 1}}}}
_WRENCH = 'wrench'


class History:
    """Evenly spaced rows of numbers of the last span of simulation time [s], so many at most."""

    def __init__(self, span_s: float = WINDOW_S, most: int = _POINTS) -> None:
        self._span_s, self._spacing_s = span_s, span_s / most
        self._rows: deque[tuple[float, FloatArray]] = deque()

    @property
    def newest_s(self) -> float:
        """The time of the newest row [s]; there must be one."""
        return self._rows[-1][0]

    def add(self, time_s: float, row: FloatArray) -> None:
        """Add the numbers of an instant, unless it follows the last one too closely."""
        if self._rows and time_s < self._rows[-1][0]:  # Simulation time began again.
            self._rows.clear()
        if self._rows and time_s < self._rows[-1][0] + self._spacing_s:
            return
        self._rows.append((time_s, row.copy()))
        while self._rows[0][0] < time_s - self._span_s:
            self._rows.popleft()

    def columns(self) -> tuple[FloatArray, FloatArray]:
        """Return times before the newest instant [s], shape (n,), and the rows, shape (n, k)."""
        if not self._rows:
            return np.zeros(0), np.zeros((0, 0))
        times = np.array([time_s for time_s, _ in self._rows])
        return times - times[-1], np.array([row for _, row in self._rows])


def add_plot(gui: Any, title: str, labels: Sequence[str], data: tuple[FloatArray, ...],
             more: Sequence[Mapping[str, Any]] = (), **options: Any) -> Any:
    """Add a plot of curves over time, and of more series, with further options of uPlot."""
    curves = [{'label': label, 'stroke': _COLORS[i % len(_COLORS)], 'width': 1.5}
              for i, label in enumerate(labels)]
    return gui.add_uplot(
        data, ({'label': 's'}, *curves, *more), title=title, axes=(_TIME_AXIS, _AXIS),
        legend={'show': len(labels) <= len(_COLORS), 'live': False}, **options)


class PlotPanel:
    """Plots of one part, or of the wrench of one end effector, that a person chooses."""

    def __init__(self, gui: Any, tab: Any, robots: Sequence[Robot]) -> None:
        self._gui = gui
        self._next_s = 0.0
        self._plots: list[tuple[Any, slice]] = []
        self._history = History()
        self._choices: dict[str, tuple[Robot, ShownPart | str]] = {}
        for robot in robots:
            self._choices.update({robot.titled(part.name.replace('/', ' ')): (robot, part)
                                  for part in robot.parts if part.joints})
            self._choices.update({robot.titled(f'{arm} {_WRENCH}'): (robot, arm)
                                  for arm in robot.end_effectors})
        self._live = gui.add_checkbox('Live', True, hint='the last ten seconds')
        self._choice = gui.add_dropdown('Show', tuple(self._choices) or ('nothing',))
        self._tab = tab
        self._shown = ''

    def show(self, now_s: float, latest: Latest) -> None:
        """Record the chosen quantity, and draw it if it is due; ``now_s`` is wall time [s]."""
        choice = self._choices.get(self._choice.value)
        if choice is None or not self._live.value:
            return
        if self._choice.value != self._shown:
            self._shown = self._choice.value
            self._history = History()
            self._rebuild(choice[1])
        robot, source = choice
        states = latest.joints.get(robot.space)
        row = None
        if states is not None and isinstance(source, ShownPart):
            index = {name: i for i, name in enumerate(states.names)}
            if all(joint.name in index for joint in source.joints):
                rows = [index[joint.name] for joint in source.joints]
                row = np.concatenate([states.position[rows], states.velocity[rows],
                                      states.effort[rows]])
        elif states is not None:
            row = latest.wrenches.get((robot.space, str(source)))
        if states is not None and row is not None:
            self._history.add(states.time_s, row)
        if now_s >= self._next_s:
            self._next_s = now_s + _PERIOD_S
            times, values = self._history.columns()
            if len(times) > 1:
                for plot, columns in self._plots:
                    plot.data = (times, *np.ascontiguousarray(values[:, columns].T))

    def _rebuild(self, source: ShownPart | str) -> None:
        for plot, _ in self._plots:
            plot.remove()
        self._plots = []
        if isinstance(source, ShownPart):
            labels = [joint.label for joint in source.joints]
            units = {(joint.unit('position'), joint.unit('velocity'), joint.unit('effort'))
                     for joint in source.joints}
            plots = list(zip(('position', 'velocity', 'effort'), zip(*sorted(units))))
        else:
            labels = ['x', 'y', 'z']
            plots = [('external force', ('N',)), ('external torque', ('N m',))]
        count = len(labels)
        with self._tab:
            for number, (title, unit) in enumerate(plots):
                plot = add_plot(
                    self._gui, f'{title} [{" or ".join(unit)}]', labels,
                    (np.array([-WINDOW_S, 0.0]), *([np.zeros(2)] * count)), scales=_SCALES,
                    padding=_PADDING, height=_HEIGHT)
                self._plots.append((plot, slice(number * count, (number + 1) * count)))


_SPEEDS = {'1/4': 0.25, '1': 1.0, '4': 4.0}
#: Stamps are nanoseconds; differences of floating-point times may be shorter by less [s].
_TOLERANCE_S = 1e-9


class Timeline:
    """
    A slider over instants, and a box that plays them.

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
        distances = np.abs(np.subtract(self._values, value))
        return int(distances.argmin()) if distances.size else -1

    def begin(self, times: FloatArray, values: list[float], index: int) -> None:
        """
        Take other instants.

        :param times: of the instants, ascending [s], shape (n,), n >= 1
        :param values: of the slider, ascending, length n
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


#: Its length in simulation time [s], the number of instants that it keeps at most, and
#: how many bytes they take at most; a view is updated 30 times a second.
_SPAN_S, _MAX_INSTANTS, _MAX_BYTES = 60.0, 3600, 2**26
_LIVE, _BACK = 'Live', 'Last minute'


class LookBack:
    """
    The last minute of a node: a person stops the view, not the node, and scrubs back.

    The history goes on to grow while the view is stopped; the part that is scrubbed through does
    not change.
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
        """Keep the ``qpos`` of a simulation time [s], shape (nq,), and play; wall time [s]."""
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
