# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What was measured in a last span of time, and plots of it."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.viewer.page.latest import JointStates, Latest
from manip_sim.viewer.page.robots import Robot, ShownPart

#: How long the plots look back in simulation time [s].
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
#: The scale of a plot reaches so far either way at least, in its unit.
_SMALL = 0.05
_WRENCH = 'wrench'


class History:
    """
    Rows of numbers of the last span of simulation time.

    :param span_s: how far it goes back [s]
    :param most: how many rows it has, but for one, at most; evenly spaced
    """

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


class PlotPanel:
    """
    Plots of one part, or of the wrench of one end effector, that a person chooses.

    :param tab: the tab that the plots are on
    :param robots: of the node
    """

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
        """Record what was chosen, and draw it if it is due; ``now_s`` is wall time [s]."""
        found = self._choices.get(self._choice.value)
        if found is None or not self._live.value:
            return
        if self._choice.value != self._shown:
            self._shown = self._choice.value
            self._history = History()
            self._rebuild(found[1])
        self._record(found[0], found[1], latest)
        if now_s >= self._next_s:
            self._next_s = now_s + _PERIOD_S
            times, rows = self._history.columns()
            if len(times) > 1:
                for plot, columns in self._plots:
                    plot.data = (times, *np.ascontiguousarray(rows[:, columns].T))

    def _record(self, robot: Robot, what: ShownPart | str, latest: Latest) -> None:
        states = latest.joints.get(robot.space)
        if states is None:
            return
        if isinstance(what, ShownPart):
            row = _row(states, what)
            if row is not None:
                self._history.add(states.time_s, row)
        elif (robot.space, what) in latest.wrenches:
            self._history.add(states.time_s, latest.wrenches[robot.space, what])

    def _rebuild(self, what: ShownPart | str) -> None:
        for plot, _ in self._plots:
            plot.remove()
        self._plots = []
        if isinstance(what, ShownPart):
            labels = [joint.label for joint in what.joints]
            units = {(joint.unit('position'), joint.unit('velocity'), joint.unit('effort'))
                     for joint in what.joints}
            plots = list(zip(('position', 'velocity', 'effort'), zip(*sorted(units))))
        else:
            labels = ['x', 'y', 'z']
            plots = [('external force', ('N',)), ('external torque', ('N m',))]
        count = len(labels)
        with self._tab:
            for number, (title, unit) in enumerate(plots):
                self._plots.append((self._plot(f'{title} [{" or ".join(unit)}]', labels),
                                    slice(number * count, (number + 1) * count)))

    def _plot(self, title: str, labels: Sequence[str]) -> Any:
        nothing = np.zeros(2)
        return self._gui.add_uplot(
            (np.array([-WINDOW_S, 0.0]), *([nothing] * len(labels))),
            ({'label': 's'}, *({'label': label, 'stroke': _COLORS[i % len(_COLORS)], 'width': 1.5}
                               for i, label in enumerate(labels))),
            title=title, scales={'x': {'time': False, 'range': (-WINDOW_S, 0.0)},
                                 'y': {'range': {'min': {'pad': 0.1, 'soft': -_SMALL, 'mode': 1},
                                                 'max': {'pad': 0.1, 'soft': _SMALL, 'mode': 1}}}},
            axes=({}, _AXIS), padding=_PADDING, height=_HEIGHT,
            legend={'show': len(labels) <= len(_COLORS), 'live': False})


def _row(states: JointStates, part: ShownPart) -> FloatArray | None:
    index = {name: i for i, name in enumerate(states.names)}
    if any(joint.name not in index for joint in part.joints):
        return None
    rows = [index[joint.name] for joint in part.joints]
    return np.concatenate([values[rows] for values in (
        states.position, states.velocity, states.effort)])
