# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What a node offers, found in the names of its topics."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
import re

_GRIPPER = '/gripper'
_DESCRIPTION, _COMMAND = 'robot_description', '/joint_command'
_TARGET, _IMAGE = '/target_pose', '/color/image_raw'
#: An absolute name, and how many topics of a node are looked at.
_NAME = re.compile(r'(/[A-Za-z_][A-Za-z0-9_]*)+')
_MAX_TOPICS = 5000


@dataclass(frozen=True)
class RobotTopics:
    """
    The topics of one robot.

    :ivar space: what their names begin with, such as ``/left/``
    :ivar parts: those that take joint commands and do not overlap
    :ivar end_effectors: the arms that take Cartesian targets
    :ivar drives: whether its base takes a twist
    """

    space: str
    parts: tuple[str, ...]
    end_effectors: tuple[str, ...]
    drives: bool


@dataclass(frozen=True)
class Layout:
    """
    What a node offers.

    :ivar robots: none as long as none is known
    :ivar objects: names of free bodies
    :ivar cameras: names
    """

    robots: tuple[RobotTopics, ...] = ()
    objects: tuple[str, ...] = ()
    cameras: tuple[str, ...] = ()


def layout_of(base: str, published: Collection[str], subscribed: Collection[str]) -> Layout:
    """
    Return what a node offers.

    :param base: namespace of the node, with a slash at its end
    :param published: absolute names of the topics that it publishes
    :param subscribed: absolute names of the topics that it takes; those that are no names of ROS
        are ignored, as is what is too much
    """
    published, subscribed = (sorted(filter(_NAME.fullmatch, names))[:_MAX_TOPICS]
                             for names in (published, subscribed))
    spaces = sorted(name.removesuffix(_DESCRIPTION) for name in published
                    if name.startswith(base) and name.endswith(f'/{_DESCRIPTION}'))
    objects = [parts[1] for name in published if name.startswith(f'{base}objects/')
               and len(parts := name.removeprefix(base).split('/')) == 3 and parts[2] == 'pose']
    cameras = [name.removeprefix(base).removesuffix(_IMAGE) for name in published
               if name.startswith(base) and name.endswith(_IMAGE)]
    # The namespace of a spawned robot is below that of the only one from the start.
    owned = {space: [topic for topic in subscribed if topic.startswith(space) and not any(
        len(other) > len(space) and topic.startswith(other) for other in spaces)]
        for space in spaces}
    return Layout(tuple(_robot(space, owned[space]) for space in spaces), tuple(sorted(objects)),
                  tuple(sorted(cameras)))


def _robot(space: str, subscribed: Collection[str]) -> RobotTopics:
    parts = _named(space, subscribed, _COMMAND)
    end_effectors = _named(space, subscribed, _TARGET)
    # A single arm is also the part right, and of two arms, arm is both.
    double = 'arm' if {'right', 'left'} <= set(parts) else 'right'
    kept = [part for part in parts if part.count('/') <= part.endswith(_GRIPPER)
            and not (part == double and 'arm' in parts)]
    return RobotTopics(space, tuple(sorted(kept, key=_order)),
                       tuple(sorted(end_effectors, reverse=True)),
                       f'{space}base/cmd_vel' in subscribed)


def _named(space: str, topics: Collection[str], end: str) -> list[str]:
    """Return what stands between a beginning and an end in the names of topics."""
    names = [topic[len(space):] for topic in topics if topic.startswith(space)]
    return [name.removesuffix(end) for name in names if name.endswith(end)]


def _order(part: str) -> tuple[int, str]:
    names = ('arm', 'right', 'right/gripper', 'left', 'left/gripper', 'torso', 'base', 'head',
             'legs')
    return names.index(part) if part in names else len(names), part
