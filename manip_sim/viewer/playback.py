# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Show records of episodes in the browser, without ROS: scrub, play, plot, jump to failures."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
import io
import os
from pathlib import Path
import time
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import FloatArray
from manip_sim.errors import ManipSimError, RecordError
from manip_sim.models import trial
from manip_sim.models.archive import load_archive
from manip_sim.records.converting import records_in
from manip_sim.records.recorded import Record, RecordedEpisode
from manip_sim.records.recorder import ACTION, GOAL, REWARD, STATE_PARTS
from manip_sim.startup import EndSignals
from manip_sim.viewer.page.access import Access
from manip_sim.viewer.page.aiming import Aiming
from manip_sim.viewer.page.kinematics import Kinematics
from manip_sim.viewer.page.model_scene import Scene
from manip_sim.viewer.page.page_commands import Events
from manip_sim.viewer.page.plain_text import Line, plain, PlainText
from manip_sim.viewer.page.server import close_server, open_server, page_address, set_theme
from manip_sim.viewer.page.timeline import Timeline

#: Least time between two updates of the browser [s].
_PERIOD_S = 1.0 / 30.0
_COLORS = ('#2e7bd6', '#e8590c', '#2f9e44', '#c2255c', '#7048e8', '#0c8599', '#f08c00', '#868e96')
_DONE, _FAILED, _CUT_OFF = '#2f9e44', '#e03131', '#868e96'
#: Width of the line that shows the present instant, as a share of the time of a plot.
_LINE = 1e-4
#: A browser lays out a plot in place of another one only when its data come again [s].
_AGAIN_S = 0.5
_IMAGE = '/color/image_raw/compressed'


@dataclass(frozen=True)
class Entry:
    """
    An episode among others.

    :ivar path: of its record
    :ivar number: of the episode in it
    :ivar seed: of the episode
    :ivar success: whether it did the task; None if the record ends before it does
    """

    path: Path
    number: int
    seed: int
    success: bool | None

    @property
    def label(self) -> str:
        """What it is called on the page."""
        how = {True: 'done', False: 'FAILED', None: 'cut off'}[self.success]
        return plain(f'{self.path.stem} #{self.number}, seed {self.seed}: {how}')


def show_records(options: argparse.Namespace) -> int:
    """
    Serve the page until SIGINT, SIGTERM or SIGHUP.

    :param options: of the command line, with the files or folders in ``record``
    :returns: the exit code, 0
    :raises ManipSimError: if a record cannot be read, or it cannot listen
    """
    ended = EndSignals()
    entries = [Entry(path, found.number, found.seed,
                     None if found.result is None else found.success)
               for path in records_in(options.record) for found in Record(path).episodes()]
    access = Access.of(os.environ, options.allow_host)
    server: Any = open_server(options.listen, options.port, access)
    try:
        player = Player(server, entries, options.dark)
        failed = sum(entry.success is False for entry in entries)
        print(f'sim_view: {page_address(server, options.listen, access)} shows {len(entries)} '
              f'episodes, {failed} of them failed', flush=True)
        while not ended.wait(_PERIOD_S):
            player.update(time.monotonic())
    finally:
        close_server(server)
    trial.give_up()
    return 0


