# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Show records in the browser, without ROS: scrub, play, plot, jump to failures."""

from __future__ import annotations

from abc import ABC, abstractmethod
import argparse
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
import contextlib
from dataclasses import dataclass
import os
from pathlib import Path
import sys
import time
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import FloatArray
from manip_sim.errors import ManipSimError, RecordError
from manip_sim.interface.topics import BY_NAME
from manip_sim.models import untrusted_models
from manip_sim.models.archive import load_archive
from manip_sim.quoting import pluralize
from manip_sim.records.converting import records_in
from manip_sim.records.record_file import full_name
from manip_sim.records.recorded import image, Record, Recorded, RecordedEpisode, RecordedWorld
from manip_sim.records.recorder import ACTION, GOAL, REWARD, STATE_PARTS
from manip_sim.startup import EndSignals
from manip_sim.viewer.page.interaction import Aiming, Events
from manip_sim.viewer.page.latest import Line, plain, PlainText
from manip_sim.viewer.page.model_scene import Kinematics, Scene
from manip_sim.viewer.page.server import Access, close_server, open_server, page_address, set_theme
from manip_sim.viewer.page.timeline import add_plot, Timeline

#: Least time between two updates of the browser [s].
_PERIOD_S = 1.0 / 30.0
#: Width of the line that shows the present instant, as a share of the time of a plot.
_LINE = 1e-4
#: A browser lays out a plot in place of another one only when its data come again [s].
_AGAIN_S = 0.5
_FAILED, _CUT_OFF = '#e03131', '#868e96'
#: Colour and words for success, failure and a record that ends before.
_OUTCOMES = {True: ('#2f9e44', 'done'), False: (_FAILED, 'failed'),
             None: (_CUT_OFF, 'the record ends early')}
_IMAGE = BY_NAME['<camera>/color/image_raw/compressed']
#: Of a node, at most so many instants are shown; of more, every second one, or third ...
_MOST_INSTANTS = 6000
#: Times of messages and instants are the same up to rounding [s].
_TOLERANCE_S = 1e-6


@dataclass(frozen=True)
class Plotted:
    """
    Something to plot.

    :ivar title: with its unit
    :ivar names: of the columns, n of them
    :ivar values: a row per instant, shape (instants, n)
    :ivar times: of the rows [s], shape (instants,)
    """

    title: str
    names: list[str]
    values: FloatArray
    times: FloatArray


@dataclass(frozen=True)
class RecordedPictures:
    """The compressed images of a camera by ascending times [s], shape (n,)."""

    times: FloatArray
    contents: list[bytes]

    def at(self, time_s: float) -> NDArray[np.uint8] | None:
        """Return the newest image at a time, (h, w, 3); None if there is none that can be read."""
        index = _newest(self.times, time_s)
        if index >= 0:
            with contextlib.suppress(RecordError):
                return image(self.contents[index])
        return None


class Shown(ABC):
    """
    Instants, plots and pictures of one model.

    :ivar times: of the instants, from the first [s], shape (n,), n >= 1
    """

    model: bytes
    times: FloatArray
    plots: dict[str, Plotted]
    pictures: dict[str, RecordedPictures]

    @abstractmethod
    def check(self, model: mujoco.MjModel) -> None:
        """Check that the instants fit a model; RecordError if they do not."""

    @abstractmethod
    def place(self, kinematics: Kinematics, instant: int) -> None:
        """Move the bodies to where they are at an instant."""

    @abstractmethod
    def lines(self, instant: int) -> list[Line]:
        """Return the lines of text for an instant."""


