# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Records on the page: instants, plots and pictures of episodes and of nodes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import FloatArray
from manip_sim.errors import RecordError
from manip_sim.interface.topics import BY_NAME
from manip_sim.quoting import pluralize
from manip_sim.records.converting import records_in
from manip_sim.records.record_file import full_name
from manip_sim.records.recorded import Record, Recorded, RecordedEpisode, RecordedWorld
from manip_sim.records.recorder import ACTION, GOAL, REWARD, STATE_PARTS
from manip_sim.records.untrusted_records import image
from manip_sim.viewer.page.model_scene import Kinematics
from manip_sim.viewer.page.plain_text import Line, plain

_DONE, _FAILED, _CUT_OFF = '#2f9e44', '#e03131', '#868e96'
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
    """
    The compressed images of a camera.

    :ivar times: ascending [s], shape (n,)
    :ivar contents: n of them
    """

    times: FloatArray
    contents: list[bytes]

    def at(self, time_s: float) -> NDArray[np.uint8] | None:
        """Return the newest image at a time, (h, w, 3); None if there is none that can be read."""
        index = int(np.searchsorted(self.times, time_s + _TOLERANCE_S, 'right')) - 1
        return None if index < 0 else decoded(self.contents[index])


class Shown(ABC):
    """
    Instants, plots and pictures of one model.

    :ivar model: its archive
    :ivar times: of the instants, from the first [s], shape (n,), n >= 1
    :ivar plots: by name
    :ivar pictures: by camera
    """

    model: bytes
    times: FloatArray
    plots: dict[str, Plotted]
    pictures: dict[str, RecordedPictures]

    @abstractmethod
    def check(self, model: mujoco.MjModel) -> None:
        """
        Check that the instants fit a model.

        :raises RecordError: if they do not
        """

    @abstractmethod
    def place(self, kinematics: Kinematics, instant: int) -> None:
        """Move the bodies to where they are at an instant."""

    @abstractmethod
    def lines(self, instant: int) -> list[Line]:
        """Return the lines of text for an instant."""


class ShownEpisode(Shown):
    """
    An episode.

    :param episode: as it was recorded
    :raises RecordError: if a topic cannot be read
    """

    def __init__(self, episode: RecordedEpisode) -> None:
        self._episode = episode
        self._states = episode.states
        self.model = episode.model
        if not len(self._states):
            raise RecordError(f'episode {episode.number} has no states')
        self.times = np.arange(float(len(self._states))) * episode.period_s
        self.plots = self._plots()
        self.pictures = {camera: RecordedPictures(np.arange(float(len(images))) * episode.period_s,
                                                  [bytes(message.data) for message in images])
                         for camera, images in _images(episode).items()}

    def _plots(self) -> dict[str, Plotted]:
        episode, period_s = self._episode, self._episode.period_s
        plots: dict[str, Plotted] = {}

        def times(count: int, first: int = 0) -> FloatArray:
            return np.arange(float(first), count + first) * period_s

        rewards = [m.data for m in episode.decoded(REWARD, 'std_msgs/Float64')]
        _add(plots, 'reward', 'reward', ['reward'], [[reward] for reward in rewards],
             times(len(rewards), 1))
        for topic, kind in episode.types.items():
            if kind in _PLOTTED:
                messages = episode.decoded(topic, _PLOTTED[kind])
                _add_messages(plots, topic, messages, times(len(messages)))
        for topic, first in ((ACTION, 1), (GOAL, 0)):
            rows, name = episode.arrays(topic), topic.rpartition('/')[2]
            _add(plots, name, name, [str(index) for index in range(rows.shape[1])], rows.tolist(),
                 times(len(rows), first))
        return plots

    def check(self, model: mujoco.MjModel) -> None:
        if mujoco.mj_stateSize(model, STATE_PARTS) != self._states.shape[1]:
            raise RecordError('the states of the record do not fit its model')

    def place(self, kinematics: Kinematics, instant: int) -> None:
        mujoco.mj_setState(kinematics.model, kinematics.data, self._states[instant], STATE_PARTS)
        kinematics.compute()

    def lines(self, instant: int) -> list[Line]:
        episode, about = self._episode, self._episode.about
        success = None if episode.result is None else episode.success
        color = {True: _DONE, False: _FAILED, None: _CUT_OFF}[success]
        how = {True: 'done', False: 'failed', None: 'the record ends early'}[success]
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

    :param world: as it was recorded
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
        now_s = self.times[instant] + self._begin_s + _TOLERANCE_S
        newest = [(times[index], messages[index]) for times, messages in self._joints
                  if (index := int(np.searchsorted(times, now_s, 'right')) - 1) >= 0]
        # Parts have topics of their own, and some end earlier.
        for _, message in sorted(newest, key=lambda found: float(found[0])):
            kinematics.set_joints(message.name, message.position)
        for name, (times, messages) in self._bodies.items():
            if messages:
                at = messages[max(int(np.searchsorted(times, now_s, 'right')) - 1, 0)].pose
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
    An episode, or a world of a node, among others.

    :ivar path: of its record
    :ivar number: of it in the record
    :ivar seed: of the episode
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
        """
        Return its instants, plots and pictures.

        :raises RecordError: if it cannot be read
        """
        for number, content in enumerate(Record(self.path).contents()):
            if isinstance(content, RecordedEpisode):
                if content.number == self.number and not self.node:
                    return ShownEpisode(content)
            elif number == self.number:
                return ShownWorld(content)
        raise RecordError(f'{self.path}: the record has changed')


def entries_in(paths: Iterable[Path], report: Callable[[str], object] = lambda _: None
               ) -> list[Entry]:
    """
    Return what can be shown of records.

    :param paths: of files, and of folders with them
    :param report: is called with why a file is left out, if others can be shown
    :raises RecordError: if no file can be read, or nothing is in them
    """
    entries: list[Entry] = []
    errors: list[RecordError] = []
    for path in records_in(paths):
        try:
            entries += _entries_of(path)
        except RecordError as error:
            errors.append(error)
    if not entries:
        raise errors[0] if errors else RecordError('nothing that can be shown is recorded')
    for unread in errors:
        report(f'left out: {unread}')
    return entries


def _entries_of(path: Path) -> list[Entry]:
    entries = []
    for number, content in enumerate(Record(path).contents()):
        if isinstance(content, RecordedEpisode):
            entries.append(Entry(path, content.number, content.seed,
                                 None if content.result is None else content.success))
        else:
            ShownWorld(content)  # Reports what it lacks here, not on the page.
            entries.append(Entry(path, number, node=content.node or '?'))
    return entries


def described(entries: Iterable[Entry]) -> str:
    """Return how many episodes there are, and how many of nodes."""
    entries = list(entries)
    episodes = [entry for entry in entries if not entry.node]
    failed = sum(entry.success is False for entry in episodes)
    counts = [f'{pluralize(len(episodes), "episode")}, {failed} of them failed'
              ] if episodes else []
    worlds = len(entries) - len(episodes)
    return ' and '.join(counts + [f'{pluralize(worlds, "world")} of nodes'] * bool(worlds))


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


def decoded(content: bytes) -> NDArray[np.uint8] | None:
    """Return an image, shape (h, w, 3); None if it cannot be read."""
    try:
        return image(content)
    except RecordError:
        return None
