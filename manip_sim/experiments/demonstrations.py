# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Demonstrations of a task with a device: recorded, and each repeated at once.

Devices are the keyboard, a gamepad, a SpaceMouse, a leader arm of LeRobot, and a file; that of the
browser is in :mod:`manip_sim.viewer.task_page`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
import csv
from dataclasses import dataclass
import importlib
import math
import os
from pathlib import Path
import pkgutil
import select
import sys
import time
from typing import Any

import numpy as np
import yaml

from manip_sim.arrays import FloatArray
from manip_sim.errors import CommandError, ModelError, UnknownNameError
from manip_sim.lerobot_units import POSITION
from manip_sim.quoting import quoted, quoted_names
from manip_sim.records import EpisodeRecorder
from manip_sim.records.recorded import Record
from manip_sim.records.replay import Repetition, Replay
from manip_sim.tasks import Episode
from manip_sim.tasks.episode_actions import STEP_M, TURN_RAD

#: Words beside a motion: the task is done, drop this demonstration, no more of them.
EVENTS = DONE, DISCARD, QUIT = ('done', 'discard', 'quit')
_FILE, _LEROBOT, _GRIPPER = 'file:', 'lerobot:', 'gripper'
#: An axis that is not deflected further than this rests.
_DEAD = 0.1


@dataclass
class Reading:
    """
    Input of a device in a control period.

    :ivar motion: deflections along and about x, y, z of ``world``, from -1 to 1, shape (6,); of
        a file and a leader arm whole actions, of any length
    :ivar toggles: whether the gripper is to open or close
    :ivar event: one of :data:`EVENTS`, or empty
    """

    motion: FloatArray
    toggles: bool = False
    event: str = ''


class Device(ABC):
    """
    A device.

    :cvar is_live: whether a person moves it, in real time
    :cvar gives_actions: whether it says whole actions, not deflections
    :cvar help: which key or button does what
    """

    is_live = True
    gives_actions = False
    help = ''

    @abstractmethod
    def read(self) -> Reading:
        """
        Return what it says at present.

        :raises CommandError: if it is gone, or says what cannot be used
        """

    def end(self) -> None:  # noqa: B027
        """Be told that a demonstration has ended without an event."""

    def close(self) -> None:  # noqa: B027
        """Release it."""


class ActionFile(Device):
    """
    Actions of a CSV file: a column for each number, named as in a header, and one ``event``.

    :param path: of the file
    :param names: of the numbers of an action
    :raises ModelError: if the file cannot be used
    """

    is_live = False
    gives_actions = True

    def __init__(self, path: Path, names: Sequence[str]) -> None:
        try:
            with path.open(newline='') as file:
                header, *rows = [row for row in csv.reader(file) if row] or [[]]
        except (OSError, UnicodeDecodeError, csv.Error) as error:
            raise ModelError(f'{path}: {getattr(error, "strerror", None) or error}') from error
        wanted = [*names, 'event'] if 'event' in header else [*names]
        for name in header:
            if name not in wanted:
                raise UnknownNameError(f'column of {path}', name, [*names, 'event'])
        if len(header) != len(wanted):
            missing = next(name for name in wanted if name not in header)
            raise ModelError(f'{path} has no column {quoted(missing)}' if missing not in header
                             else f'{path} has a column twice')
        self._rest = iter([_of_row(f'{path}: row {number}', header, row, names)
                           for number, row in enumerate(rows, 2)])

    def read(self) -> Reading:
        """Return the next row; after the last one, that there are no more."""
        return next(self._rest, Reading(np.zeros(0), event=QUIT))

    def end(self) -> None:
        """Skip what is left of a demonstration, up to its event."""
        for reading in self._rest:
            if reading.event:
                break


def _of_row(location: str, header: Sequence[str], row: Sequence[str], names: Sequence[str]
            ) -> Reading:
    if len(row) != len(header):
        raise ModelError(f'{location} has {len(row)} cells, and the header has {len(header)}')
    cells = dict(zip(header, row))
    event = cells.get('event', '').strip()
    if event and event not in EVENTS:
        raise UnknownNameError(f'event in {location}', event, EVENTS)
    try:
        motion = np.array([float(cells[name]) for name in names])
    except ValueError as error:
        raise ModelError(f'{location}: {error}') from error
    if not np.isfinite(motion).all():
        raise ModelError(f'{location} has a number that is not finite')
    return Reading(motion, event=event)


