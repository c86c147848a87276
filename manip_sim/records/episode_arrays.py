# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A recorded episode as arrays, in which an action has the row of the state that it was for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import FloatArray
from manip_sim.errors import RecordError
from manip_sim.interface.topics import BY_NAME
from manip_sim.quoting import quoted
from manip_sim.records.recorded import RecordedEpisode
from manip_sim.records.recorder import ACTION, GOAL, REWARD, SUCCESS
from manip_sim.records.untrusted_records import finite, image

#: Of the topics of exact values, after the name of the robot if there are several, and of objects.
_TRUTH, _OBJECTS = 'truth', 'objects'
_IMAGE = BY_NAME['<camera>/color/image_raw/compressed']


@dataclass(frozen=True)
class Columns:
    """
    Something that was observed.

    :ivar values: at the start and after each control period, in SI units, shape (periods + 1, n)
    :ivar names: of the numbers, n of them
    """

    values: NDArray[Any]
    names: list[str]


@dataclass
class Quantities:
    """
    Measured quantities of robots and objects at the start and after each control period.

    :ivar positions: joint positions by robot [rad or m]
    :ivar velocities: joint velocities by robot [rad/s or m/s]
    :ivar end_effectors: poses of ``grip_site`` by robot and arm: position [m] and quaternion
        x, y, z, w
    :ivar objects: poses of free bodies by name
    :ivar goal: what the task has as its goal, or None
    """

    positions: dict[str, Columns] = field(default_factory=dict)
    velocities: dict[str, Columns] = field(default_factory=dict)
    end_effectors: dict[str, Columns] = field(default_factory=dict)
    objects: dict[str, Columns] = field(default_factory=dict)
    goal: Columns | None = None


class Frames:
    """
    The control periods of an episode.

    :param recorded: the episode
    :raises RecordError: if it has no actions, or a topic does not have a message of each period
    :ivar recorded: the episode
    :ivar actions: shape (periods, n)
    :ivar rewards: after each period, shape (periods,)
    :ivar done: whether the task is done after each period, shape (periods,)
    :ivar observed: as a policy observes it, with noise and latency
    :ivar truth: exactly, at the present instant; None where observations are exact
    """

    def __init__(self, recorded: RecordedEpisode) -> None:
        self.recorded = recorded
        self.actions = finite(recorded.actions, ACTION)
        self._count = len(self.actions)
        if not self.actions.size:
            raise RecordError(f'episode {recorded.number} has no actions')
        if not 0 <= recorded.seed < 2**63:
            raise RecordError(f'episode {recorded.number} has the seed {quoted(recorded.seed)}, '
                              'and data sets hold whole numbers below 2^63')
        self.rewards = finite(np.array([
            m.data for m in recorded.decoded(REWARD, 'std_msgs/Float64')]), REWARD)
        self.done = np.array([m.data for m in recorded.decoded(SUCCESS, 'std_msgs/Bool')], bool)
        for values, noun in ((self.rewards, 'rewards'), (self.done, 'results')):
            self._check(len(values), noun, self._count)
        self.observed, truth = Quantities(), Quantities()
        for topic in recorded.types:
            names = topic.strip('/').split('/')
            is_truth = _TRUTH in names[:2] and names[0] != _OBJECTS
            if is_truth:
                names.remove(_TRUTH)
            self._read(truth if is_truth else self.observed, topic, names)
        self.truth = truth if truth.positions else None
        goal = finite(recorded.arrays(GOAL), GOAL)
        if goal.size:
            self.observed.goal = Columns(goal, [f'goal{n}' for n in range(goal.shape[1])])

    def _read(self, into: Quantities, topic: str, names: list[str]) -> None:
        *scope, last = names
        if last == 'joint_states' and len(scope) < 2:
            robot = scope[0] if scope else next(iter(self.robots), '')
            messages = self.recorded.decoded(topic, 'sensor_msgs/JointState')
            self._check(len(messages), topic)
            names = list(messages[0].name)
            for series, member in ((into.positions, 'position'), (into.velocities, 'velocity')):
                self._add(series, robot, topic, Columns(
                    _rows([getattr(m, member) for m in messages], topic, len(names)), names))
        elif last == 'eef_pose' and scope:
            name = '/'.join(scope if len(scope) > 1 else [next(iter(self.robots), ''), *scope])
            self._add(into.end_effectors, name, topic, self._poses(topic, name))
        elif last == 'pose' and scope[:1] == [_OBJECTS]:
            name = '/'.join(scope[1:])
            self._add(into.objects, name, topic, self._poses(topic, name))

    def _add(self, columns: dict[str, Columns], name: str, topic: str, quantity: Columns) -> None:
        if not name:
            raise RecordError(f'{topic} does not say of what it is')
        if name in columns:
            raise RecordError(f'{topic} is of {quoted(name)}, as another topic is')
        columns[name] = Columns(finite(quantity.values, topic), quantity.names)

    def _poses(self, topic: str, name: str) -> Columns:
        messages = self.recorded.decoded(topic, 'geometry_msgs/PoseStamped')
        self._check(len(messages), topic)
        poses = [m.pose for m in messages]
        return Columns(np.array([[p.position.x, p.position.y, p.position.z, p.orientation.x,
                                  p.orientation.y, p.orientation.z, p.orientation.w]
                                 for p in poses]),
                       [f'{name}/{axis}' for axis in ('x', 'y', 'z', 'qx', 'qy', 'qz', 'qw')])

    def _check(self, count: int, noun: str, expected: int | None = None) -> None:
        expected = self._count + 1 if expected is None else expected
        if count != expected:
            raise RecordError(f'episode {self.recorded.number} has {count} messages of {noun} for '
                              f'{self._count} control periods, it should have {expected}')

    @property
    def robots(self) -> dict[str, dict[str, list[str]]]:
        """The names of joints by robot and part."""
        robots: dict[str, Any] = json.loads(self.recorded.about['robots'])
        return robots

    @property
    def fingers(self) -> set[str]:
        """The names of the joints of grippers."""
        return {joint for parts in self.robots.values() for part, joints in parts.items()
                if part.endswith('gripper') for joint in joints}

    @property
    def cameras(self) -> dict[str, str]:
        """The topics of images by camera."""
        return {camera: topic for topic in self.recorded.types
                if (camera := _IMAGE.of_name(topic.removeprefix('/')))}

    def images(self, camera: str) -> Iterator[NDArray[np.uint8]]:
        """
        Yield the images of a camera, at the start and after each period but the last.

        :param camera: its name
        :returns: arrays of one shape (height, width, 3), rgb
        :raises RecordError: if one is missing or cannot be read, or they differ in size
        """
        topic = self.cameras[camera]
        messages = self.recorded.decoded(topic, 'sensor_msgs/CompressedImage')
        self._check(len(messages), topic)
        shape: tuple[int, ...] = ()
        for message in messages[:-1]:
            picture = image(bytes(message.data), f'an image of {camera}')
            if picture.shape != (shape or picture.shape):
                raise RecordError(f'images of {camera} differ in size')
            shape = picture.shape
            yield picture


def _rows(rows: list[Any], topic: str, count: int) -> FloatArray:
    if any(len(row) != count for row in rows):
        raise RecordError(f'{topic} has arrays of different lengths')
    return np.array(rows, dtype=np.float64).reshape(len(rows), count)