class ShownEpisode(Shown):
    """An episode; RecordError if a topic cannot be read."""

    def __init__(self, episode: RecordedEpisode) -> None:
        self._episode = episode
        self._states = episode.states
        self.model = episode.model
        if not len(self._states):
            raise RecordError(f'episode {episode.number} has no states')

        def times(count: int, first: int = 0) -> FloatArray:
            return np.arange(float(first), count + first) * episode.period_s

        self.times = times(len(self._states))
        self.pictures = {camera: RecordedPictures(times(len(images)), [
            bytes(message.data) for message in images])
            for camera, images in _images(episode).items()}
        self.plots: dict[str, Plotted] = {}
        rewards = [[m.data] for m in episode.decoded(REWARD, 'std_msgs/Float64')]
        _add(self.plots, 'reward', 'reward', ['reward'], rewards, times(len(rewards), 1))
        for topic, kind in episode.types.items():
            if kind in _PLOTTED:
                messages = episode.decoded(topic, _PLOTTED[kind])
                _add_messages(self.plots, topic, messages, times(len(messages)))
        for topic, first in ((ACTION, 1), (GOAL, 0)):
            rows, name = episode.arrays(topic), topic.rpartition('/')[2]
            _add(self.plots, name, name, [str(index) for index in range(rows.shape[1])],
                 rows.tolist(), times(len(rows), first))

    def check(self, model: mujoco.MjModel) -> None:
        if mujoco.mj_stateSize(model, STATE_PARTS) != self._states.shape[1]:
            raise RecordError('the states of the record do not fit its model')

    def place(self, kinematics: Kinematics, instant: int) -> None:
        mujoco.mj_setState(kinematics.model, kinematics.data, self._states[instant], STATE_PARTS)
        kinematics.compute()

    def lines(self, instant: int) -> list[Line]:
        episode, about = self._episode, self._episode.about
        color, how = _OUTCOMES[None if episode.result is None else episode.success]
        error = (episode.result or {}).get('error', '')
        rewards = self.plots.get('reward')
        reward = '' if rewards is None or not instant else (
            f', reward {rewards.values[min(instant, len(rewards.values)) - 1, 0]:.3f}')
        return [
            Line(f'{about["instruction"]} {about["robot"]}, seed {episode.seed}', color=color),
            Line(how + (f': {error}' if error else '')),
            Line(f'{self.times[instant]:.2f} s, period {instant} of '
                 f'{len(self.times) - 1}{reward}')]