class Keyboard(Device):
    """
    The terminal, whose keys move by a step and, while they repeat, go on.

    :raises ModelError: without a terminal
    """

    help = ('w s: x, a d: y, r f: z, i k: pitch, j l: yaw, u o: roll, space: gripper, return: '
            'done, backspace: discard, q: quit')
    _AXES = {key: (axis, sign) for axis, keys in enumerate(('ws', 'ad', 'rf', 'uo', 'ik', 'jl'))
             for key, sign in zip(keys, (1.0, -1.0))}
    _EVENTS = {'\r': DONE, '\n': DONE, '\x7f': DISCARD, '\x08': DISCARD, 'q': QUIT, '': QUIT}
    #: Time for which a key counts after it came: repeats come every 30 to 50 ms [s].
    _HELD_S = 0.15

    def __init__(self) -> None:
        if not sys.stdin.isatty():
            raise ModelError('the keyboard needs a terminal as its input; file:ACTIONS.csv needs '
                             'none')
        import termios
        import tty
        self._terminal, self._until = sys.stdin.fileno(), np.zeros((6, 2))
        self._before = termios.tcgetattr(self._terminal)
        # Keys that were typed before count.
        tty.setcbreak(self._terminal, termios.TCSADRAIN)

    def read(self) -> Reading:
        """Return the motion of the keys that are held, and what the others say."""
        reading, now = Reading(np.zeros(6)), time.monotonic()
        while select.select([self._terminal], [], [], 0.0)[0]:
            text = os.read(self._terminal, 64).decode(errors='replace')
            for key in text or ['']:
                if key in self._EVENTS:
                    reading.event = reading.event or self._EVENTS[key]
                elif key == ' ':
                    reading.toggles = not reading.toggles
                elif key in self._AXES:
                    axis, sign = self._AXES[key]
                    self._until[axis] = 0.0
                    self._until[axis, int(sign < 0.0)] = now + self._HELD_S
            if not text:
                break
        held = self._until > now
        reading.motion = held[:, 0].astype(float) - held[:, 1]
        return reading

    def close(self) -> None:
        """Give the terminal back as it was."""
        import termios
        termios.tcsetattr(self._terminal, termios.TCSADRAIN, self._before)


