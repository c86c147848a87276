# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Commands that people give on the page, saved poses, and a queue between threads."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
import json
import math
from pathlib import Path
import queue
import re
from typing import Any, Protocol

from manip_sim.arrays import FloatArray
from manip_sim.errors import ManipSimError
from manip_sim.quoting import quoted
from manip_sim.viewer.page.latest import Latest, Robot, ShownJoint, ShownPart

#: Least time for which a request of a person is shown [s]; also until nothing moves.
_HOLD_S = 1.0


class PageCommands(Protocol):
    """
    A receiver of the commands that people give on the page; called in one thread.

    A page without one can only be watched.
    """

    def move_joints(self, space: str, part: str, field: str, goals: Mapping[str, float]) -> None:
        """
        Command joints.

        :param space: namespace of the robot's topics, such as ``/left/``
        :param part: that the joints belong to
        :param field: of the commands, such as ``position``
        :param goals: by joint [rad or m, rad/s or m/s, N m or N]
        """

    def act(self, space: str, part: str, action: float) -> None:
        """Send an action in [-1, 1], the same for all fingers of a gripper; +1 closes."""

    def drive(self, space: str, twist: tuple[float, float, float]) -> None:
        """Send a velocity of a mobile base along its x and y and about z [m/s, m/s, rad/s]."""

    def reach(self, space: str, arm: str, position: FloatArray, quat_wxyz: FloatArray) -> None:
        """Send a target pose of an end effector in ``world``; the position in [m]."""

    def pull(self, body: str, number: int, point: FloatArray, target: FloatArray) -> None:
        """
        Pull a body for a moment.

        :param number: of the drag; while it stays the same, the point does not count again
        :param point: of the body, in ``world`` [m], shape (3,)
        :param target: where the point is pulled to, in ``world`` [m], shape (3,)
        """

    def let_go(self, body: str) -> None:
        """End the pull of a body."""

    def modes(self, space: str, part: str) -> Sequence[str]:
        """Return the control modes that a part can be switched to; none if it has no choice."""

    def switch_mode(self, space: str, part: str, mode: str) -> None:
        """Switch the control mode of a part."""

    def record(self, wanted: bool) -> None:
        """Begin or end a record of the node."""

    def pause(self, paused: bool) -> None:
        """Pause the simulation, or let it go on."""

    def step(self) -> None:
        """Advance a paused simulation by one control period."""

    def reset(self) -> None:
        """Bring the simulation back to its start."""

    def tare(self) -> None:
        """Tare the external wrenches: let them read zero now."""


class Events:
    """A queue of calls, from threads of the server to the thread that updates the page."""

    def __init__(self) -> None:
        self._waiting: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()

    def add(self, event: Callable[[], None]) -> None:
        """Queue a call for the next :meth:`run`."""
        self._waiting.put(event)

    def run(self) -> None:
        """Make the queued calls, in the order in which they came."""
        for _ in range(self._waiting.qsize()):
            self._waiting.get()()


class Following:
    """
    The choice whether an input shows the measured or the requested value.

    A goal that is not reached, such as one behind an obstacle, is given up when all is still.
    """

    def __init__(self) -> None:
        self._until_s: float | None = None

    def asked(self, now_s: float) -> None:
        """Note that a person has changed the input; ``now_s`` is wall time [s]."""
        self._until_s = now_s + _HOLD_S

    def follows(self, now_s: float, moving: bool) -> bool:
        """
        Tell whether the input is to show the measured value.

        :param now_s: wall time [s]
        :param moving: whether the measured value changes, or cannot because of a pause
        """
        if self._until_s is None:
            return True
        if moving:
            self._until_s = max(self._until_s, now_s + 0.2 * _HOLD_S)
        if now_s > self._until_s:
            self._until_s = None
        return self._until_s is None


_NAME = re.compile(r'\w[\w -]{0,39}')
#: Number of poses, and size of their file [bytes], at most.
_MOST, _MAX_BYTES = 100, 2**20
_NONE = '(none saved)'
_POSITION = 'position'


class Poses:
    """
    Joint positions [rad or m] by joint, by the name of the pose.

    :param file: keeps them in JSON, and is written at each change; None keeps them in memory
    :raises ManipSimError: if the file cannot be read, or holds anything else
    """

    def __init__(self, file: Path | None = None) -> None:
        self._file = file
        self._poses = {} if file is None else _read(file)

    @property
    def names(self) -> list[str]:
        return sorted(self._poses)

    def get(self, name: str) -> dict[str, float]:
        """Return the positions by joint; empty if the pose is unknown."""
        return dict(self._poses.get(name, {}))

    def save(self, name: str, joints: Mapping[str, float]) -> None:
        """
        Add a pose, or replace the one of this name.

        :raises ManipSimError: if the name cannot be used, there are too many poses, or the file
            cannot be written; nothing changes then
        """
        if not _NAME.fullmatch(name):
            raise ManipSimError(f'{quoted(name)} cannot name a pose: use 1 to 40 letters, '
                                'digits, spaces, _ or -')
        if name not in self._poses and len(self._poses) >= _MOST:
            raise ManipSimError(f'there are {_MOST} poses already: delete one first')
        self._change({**self._poses, name: dict(joints)})

    def delete(self, name: str) -> None:
        """
        Delete a pose; an unknown name is ignored.

        :raises ManipSimError: if the file cannot be written; nothing changes then
        """
        self._change({other: joints for other, joints in self._poses.items() if other != name})

    def _change(self, poses: dict[str, dict[str, float]]) -> None:
        if self._file is not None:
            new = self._file.with_name(f'{self._file.name}.new')
            try:
                new.write_text(json.dumps(poses, indent=1) + '\n')
                new.replace(self._file)
            except OSError as error:
                raise ManipSimError(
                    f'cannot write {self._file}: {error.strerror or error}') from error
        self._poses = poses


