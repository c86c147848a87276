# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What a node offers, found in the names of its topics."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
import re

from manip_sim.interface.topics import BY_NAME

_GRIPPER = '/gripper'
_DESCRIPTION = BY_NAME['robot_description'].name
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


def name_of(space: str, row: str, of: str = '') -> str:
    """
    Return the name of a topic.

    :param space: that it begins with, such as ``/left/``
    :param row: its name in the table, such as ``<part>/joint_command``
    :param of: the part, arm, object or camera
    """
    return space + BY_NAME[row].filled_in(of).name


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
    objects = [name for name in _named(base, published, 'objects/<name>/pose') if '/' not in name]
    cameras = _named(base, published, '<camera>/color/image_raw')
    # The namespace of a spawned robot is below that of the only one from the start.
    owned = {space: [topic for topic in subscribed if topic.startswith(space) and not any(
        len(other) > len(space) and topic.startswith(other) for other in spaces)]
        for space in spaces}
    return Layout(tuple(_robot(space, owned[space]) for space in spaces), tuple(sorted(objects)),
                  tuple(sorted(cameras)))


def _robot(space: str, subscribed: Collection[str]) -> RobotTopics:
    parts = _named(space, subscribed, '<part>/joint_command')
    end_effectors = _named(space, subscribed, '<arm>/target_pose')
    # A single arm is also the part right, and of two arms, arm is both.
    double = 'arm' if {'right', 'left'} <= set(parts) else 'right'
    kept = [part for part in parts if part.count('/') <= part.endswith(_GRIPPER)
            and not (part == double and 'arm' in parts)]
    return RobotTopics(space, tuple(sorted(kept, key=_order)),
                       tuple(sorted(end_effectors, reverse=True)),
                       name_of(space, 'base/cmd_vel') in subscribed)


def _named(space: str, topics: Collection[str], row: str) -> list[str]:
    """Return the parts, arms, objects or cameras that have a topic of the table."""
    names = [BY_NAME[row].of_name(topic.removeprefix(space)) for topic in topics
             if topic.startswith(space)]
    return list(filter(None, names))


def _order(part: str) -> tuple[int, str]:
    names = ('arm', 'right', 'right/gripper', 'left', 'left/gripper', 'torso', 'base', 'head',
             'legs')
    return names.index(part) if part in names else len(names), part
