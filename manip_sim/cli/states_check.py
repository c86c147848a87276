# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim check --against``: joint states of another source and the joints of a world."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations, pairwise

import numpy as np

from manip_sim.errors import ManipSimError
from manip_sim.models import World
from manip_sim.models.robots.subsystems import SCALAR
from manip_sim.quoting import quoted, quoted_names
from manip_sim.simulation.start_defect import StartDefect

#: A position is beyond its range if it exceeds it by more than this [rad or m], as noise does.
_TOLERANCE = 0.01


def differences(world: World, topic: str, names: Sequence[str], positions: Sequence[float]
                ) -> tuple[list[StartDefect], list[str]]:
    """
    Compare joint states with the joints of the robots of a world.

    :param topic: on which they came, for the messages
    :param names: of the joints
    :param positions: [rad or m]
    :returns: their defects, and remarks
    """
    ranges = _ranges(world)
    return list(_defects(topic, names, positions, ranges)), list(_remarks(topic, names, ranges))


def _ranges(world: World) -> dict[str, tuple[float, float]]:
    """Return the ranges of the joints of robots, by name in the order of their states."""
    model, ranges = world.compile(), {}
    for name in (name for robot in world.robots for part in (robot, *robot.models)
                 for name in part.joints):
        joint = model.joint(name)
        if int(joint.type[0]) in SCALAR:
            limited = bool(model.jnt_limited[joint.id])
            ranges[name] = tuple(joint.range.tolist()) if limited else (-np.inf, np.inf)
    return ranges


def _defects(topic: str, names: Sequence[str], positions: Sequence[float],
             ranges: Mapping[str, tuple[float, float]]) -> Iterator[StartDefect]:
    unknown = [name for name in dict.fromkeys(names) if name not in ranges]
    missing = [name for name in ranges if name not in names]
    twice = [name for name in dict.fromkeys(names) if list(names).count(name) > 1]
    for joints, text, remedy in (
            (unknown, 'has joints that this robot does not have', 'choose the robot or its prefix '
             f'so that its joints have these names: it has {quoted_names(list(ranges), 8)}'),
            (missing, 'lacks joints of this robot', 'let their source publish them, or choose '
             'another robot, gripper or base'),
            (twice, 'names joints twice', 'let one source publish each joint')):
        if joints:
            yield StartDefect('states', f'{topic} {text}: {quoted_names(joints, 8)}', remedy)
    if len(positions) != len(names):
        yield StartDefect('states', f'{topic} has {len(names)} names and {len(positions)} '
                          'positions', 'let its source publish a position for each joint')
        return
    values = {name: value for name, value in zip(names, positions) if name in ranges}
    beyond = [name for name, value in values.items() if not _within(value, ranges[name])]
    swapped = {name: other for pair in combinations(beyond, 2) for name, other in (
        pair, pair[::-1]) if all(_within(values[a], ranges[b]) for a, b in (pair, pair[::-1]))}
    for name in beyond:
        low, high = ranges[name]
        hint = (f'; {quoted(swapped[name])} is beyond its own too, and each value would fit the '
                'other joint: they may be swapped' if name in swapped else '')
        yield StartDefect(
            'states', f'{topic}: {quoted(name)} is at {values[name]:.4g}, beyond its range from '
            f'{low:.4g} to {high:.4g}{hint}',
            'compare the order of names and positions in its source, its units and its zeros')


def _remarks(topic: str, names: Sequence[str], ranges: Mapping[str, tuple[float, float]]
             ) -> Iterator[str]:
    common = [name for name in names if name in ranges]
    places = {name: place for place, name in enumerate(ranges)}
    moved = next((pair for pair in pairwise(common) if places[pair[0]] > places[pair[1]]), None)
    if moved is not None:
        yield (f'{topic} has {quoted(moved[0])} before {quoted(moved[1])}, this robot after it: a '
               'client that takes positions by their place instead of their names swaps joints')


def _within(value: float, limits: tuple[float, float]) -> bool:
    return limits[0] - _TOLERANCE <= value <= limits[1] + _TOLERANCE


def states_on(topic: str) -> tuple[list[str], list[float]]:
    """
    Return names and positions of the next message on a topic.

    :raises ManipSimError: if ROS is not there, the topic has another type or no message comes
    """
    try:
        from manip_sim.cli.ros_commands import next_message
    except ImportError as error:
        raise ManipSimError(f'--against needs ROS 2: {error}') from error
    message = next_message(topic, 'sensor_msgs/msg/JointState')
    return list(message.name), list(message.position)
