# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Saved poses: joint positions by name, kept in a file if there is one, and their panel."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
import json
import math
from pathlib import Path
import re
from typing import Any

from manip_sim.errors import ManipSimError
from manip_sim.quoting import quoted
from manip_sim.viewer.page.latest import Latest
from manip_sim.viewer.page.page_commands import Events, PageCommands
from manip_sim.viewer.page.robots import Robot, ShownJoint, ShownPart

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
        """Return the positions by joint; empty if there is no such pose."""
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

    :param poses: what is saved
    :param robots: of the node
    :param notify: called with what could not be done, for people
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