class Player:
    """
    A page that shows one episode at a time, at one of its control periods.

    :param server: the ``viser.ViserServer``
    :param entries: the episodes, at least one
    :param dark: whether the page is dark
    """

    def __init__(self, server: Any, entries: list[Entry], dark: bool = False) -> None:
        self._server, self._entries = server, entries
        self._events = Events()
        self._aiming = Aiming(server)
        self._model_archive: bytes | None = None
        self._scene: Scene | None = None
        self._images: dict[str, Any] = {}
        self._plot: Any = None
        self._drawn: tuple[str, ...] | None = None
        self._is_new = False
        self._new_s: float | None = None
        self._period = 0
        set_theme(server, dark)
        server.gui.set_panel_label('manip_sim')
        self._build()
        self._open(0)

    def _build(self) -> None:
        gui, add = self._server.gui, self._events.add
        self._text = PlainText(gui)
        labels = tuple(entry.label for entry in self._entries)
        self._choice = gui.add_dropdown('Episode', labels)
        self._choice.on_update(lambda event: add(
            lambda: self._open(labels.index(event.target.value))))
        jump = gui.add_button_group('Jump to', ('Failure', 'Previous', 'Next'),
                                    hint='Failure: the next episode without success')
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
            self._episode = next(found for found in Record(entry.path).episodes()
                                 if found.number == entry.number)
            self._states = self._episode.states
            self._show_model()
            self._quantities = quantities(self._episode)
            self._pictures = pictures(self._episode)
        except (ManipSimError, StopIteration) as error:
            self._text.show([Line(str(error) or 'the record has changed', color=_FAILED)])
            return
        self._choice.value = entry.label
        self._quantity.options = tuple(self._quantities) or ('nothing',)
        self._draw()
        count = len(self._states)
        self._timeline.begin(np.arange(count, dtype=float) * self._episode.period_s,
                             list(range(count)), count - 1 if entry.success is False else 0)

    def _show_model(self) -> None:
        if self._episode.model == self._model_archive:
            return
        model = load_archive(self._episode.model)
        if mujoco.mj_stateSize(model, STATE_PARTS) != self._states.shape[1]:
            raise RecordError('the states of the record do not fit its model')
        if self._scene is not None:
            self._scene.remove()
        self._kinematics = Kinematics(model)
        self._place(0)
        self._scene = Scene(self._server, model, self._kinematics.data)
        self._aiming.begin(self._kinematics)
        self._model_archive = self._episode.model

    def _place(self, period: int) -> None:
        kinematics = self._kinematics
        mujoco.mj_setState(kinematics.model, kinematics.data, self._states[period], STATE_PARTS)
        kinematics.compute()

    def _show(self, period: int) -> None:
        """Show a control period."""
        if self._scene is None:
            return
        self._period = period
        self._place(period)
        self._scene.update(self._kinematics.data)
        self._show_text()
        self._show_images()
        self._draw_line()

    def _show_text(self) -> None:
        about, entry = self._episode.about, self._entries[self._index]
        color = {True: _DONE, False: _FAILED, None: _CUT_OFF}[entry.success]
        how = {True: 'done', False: 'failed', None: 'the record ends early'}[entry.success]
        error = (self._episode.result or {}).get('error', '')
        rewards = self._quantities.get('reward')
        reward = '' if rewards is None or not self._period else (
            f', reward {rewards.values[min(self._period, len(rewards.values)) - 1, 0]:.3f}')
        self._text.show([
            Line(f'{about["instruction"]} {about["robot"]}, seed {entry.seed}', color=color),
            Line(how + (f': {error}' if error else '')),
            Line(f'{self._period * self._episode.period_s:.2f} s, period {self._period} of '
                 f'{len(self._states) - 1}{reward}')])

    def _show_images(self) -> None:
        for camera, found in self._pictures.items():
            if self._period < len(found):
                pixels = decoded(found[self._period])
                if pixels is None:
                    continue
                if camera in self._images:
                    self._images[camera].image = pixels
                else:
                    self._images[camera] = self._server.gui.add_image(pixels, label=plain(camera))
        for camera in self._images.keys() - self._pictures.keys():
            self._images.pop(camera).remove()

    def _draw(self) -> None:
        """Plot the chosen quantity."""
        chosen = self._quantities.get(str(self._quantity.value))
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
        chosen = self._quantities.get(str(self._quantity.value))
        if self._plot is not None and chosen is not None:
            self._plot.data = self._data(chosen)

    def _data(self, chosen: Plotted) -> tuple[FloatArray, ...]:
        """Return times, columns, and a line that goes up at the present instant."""
        times = (np.arange(len(chosen.values)) + chosen.first) * self._episode.period_s
        now = min(max(self._period * self._episode.period_s, times[0]), times[-1])
        width = _LINE * max(times[-1] - times[0], 1e-3)
        whole = np.sort(np.concatenate([times, [now - width, now, now + width]]))
        low, high = float(chosen.values.min()), float(chosen.values.max())
        return (whole, *(np.interp(whole, times, column) for column in chosen.values.T),
                np.where(whole == now, high, low))

    def update(self, now_s: float) -> None:
        """
        Do what people asked for, and play.

        :param now_s: wall time [s]
        """
        self._events.run()
        if self._plot is not None and self._is_new:
            if self._new_s is None:
                self._new_s = now_s + _AGAIN_S
            elif now_s >= self._new_s:
                self._is_new, self._new_s = False, None
                self._draw_line()
        self._timeline.update(now_s)


