# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A recorded episode as arrays, in which an action has the row of the state that it was for."""

from __future__ import annotations

from dataclasses import dataclass
import io
import json
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from manip_sim.arrays import FloatArray
from manip_sim.errors import RecordError
from manip_sim.records.recorded import RecordedEpisode
from manip_sim.records.recorder import GOAL, REWARD, SUCCESS

_IMAGE = re.compile(r'/(?P<camera>.+)/color/image_raw/compressed')


@dataclass(frozen=True)
class Columns:
    """
    Something that was observed.

    :ivar values: at the start and after each control period, in SI units, shape (periods + 1, n)
    :ivar names: of the numbers, n of them
    """

    values: NDArray[Any]
    names: list[str]


class Frames:
    """
    The control periods of an episode.

    :param recorded: the episode
    :raises RecordError: if it has no actions, or a topic does not have a message of each period
    :ivar recorded: the episode
    :ivar actions: shape (periods, n)
    :ivar rewards: after each period, shape (periods,)
    :ivar done: whether the task is done after each period, shape (periods,)
    :ivar positions: joint positions by robot [rad or m]
    :ivar velocities: joint velocities by robot [rad/s or m/s]
    :ivar hands: poses of ``grip_site`` by robot and arm: position [m] and quaternion x, y, z, w
    :ivar objects: poses of free bodies by name
    :ivar goal: what the task has as its goal, or None
    """

    def __init__(self, recorded: RecordedEpisode) -> None:
        self.recorded = recorded
        self.actions = recorded.actions
        self._count = len(self.actions)
        if not self._count:
            raise RecordError(f'episode {recorded.number} has no actions')
        self.rewards = np.array([m.data for m in recorded.decoded(REWARD, 'std_msgs/Float64')])
        self.done = np.array([m.data for m in recorded.decoded(SUCCESS, 'std_msgs/Bool')], bool)
        for values, what in ((self.rewards, 'rewards'), (self.done, 'results')):
            self._check(len(values), what, self._count)
        self.positions: dict[str, Columns] = {}
        self.velocities: dict[str, Columns] = {}
        self.hands: dict[str, Columns] = {}
        self.objects: dict[str, Columns] = {}
        for topic in recorded.types:
            self._read(topic)
        goal = recorded.arrays(GOAL)
        self.goal = Columns(goal, [f'goal{index}' for index in range(goal.shape[1])]
                            ) if goal.size else None

    def _read(self, topic: str) -> None:
        *scope, last = topic.strip('/').split('/')
        if last == 'joint_states' and len(scope) < 2:
            robot = scope[0] if scope else next(iter(self.robots), '')
            messages = self.recorded.decoded(topic, 'sensor_msgs/JointState')
            self._check(len(messages), topic)
            names = list(messages[0].name)
            for found, field in ((self.positions, 'position'), (self.velocities, 'velocity')):
                found[robot] = Columns(_rows([getattr(m, field) for m in messages], topic,
                                             len(names)), names)
        elif last == 'eef_pose' and scope:
            name = '/'.join(scope if len(scope) > 1 else [next(iter(self.robots), ''), *scope])
            self.hands[name] = self._poses(topic, name)
        elif last == 'pose' and scope[:1] == ['objects']:
            self.objects[scope[1]] = self._poses(topic, scope[1])

    def _poses(self, topic: str, name: str) -> Columns:
        messages = self.recorded.decoded(topic, 'geometry_msgs/PoseStamped')
        self._check(len(messages), topic)
        poses = [m.pose for m in messages]
        return Columns(np.array([[p.position.x, p.position.y, p.position.z, p.orientation.x,
                                  p.orientation.y, p.orientation.z, p.orientation.w]
                                 for p in poses]),
                       [f'{name}/{axis}' for axis in ('x', 'y', 'z', 'qx', 'qy', 'qz', 'qw')])

    def _check(self, found: int, what: str, wanted: int | None = None) -> None:
        wanted = self._count + 1 if wanted is None else wanted
        if found != wanted:
            raise RecordError(f'episode {self.recorded.number} has {found} messages of {what} for '
                              f'{self._count} control periods, it should have {wanted}')

    @property
    def robots(self) -> dict[str, dict[str, list[str]]]:
        """The names of joints by robot and part."""
        found: dict[str, Any] = json.loads(self.recorded.about['robots'])
        return found

    @property
    def fingers(self) -> set[str]:
        """The names of the joints of grippers."""
        return {joint for parts in self.robots.values() for part, joints in parts.items()
                if part.endswith('gripper') for joint in joints}

    @property
    def cameras(self) -> dict[str, str]:
        """The topics of images by camera."""
        return {match['camera']: topic for topic in self.recorded.types
                if (match := _IMAGE.fullmatch(topic))}

    def images(self, camera: str) -> list[NDArray[np.uint8]]:
        """
        Return the images of a camera, at the start and after each period but the last.

        :param camera: its name
        :returns: arrays of shape (height, width, 3), rgb
        :raises RecordError: if one is missing or cannot be read, or they differ in size
        """
        from PIL import Image, UnidentifiedImageError
        topic = self.cameras[camera]
        messages = self.recorded.decoded(topic, 'sensor_msgs/CompressedImage')
        self._check(len(messages), topic)
        try:
            found = [np.asarray(Image.open(io.BytesIO(bytes(m.data)), formats=['JPEG', 'PNG'])
                                .convert('RGB')) for m in messages[:-1]]
        except (UnidentifiedImageError, OSError, ValueError,
                Image.DecompressionBombError) as error:
            raise RecordError(f'an image of {camera} cannot be read: {error}') from error
        if len({image.shape for image in found}) > 1:
            raise RecordError(f'images of {camera} differ in size')
        return found


def _rows(rows: list[Any], topic: str, count: int) -> FloatArray:
    if any(len(row) != count for row in rows):
        raise RecordError(f'{topic} has arrays of different lengths')
    return np.array(rows, dtype=np.float64).reshape(len(rows), count)
