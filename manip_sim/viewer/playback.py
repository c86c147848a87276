# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Show records in the browser, without ROS: scrub, play, plot, jump to failures."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterable
import os
import sys
import time
from typing import Any

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.errors import ManipSimError
from manip_sim.models import untrusted_models
from manip_sim.models.archive import load_archive
from manip_sim.startup import EndSignals
from manip_sim.viewer.page.model_scene import Kinematics, Scene
from manip_sim.viewer.page.page_commands import Events
from manip_sim.viewer.page.plain_text import Line, plain, PlainText
from manip_sim.viewer.page.pointer import Aiming
from manip_sim.viewer.page.server import Access, close_server, open_server, page_address, set_theme
from manip_sim.viewer.page.timeline import Timeline
from manip_sim.viewer.shown_records import described, entries_in, Entry, Plotted, Shown

#: Least time between two updates of the browser [s].
_PERIOD_S = 1.0 / 30.0
_COLORS = ('#2e7bd6', '#e8590c', '#2f9e44', '#c2255c', '#7048e8', '#0c8599', '#f08c00', '#868e96')
_FAILED = '#e03131'
#: Width of the line that shows the present instant, as a share of the time of a plot.
_LINE = 1e-4
#: A browser lays out a plot in place of another one only when its data come again [s].
_AGAIN_S = 0.5


def show_records(options: argparse.Namespace) -> int:
    """
    Serve the page until SIGINT, SIGTERM or SIGHUP.

    :param options: of the command line, with the files or folders in ``record``
    :returns: the exit code, 0
    :raises ManipSimError: if a record cannot be read, or it cannot listen
    """
    ended = EndSignals()
    entries = entries_in(options.record, lambda why: print(f'sim_view: {why}', file=sys.stderr))
    access = Access.of(os.environ, options.allow_host)
    server: Any = open_server(options.listen, options.port, access)
    try:
        player = Player(server, entries, options.dark)
        print(f'sim_view: {page_address(server, options.listen, access)} shows '
              f'{described(entries)}', flush=True)
        while not ended.wait(_PERIOD_S):
            player.update(time.monotonic())
    finally:
        close_server(server)
    untrusted_models.give_up()
    return 0


