# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Names of topics, services, actions and joints as the driver of a real arm has them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
import re
from typing import Any

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.interface.topics import ACTIONS, GRIPPER, SERVICES, TOKEN, TOPICS
from manip_sim.models.grippers import GripperModel
from manip_sim.models.user_files import parse_yaml
from manip_sim.quoting import quoted, quoted_names
from manip_sim.resources import share_directory
from manip_sim.simulation import SimulatedRobot

#: Sections of a file, each a mapping from our names to the driver's.
_NAMES, _JOINTS = ('topics', 'services', 'actions'), ('joints', 'gripper_joints')
_SOURCE = 'source'
_NAME = re.compile(rf'(~/)?{TOKEN.pattern}(/{TOKEN.pattern})*')
_PLACEHOLDER = re.compile('<[a-z]+>')


@dataclass(frozen=True)
class JointNames:
    """
    Names of joints in messages.

    :ivar by_own: those that are not the model's own, by the model's own
    """

    by_own: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def _by_public(self) -> dict[str, str]:
        return {public: internal for internal, public in self.by_own.items()}

    def public(self, names: Iterable[str]) -> list[str]:
        """Return what joints are called in messages."""
        return [self.by_own.get(name, name) for name in names]

    def own(self, names: Sequence[str]) -> Sequence[str]:
        """Return what joints of a message are called in the model; own names are taken too."""
        if not self.by_own:
            return names
        return [self._by_public.get(name, name) for name in names]


@dataclass(frozen=True)
class Profile:
    """
    A profile.

    :ivar name: of the profile; empty if it changes nothing
    :ivar names: of topics, services and actions in the driver, by ours
    :ivar joints: of the arm in the driver, by those of the file of the robot
    :ivar gripper_joints: of the gripper in the driver, by those of its file
    """

    name: str = ''
    names: Mapping[str, str] = field(default_factory=dict)
    joints: Mapping[str, str] = field(default_factory=dict)
    gripper_joints: Mapping[str, str] = field(default_factory=dict)

    def joint_names(self, robot: SimulatedRobot) -> JointNames:
        """
        Return the names of the joints of a robot in messages.

        :raises ModelError: if it lacks joints of the arm
        """
        model = robot.robot_model
        by_own = {model.correct_naming(raw): name for raw, name in self.joints.items()}
        missing = [raw for raw in self.joints if model.correct_naming(raw) not in model.joints]
        if missing:
            raise ModelError(f"parameter 'profile': {self.name} is for another robot than "
                             f'{model.type_name}, which has no joints {quoted_names(missing)}')
        for part in model.models:
            if isinstance(part, GripperModel):
                by_own |= {part.correct_naming(raw): name
                           for raw, name in self.gripper_joints.items()
                           if part.correct_naming(raw) in part.joints}
        return JointNames(by_own)


def profiles_folder() -> Path:
    """Return the folder of the profiles of this package."""
    return share_directory() / 'config' / 'profiles'


def load_profile(name: str) -> Profile:
    """
    Return a profile.

    :param name: of a file in :func:`profiles_folder` without its suffix, or path of a YAML file;
        empty for one that changes nothing
    :raises UnknownNameError: if there is none, or the node has no such topic, service or action
    :raises ModelError: if the file cannot be used
    """
    if not name:
        return Profile()
    path = Path(name).expanduser()
    if path.suffix != '.yaml':
        known = sorted(file.stem for file in profiles_folder().glob('*.yaml'))
        if name not in known:
            raise UnknownNameError('profile', name, [*known, 'FILE.yaml'])
        path = profiles_folder() / f'{name}.yaml'
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ModelError(f'{path}: {error.strerror or error}') from error
    sections = parse_yaml(content, str(path))
    for section in sections:
        if section not in (*_NAMES, *_JOINTS, _SOURCE):
            raise UnknownNameError(f'section of {path}', section, [*_NAMES, *_JOINTS, _SOURCE])
    tables = {section: _table(path, section, sections.get(section, {}))
              for section in (*_NAMES, *_JOINTS)}
    names = {ours: name for section in _NAMES for ours, name in tables[section].items()}
    _check_names(path, tables, names)
    return Profile(name, names, tables['joints'], tables['gripper_joints'])


def _table(path: Path, section: str, table: Any) -> dict[str, str]:
    """Return a section, each of whose names is valid and given once."""
    if not isinstance(table, dict) or not all(
            isinstance(text, str) for item in table.items() for text in item):
        raise ModelError(f'{path}: {section} must hold names by names')
    for name in table.values():
        if not (_NAME if section in _NAMES else TOKEN).fullmatch(name):
            raise ModelError(f'{path}: {section}: {quoted(name)} is no relative or private name '
                             'of ROS' if section in _NAMES else
                             f'{path}: {section}: {quoted(name)} is no name of a joint')
        if [*table.values()].count(name) > 1:
            raise ModelError(f'{path}: {section}: {quoted(name)} is there twice')
    return table


def _check_names(path: Path, tables: Mapping[str, Mapping[str, str]], names: Mapping[str, str]
                 ) -> None:
    """Check that the node has what is renamed, and that nothing is renamed twice."""
    rows = [row.name for row in TOPICS], [row.name for row in SERVICES], [
        row.name for row in ACTIONS]
    for section, patterns in zip(_NAMES, rows):
        for ours, name in tables[section].items():
            if not any(_pattern(pattern).fullmatch(ours) for pattern in patterns):
                raise UnknownNameError(f'name in {section} of {path}', ours, patterns)
            if name in names:
                raise ModelError(f'{path}: {quoted(name)} is a name of the node too')


def _pattern(name: str) -> re.Pattern[str]:
    """Return what matches the names that a row of a table is for."""
    arm = '(right|left)'
    parts = re.split(f'({GRIPPER}|{_PLACEHOLDER.pattern})', name)
    return re.compile(''.join(
        f'{arm}/gripper' if part == GRIPPER else f'({TOKEN.pattern})'
        if _PLACEHOLDER.fullmatch(part) else re.escape(part) for part in parts))