class EventDevice(Device):
    """
    A gamepad or a SpaceMouse, which the Linux kernel reports as an input device (evdev).

    :param kind: ``gamepad`` or ``spacemouse``
    :param device: an ``evdev.InputDevice``; None for the first one that has its axes
    :raises ModelError: if there is none, or evdev is not installed
    """

    help = ('gamepad: sticks and hat, A: gripper, start: done, select: discard, B: quit; '
            'spacemouse: cap, left button: gripper, right button: done')
    #: Types of events: button, relative and absolute axis.
    _BUTTON, _RELATIVE, _ABSOLUTE = 1, 2, 3
    #: By kind: codes of the axes of the six motions, and their signs.
    _AXES = {'spacemouse': ((1, -1.0), (0, -1.0), (2, -1.0), (4, -1.0), (3, -1.0), (5, -1.0)),
             'gamepad': ((1, -1.0), (0, -1.0), (4, -1.0), (16, 1.0), (17, 1.0), (3, -1.0))}
    _BUTTONS = {'spacemouse': {256: 'grip', 257: DONE},
                'gamepad': {304: 'grip', 305: QUIT, 314: DISCARD, 315: DONE}}
    #: Counts of a cap that is deflected completely, and after what time without a report of an
    #: axis it rests [s]. Caps report 60 times a second or more, most of them in turns the axes
    #: that they move along and those that they turn about, and no axis that rests.
    _FULL, _RESTS_S = 350.0, 0.15

    def __init__(self, kind: str, device: Any = None) -> None:
        self._axes = {code: (number, sign)
                      for number, (code, sign) in enumerate(self._AXES[kind])}
        self._buttons = self._BUTTONS[kind]
        self._device = _input_device(kind, set(self._axes)) if device is None else device
        self._values, self._reported_s = np.zeros(6), np.full(6, np.inf)

    def read(self) -> Reading:
        """Return the present deflections, and what the buttons say."""
        reading = Reading(self._values)
        for event in self._events():
            if event.type in (self._RELATIVE, self._ABSOLUTE) and event.code in self._axes:
                self._move(event)
            elif event.type == self._BUTTON and event.value == 1 and event.code in self._buttons:
                meaning = self._buttons[event.code]
                reading.toggles ^= meaning == 'grip'
                reading.event = reading.event or ('' if meaning == 'grip' else meaning)
        self._values[time.monotonic() - self._reported_s > self._RESTS_S] = 0.0
        reading.motion = self._values.copy()
        return reading

    def _move(self, event: Any) -> None:
        number, sign = self._axes[event.code]
        middle, half = 0.0, self._FULL
        if event.type == self._ABSOLUTE:
            info = self._device.absinfo(event.code)
            middle, half = 0.5 * (info.min + info.max), max(0.5 * (info.max - info.min), 1.0)
        else:
            self._reported_s[number] = time.monotonic()
        share = sign * (event.value - middle) / half
        self._values[number] = 0.0 if abs(share) < _DEAD else min(max(share, -1.0), 1.0)

    def _events(self) -> Iterator[Any]:
        try:
            yield from self._device.read()
        except BlockingIOError:  # Nothing has happened.
            return
        except OSError as error:
            raise CommandError(f'the device is gone: {error.strerror or error}') from error

    def close(self) -> None:
        """Release it."""
        self._device.close()


def is_spacemouse(name: str) -> bool:
    """Return whether a device of the kernel is a SpaceMouse, by its name."""
    # A wireless one has the name of its receiver, 3Dconnexion Universal Receiver.
    return any(word in name.lower() for word in ('space', '3dconnexion'))


def _input_device(kind: str, axes: set[int]) -> Any:
    """Return the first device of the kernel that has all axes."""
    try:
        import evdev
    except ImportError as error:
        raise ModelError(f'a {kind} needs evdev: pip install evdev') from error
    for path in evdev.list_devices():
        device = evdev.InputDevice(path)
        capabilities = device.capabilities(absinfo=False)
        if is_spacemouse(device.name) == (kind == 'spacemouse') and any(
                axes <= set(capabilities.get(of_type, ())) for of_type in (2, 3)):
            return device
        device.close()
    raise ModelError(f'no {kind} is connected, or /dev/input may not be read: join the group '
                     'input')


class LeaderArm(Device):
    """
    A leader arm of LeRobot, whose joints lead those of the robot; the keyboard says events.

    Its arm is in degrees, and its gripper counts from 0 (closed) to 100 (open), as LeRobot's
    own leaders do.

    :param leader: a ``lerobot.teleoperators.Teleoperator``, connected
    :param names: of the numbers of an action of kind ``joint_position``
    :raises ModelError: if it has other joints than the robot
    """

    gives_actions = True

    def __init__(self, leader: Any, names: Sequence[str]) -> None:
        self._leader = leader
        motors = [key.removesuffix(POSITION) for key in leader.action_features]
        #: By number of an action: the key of the leader, and whether it is of a gripper.
        self._keys: list[tuple[str, bool]] = []
        for name in names:
            is_gripper = name.endswith(f'/{_GRIPPER}')
            candidates = [motor for motor in motors if (motor == _GRIPPER) == is_gripper and (
                is_gripper or name == motor or name.endswith(f'_{motor}'))]
            if len(candidates) != 1:
                raise ModelError(f'the leader has {len(candidates)} joints for {quoted(name)}: it '
                                 f'has {quoted_names(motors)}, the robot {quoted_names(names)}')
            self._keys.append((candidates[0] + POSITION, is_gripper))
        self._keyboard = Keyboard() if sys.stdin.isatty() else None
        self.help = '' if self._keyboard is None else (
            'return: done, backspace: discard, q: quit')

    def read(self) -> Reading:
        """Return where the leader is, as an action, and what the keys say."""
        try:
            said = self._leader.get_action()
        except OSError as error:  # A ConnectionError of LeRobot, or one of the serial port.
            raise CommandError(f'the leader arm is gone: {error}') from error
        action = np.array([1.0 - float(said[key]) / 50.0 if is_gripper else
                           math.radians(said[key]) for key, is_gripper in self._keys])
        event = '' if self._keyboard is None else self._keyboard.read().event
        return Reading(action, event=event)

    def close(self) -> None:
        """Release it, and the terminal."""
        if self._keyboard is not None:
            self._keyboard.close()
        self._leader.disconnect()