class Player:
    """
    A page that shows one episode, or world of a node, at one of its instants.

    :param entries: what can be shown, at least one
    :param dark: whether the page is dark
    """

    def __init__(self, server: Any, entries: list[Entry], dark: bool = False) -> None:
        self._server, self._entries = server, entries
        self._labels = _labels_of(entries)
        self._events = Events()
        self._aiming = Aiming(server)
        self._model_archive: bytes | None = None
        self._kinematics: Kinematics
        self._scene: Scene | None = None
        self._images: dict[str, Any] = {}
        self._plot: Any = None
        self._drawn: tuple[str, ...] | None = None
        self._is_new = False
        self._new_s: float | None = None
        self._plots: dict[str, Plotted] = {}
        self._instant = 0
        set_theme(server, dark)
        server.gui.set_panel_label('manip_sim')
        self._build()
        self._open(0)

    def _build(self) -> None:
        gui, add = self._server.gui, self._events.add
        self._text = PlainText(gui)
        labels = self._labels
        self._choice = gui.add_dropdown('Episode', labels)
        self._choice.on_update(lambda event: add(
            lambda: self._open(labels.index(event.target.value))))
        jump = gui.add_button_group('Jump to', ('Failure', 'Previous', 'Next'))
        jump.on_click(lambda event: add(lambda: self._jump(event.target.value)))
        self._timeline = Timeline(gui, self._events, 'Period', 1, self._show)
        self._quantity = gui.add_dropdown('Plot', ('nothing',))
        self._quantity.on_update(lambda event: add(self._draw))

    def _jump(self, where: str) -> None:
        count = len(self._entries)
        present = self._index
        steps = range(-1, -count, -1) if where == 'Previous' else range(1, count)
        for step in steps:
            entry = self._entries[(present + step) % count]
            if where != 'Failure' or entry.success is False:
                self._open((present + step) % count)
                return

    def _open(self, index: int) -> None:
        """Show an episode at its start; one that failed at its end."""
        if getattr(self, '_index', None) == index:
            return
        self._index = index
        entry = self._entries[index]
        try:
            shown = entry.read()
            self._show_model(shown)
        except ManipSimError as error:
            self._text.show([Line(str(error), color=_FAILED)])
            return
        self._choice.value = self._labels[index]
        self._quantity.options = tuple(shown.plots) or ('nothing',)
        self._draw()
        count = len(shown.times)
        self._timeline.begin(shown.times, list(range(count)),
                             count - 1 if entry.success is False else 0)

    def _show_model(self, shown: Shown) -> None:
        is_new = shown.model != self._model_archive
        model = load_archive(shown.model) if is_new else self._kinematics.model
        shown.check(model)
        if is_new:
            if self._scene is not None:
                self._scene.remove()
            self._kinematics = Kinematics(model)
            shown.place(self._kinematics, 0)
            self._scene = Scene(self._server, model, self._kinematics.data)
            self._aiming.begin(self._kinematics)
            self._model_archive = shown.model
        self._shown, self._plots = shown, shown.plots

    def _show(self, instant: int) -> None:
        if self._scene is None:
            return
        self._instant = instant
        self._shown.place(self._kinematics, instant)
        self._scene.update(self._kinematics.data)
        self._text.show(self._shown.lines(instant))
        self._show_images()
        self._draw_line()

    def _show_images(self) -> None:
        for camera, pictures in self._shown.pictures.items():
            pixels = pictures.at(self._shown.times[self._instant])
            if pixels is None:
                continue
            if camera in self._images:
                self._images[camera].image = pixels
            else:
                self._images[camera] = self._server.gui.add_image(pixels, label=plain(camera))
        for camera in self._images.keys() - self._shown.pictures.keys():
            self._images.pop(camera).remove()

    def _draw(self) -> None:
        chosen = self._plots.get(str(self._quantity.value))
        drawn = None if chosen is None else (chosen.title, *chosen.names)
        if drawn == self._drawn:
            self._draw_line()
            return
        if self._plot is not None:
            self._plot.remove()
            self._plot = None
        self._drawn, self._is_new, self._new_s = drawn, True, None
        if chosen is None:
            return
        curves = [{'label': plain(name), 'stroke': _COLORS[i % len(_COLORS)], 'width': 1.5}
                  for i, name in enumerate(chosen.names)]
        self._plot = self._server.gui.add_uplot(
            self._data(chosen),
            ({'label': 's'}, *curves, {'label': 'now', 'stroke': '#868e96', 'width': 1}),
            title=plain(chosen.title), scales={'x': {'time': False}}, height=220,
            axes=({}, {'size': 52, 'gap': 3, 'ticks': {'size': 4}}),
            legend={'show': len(chosen.names) <= len(_COLORS), 'live': False})

    def _draw_line(self) -> None:
        chosen = self._plots.get(str(self._quantity.value))
        if self._plot is not None and chosen is not None:
            self._plot.data = self._data(chosen)

    def _data(self, chosen: Plotted) -> tuple[FloatArray, ...]:
        """Return times, columns, and a line that goes up at the present instant."""
        times = chosen.times
        now = min(max(self._shown.times[self._instant], times[0]), times[-1])
        width = _LINE * max(times[-1] - times[0], 1e-3)
        whole = np.sort(np.concatenate([times, [now - width, now, now + width]]))
        low, high = float(chosen.values.min()), float(chosen.values.max())
        return (whole, *(np.interp(whole, times, column) for column in chosen.values.T),
                np.where(whole == now, high, low))

    def update(self, now_s: float) -> None:
        """Do what people asked for, and play; ``now_s`` is wall time [s]."""
        self._events.run()
        if self._plot is not None and self._is_new:
            if self._new_s is None:
                self._new_s = now_s + _AGAIN_S
            elif now_s >= self._new_s:
                self._is_new, self._new_s = False, None
                self._draw_line()
        self._timeline.update(now_s)
        if self._scene is not None:
            self._aiming.update(self._kinematics)


def _labels_of(entries: Iterable[Entry]) -> tuple[str, ...]:
    """Return what entries are called on the page; files of one name in two folders differ."""
    count: Counter[str] = Counter()
    labels = []
    for entry in entries:
        count[entry.label] += 1
        again = count[entry.label]
        labels.append(entry.label if again == 1 else f'{entry.label} ({again})')
    return tuple(labels)