class ShownWorld(Shown):
    """
    A world of a node, by the messages that it sent: joints, free bodies and images.

    :raises RecordError: without joint states or a model, or if a message cannot be read
    """

    def __init__(self, world: RecordedWorld) -> None:
        self.model = world.model
        self._node = f'{world.node}, manip_sim {world.about.get("manip_sim", "?")}'
        most = max((len(world.messages[topic]) for topic in world.types if _is_joints(topic)),
                   default=0)
        if not most or not self.model:
            raise RecordError(f'the record of {world.node} cannot be shown: it has no '
                              + ('joint_states' if self.model else 'model'))
        self._every = -(-most // _MOST_INSTANTS)
        rising = {topic: _rising(world.decoded(topic, _PLOTTED[kind]), self._every)
                  for topic, kind in world.types.items() if kind in _PLOTTED}
        # Exact joint states are set after measured ones.
        self._joints = [rising[topic] for topic in sorted(filter(_is_joints, rising),
                                                          key=lambda name: 'truth/' in name)]
        instants = max((times for times, _ in self._joints), key=len)
        if not len(instants):
            raise RecordError(f'the joint_states of {world.node} have no joints')
        begin_s = instants[0]
        self.times, self._begin_s = instants - begin_s, float(begin_s)
        self._bodies = {topic.split('/')[-2]: series for topic, series in rising.items()
                        if topic.split('/')[-3:-2] == ['objects'] and topic.endswith('/pose')}
        self.plots = {}
        for topic, (times, messages) in rising.items():
            _add_messages(self.plots, topic, messages, times - begin_s)
        self.pictures = {}
        for camera, images in _images(world).items():
            times, messages = _rising(images)
            self.pictures[camera] = RecordedPictures(
                times - begin_s, [bytes(m.data) for m in messages])
        self._notes: list[Line] = []

    def check(self, model: mujoco.MjModel) -> None:
        """Note which bodies and joints have no messages."""
        kinematics = Kinematics(model)
        known = {name for _, messages in self._joints for name in messages[0].name}
        missing = sorted({*kinematics.scalar_joints} - known) + sorted(
            {*kinematics.free_bodies} - self._bodies.keys())
        self._notes = [] if not missing else [Line(
            f'Not recorded, and so at their start: {", ".join(missing)}')]

    def place(self, kinematics: Kinematics, instant: int) -> None:
        now_s = self.times[instant] + self._begin_s
        newest = [(times[index], messages[index]) for times, messages in self._joints
                  if (index := _newest(times, now_s)) >= 0]
        # Parts have topics of their own, and some end earlier.
        for _, message in sorted(newest, key=lambda entry: float(entry[0])):
            kinematics.set_joints(message.name, message.position)
        for name, (times, messages) in self._bodies.items():
            if messages:
                at = messages[max(_newest(times, now_s), 0)].pose
                turn = at.orientation
                kinematics.place(name, _numbers(at.position), np.array(
                    [turn.w, turn.x, turn.y, turn.z]))
        kinematics.compute()

    def lines(self, instant: int) -> list[Line]:
        position = f'state {instant} of {len(self.times) - 1}'
        often = f', of {self._every} recorded states one is shown' if self._every > 1 else ''
        return [Line(self._node, color=_CUT_OFF),
                Line(f'{self.times[instant] + self._begin_s:.2f} s of the simulation, '
                     f'{position}{often}'),
                *self._notes]


@dataclass(frozen=True)
class Entry:
    """
    An episode, or a world of a node, and its number in the record.

    :ivar success: whether it did the task; None if the record ends before it does
    :ivar node: the full name of the node; empty for an episode
    """

    path: Path
    number: int
    seed: int = 0
    success: bool | None = None
    node: str = ''

    @property
    def label(self) -> str:
        how = {True: 'done', False: 'FAILED', None: 'cut off'}[self.success]
        origin = f'node {self.node}' if self.node else f'seed {self.seed}: {how}'
        return plain(f'{self.path.stem} #{self.number}, {origin}')

    def read(self) -> Shown:
        """Return its instants, plots and pictures; RecordError if it cannot be read."""
        for entry, content in _contents(self.path):
            if (entry.number, entry.node) == (self.number, self.node):
                return _shown(content)
        raise RecordError(f'{self.path}: the record has changed')


def entries_in(paths: Iterable[Path], report: Callable[[str], object] = lambda _: None
               ) -> list[Entry]:
    """
    Return what can be shown of records; report why a file is left out.

    :raises RecordError: if no file can be read, or nothing is in them
    """
    entries: list[Entry] = []
    errors: list[RecordError] = []
    for path in records_in(paths):
        try:  # A world reports what it lacks here, not on the page.
            entries += [entry for entry, content in _contents(path) if not entry.node
                        or _shown(content)]
        except RecordError as error:
            errors.append(error)
    if not entries:
        raise errors[0] if errors else RecordError('nothing that can be shown is recorded')
    for unread in errors:
        report(f'left out: {unread}')
    return entries


def _contents(path: Path) -> Iterator[tuple[Entry, RecordedEpisode | RecordedWorld]]:
    for number, content in enumerate(Record(path).contents()):
        if isinstance(content, RecordedEpisode):
            yield Entry(path, content.number, content.seed,
                        None if content.result is None else content.success), content
        else:
            yield Entry(path, number, node=content.node or '?'), content


def _shown(content: RecordedEpisode | RecordedWorld) -> Shown:
    return ShownEpisode(content) if isinstance(content, RecordedEpisode) else ShownWorld(content)


def described(entries: Iterable[Entry]) -> str:
    """Return how many episodes there are, and how many of nodes."""
    entries = list(entries)
    episodes = [entry for entry in entries if not entry.node]
    failed = sum(entry.success is False for entry in episodes)
    worlds = len(entries) - len(episodes)
    counts = {f'{pluralize(len(episodes), "episode")}, {failed} of them failed': episodes,
              f'{pluralize(worlds, "world")} of nodes': worlds}
    return ' and '.join(text for text, number in counts.items() if number)


def _newest(times: FloatArray, now_s: float) -> int:
    """Return the index of the newest of some times at an instant; -1 before the first."""
    return int(np.searchsorted(times, now_s + _TOLERANCE_S, 'right')) - 1


def _is_joints(topic: str) -> bool:
    return topic.rpartition('/')[2] == 'joint_states'


def _rising(messages: list[Any], every: int = 1) -> tuple[FloatArray, list[Any]]:
    """
    Return messages with finite numbers and rising stamps, one of several, with their times [s].

    While a node is paused, and in lock-step, it repeats states; only newer ones are kept.
    """
    times: list[float] = []
    kept: list[Any] = []
    for message in messages:
        stamp = message.header.stamp
        time_s = stamp.sec + stamp.nanosec * 1e-9
        if (not times or time_s > times[-1]) and _is_usable(message):
            times.append(time_s)
            kept.append(message)
    return np.array(times[::every]), kept[::every]


def _is_usable(message: Any) -> bool:
    if hasattr(message, 'pose'):
        turn = message.pose.orientation
        numbers = [*_numbers(message.pose.position), turn.x, turn.y, turn.z, turn.w]
        return bool(np.isfinite(numbers).all() and np.abs(numbers[3:]).max() > 1e-3)
    if hasattr(message, 'position'):
        count = len(message.name)
        return bool(count and len(message.position) == count
                    and np.isfinite(np.asarray(message.position, dtype=float)).all())
    return True


def _numbers(vector: Any) -> FloatArray:
    return np.array([vector.x, vector.y, vector.z])


#: The types that are plotted, by their full names.
_PLOTTED = {full_name(name): name for name in (
    'geometry_msgs/PoseStamped', 'geometry_msgs/WrenchStamped', 'sensor_msgs/JointState')}


def _add_messages(plots: dict[str, Plotted], topic: str, messages: list[Any], times: FloatArray
                  ) -> None:
    """Add the plots of a topic."""
    *scope, last = topic.strip('/').split('/')
    name = ' '.join(scope)
    if not messages:
        return
    if last == 'joint_states':
        for field, unit in (('position', 'rad or m'), ('velocity', 'rad/s or m/s'),
                            ('effort', 'N m or N')):
            _add(plots, f'{name} joint {field}'.strip(), f'{field} [{unit}]',
                 list(messages[0].name), [getattr(m, field) for m in messages], times)
    elif last == 'external_wrench' and hasattr(messages[0], 'wrench'):
        _add(plots, f'{name} external force', 'external force [N]', ['x', 'y', 'z'],
             [_numbers(m.wrench.force) for m in messages], times)
    elif last in ('eef_pose', 'pose') and hasattr(messages[0], 'pose'):
        _add(plots, f'{name} position', f'position of {name} [m]', ['x', 'y', 'z'],
             [_numbers(m.pose.position) for m in messages], times)


def _add(plots: dict[str, Plotted], name: str, title: str, names: list[str], rows: list[Any],
         times: FloatArray) -> None:
    if len(rows) > 1 and names and all(len(row) == len(names) for row in rows):
        plots[name] = Plotted(title, names, np.nan_to_num(np.array(rows, dtype=float)), times)


def _images(recorded: Recorded) -> dict[str, list[Any]]:
    """Return the messages with compressed images by camera."""
    return {camera: recorded.decoded(topic, _IMAGE.type) for topic in recorded.types
            if (camera := _IMAGE.of_name(topic.removeprefix('/')))}


def show_records(options: argparse.Namespace) -> int:
    """
    Serve the page until SIGINT, SIGTERM or SIGHUP, and return the exit code, 0.

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
    """A page that shows one of some episodes or worlds of nodes at one of its instants."""

    def __init__(self, server: Any, entries: list[Entry], dark: bool = False) -> None:
        self._server, self._entries = server, entries
        count: Counter[str] = Counter()
        labels = []
        for entry in entries:  # Files of one name in two folders differ.
            count[entry.label] += 1
            again = count[entry.label]
            labels.append(entry.label if again == 1 else f'{entry.label} ({again})')
        self._labels = tuple(labels)
        self._events = Events()
        self._aiming = Aiming(server)
        self._kinematics: Kinematics
        self._shown: Shown
        self._scene: Scene | None = None
        self._images: dict[str, Any] = {}
        self._plot: Any = None
        self._drawn: tuple[str, ...] | None = None
        self._is_new = False
        self._new_s: float | None = None
        self._instant, self._index = 0, -1
        set_theme(server, dark)
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

    def _jump(self, destination: str) -> None:
        count = len(self._entries)
        step = -1 if destination == 'Previous' else 1
        for index in [(self._index + step * n) % count for n in range(1, count)]:
            if destination != 'Failure' or self._entries[index].success is False:
                self._open(index)
                return

    def _open(self, index: int) -> None:
        """Show an episode at its start; one that failed at its end."""
        if self._index == index:
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
        is_new = self._scene is None or shown.model != self._shown.model
        model = load_archive(shown.model) if is_new else self._kinematics.model
        shown.check(model)
        if is_new:
            if self._scene is not None:
                self._scene.remove()
            self._kinematics = Kinematics(model)
            shown.place(self._kinematics, 0)
            self._scene = Scene(self._server, model, self._kinematics.data)
            self._aiming.begin(self._kinematics)
        self._shown = shown

    def _show(self, instant: int) -> None:
        if self._scene is None:
            return
        self._instant = instant
        self._shown.place(self._kinematics, instant)
        self._scene.update(self._kinematics.data)
        self._text.show(self._shown.lines(instant))
        self._draw_line()
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
        chosen = self._chosen()
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
        self._plot = add_plot(
            self._server.gui, plain(chosen.title), [*map(plain, chosen.names)],
            self._data(chosen), [{'label': 'now', 'stroke': '#868e96', 'width': 1}],
            scales={'x': {'time': False}}, height=220)

    def _chosen(self) -> Plotted | None:
        return None if self._scene is None else self._shown.plots.get(str(self._quantity.value))

    def _draw_line(self) -> None:
        chosen = self._chosen()
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