def open_leader(description: str) -> Any:
    """
    Return a connected leader arm of LeRobot, which may ask for its calibration.

    :param description: its type and options, such as ``so101_leader,port=/dev/ttyACM0,id=blue``
    :raises ModelError: if LeRobot is not installed, an option cannot be used, or it is not there
    :raises UnknownNameError: if LeRobot knows no such type
    """
    try:
        import draccus
        from lerobot import teleoperators
        from lerobot.utils.import_utils import register_third_party_plugins
    except ImportError as error:
        raise ModelError('a leader arm needs LeRobot, with Python 3.12: pip install lerobot'
                         ) from error
    register_third_party_plugins()
    for module in pkgutil.iter_modules(teleoperators.__path__):
        try:
            importlib.import_module(f'{teleoperators.__name__}.{module.name}')
        except ImportError:  # Of a device whose driver is not installed.
            continue
    kind, *rest = description.split(',')
    known = teleoperators.TeleoperatorConfig.get_known_choices()
    if kind not in known:
        raise UnknownNameError('leader arm of LeRobot', kind, known)
    options = {key: yaml.safe_load(value) for key, _, value in (
        option.partition('=') for option in rest)}
    try:
        leader = teleoperators.make_teleoperator_from_config(draccus.decode(
            teleoperators.TeleoperatorConfig, {'type': kind, **options}))
        leader.connect()
    except (draccus.utils.DraccusException, OSError, ImportError, ValueError) as error:
        raise ModelError(f'{quoted(description)}: {error}') from error
    return leader


def action_of(name: str) -> str:
    """
    Return the kind of actions that a device needs.

    :param name: of the device, as for :func:`open_device`
    """
    return 'joint_position' if name.startswith(_LEROBOT) else 'osc_pose'


def open_device(name: str, actions: Sequence[str]) -> Device:
    """
    Return a device by its name, except that of the browser.

    :param name: ``keyboard``, ``gamepad``, ``spacemouse``, ``file:ACTIONS.csv``, or as for
        :func:`open_leader` ``lerobot:TYPE,OPTION=VALUE``
    :param actions: names of the numbers of an action
    :raises ModelError: if it is not there, or cannot be used
    :raises UnknownNameError: if the device is unknown
    """
    if name.startswith(_FILE):
        return ActionFile(Path(name.removeprefix(_FILE)), actions)
    if name.startswith(_LEROBOT):
        leader = open_leader(name.removeprefix(_LEROBOT))
        try:
            return LeaderArm(leader, actions)
        except BaseException:
            leader.disconnect()
            raise
    if name == 'keyboard':
        return Keyboard()
    if name in EventDevice._AXES:
        return EventDevice(name)
    raise UnknownNameError('device', name, [
        'keyboard', 'browser', *EventDevice._AXES, f'{_FILE}ACTIONS.csv', f'{_LEROBOT}TYPE'])


def external_force(episode: Episode) -> float:
    """Return the greatest external force on a gripper of an episode [N]."""
    return max((float(np.linalg.norm(robot.sensing.measured(f'{arm}/external_wrench')[:3]))
                for robot in episode.simulation.robots.values()
                for arm in robot.end_effectors), default=0.0)


#: Speed at full deflection with which the goal of an end effector goes ahead of it [m/s, rad/s].
_SPEED, _TURN = 0.25, 1.0