def _read(file: Path) -> dict[str, dict[str, float]]:
    try:
        with file.open('rb') as stream:
            poses = json.loads(stream.read(_MAX_BYTES))
    except FileNotFoundError:
        if file.parent.is_dir():
            return {}
        raise ManipSimError(f'no such folder: {file.parent}') from None
    except OSError as error:
        raise ManipSimError(f'cannot read {file}: {error.strerror or error}') from error
    except (ValueError, RecursionError) as error:
        raise ManipSimError(f'{file} is not JSON: {error}') from error
    if not (isinstance(poses, dict) and len(poses) <= _MOST
            and all(_NAME.fullmatch(name) and _is_pose(pose) for name, pose in poses.items())):
        raise ManipSimError(f'{file} holds no poses: expected at most {_MOST} names, each with '
                            'finite positions by joint')
    return poses


def _is_pose(pose: Any) -> bool:
    return isinstance(pose, dict) and all(
        type(position) in (int, float) and abs(position) < math.inf for position in pose.values())


class PosePanel:
    """
    A folder that saves where the joints are under a name, and moves them there again.

    A pose has the joints with a slider of all parts that take positions.

    :param poses: that are saved
    :param robots: of the node
    :param notify: called with a message for people, if something could not be done
    """

    def __init__(self, gui: Any, poses: Poses, robots: Sequence[Robot], commands: PageCommands,
                 events: Events, notify: Callable[[str], None]) -> None:
        self._poses, self._robots = poses, robots
        self._commands, self._notify = commands, notify
        self._latest, self._fields = Latest(), dict[str, str]()
        with gui.add_folder('Poses', expand_by_default=False, order=-2.0):
            self._choice = gui.add_dropdown('Pose', self._options)
            gui.add_button_group('Saved', ('Go to pose', 'Delete')).on_click(
                lambda event: events.add(
                    self._delete if event.target.value == 'Delete' else self._go))
            self._name = gui.add_text('Name', '', hint='of the pose to save')
            gui.add_button('Save pose').on_click(
                lambda _: events.add(self._save))

    def update(self, latest: Latest, fields: Mapping[str, str]) -> None:
        """Take the newest states, and by part the field that its commands use."""
        self._latest, self._fields = latest, dict(fields)

    @property
    def _options(self) -> tuple[str, ...]:
        return tuple(self._poses.names) or (_NONE,)

    def _parts(self) -> Iterator[tuple[Robot, ShownPart, str]]:
        """Yield robots and parts that have sliders, with the fields of their commands."""
        for robot in self._robots:
            for part in robot.parts:
                if part.joints:
                    yield robot, part, self._fields.get(
                        robot.status_name(part.name), _POSITION)

    def _save(self) -> None:
        joints = {}
        for robot, part, field in self._parts():
            states = self._latest.joints.get(robot.space)
            if states is not None and field == _POSITION:
                measured = dict(zip(states.names, states.position))
                joints.update({joint.name: _within(joint, float(measured[joint.name]))
                               for joint in part.joints if joint.name in measured})
        name = str(self._name.value).strip()
        if not joints:
            self._notify('no pose saved: no part takes position commands')
        elif self._done(lambda: self._poses.save(name, joints)):
            self._choice.options = self._options
            self._choice.value = name
            self._name.value = ''

    def _delete(self) -> None:
        if self._done(lambda: self._poses.delete(str(self._choice.value))):
            self._choice.options = self._options

    def _go(self) -> None:
        pose = self._poses.get(str(self._choice.value))
        moved = False
        for robot, part, field in self._parts():
            goals = {joint.name: _within(joint, pose[joint.name]) for joint in part.joints
                     if joint.name in pose}
            if goals and field != _POSITION:
                self._notify(f'{robot.titled(part.name)} takes {field} commands: a pose needs '
                             'position commands')
            elif goals:
                self._commands.move_joints(robot.space, part.name, _POSITION, goals)
            moved = moved or bool(goals)
        if pose and not moved:
            self._notify('this pose has no joint of these robots')

    def _done(self, change: Callable[[], None]) -> bool:
        try:
            change()
        except ManipSimError as error:
            self._notify(str(error))
            return False
        return True


def _within(joint: ShownJoint, position: float) -> float:
    low, high = joint.ranges[_POSITION]
    return min(max(position, low), high)