@dataclass(frozen=True)
class Plotted:
    """
    Something to plot.

    :ivar title: with its unit
    :ivar names: of the columns, n of them
    :ivar values: a row per control period, shape (periods, n)
    :ivar first: control period of the first row
    """

    title: str
    names: list[str]
    values: FloatArray
    first: int


def quantities(recorded: RecordedEpisode) -> dict[str, Plotted]:
    """
    Return what can be plotted of an episode, by name.

    :param recorded: the episode
    :raises RecordError: if a topic cannot be read
    """
    found: dict[str, Plotted] = {}
    rewards = recorded.decoded(REWARD, 'std_msgs/Float64')
    _add(found, 'reward', 'reward', ['reward'], [[message.data] for message in rewards], 1)
    for topic in recorded.types:
        *scope, last = topic.strip('/').split('/')
        name = ' '.join(scope)
        if last == 'joint_states':
            messages = recorded.decoded(topic, 'sensor_msgs/JointState')
            for field, unit in (('position', 'rad or m'), ('velocity', 'rad/s or m/s'),
                                ('effort', 'N m or N')):
                _add(found, f'{name} joint {field}'.strip(), f'{field} [{unit}]',
                     list(messages[0].name), [getattr(m, field) for m in messages], 0)
        elif last == 'external_wrench':
            forces = [m.wrench.force
                      for m in recorded.decoded(topic, 'geometry_msgs/WrenchStamped')]
            _add(found, f'{name} external force', 'external force [N]', ['x', 'y', 'z'],
                 [[f.x, f.y, f.z] for f in forces], 0)
        elif last in ('eef_pose', 'pose'):
            places = [m.pose.position
                      for m in recorded.decoded(topic, 'geometry_msgs/PoseStamped')]
            _add(found, f'{name} position', f'position of {name} [m]', ['x', 'y', 'z'],
                 [[p.x, p.y, p.z] for p in places], 0)
    for topic, first in ((ACTION, 1), (GOAL, 0)):
        rows = recorded.arrays(topic)
        _add(found, topic.rpartition('/')[2], topic.rpartition('/')[2],
             [str(index) for index in range(rows.shape[1])], rows.tolist(), first)
    return found


def _add(found: dict[str, Plotted], name: str, title: str, names: list[str],
         rows: list[Any], first: int) -> None:
    if len(rows) > 1 and names and all(len(row) == len(names) for row in rows):
        found[name] = Plotted(title, names, np.nan_to_num(np.array(rows, dtype=float)), first)


def pictures(recorded: RecordedEpisode) -> dict[str, list[bytes]]:
    """
    Return the compressed images of an episode by camera.

    :param recorded: the episode
    :raises RecordError: if a topic cannot be read
    """
    return {topic.removesuffix(_IMAGE).strip('/'): [
        bytes(message.data) for message in recorded.decoded(topic, 'sensor_msgs/CompressedImage')]
        for topic in recorded.types if topic.endswith(_IMAGE)}


def decoded(content: bytes) -> NDArray[np.uint8] | None:
    """Return an image, shape (h, w, 3); None if it cannot be read."""
    from PIL import Image, UnidentifiedImageError
    try:
        return np.asarray(Image.open(io.BytesIO(content), formats=['JPEG', 'PNG']).convert('RGB'))
    except (UnidentifiedImageError, OSError, ValueError, Image.DecompressionBombError):
        return None