@dataclass(frozen=True)
class Demonstration:
    """
    A demonstration.

    :ivar seed: of its start
    :ivar file: its record; None if it was discarded
    :ivar success: whether it ended with success
    :ivar periods: control periods
    :ivar repetition: what came of repeating it; None if it was discarded
    :ivar quits: whether there are to be no more
    """

    seed: int
    file: Path | None
    success: bool
    periods: int
    repetition: Repetition | None
    quits: bool

    @property
    def repeats(self) -> bool:
        """True if the record repeats to the same end, to the last bit."""
        return self.repetition is not None and self.repetition.difference is None


class Demonstrator:
    """
    Lets a device act in episodes.

    :param episode: of the task, with actions ``osc_pose``; a device that gives actions may have
        others
    :param device: that acts
    :param folder: of the records, which are called SEED.mcap
    :param settings: for the records, JSON
    :param show: is called after each period with time [s], success and external force [N]
    """

    def __init__(self, episode: Episode, device: Device, folder: Path,
                 settings: Mapping[str, Any],
                 show: Callable[[float, bool, float], object] = lambda *_: None) -> None:
        self._episode, self._device, self._folder = episode, device, folder
        self._settings, self._show = dict(settings), show
        self._replay = Replay()
        self._scale = np.repeat([_SPEED / STEP_M, _TURN / TURN_RAD], 3) * episode.period_s

    def run(self, seed: int) -> Demonstration:
        """
        Let the device act in the episode of a seed, record it, and repeat the record.

        :raises ManipSimError: if the device or the physics fails, or nothing can be recorded; then
            there is no record
        """
        episode = self._episode
        unfinished = self._folder / f'.{seed}.mcap'
        episode.reset(seed)
        try:
            with EpisodeRecorder(unfinished, episode, self._settings, overwrite=True) as recorder:
                recorder.begin(seed)
                event = self._act(recorder)
                recorder.end()
            success, kept = episode.success, event != DISCARD and episode.periods and (
                event != QUIT or not self._device.is_live)
            if not kept:
                return Demonstration(seed, None, success, episode.periods, None, event == QUIT)
            file = unfinished.rename(self._folder / f'{seed}.mcap')
        finally:
            unfinished.unlink(missing_ok=True)
        (recorded,) = Record(file).episodes()
        return Demonstration(seed, file, success, episode.periods, self._replay.repeat(recorded),
                             event == QUIT)

    def _act(self, recorder: EpisodeRecorder) -> str:
        """Act until the episode or the demonstration ends; return the event that ended it."""
        episode, closing = self._episode, np.full(len(self._episode.actions.arms), -1.0)
        reading = self._first()
        due_s = time.monotonic()
        while not episode.over:
            if episode.periods:
                reading = self._device.read()
            if reading.event:
                return reading.event
            if reading.toggles:
                closing[0] = -closing[0]
            action = self._action(reading.motion, closing)
            episode.step(action)
            recorder.period(action)
            self._show(episode.periods * episode.period_s, episode.success,
                       external_force(episode))
            if self._device.is_live:
                # Time that a slow machine has lost is not made up for: a person would not keep up.
                now_s = time.monotonic()
                due_s = max(due_s + episode.period_s, now_s)
                time.sleep(due_s - now_s)
        self._device.end()
        return ''

    def _first(self) -> Reading:
        """Return the first reading; without one of whole actions, wait for one that acts."""
        device, episode = self._device, self._episode
        reading = device.read()
        while not (device.gives_actions or reading.event or reading.toggles
                   or reading.motion.any()):
            self._show(0.0, episode.success, external_force(episode))
            time.sleep(episode.period_s)
            reading = device.read()
        return reading

    def _action(self, motion: FloatArray, closing: FloatArray) -> FloatArray:
        """Return the action of a motion; a person moves the first arm."""
        if self._device.gives_actions:
            return motion
        action = np.zeros(self._episode.actions.size)
        for index, item in enumerate(self._episode.actions.arms):
            if index == 0:
                action[item.goals] = motion * self._scale
            action[item.gripper] = closing[index]
        return action
